/* SPDX-License-Identifier: MIT
 * Prunes occupied cells of low density: fewer samples, but the picture is no longer exact. */
#ifndef ERN_RENDER_OCCUPANCY_PRUNE_H
#define ERN_RENDER_OCCUPANCY_PRUNE_H

#include "core/backend.h"
#include "model/field.h"
#include "render/keyframes.h"

/* Clears the bits of cells whose density is under `least` at all of 8 points (the centres of a cell's octants) in all
 * of the frames. bits: [ERN_OCCUPANCY_BYTES], on the host, in and out. */
ERN_NODISCARD ern_status ern_occupancy_prune(struct ern_stream *stream, const struct ern_field *field,
                                             ern_span parameters, const struct ern_speech_frame *frame, size_t frames,
                                             float least, uint8_t *bits);

#endif
