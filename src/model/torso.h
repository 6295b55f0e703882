/* SPDX-License-Identifier: MIT
 * The torso field over a batch of pixels, through the dispatch table (docs/maths.md, Torso; paper section 3.4). */
#ifndef ERN_MODEL_TORSO_H
#define ERN_MODEL_TORSO_H

#include "core/backend.h"
#include "model/field.h"
#include "model/torso_ops.h"

struct ern_torso_inputs {
  const struct ern_field *field;
  ern_span parameters;
  const float *pose;   /* [16] camera to world, renderer's frame */
  size_t individual;   /* row of the individual codes */
  const float *motion; /* [ERN_MOTION_VALUES] of the body in this frame, of ern_torso_motion_of */
  float shrink;        /* of coordinates */
};

/* Values of a batch, or gradients by them. */
struct ern_torso_batch {
  size_t n;
  ern_rows k;            /* [6] once: transformed key points */
  ern_rows k_encoded;    /* [42] once */
  ern_rows q, q_encoded; /* [2], [34] */
  ern_rows moved;        /* [2] q moved with the body */
  ern_rows moved_by, x;  /* [2] output of the deformation, and moved + it, clamped */
  ern_rows grid;         /* [32] */
  ern_rows raw, layer;   /* [4] alpha, r, g, b before and after the sigmoid */
};

ERN_NODISCARD ern_status ern_torso_batch_take(struct ern_stream *stream, const struct ern_field *field, size_t n,
                                              struct ern_torso_batch *batch);

/* batch->q is set by the caller. */
ERN_NODISCARD ern_status ern_torso_fwd(struct ern_stream *stream, const struct ern_torso_inputs *in,
                                       struct ern_torso_batch *batch);
/* d->layer is set by the caller; dparameters accumulates. */
ERN_NODISCARD ern_status ern_torso_bwd(struct ern_stream *stream, const struct ern_torso_inputs *in,
                                       const struct ern_torso_batch *batch, struct ern_torso_batch *d,
                                       ern_span dparameters);

/* moved: in coordinates from -1 to 1, as of ern_frame_input, to those times shrink. */
static inline void ern_torso_motion_of(float motion[ERN_MOTION_VALUES], const float moved[ERN_MOTION_VALUES],
                                       float shrink) {
  for (int i = 0; i < ERN_MOTION_VALUES; i++) motion[i] = moved[i] * shrink;
}

/* motion of the affine one of earlier files, six numbers a: (r, c) moves by (a_0 r + a_1 c + a_2, a_3 r + a_4 c + a_5).
 */
void ern_torso_motion_of_affine(float motion[ERN_MOTION_VALUES], const float a[6]);

/* q of pixels (row-major numbers of a width x height picture). */
ERN_NODISCARD ern_status ern_torso_q(struct ern_stream *stream, ern_span pixel, int width, int height, float shrink,
                                     size_t n, ern_rows q);

#endif
