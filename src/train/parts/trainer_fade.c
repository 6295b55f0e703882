/* SPDX-License-Identifier: MIT */
#include "train/parts/trainer_fade.h"

#include <math.h>
#include <string.h>

#include "train/parts/trainer_data.h"

/* From the lips (0) to the eyes (1): the base of the nose and the top of its bridge, landmarks 33 and 27, in eight
 * clips within 0.01. */
static const double base_of_nose = 0.31, top_of_nose = 1.07;

/* Pulls a point along its rays toward the head's middle, where the frames do not tell its depth. */
static const double ridge = 1e-3;

/* Sums over rays o + t d of A = I - d d^T and of A o: the point x that is nearest to all solves (sum A) x = sum A o. */
struct rays {
  double a[3][3], b[3];
  size_t count;
};

static void add_ray(struct rays *rays, const struct ern_view *view, const ern_box *box) {
  if (box->right <= box->left || box->bottom <= box->top) return; /* not known */
  const double x = (0.5 * ((double)box->left + box->right + 1) - (double)view->cx) / (double)view->focal,
               y = (0.5 * ((double)box->top + box->bottom + 1) - (double)view->cy) / (double)view->focal,
               length = sqrt(x * x + y * y + 1);
  double d[3];
  for (int r = 0; r < 3; r++) {
    const float *row = view->pose + 4 * r;
    d[r] = ((double)row[0] * x + (double)row[1] * y + (double)row[2]) / length;
  }
  for (int r = 0; r < 3; r++) {
    for (int c = 0; c < 3; c++) {
      const double a = (r == c ? 1 : 0) - d[r] * d[c];
      rays->a[r][c] += a;
      rays->b[r] += a * (double)view->pose[4 * c + 3];
    }
  }
  rays->count++;
}

static double determinant(double a[3][3]) {
  return a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) - a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0]) +
         a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
}

/* x_0 of the nearest point, by Cramer's rule. */
static double height_of(const struct rays *rays) {
  double a[3][3], replaced[3][3];
  memcpy(a, rays->a, sizeof a);
  for (int r = 0; r < 3; r++) a[r][r] += ridge * (double)rays->count;
  memcpy(replaced, a, sizeof a);
  for (int r = 0; r < 3; r++) replaced[r][0] = rays->b[r];
  return determinant(replaced) / determinant(a);
}

ern_status ern_trainer_fade_find(struct ern_training *t) {
  float *fade = t->model->field.config.voice_fade;
  struct rays lips = {.count = 0}, eyes = {.count = 0};
  fade[0] = fade[1] = 0;
  if (!ern_field_attends(&t->model->field)) return ERN_OK;
  for (size_t i = t->config.data_begin; i < t->config.data_end; i++) {
    ern_dataset_frame about;
    const ern_status status = ern_trainer_frame(t, 0, i, &about);
    if (status != ERN_OK) return status;
    if (!about.has_face) continue;
    add_ray(&lips, &t->views[i], &about.lips);
    add_ray(&eyes, &t->views[i], &about.eyes);
  }
  if (lips.count == 0 || eyes.count == 0) return ERN_OK;
  const double from = height_of(&lips), way = height_of(&eyes) - from, bound = (double)t->config.bound;
  const double begin = from + base_of_nose * way, end = from + top_of_nose * way;
  if (!(way > 0 && begin >= -bound && end <= bound)) return ERN_OK; /* no face that is upright in the head's frame */
  fade[0] = (float)begin;
  fade[1] = (float)end;
  return ERN_OK;
}

void ern_trainer_fade_follow(struct ern_training *t, const ern_model *model, const char *path) {
  if (ern_field_fades(&model->field) && !t->config.voice_fade && !t->config.torso)
    ern_log(t->context, ERN_LOG_WARNING,
            "%s: voice_fade is no, but its voice ends above the nose, and goes on so: only a new training is without",
            path);
  if (!ern_field_fades(&model->field) && ern_field_fades(&t->model->field))
    ern_log(t->context, ERN_LOG_INFO, "%s: its voice reaches the whole head, and goes on so, without voice_fade", path);
  memcpy(t->model->field.config.voice_fade, model->field.config.voice_fade, sizeof model->field.config.voice_fade);
}
