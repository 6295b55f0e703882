/* SPDX-License-Identifier: MIT
 * What a small network, trained on speech of known phonemes, tells of jaw, lips and tongue: beside the cepstra, the
 * features "articulatory" (docs/speech.md). */
#ifndef ERN_MEDIA_ARTICULATORY_H
#define ERN_MEDIA_ARTICULATORY_H

#include "core/status.h"
#include "media/speech/cepstra.h"

enum { ERN_ARTICULATORY_OUTPUTS = 32 };

/* The network, and what it keeps of the rows before. */
struct ern_articulatory;

ERN_NODISCARD ern_status ern_articulatory_make(ern_context *context, struct ern_articulatory **articulatory);
void ern_articulatory_free(ern_context *context, struct ern_articulatory *articulatory); /* accepts NULL */

/* The outputs for the next row, from the rows before and the logarithms of its mel bands, which are changed. audible:
 * as ern_cepstra_bands returns. */
void ern_articulatory_row(struct ern_articulatory *articulatory, float band[ERN_CEPSTRA_BANDS], bool audible,
                          float output[ERN_ARTICULATORY_OUTPUTS]);

#endif
