/* SPDX-License-Identifier: MIT
 * Whether the template's landmarks lie beside the mouth, which is where the lower face has another colour than skin:
 * red lips, dark or bright between them. */
#include "prepare/landmarks/mouth_aside.h"

#include <math.h>
#include <stdio.h>

#include "prepare/stabilized_crop.h"

enum { COLUMNS = 71, ROWS = 51, PIXELS = COLUMNS * ROWS, PLANES = 2 };
static const double step = 0.001, under = 0.005; /* metres; of the crop's middle below the mouth's line */
/* Metres, and a share of the frames. Of twelve speakers the mouth was farther aside in 0 to 8 % of the frames, of a
 * singer in 14 %, of two who make faces in 13 and 49 %. */
static const double far_aside = 0.004, most_share = 0.08;
static const double most_turn = 10; /* degrees: with more the far cheek's edge comes near */

struct looking {
  struct ern_prepare_job *job;
  struct ern_stabilized_crop crop;
  uint8_t *plane[PLANES];       /* [side][side]: grey (BT.601); 255 R/(R + G), which is more in lips than in skin */
  float values[PLANES][PIXELS]; /* their crops */
  float sorted[PIXELS];
};

static ern_status read_planes(struct looking *l, size_t frame) {
  char name[64];
  ern_image image = {0};
  snprintf(name, sizeof name, "ori_imgs/%zu.jpg", frame);
  const ern_status status = ern_prepare_picture(l->job, name, 3, &image);
  if (status != ERN_OK) return status;
  const size_t count = (size_t)image.width * (size_t)image.height;
  for (size_t i = 0; i < count; i++) {
    const uint8_t *p = image.data + 3 * i;
    l->plane[0][i] = (uint8_t)((77 * p[0] + 150 * p[1] + 29 * p[2] + 128) >> 8);
    l->plane[1][i] = (uint8_t)(255 * p[0] / (p[0] + p[1] + 1));
  }
  ern_image_free(l->job->context, &image);
  return ERN_OK;
}

static float median(struct looking *l, const float *values) {
  for (int i = 0; i < PIXELS; i++) l->sorted[i] = values[i];
  return ern_quantile(l->sorted, PIXELS, 0.5);
}

/* 1 within 28 x 14 mm of the mouth, which is 2 mm below its line, and less outside. */
static double window(int r, int c) {
  const double x = fabs(c - 0.5 * (COLUMNS - 1)) * step - 0.028, y = fabs((r - 22) * step) - 0.014;
  return exp(-0.5 * (pow(fmax(x, 0) / 0.004, 2) + pow(fmax(y, 0) / 0.004, 2)));
}

/* Metres by which the centre of the values above `least` is aside of the crop's middle. */
static double centre(const float *values, float least) {
  double sum = 0, weight = 1e-6;
  for (int r = 0; r < ROWS; r++)
    for (int c = 0; c < COLUMNS; c++) {
      const double w = window(r, c) * fmax((double)(values[r * COLUMNS + c] - least), 0);
      sum += w * (c - 0.5 * (COLUMNS - 1)) * step;
      weight += w;
    }
  return sum / weight;
}

/* The places of what is redder than skin and of what is unlike skin, metres aside of the mouth at rest. */
static void look(struct looking *l, const struct ern_head_pose *pose, float *red, float *unlike) {
  float *const grey = l->values[0], *const hue = l->values[1];
  for (int k = 0; k < PLANES; k++) ern_stabilized_crop_take(&l->crop, pose, l->job, l->plane[k], l->values[k]);
  const float skin_grey = median(l, grey), skin_hue = median(l, hue);
  *red = (float)centre(hue, skin_hue + 2.5f);
  for (int i = 0; i < PIXELS; i++) grey[i] = hypotf(grey[i] - skin_grey, 4 * (hue[i] - skin_hue));
  *unlike = (float)centre(grey, 1.5f * median(l, grey));
}

static double yaw(const struct ern_head_pose *pose) {
  return atan2(pose->rotation[0][2], pose->rotation[2][2]) * 57.29577951308232;
}

/* The number of frames in which both places are `far_aside` from their medians, on one side. */
static size_t count_aside(float *red, float *unlike, float *sorted, size_t n) {
  float *const places[] = {red, unlike};
  size_t aside = 0;
  for (int k = 0; k < 2; k++) {
    for (size_t i = 0; i < n; i++) sorted[i] = places[k][i];
    const float rest = ern_quantile(sorted, n, 0.5);
    for (size_t i = 0; i < n; i++) places[k][i] -= rest;
  }
  for (size_t i = 0; i < n; i++)
    aside += red[i] * unlike[i] > 0 && fmin(fabs((double)red[i]), fabs((double)unlike[i])) > far_aside;
  return aside;
}

ern_status ern_landmarks_check_aside(struct ern_prepare_job *job, const struct ern_head_pose *poses, double x, double y,
                                     size_t done, size_t total) {
  ern_status status = ERN_OK;
  const size_t frames = job->frames, pixels = (size_t)job->side * (size_t)job->side;
  struct looking *l = NULL;
  float *red = NULL, *unlike = NULL, *sorted = NULL;
  size_t n = 0;
  ERN_TRY(ERN_NEW(job->context, 1, &l));
  l->job = job;
  l->crop = (struct ern_stabilized_crop){.x = x, .y = y - under, .step = step, .columns = COLUMNS, .rows = ROWS};
  for (int k = 0; k < PLANES; k++) ERN_TRY(ERN_NEW(job->context, pixels, &l->plane[k]));
  ERN_TRY(ERN_NEW(job->context, frames, &red));
  ERN_TRY(ERN_NEW(job->context, frames, &unlike));
  ERN_TRY(ERN_NEW(job->context, frames, &sorted));
  for (size_t i = 0; i < frames; i++) sorted[i] = (float)yaw(&poses[i]);
  const double ahead = (double)ern_quantile(sorted, frames, 0.5);
  for (size_t i = 0; i < frames; i++) {
    ERN_TRY(ern_prepare_progress(job, done + i, total));
    if (fabs(yaw(&poses[i]) - ahead) > most_turn) continue;
    ERN_TRY(read_planes(l, i));
    look(l, &poses[i], &red[n], &unlike[n]);
    n++;
  }
  const size_t aside = count_aside(red, unlike, sorted, n);
  ern_prepare_figure(job, "mouth_aside", (double)aside / (double)frames);
  if ((double)aside > most_share * (double)frames)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "the mouth is more than %.0f mm beside its landmarks in %zu of %zu frames, expected %.0f %% "
                           "of them at most: they open along one line and do not follow a mouth that is drawn "
                           "sideways; --landmarks takes points of another program or network, --from and --to choose "
                           "a part",
                           1000 * far_aside, aside, frames, 100 * most_share);
fail:
  for (int k = 0; k < PLANES && l != NULL; k++) ern_release(job->context, l->plane[k]);
  ern_release(job->context, l);
  ern_release(job->context, red);
  ern_release(job->context, unlike);
  ern_release(job->context, sorted);
  return status;
}
