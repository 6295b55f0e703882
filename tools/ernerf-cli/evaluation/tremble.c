/* SPDX-License-Identifier: MIT */
#include "evaluation/tremble.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "evaluation/regions.h"

static bool reserve(struct tremble *t, size_t pixels) {
  if (t->pixels == pixels) return true;
  tremble_free(t);
  t->flow = malloc(2 * pixels * sizeof *t->flow);
  bool made = t->flow != NULL;
  for (int k = 0; k < TREMBLE_KINDS; k++) made &= (t->last[k] = malloc(pixels)) != NULL;
  t->pixels = made ? pixels : 0;
  return made;
}

static void to_bytes(uint8_t *bytes, const float *grey, size_t pixels) {
  for (size_t i = 0; i < pixels; i++) bytes[i] = (uint8_t)lrintf(255 * fminf(fmaxf(grey[i], 0), 1));
}

static bool inside(const ern_box *box, int x, int y) {
  return x >= box->left && x < box->right && y >= box->top && y < box->bottom;
}

/* The mean flow of the face. */
static void mean_motion(const float *flow, const ern_clip_frame *frame, int width, int height, double motion[2]) {
  ern_box face, mouth = {0}, eyes = {0};
  size_t count = 0;
  motion[0] = motion[1] = 0;
  (void)region_head(frame, width, height, &face);
  (void)region_mouth(frame, width, height, &mouth);
  (void)region_eyes(frame, width, height, &eyes);
  for (int y = face.top; y < face.bottom; y++)
    for (int x = face.left; x < face.right; x++) {
      if (inside(&mouth, x, y) || inside(&eyes, x, y)) continue;
      const float *at = flow + 2 * ((size_t)y * (size_t)width + (size_t)x);
      motion[0] += (double)at[0];
      motion[1] += (double)at[1];
      count++;
    }
  for (int axis = 0; axis < 2; axis++) motion[axis] /= count > 0 ? (double)count : 1;
}

ern_status tremble_add(struct tremble *t, ern_context *context, const ern_clip_frame *frame, int width, int height,
                       const float *truth, const float *rendered) {
  const size_t pixels = (size_t)width * (size_t)height;
  const float *const grey[] = {truth, rendered};
  ern_box face;
  if (!region_head(frame, width, height, &face)) {
    t->frames = 0;
    return ERN_OK;
  }
  if (!reserve(t, pixels)) return ERN_E_NO_MEMORY;
  if (frame->pose.aud_id != t->time + 1) t->frames = 0;
  uint8_t *now = malloc(pixels);
  ern_status status = now != NULL ? ERN_OK : ERN_E_NO_MEMORY;
  for (int k = 0; k < TREMBLE_KINDS && status == ERN_OK; k++) {
    double motion[2] = {0};
    to_bytes(now, grey[k], pixels);
    if (t->frames > 0) status = ern_optical_flow(context, t->last[k], now, width, height, t->flow);
    if (t->frames > 0 && status == ERN_OK) mean_motion(t->flow, frame, width, height, motion);
    for (int axis = 0; axis < 2; axis++) {
      if (t->frames > 1) t->uneven[k] += pow(motion[axis] - t->motion[k][axis], 2);
      t->motion[k][axis] = motion[axis];
    }
    memcpy(t->last[k], now, pixels);
  }
  t->count += t->frames > 1;
  t->frames++;
  t->time = frame->pose.aud_id;
  free(now);
  return status;
}

double tremble_ratio(const struct tremble *t) {
  return t->count > 0 && t->uneven[TREMBLE_TRUE] > 0 ? sqrt(t->uneven[TREMBLE_RENDERED] / t->uneven[TREMBLE_TRUE])
                                                     : NAN;
}

void tremble_free(struct tremble *t) {
  for (int k = 0; k < TREMBLE_KINDS; k++) free(t->last[k]);
  free(t->flow);
  *t = (struct tremble){0};
}
