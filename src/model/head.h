/* SPDX-License-Identifier: MIT
 * The head field over a batch of samples, stage by stage through the dispatch table: encoder, region attention,
 * density, colour, uncertainty (model.md section 4; paper section 3). Each forward function has its mirror. */
#ifndef ERN_MODEL_HEAD_H
#define ERN_MODEL_HEAD_H

#include "core/backend.h"
#include "model/field.h"

/* What a frame gives to all its samples. */
struct ern_head_inputs {
  const struct ern_field *field;
  ern_span parameters; /* the whole block */
  ern_span code;       /* real [A], the audio code */
  float eye;           /* 0..1 */
  size_t individual;   /* row of the individual codes */
  ern_rows sh;         /* [16] per ray */
  ern_span ray;        /* int32 [n]; zeroed where only the density is asked for */
};

/* Values of a batch, or gradients by them. Rows are in scratch. */
struct ern_head_batch {
  size_t n;
  ern_rows f;             /* [feature_rows] */
  ern_rows waves, hidden; /* [63], [256] of the backbone `mlp`; zeroed for others */
  ern_rows v;             /* [A], or [1] for all channels: audio attention; zeroed without one, as the next two */
  ern_rows region;        /* [A] v * code */
  ern_rows norm;          /* [1] |v|_2 */
  ern_rows eye_raw, eye;  /* [1] eye attention before and after the sigmoid; zeroed without one */
  ern_rows region_eye;    /* [1] eye value by the attention, or one eye value per batch; zeroed without an eye */
  ern_rows h;             /* [65]: logarithm of the density, geometry; [1] in a density-only batch */
  ern_rows sigma;         /* [1] */
  ern_rows rgb_raw, rgb;  /* [3] before and after the sigmoid */
  ern_rows unc_raw, unc;  /* [1] before and after the softplus */
};

enum { ERN_BATCH_ATTENTION = 1, ERN_BATCH_DENSITY = 2, ERN_BATCH_COLOUR = 4, ERN_BATCH_UNCERTAINTY = 8 };

/* Takes the rows that the parts in `parts` need from the stream's scratch. ERN_BATCH_DENSITY without ERN_BATCH_COLOUR
 * leaves the geometry out. */
ERN_NODISCARD ern_status ern_head_batch_take(struct ern_stream *stream, const struct ern_field *field, size_t n,
                                             int parts, struct ern_head_batch *batch);

/* x: [3] per sample. Features, region attention and, where the batch has room for it, the density. */
ERN_NODISCARD ern_status ern_head_density_fwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                                              struct ern_head_batch *batch);
ERN_NODISCARD ern_status ern_head_colour_fwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                                             struct ern_head_batch *batch);
ERN_NODISCARD ern_status ern_head_uncertainty_fwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                                                  struct ern_head_batch *batch);

/* The mirrors. `d` holds the gradients by the values of `batch`; the caller zeroes d->f and d->h and sets
 * d->sigma, d->rgb, d->unc, d->norm, d->eye. dparameters accumulates; so does dcode [A], unless it is zeroed
 * (detached). */
ERN_NODISCARD ern_status ern_head_colour_bwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                                             const struct ern_head_batch *batch, struct ern_head_batch *d,
                                             ern_span dparameters);
ERN_NODISCARD ern_status ern_head_uncertainty_bwd(struct ern_stream *stream, const struct ern_head_inputs *in,
                                                  const struct ern_head_batch *batch, struct ern_head_batch *d,
                                                  ern_span dparameters);
ERN_NODISCARD ern_status ern_head_density_bwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                                              const struct ern_head_batch *batch, struct ern_head_batch *d,
                                              ern_span dparameters, ern_span dcode);

#endif
