/* SPDX-License-Identifier: MIT
 * The composite of a dubbed frame, by OpenCV. */
#ifndef ERN_MEDIA_DUB_H
#define ERN_MEDIA_DUB_H

#include "core/status.h"
#include "ernerf/media.h"

ERN_NODISCARD ern_status ern_dub_find_box(ern_context *context, const ern_dub_input *input, int box[4]);
/* wanted: [head_height][head_width]; the input is checked. */
ERN_NODISCARD ern_status ern_dub_find_wanted(ern_context *context, const ern_dub_input *input, uint8_t *wanted);
/* Draws on rgba, which holds the recorded frame; the input is checked. */
ERN_NODISCARD ern_status ern_dub_compose(ern_context *context, const ern_dub_input *input, uint8_t *rgba, bool *drawn);

#endif
