/* SPDX-License-Identifier: MIT
 * What a renderer keeps from one frame for the next (ray_reuse.h). */
#ifndef ERN_RENDER_RAY_REUSE_STATE_H
#define ERN_RENDER_RAY_REUSE_STATE_H

#include "ernerf/render.h"
#include "render/keyframes.h"
#include "render/render_ops.h"

/* Rays of a view. */
struct ern_reused_rays {
  bool sorted;
  size_t hits, steady;           /* rays with samples; and those of them that are interpolated */
  struct ern_buffer *list;       /* int32 [hits]: pixel numbers, the steady ones first, ascending in each kind */
  struct ern_buffer *ray;        /* int32 [hits]: numbers of the pixels that their rays go through */
  struct ern_buffer *known;      /* real: channels of the steady rays at each keyframe */
  ern_rows known_rows;           /* of it: [keyframes * channels] per steady ray */
  uint64_t samples, all_samples; /* in occupied cells: of the rays that are rendered anew; of all */
};

/* What stands behind the head, as it was handed in. */
struct ern_ray_reuse_background {
  bool known;                  /* the background rows are those of: */
  uint8_t *background, *torso; /* copies; NULL: none was handed in */
  int width, height;
  float pose[16];
  ern_box frame;
  size_t individual;
};

struct ern_ray_reuse {
  bool on;
  float bound;                    /* most that a pixel may be off, 0..1 */
  struct ern_keyframes keyframes; /* of the speech to come, where bound > 0 */
  struct ern_ray_reuse_background behind;
  bool behind_changed; /* since the frame before */
  bool known;          /* the head's rows are those of: */
  struct ern_view view;
  size_t individual;
  unsigned wanted; /* bit k: depth, attention, eye */
  float code[ERN_AUDIO_CODE], eye;
  int stood; /* frames that were rendered whole since the view came to stand */
  struct ern_reused_rays rays;
  ern_ray_reuse_work work;
};

#endif
