/* SPDX-License-Identifier: MIT
 * The head's weights in the layout of the renderer: what does not depend on the sample is precomputed once for a model
 * or for a frame.
 *
 * Once for a model: the weights are packed for the tile product (pack.h); the last density layer and the first colour
 * layer, with no activation between them, become one matrix; the grids are unhashed, so that the two neighbours along
 * the first coordinate are always contiguous. Once for a frame: the audio code a scales the attention's last layer,
 * which has no activation behind it either:
 *   W_region (a * (W_v h)) = (W_region diag(a) W_v) h, one matrix over the hidden attention h;
 * the individual code becomes a constant term of the colour's first layer.
 *
 * For instruction sets that multiply pairs of bf16, the layers that run for each sample are packed in pairs
 * (pack_pairs.h); each part of the density's input is padded to whole pairs. The terms of a ray (`ray`, `code`) stay in
 * float. */
#ifndef ERN_FRAME_NET_H
#define ERN_FRAME_NET_H

#include "core/backend.h"
#include "model/field.h"

/* A level of a plane, [resolution + 1][row]: value (c0, c1) at c0 + c1*row, row = resolution + 1. */
struct ern_dense_level {
  float scale; /* position = u*scale + 0.5 */
  uint32_t row;
  const float *value;
};

struct ern_frame_net {
  struct ern_dense_level level[ERN_PLANES][ERN_GRID_MAX_LEVELS];
  int axis[ERN_PLANES][2];
  int levels;
  float bound, eye_value;
  float fade[2]; /* of attention_fade, where `fades` is set */
  bool eye, pairs, fades;
  size_t features, attention, eye_hidden, density, colour, value_rows; /* widths of inputs and hidden layers */
  size_t harmonics; /* spherical harmonics of the direction, inputs of the colour MLP: 16 or 0 */
  /* packed; where `pairs` is set, all but `ray` in pairs of bf16; [rows] x [columns] */
  float *attention1;  /* [attention] x [features] */
  float *eye1, *eye2; /* [eye_hidden] x [features]; [1] x [eye_hidden] */
  float *value;       /* [value_rows] x [attention]: v itself, for its norm */
  float *density1;    /* [density] x [features, attention, eye 1]; of the frame */
  float *density2;    /* [density] x [density] */
  float *sigma;       /* [1] x [density] */
  float *colour1;     /* [colour] x [density] */
  float *ray;         /* [colour] x [harmonics] */
  float *colour2;     /* [3] x [colour] */
  float *code;        /* [colour], plain; of the frame */
  float *folded;      /* a temporary product before packing */
  float *memory;      /* of all the above */
};

/* Whether a model has the layers that the net supports. */
bool ern_frame_net_fits(const struct ern_field *field);
/* Computes the parts that depend on the model alone, with layers in pairs of bf16 or in floats. The caller frees *net.
 * parameters: the whole block. */
ern_status ern_frame_net_make(ern_context *context, const struct ern_field *field, const float *parameters, bool pairs,
                              struct ern_frame_net **net);
void ern_frame_net_free(ern_context *context, struct ern_frame_net *net); /* accepts NULL */
/* Computes the parts that depend on the frame. code: [ERN_AUDIO_CODE]; individual: row of the individual codes. */
void ern_frame_net_fold(struct ern_frame_net *net, const struct ern_field *field, const float *parameters,
                        const float *code, float eye_value, size_t individual);

#endif
