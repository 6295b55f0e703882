/* SPDX-License-Identifier: MIT
 * Writes torso.npy: where the body is in each frame, after the pictures of the step "layers" (docs/formats.md). */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "io/npy.h"
#include "prepare/layers/layers.h"

enum { MEAN_OF = 60 }; /* frames of the mean picture that all frames are compared with */

struct body {
  struct ern_prepare_job *job;
  ern_image torso, parts;             /* of one frame */
  float (*motion)[ERN_MOTION_VALUES]; /* [job->frames] */
};

/* The frame's torso picture, and its parts, of enum ern_layer_part. */
static ern_status read_body(struct body *b, size_t frame) {
  const size_t pixels = (size_t)b->job->side * (size_t)b->job->side;
  char name[64];
  ern_status status = ERN_OK;
  ern_image_free(b->job->context, &b->torso);
  ern_image_free(b->job->context, &b->parts);
  snprintf(name, sizeof name, "torso_imgs/%zu.png", frame);
  ERN_TRY(ern_prepare_picture(b->job, name, 4, &b->torso));
  snprintf(name, sizeof name, "parsing/%zu.png", frame);
  ERN_TRY(ern_prepare_picture(b->job, name, 3, &b->parts));
  for (size_t k = 0; k < pixels; k++) { /* in place: a pixel's byte lies at or before its colour */
    const uint8_t *colour = b->parts.data + 3 * k;
    const bool red = colour[0] > 127, green = colour[1] > 127, blue = colour[2] > 127;
    b->parts.data[k] = red && !green && !blue   ? ERN_PART_TORSO
                       : green && !red && !blue ? ERN_PART_NECK
                                                : ERN_PART_BACKGROUND;
  }
fail:
  return status;
}

/* The frame in which the head is nearest to its mean place. */
static size_t middle_frame(const struct ern_layer_face *faces, size_t count) {
  double mean[2] = {0, 0}, least = INFINITY;
  size_t middle = 0;
  for (size_t f = 0; f < count; f++)
    for (int d = 0; d < 2; d++) mean[d] += (double)faces[f].centre[d] / (double)count;
  for (size_t f = 0; f < count; f++) {
    const double off = hypot((double)faces[f].centre[0] - mean[0], (double)faces[f].centre[1] - mean[1]);
    if (off < least) middle = f;
    least = fmin(least, off);
  }
  return middle;
}

static ern_status write_motion(struct body *b) {
  struct ern_prepare_job *job = b->job;
  char path[ERN_PREPARE_PATH];
  const ern_status status = ern_prepare_register_output(job, "torso.npy", path);
  if (status != ERN_OK) return status;
  return ern_npy_write_f32(job->context, path, b->motion[0], 4,
                           (size_t[]){job->frames, 2, ERN_MOTION_SIDE, ERN_MOTION_SIDE});
}

/* The reference becomes the mean picture of frames that were moved onto it; then again, as they fit a mean better than
 * the single frame that it was at first. */
static ern_status mean_reference(struct body *b, struct ern_body_reference *reference) {
  const size_t frames = b->job->frames, count = frames < MEAN_OF ? frames : MEAN_OF;
  ern_status status = ERN_OK;
  for (int round = 0; round < 2; round++) {
    for (size_t i = 0; i < count; i++) {
      ERN_TRY(read_body(b, count > 1 ? i * (frames - 1) / (count - 1) : 0));
      ERN_TRY(ern_body_reference_add(reference, b->torso.data, b->parts.data));
    }
    ERN_TRY(ern_body_reference_mean(reference));
  }
fail:
  return status;
}

ern_status ern_prepare_body_motion(struct ern_prepare_job *job, const struct ern_layer_face *faces,
                                   const uint8_t *background, size_t done, size_t total) {
  struct body b = {.job = job};
  struct ern_body_reference *reference = NULL;
  size_t known = 0;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(job->context, job->frames, &b.motion));
  ERN_TRY(read_body(&b, middle_frame(faces, job->frames)));
  ERN_TRY(ern_body_reference_make(job->context, job->side, background, b.torso.data, b.parts.data, &reference));
  ERN_TRY(mean_reference(&b, reference));
  for (size_t f = 0; f < job->frames; f++) {
    bool found = false;
    ERN_TRY(read_body(&b, f));
    ERN_TRY(ern_body_reference_find(reference, b.torso.data, b.parts.data, b.motion[f], &found));
    known += found;
    if (!found && f > 0) memcpy(b.motion[f], b.motion[f - 1], sizeof b.motion[f]);
    if (!found && f == 0) memset(b.motion[f], 0, sizeof b.motion[f]);
    ERN_TRY(ern_prepare_progress(job, done + f + 1, total));
  }
  ern_prepare_figure(job, "body_motion_known", (double)known / (double)job->frames);
  if (known > 0) ERN_TRY(write_motion(&b));
fail:
  ern_body_reference_free(reference);
  ern_image_free(job->context, &b.torso);
  ern_image_free(job->context, &b.parts);
  ern_release(job->context, b.motion);
  return status;
}
