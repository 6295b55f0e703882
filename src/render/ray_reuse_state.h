/* SPDX-License-Identifier: MIT
 * What a renderer keeps from one frame for the next (ray_reuse.h). */
#ifndef ERN_RENDER_RAY_REUSE_STATE_H
#define ERN_RENDER_RAY_REUSE_STATE_H

#include "ernerf/render.h"
#include "render/keyframes.h"
#include "render/render_ops.h"

/* The rays of a view, sorted by kind. */
struct ern_reused_rays {
  bool sorted;
  size_t hits, steady;           /* rays with samples; of these, the interpolated ones */
  struct ern_buffer *list;       /* int32 [hits]: pixel numbers, the steady ones first, ascending in each kind */
  struct ern_buffer *ray;        /* int32 [hits]: numbers of the pixels that their rays go through */
  struct ern_buffer *known;      /* real: channels of the steady rays at each keyframe */
  ern_rows known_rows;           /* of it: [keyframes * channels] per steady ray */
  uint64_t samples, all_samples; /* in occupied cells: of the rays rendered in every frame; of all */
};

/* The caller's inputs from which the background rows were made. */
struct ern_ray_reuse_background {
  bool known;                  /* the background rows were made from the following */
  uint8_t *background, *torso; /* copies; NULL: none was handed in */
  int width, height;
  float pose[16];
  ern_box frame;
  size_t individual;
  float motion[ERN_MOTION_VALUES]; /* of the model's torso */
};

struct ern_ray_reuse {
  bool on;
  float bound;                    /* largest error of a pixel, 0..1 */
  struct ern_keyframes keyframes; /* of the coming speech, where bound > 0 */
  struct ern_ray_reuse_background behind;
  bool behind_changed; /* since the frame before */
  bool known;          /* the head's rows were rendered with the following */
  struct ern_view view;
  size_t individual;
  unsigned wanted; /* bit k: depth, attention, eye */
  float code[ERN_AUDIO_CODE], eye;
  int full_frames; /* frames rendered in full since the view last changed */
  struct ern_reused_rays rays;
  ern_ray_reuse_work work;
};

#endif
