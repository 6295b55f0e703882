/* SPDX-License-Identifier: MIT
 * A whole training step of the head or of the torso, forward and backward. */
#ifndef ERN_STEP_OPS_H
#define ERN_STEP_OPS_H

#include "core/types.h"
#include "train/losses_ops.h"
#include "train/patches_ops.h"

struct ern_field;
struct ern_view;
struct ern_march_settings;
struct ern_profile;
struct ern_fine_loss;

/* The rays form patches (patches_ops.h), patch after patch, with a loss term of their own. All zeros: no patches. */
struct ern_step_patches {
  const struct ern_fine_loss *loss; /* NULL: patch_loss */
  ern_span filter;                  /* of ern_patch_loss_args */
  float weight;
  int side;     /* pixels */
  size_t count; /* side^2 count = n */
};

struct ern_head_step_args {
  ern_span dparameters;         /* accumulates, the whole block */
  double terms[ERN_LOSS_TERMS]; /* out, on the host, weights included */
  size_t samples;               /* out, on the host */
  double squared_error;         /* out, on the host: mean over rays and channels of (pixel - truth)^2, unweighted */
  ern_span parameters;
  const struct ern_field *field;
  const struct ern_view *view;
  const struct ern_march_settings *settings;
  ern_span bits;
  ern_span pixel_number;      /* int32 [n] */
  ern_span jitter;            /* real [n]; zeroed: none */
  ern_rows truth, background; /* [3] per ray */
  ern_span face;              /* real [n] */
  ern_span windows;           /* real [8][window_length][width] */
  float eye_value;
  size_t individual; /* row of the individual codes */
  struct ern_loss_weights weights;
  float transmittance_stop;
  bool smooth; /* with the smoothness term */
  bool bf16;   /* as above, except in a step with the smoothness term: its differences are below bf16's rounding */
  const float
      *smooth_offsets; /* recorded offsets [samples][3], on the host, to repeat another program's step; NULL: Philox */
  uint64_t seed, step;
  struct ern_profile *profile; /* added to; NULL: not wanted. Only fused passes fill it */
  double *dpose;               /* out, on the host: [ERN_POSE_PARAMETERS], as ern_pose_bwd_args has it, without the
                                * smoothness term; NULL: not wanted */
  ern_span dpose_weight;       /* real [n], weight of a ray in dpose; zeroed: 1 */
  struct ern_step_patches patches;
  void (*meanwhile)(
      void *user); /* work for the host while the device computes, called any number of times; NULL: none */
  void *user;
  size_t n; /* rays */
};
#define ERN_COST_head_step(a) ERN_COST_ELSEWHERE

struct ern_torso_step_args {
  ern_span dparameters;
  double terms[ERN_LOSS_TERMS]; /* photometric and key points */
  size_t samples;               /* pixels inside the torso's occupancy */
  ern_span parameters;
  const struct ern_field *field;
  const struct ern_view *view;
  ern_span grid; /* the torso's occupancy */
  float threshold, shrink;
  ern_span pixel_number;
  ern_rows truth, background;
  size_t individual;
  const float *motion;           /* [ERN_MOTION_VALUES] of torso_move */
  void (*meanwhile)(void *user); /* as above */
  void *user;
  size_t n;
};
#define ERN_COST_torso_step(a) ERN_COST_ELSEWHERE

#endif
