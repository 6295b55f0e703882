/* SPDX-License-Identifier: MIT
 * The head field over a batch of samples, stage by stage through the dispatch table: encoder, region attention,
 * density, colour, uncertainty (docs/maths.md, Field; paper section 3). Each forward function has a backward
 * function. */
#ifndef ERN_MODEL_HEAD_H
#define ERN_MODEL_HEAD_H

#include "model/head_batch.h"

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

/* The backward functions. `d` holds the gradients by the values of `batch`; the caller zeroes d->f and d->h and sets
 * d->sigma, d->rgb, d->unc, d->norm, d->eye. dparameters accumulates; so does dcode [A], unless it is zeroed
 * (detached), and so do d->x and d->sh where the caller took rows for them (in->sh is then per sample). */
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
