/* SPDX-License-Identifier: MIT */
#include "evaluation/dubbed.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "evaluation/picture_measures.h"

enum { JAW_BEGIN = 2, JAW_END = 14 };
static const float band_width = 0.08F; /* on each side of the jaw's line, in face widths: the mask ends in it */

int dubbed_open(struct dubbed *d, struct session *session, ern_clip *clip, struct recorded_picture *recorded) {
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  *d = (struct dubbed){.session = session,
                       .clip = clip,
                       .width = info.width,
                       .height = info.height,
                       .recorded = recorded,
                       .before_id = -2}; /* which no frame follows */
  const size_t pixels = (size_t)info.width * (size_t)info.height;
  const int square[4] = {0, 0, info.width, info.height};
  if (dubbed_frame_open(&d->frame, session, clip, recorded->folder, square) != 0) return EXIT_FAILURE;
  d->grey[0] = malloc(2 * pixels * sizeof *d->grey[0]);
  if (d->grey[0] == NULL) return session_fail_with(session, "no memory for a dubbed frame");
  d->grey[1] = d->grey[0] + pixels;
  return 0;
}

int dubbed_draw(struct dubbed *d, ern_renderer *renderer, const struct frame_source *frame_source, size_t k,
                const ern_frame_input *input, uint8_t *rgba, float *rgb, ern_frame_times *times) {
  const int square[4] = {0, 0, d->width, d->height};
  ern_image recorded;
  if (recorded_picture_read(d->recorded, d->session, frame_source->source_frame[k].pose.img_id, &recorded) != 0)
    return EXIT_FAILURE;
  if (dubbed_frame_draw(&d->frame, renderer, frame_source, k, input, &recorded, square, rgba, times) != ERN_OK)
    return session_fail(d->session);
  const size_t pixels = (size_t)d->width * (size_t)d->height;
  for (size_t i = 0; rgb != NULL && i < pixels; i++)
    for (size_t c = 0; c < 3; c++) rgb[3 * i + c] = (float)rgba[4 * i + c] / 255;
  return 0;
}

/* ---- figures ----------------------------------------------------------------------------------------------------- */

static float distance_to(const float p[2], const float a[2], const float b[2]) {
  const float ab[2] = {b[0] - a[0], b[1] - a[1]}, ap[2] = {p[0] - a[0], p[1] - a[1]};
  const float length = ab[0] * ab[0] + ab[1] * ab[1];
  const float at = length > 0 ? fminf(fmaxf((ap[0] * ab[0] + ap[1] * ab[1]) / length, 0), 1) : 0;
  return hypotf(ap[0] - at * ab[0], ap[1] - at * ab[1]);
}

static bool in_band(const ern_clip_frame *frame, float most, int x, int y) {
  const float p[2] = {(float)x + 0.5F, (float)y + 0.5F}; /* the pixel's centre */
  for (int i = JAW_BEGIN; i < JAW_END; i++)
    if (distance_to(p, frame->landmarks[i], frame->landmarks[i + 1]) <= most) return true;
  return false;
}

static double squared_gradient(const float *grey, int width, size_t i) {
  return hypot((double)(grey[i + 1] - grey[i - 1]), (double)(grey[i + (size_t)width] - grey[i - (size_t)width]));
}

/* Adds pixel i of the band. grey: recorded and dubbed; follows: of the frame after that of d->grey. */
static void add_pixel(struct dubbed *d, const float *const grey[2], const float *rgb, size_t i, bool follows) {
  for (size_t c = 0; c < 3; c++) {
    const double apart = (double)rgb[3 * i + c] - (double)d->recorded->image.data[3 * i + c] / 255;
    d->squares += apart * apart;
  }
  d->values += 3;
  for (size_t k = 0; k < 2; k++) {
    d->gradient[k] += squared_gradient(grey[k], d->width, i);
    if (follows) d->change[k] += fabs((double)(grey[k][i] - d->grey[k][i]));
  }
}

bool dubbed_add(struct dubbed *d, const struct source_frame *source, const float *rgb) {
  const ern_clip_frame *frame = ern_clip_frame_at(d->clip, source->split, source->index);
  const size_t pixels = (size_t)d->width * (size_t)d->height;
  const float most = band_width * hypotf(frame->landmarks[16][0] - frame->landmarks[0][0],
                                         frame->landmarks[16][1] - frame->landmarks[0][1]);
  const int *drawn = d->frame.box;
  float *made = malloc(2 * pixels * sizeof *made);
  if (made == NULL) return false;
  const float *const grey[2] = {made, made + pixels};
  d->left += drawn[2] == 0;
  grey_of_bytes(made, d->recorded->image.data, pixels);
  grey_of_colours(made + pixels, rgb, pixels);
  if (drawn[2] > 0) {
    const ern_box box = {
        .top = drawn[1], .bottom = drawn[1] + drawn[3], .left = drawn[0], .right = drawn[0] + drawn[2]};
    d->lower_face += ern_psnr(rgb, d->recorded->image.data, d->width, d->height, &box);
    d->frames++;
    for (int y = box.top > 1 ? box.top : 1; y < box.bottom && y < d->height - 1; y++)
      for (int x = box.left > 1 ? box.left : 1; x < box.right && x < d->width - 1; x++)
        if (in_band(frame, most, x, y))
          add_pixel(d, grey, rgb, (size_t)y * (size_t)d->width + (size_t)x,
                    d->before_id >= 0 && source->pose.img_id == d->before_id + 1);
  }
  memcpy(d->grey[0], made, 2 * pixels * sizeof *made);
  d->before_id = drawn[2] > 0 ? source->pose.img_id : -2;
  free(made);
  return true;
}

/* NaN: not known. */
struct figures {
  double lower_face, band, seam, flicker;
};
static struct figures figures_of(const struct dubbed *d) {
  return (struct figures){.lower_face = d->frames > 0 ? d->lower_face / (double)d->frames : NAN,
                          .band = d->values > 0 ? -10 * log10(fmax(d->squares / (double)d->values, 1e-10)) : NAN,
                          .seam = d->gradient[0] > 0 ? d->gradient[1] / d->gradient[0] : NAN,
                          .flicker = d->change[0] > 0 ? d->change[1] / d->change[0] : NAN};
}

void dubbed_print(const struct dubbed *d) {
  const struct figures f = figures_of(d);
  printf("dubbed: lower face PSNR %.3f dB, jaw band %.3f dB, its gradient %.3f and its flicker %.3f of the recording's",
         f.lower_face, f.band, f.seam, f.flicker);
  printf("; left as recorded: %zu\n", d->left);
}

json_t *dubbed_json(const struct dubbed *d) {
  const struct figures f = figures_of(d);
  return json_pack("{s:o, s:o, s:o, s:o, s:I}", "psnr_lower_face", session_number(f.lower_face), "psnr_jaw_band",
                   session_number(f.band), "seam_gradient", session_number(f.seam), "flicker",
                   session_number(f.flicker), "left", (json_int_t)d->left);
}

void dubbed_close(struct dubbed *d) {
  if (d->session == NULL) return;
  dubbed_frame_close(&d->frame);
  free(d->grey[0]);
}
