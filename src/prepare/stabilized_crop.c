/* SPDX-License-Identifier: MIT */
#include "prepare/stabilized_crop.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "prepare/head_shape.h"

ern_status ern_frame_grey(const struct ern_prepare_job *job, size_t frame, uint8_t *grey) {
  char name[64];
  ern_image image = {0};
  snprintf(name, sizeof name, "ori_imgs/%zu.jpg", frame);
  const ern_status status = ern_prepare_picture(job, name, 3, &image);
  if (status != ERN_OK) return status;
  const size_t count = (size_t)image.width * (size_t)image.height;
  for (size_t i = 0; i < count; i++) { /* BT.601 */
    const uint8_t *p = image.data + 3 * i;
    grey[i] = (uint8_t)((77 * p[0] + 150 * p[1] + 29 * p[2] + 128) >> 8);
  }
  ern_image_free(job->context, &image);
  return ERN_OK;
}

/* Bilinear sample with the edge repeated; coordinates count from pixel corners, so the first pixel's centre is 0.5. */
static float sample(const uint8_t *grey, int side, double x, double y) {
  const double u = fmin(fmax(x - 0.5, 0), side - 1.001), v = fmin(fmax(y - 0.5, 0), side - 1.001);
  const size_t i = (size_t)u, k = (size_t)v;
  const double a = u - (double)i, b = v - (double)k;
  const uint8_t *p = grey + k * (size_t)side + i, *q = p + side;
  return (float)((1 - b) * ((1 - a) * p[0] + a * p[1]) + b * ((1 - a) * q[0] + a * q[1]));
}

void ern_stabilized_crop_take(const struct ern_stabilized_crop *crop, const struct ern_head_pose *pose,
                              const struct ern_prepare_job *job, const uint8_t *grey, float *values) {
  for (int r = 0; r < crop->rows; r++)
    for (int c = 0; c < crop->columns; c++) {
      const double x = crop->x + (c - 0.5 * (crop->columns - 1)) * crop->step;
      const double y = crop->y - (r - 0.5 * (crop->rows - 1)) * crop->step;
      const double point[3] = {x, y, ern_head_surface(x, y)};
      double pixel[2] = {0, 0};
      (void)ern_head_project(pose, job->focal, 0.5 * job->side, point, pixel);
      values[r * crop->columns + c] = sample(grey, job->side, pixel[0], pixel[1]);
    }
}

static int rising(const void *a, const void *b) {
  const float x = *(const float *)a, y = *(const float *)b;
  return (x > y) - (x < y);
}

float ern_quantile(float *values, size_t count, double share) {
  if (count == 0) return NAN;
  qsort(values, count, sizeof *values, rising);
  const size_t at = (size_t)(share * (double)(count - 1) + 0.5);
  return values[at < count ? at : count - 1];
}
