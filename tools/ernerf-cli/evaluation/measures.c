/* SPDX-License-Identifier: MIT */
#include "evaluation/measures.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "ernerf/render.h"
#include "evaluation/regions.h"
#include "session/session.h"

bool measures_add(struct measures *m, const ern_clip_frame *frame, int width, int height, const uint8_t *truth,
                  const float *rendered) {
  const size_t pixels = (size_t)width * (size_t)height;
  float *grey = malloc(2 * pixels * sizeof *grey), *drawn = grey + pixels;
  ern_box box;
  if (grey == NULL) return false;
  grey_of_bytes(grey, truth, pixels);
  grey_of_colours(drawn, rendered, pixels);
  if (region_head(frame, width, height, &box)) {
    m->head_truth += gradient_energy(grey, width, height, &box);
    m->head_rendered += gradient_energy(drawn, width, height, &box);
  }
  if (region_mouth(frame, width, height, &box)) {
    m->mouth_truth += gradient_energy(grey, width, height, &box);
    m->mouth_rendered += gradient_energy(drawn, width, height, &box);
  }
  if (region_eyes(frame, width, height, &box)) {
    const int shut = frame->eye >= 0.5f;
    m->eyes[shut] += ern_psnr(rendered, truth, width, height, &box);
    m->eye_frames[shut]++;
  }
  (void)neck_difference(frame, grey, drawn, width, height, &m->neck, &m->neck_pixels);
  const bool added = mouth_motion_add(&m->mouth, frame, width, height, grey, drawn);
  if (m->flow != NULL && tremble_add(&m->tremble, m->flow, frame, width, height, grey, drawn) != ERN_OK) m->flow = NULL;
  free(grey);
  return added;
}

static double mean_of(double sum, size_t count) { return count > 0 ? sum / (double)count : NAN; }

struct measures_figures measures_figures(const struct measures *m) {
  return (struct measures_figures){
      .mouth = mouth_motion_figures(&m->mouth),
      .sharpness_head = m->head_truth > 0 ? m->head_rendered / m->head_truth : NAN,
      .sharpness_mouth = m->mouth_truth > 0 ? m->mouth_rendered / m->mouth_truth : NAN,
      .eyes = {mean_of(m->eyes[0], m->eye_frames[0]), mean_of(m->eyes[1], m->eye_frames[1])},
      .eye_frames = {m->eye_frames[0], m->eye_frames[1]},
      .seam = m->neck_pixels > 0 ? 255 * sqrt(m->neck / (double)m->neck_pixels) : NAN,
      .tremble = m->flow != NULL ? tremble_ratio(&m->tremble) : NAN};
}

void measures_print(const struct measures_figures *f) {
  if (f->mouth.known)
    printf("mouth: %.1f %% of its motion, correlation %.2f, amplitude %.2f\n", 100 * f->mouth.explained,
           f->mouth.correlation, f->mouth.amplitude);
  else
    printf("mouth: its motion cannot be measured without landmarks of three frames in which it moves\n");
  if (isfinite(f->sharpness_head) && isfinite(f->sharpness_mouth))
    printf(
        "sharpness relative to the recorded frames: head %.2f, mouth "
        "%.2f\n",
        f->sharpness_head, f->sharpness_mouth);
  static const char *const lids[2] = {"open", "shut"};
  for (int shut = 0; shut < 2; shut++)
    if (f->eye_frames[shut] > 0)
      printf("eyes, %s: PSNR %.3f dB, %zu frames\n", lids[shut], f->eyes[shut], f->eye_frames[shut]);
  if (isfinite(f->seam)) printf("seam: the neck under the jaw is off by %.1f of 255\n", f->seam);
  if (isfinite(f->tremble))
    printf("tremble: the face moves %.2f times as unevenly as the recorded one\n", f->tremble);
  else
    printf("tremble: cannot be measured without libernerf-vision and landmarks of three frames in a row\n");
}

json_t *measures_json(const struct measures_figures *f) {
  json_t *mouth = f->mouth.known
                      ? json_pack("{s:o, s:o, s:o}", "explained", session_number(f->mouth.explained), "correlation",
                                  session_number(f->mouth.correlation), "amplitude", session_number(f->mouth.amplitude))
                      : json_null();
  json_t *eyes =
      json_pack("{s:o, s:I, s:o, s:I}", "psnr_open", session_number(f->eyes[0]), "open", (json_int_t)f->eye_frames[0],
                "psnr_shut", session_number(f->eyes[1]), "shut", (json_int_t)f->eye_frames[1]);
  return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "mouth_motion", mouth, "eyes", eyes, "sharpness_head",
                   session_number(f->sharpness_head), "sharpness_mouth", session_number(f->sharpness_mouth), "seam",
                   session_number(f->seam), "tremble", session_number(f->tremble));
}

void measures_free(struct measures *m) {
  mouth_motion_free(&m->mouth);
  tremble_free(&m->tremble);
  *m = (struct measures){0};
}
