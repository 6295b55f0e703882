/* SPDX-License-Identifier: MIT
 * Leaving out occupied cells that hold next to nothing: fewer samples, and a picture that is no longer exact. */
#ifndef ERN_RENDER_THIN_H
#define ERN_RENDER_THIN_H

#include "core/backend.h"
#include "model/field.h"

/* One of the speeches that decide. */
struct ern_thin_speech {
  const float *windows; /* [ERN_AUDIO_WINDOWS][window_length][width], on the host */
  int window_length;
  float eye;
};

/* Clears the bits of cells whose density is under `least` at all of 8 points (the middles of a cell's eighths) in all
 * of the speeches. bits: [ERN_OCCUPANCY_BYTES], on the host, in and out. */
ERN_NODISCARD ern_status ern_occupancy_thin(struct ern_stream *stream, const struct ern_field *field,
                                            ern_span parameters, const struct ern_thin_speech *speech, size_t speeches,
                                            float least, uint8_t *bits);

#endif
