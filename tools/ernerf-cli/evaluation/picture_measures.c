/* SPDX-License-Identifier: MIT */
#include "evaluation/picture_measures.h"

#include <math.h>

enum { JAW_BEGIN = 4, JAW_END = 12, RIGHT_EYE = 36, LEFT_EYE = 42, EYES_END = 48 };

static const double band_height = 0.35; /* eye distances */

static float grey(double r, double g, double b) { return (float)(0.299 * r + 0.587 * g + 0.114 * b); }

void grey_of_bytes(float *out, const uint8_t *rgb, size_t pixels) {
  for (size_t i = 0; i < pixels; i++) out[i] = grey(rgb[3 * i] / 255.0, rgb[3 * i + 1] / 255.0, rgb[3 * i + 2] / 255.0);
}

void grey_of_colours(float *out, const float *rgb, size_t pixels) {
  for (size_t i = 0; i < pixels; i++) out[i] = grey((double)rgb[3 * i], (double)rgb[3 * i + 1], (double)rgb[3 * i + 2]);
}

double gradient_energy(const float *picture, int width, int height, const ern_box *box) {
  const int left = box->left > 1 ? box->left : 1, right = box->right < width - 1 ? box->right : width - 1;
  const int top = box->top > 1 ? box->top : 1, bottom = box->bottom < height - 1 ? box->bottom : height - 1;
  double sum = 0;
  for (int j = top; j < bottom; j++)
    for (int i = left; i < right; i++) {
      const float *at = picture + (size_t)j * (size_t)width + (size_t)i;
      const double across = ((double)at[1] - (double)at[-1]) / 2, down = ((double)at[width] - (double)at[-width]) / 2;
      sum += across * across + down * down;
    }
  return sum;
}

static double eye_distance(const ern_clip_frame *frame) {
  double between[2] = {0, 0};
  for (int axis = 0; axis < 2; axis++)
    for (int i = RIGHT_EYE; i < EYES_END; i++)
      between[axis] += (i < LEFT_EYE ? -1 : 1) * (double)frame->landmarks[i][axis] / 6;
  return hypot(between[0], between[1]);
}

/* The jaw's y at column x; NaN outside the jaw line. */
static double jaw_at(const ern_clip_frame *frame, double x) {
  for (int i = JAW_BEGIN; i < JAW_END; i++) {
    const double x0 = (double)frame->landmarks[i][0], x1 = (double)frame->landmarks[i + 1][0];
    if (!(x >= fmin(x0, x1) && x <= fmax(x0, x1) && x0 != x1)) continue;
    const double share = (x - x0) / (x1 - x0);
    return (1 - share) * (double)frame->landmarks[i][1] + share * (double)frame->landmarks[i + 1][1];
  }
  return NAN;
}

bool neck_difference(const ern_clip_frame *frame, const float *truth, const float *rendered, int width, int height,
                     double *sum, size_t *count) {
  if (!frame->has_landmarks) return false;
  const double down = band_height * eye_distance(frame);
  size_t found = 0;
  for (int i = 0; i < width; i++) {
    const double jaw = jaw_at(frame, i + 0.5);
    if (isnan(jaw)) continue;
    for (int j = jaw > 0 ? (int)jaw : 0; j < jaw + down && j < height; j++) {
      const size_t at = (size_t)j * (size_t)width + (size_t)i;
      *sum += pow((double)rendered[at] - (double)truth[at], 2);
      found++;
    }
  }
  *count += found;
  return found > 0;
}
