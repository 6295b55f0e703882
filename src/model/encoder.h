/* SPDX-License-Identifier: MIT
 * From positions to features, by the model's backbone (docs/maths.md, Tri-plane hash grids), through the dispatch
 * table. */
#ifndef ERN_MODEL_ENCODER_H
#define ERN_MODEL_ENCODER_H

#include "model/head_batch.h"

/* x: [3] per sample; writes batch->f, and for the backbone `mlp` batch->waves and batch->hidden. */
ERN_NODISCARD ern_status ern_encode_fwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                                        struct ern_head_batch *batch);
/* From d->f; d->hidden and d->waves are workspace. dparameters accumulates, and so does d->x unless it is zeroed. */
ERN_NODISCARD ern_status ern_encode_bwd(struct ern_stream *stream, const struct ern_head_inputs *in, ern_rows x,
                                        const struct ern_head_batch *batch, struct ern_head_batch *d,
                                        ern_span dparameters);

#endif
