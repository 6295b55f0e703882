/* SPDX-License-Identifier: MIT
 * The features "cepstra": mel-frequency cepstral coefficients of 16 kHz mono sound, 50 rows a second, relative to how
 * loud the speech has been (docs/speech.md). */
#ifndef ERN_MEDIA_CEPSTRA_H
#define ERN_MEDIA_CEPSTRA_H

#include "core/status.h"

enum {
  ERN_CEPSTRA_RATE = 16000,      /* samples a second */
  ERN_CEPSTRA_LEAST_RATE = 1000, /* of the sound that they are made of */
  ERN_CEPSTRA_HOP = 320,         /* samples from row to row */
  ERN_CEPSTRA_FRAME = 400,       /* samples that a row looks at; its middle is the middle of its 320 */
  ERN_CEPSTRA_BANDS = 40,        /* of mel */
  ERN_CEPSTRA_WIDTH = 13         /* values a row */
};

struct ern_cepstra;

/* warp: every frequency of the mel bands is multiplied by it, 0.5 to 2: the speech of a longer or shorter throat. */
ERN_NODISCARD ern_status ern_cepstra_check_warp(ern_context *context, float warp);
ERN_NODISCARD ern_status ern_cepstra_make(ern_context *context, float warp, struct ern_cepstra **cepstra);
void ern_cepstra_free(ern_context *context, struct ern_cepstra *cepstra); /* accepts NULL */

/* The logarithms of the bands' powers, of which ern_cepstra_row takes the cosines: for it, and to compare kinds. */
void ern_cepstra_bands(struct ern_cepstra *cepstra, const float frame[ERN_CEPSTRA_FRAME],
                       float band[ERN_CEPSTRA_BANDS]);

/* The next row of the sound: rows must be asked for in their order, as the loudness of the earlier ones counts. */
void ern_cepstra_row(struct ern_cepstra *cepstra, const float frame[ERN_CEPSTRA_FRAME], float row[ERN_CEPSTRA_WIDTH]);

#endif
