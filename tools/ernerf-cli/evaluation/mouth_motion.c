/* SPDX-License-Identifier: MIT */
#include "evaluation/mouth_motion.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { RIGHT_EYE = 36, LEFT_EYE = 42, EYES_END = 48, MOUTH_BEGIN = 48, LANDMARKS = 68, SAMPLES = 3 /* a side */ };

static const double crop_width = 1.24, crop_above = 0.34, crop_below = 0.465; /* eye distances */

/* Pixels of a picture, its corner at (0, 0). */
struct crop {
  double left, top, width, height;
};

static void mean_point(const ern_clip_frame *frame, int begin, int end, double point[2]) {
  for (int axis = 0; axis < 2; axis++) {
    point[axis] = 0;
    for (int i = begin; i < end; i++) point[axis] += (double)frame->landmarks[i][axis] / (end - begin);
  }
}

static bool find_crop(const ern_clip_frame *frame, int width, int height, struct crop *crop) {
  double right[2], left[2], mouth[2];
  if (!frame->has_landmarks) return false;
  mean_point(frame, RIGHT_EYE, LEFT_EYE, right);
  mean_point(frame, LEFT_EYE, EYES_END, left);
  mean_point(frame, MOUTH_BEGIN, LANDMARKS, mouth);
  const double eyes = hypot(left[0] - right[0], left[1] - right[1]);
  *crop = (struct crop){.left = mouth[0] - crop_width / 2 * eyes,
                        .top = mouth[1] - crop_above * eyes,
                        .width = crop_width * eyes,
                        .height = (crop_above + crop_below) * eyes};
  return eyes >= 4 && crop->left >= 0 && crop->top >= 0 && crop->left + crop->width <= width &&
         crop->top + crop->height <= height;
}

/* Bilinear interpolation between pixel centres; outside the picture the nearest pixel. */
static double sample(const float *grey, int width, int height, double x, double y) {
  const double cx = fmin(fmax(x - 0.5, 0), width - 1), cy = fmin(fmax(y - 0.5, 0), height - 1);
  const int i = (int)cx, j = (int)cy, i1 = i + 1 < width ? i + 1 : i, j1 = j + 1 < height ? j + 1 : j;
  const double u = cx - i, v = cy - j;
  const float *above = grey + (size_t)j * (size_t)width, *below = grey + (size_t)j1 * (size_t)width;
  return (1 - v) * ((1 - u) * (double)above[i] + u * (double)above[i1]) +
         v * ((1 - u) * (double)below[i] + u * (double)below[i1]);
}

static void take_crop(const struct crop *crop, const float *grey, int width, int height, float *out) {
  for (int j = 0; j < MOUTH_HEIGHT; j++)
    for (int i = 0; i < MOUTH_WIDTH; i++) {
      double sum = 0;
      for (int k = 0; k < SAMPLES * SAMPLES; k++) {
        const double x = i + (k % SAMPLES + 0.5) / SAMPLES, y = j + ((double)(k / SAMPLES) + 0.5) / SAMPLES;
        sum += sample(grey, width, height, crop->left + crop->width * x / MOUTH_WIDTH,
                      crop->top + crop->height * y / MOUTH_HEIGHT);
      }
      out[j * MOUTH_WIDTH + i] = (float)(sum / (SAMPLES * SAMPLES));
    }
}

static bool reserve(struct mouth_motion *motion) {
  if (motion->count < motion->capacity) return true;
  const size_t capacity = 2 * motion->capacity + 64, bytes = capacity * MOUTH_PIXELS * sizeof(float);
  float *truth = realloc(motion->truth, bytes);
  if (truth != NULL) motion->truth = truth;
  float *rendered = realloc(motion->rendered, bytes);
  if (rendered != NULL) motion->rendered = rendered;
  if (truth == NULL || rendered == NULL) return false;
  motion->capacity = capacity;
  return true;
}

bool mouth_motion_add(struct mouth_motion *motion, const ern_clip_frame *frame, int width, int height,
                      const float *truth, const float *rendered) {
  struct crop crop;
  if (!find_crop(frame, width, height, &crop)) return true;
  if (!reserve(motion)) return false;
  take_crop(&crop, truth, width, height, motion->truth + motion->count * MOUTH_PIXELS);
  take_crop(&crop, rendered, width, height, motion->rendered + motion->count * MOUTH_PIXELS);
  motion->count++;
  return true;
}

static void mean_crop(const float *crops, size_t count, double mean[MOUTH_PIXELS]) {
  memset(mean, 0, MOUTH_PIXELS * sizeof *mean);
  for (size_t k = 0; k < count; k++)
    for (int i = 0; i < MOUTH_PIXELS; i++) mean[i] += (double)crops[k * MOUTH_PIXELS + (size_t)i] / (double)count;
}

static double project(const float *crop, const double mean[MOUTH_PIXELS], const double axis[MOUTH_PIXELS]) {
  double sum = 0;
  for (int i = 0; i < MOUTH_PIXELS; i++) sum += ((double)crop[i] - mean[i]) * axis[i];
  return sum;
}

/* Power iteration from the frame that is farthest from the mean. */
static void principal_axis(const struct mouth_motion *m, const double mean[MOUTH_PIXELS], double axis[MOUTH_PIXELS]) {
  enum { ROUNDS = 100 };
  double farthest = -1;
  for (size_t k = 0; k < m->count; k++) {
    double away = 0;
    const float *crop = m->truth + k * MOUTH_PIXELS;
    for (int i = 0; i < MOUTH_PIXELS; i++) away += pow((double)crop[i] - mean[i], 2);
    if (away <= farthest) continue;
    farthest = away;
    for (int i = 0; i < MOUTH_PIXELS; i++) axis[i] = (double)crop[i] - mean[i];
  }
  for (int round = 0; round < ROUNDS; round++) {
    double next[MOUTH_PIXELS] = {0}, length = 0;
    for (size_t k = 0; k < m->count; k++) {
      const float *crop = m->truth + k * MOUTH_PIXELS;
      const double along = project(crop, mean, axis);
      for (int i = 0; i < MOUTH_PIXELS; i++) next[i] += along * ((double)crop[i] - mean[i]);
    }
    for (int i = 0; i < MOUTH_PIXELS; i++) length += next[i] * next[i];
    for (int i = 0; i < MOUTH_PIXELS && length > 0; i++) axis[i] = next[i] / sqrt(length);
  }
}

struct mouth_figures mouth_motion_figures(const struct mouth_motion *m) {
  struct mouth_figures figures = {.known = false};
  double p[MOUTH_PIXELS], q[MOUTH_PIXELS], axis[MOUTH_PIXELS], moved = 0, missed = 0, pp = 0, qq = 0, pq = 0;
  if (m->count < 3) return figures;
  mean_crop(m->truth, m->count, p);
  mean_crop(m->rendered, m->count, q);
  for (size_t k = 0; k < m->count * MOUTH_PIXELS; k++) {
    const double truth = (double)m->truth[k] - p[k % MOUTH_PIXELS],
                 drawn = (double)m->rendered[k] - q[k % MOUTH_PIXELS];
    moved += truth * truth;
    missed += (truth - drawn) * (truth - drawn);
  }
  /* an RMS below a hundredth of a grey level counts as no motion */
  if (!(moved > 1e-4 / 255 / 255 * (double)(m->count * MOUTH_PIXELS))) return figures;
  principal_axis(m, p, axis);
  for (size_t k = 0; k < m->count; k++) {
    const double truth = project(m->truth + k * MOUTH_PIXELS, p, axis),
                 drawn = project(m->rendered + k * MOUTH_PIXELS, q, axis);
    pp += truth * truth;
    qq += drawn * drawn;
    pq += truth * drawn;
  }
  figures.known = true;
  figures.explained = 1 - missed / moved;
  figures.correlation = qq > 1e-10 * pp ? pq / sqrt(pp * qq) : NAN; /* rounding errors do not count as motion */
  figures.amplitude = sqrt(qq / pp);
  return figures;
}

void mouth_motion_free(struct mouth_motion *motion) {
  free(motion->truth);
  free(motion->rendered);
  *motion = (struct mouth_motion){0};
}
