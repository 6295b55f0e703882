/* SPDX-License-Identifier: MIT
 * Data that the stages of the head field pass on: a frame's inputs, and the values of a batch of samples. */
#ifndef ERN_MODEL_HEAD_BATCH_H
#define ERN_MODEL_HEAD_BATCH_H

#include "core/backend.h"
#include "model/field.h"

/* Inputs that all samples of a frame share. */
struct ern_head_inputs {
  const struct ern_field *field;
  ern_span parameters; /* the whole block */
  ern_span code;       /* real [A], the audio code */
  float eye;           /* 0..1 */
  size_t individual;   /* row of the individual codes */
  ern_rows sh;         /* [16] per ray */
  ern_span ray;        /* int32 [n]; zeroed where only the density is computed */
};

/* Values of a batch, or gradients by them. Rows are in scratch. */
struct ern_head_batch {
  size_t n;
  ern_rows f;             /* [feature_rows] */
  ern_rows waves, hidden; /* [63], [256] of the backbone `mlp`; zeroed for others */
  ern_rows v;      /* [A], or [1] for all channels: audio attention; zeroed without one, and so are the next two */
  ern_rows region; /* [A] v * code */
  ern_rows norm;   /* [1] |v|_2 */
  ern_rows eye_raw, eye; /* [1] eye attention before and after the sigmoid; zeroed without one */
  ern_rows region_eye;   /* [1] eye value by the attention, or one eye value per batch; zeroed without an eye */
  ern_rows h;            /* [65]: logarithm of the density, geometry; [1] in a density-only batch */
  ern_rows sigma;        /* [1] */
  ern_rows rgb_raw, rgb; /* [3] before and after the sigmoid */
  ern_rows unc_raw, unc; /* [1] before and after the softplus */
  ern_rows x, sh;        /* [3], [16] per sample, of gradients alone, accumulated; zeroed: not wanted */
};

enum { ERN_BATCH_ATTENTION = 1, ERN_BATCH_DENSITY = 2, ERN_BATCH_COLOUR = 4, ERN_BATCH_UNCERTAINTY = 8 };

#endif
