/* SPDX-License-Identifier: MIT
 * The features "cepstra": mel-frequency cepstral coefficients of 16 kHz mono sound, 50 rows a second, normalised by the
 * loudness of the speech so far (docs/speech.md). */
#ifndef ERN_MEDIA_CEPSTRA_H
#define ERN_MEDIA_CEPSTRA_H

#include <stdbool.h>

#include "core/status.h"

enum {
  ERN_CEPSTRA_RATE = 16000,      /* samples a second */
  ERN_CEPSTRA_LEAST_RATE = 1000, /* the lowest sample rate of a source sound */
  ERN_CEPSTRA_HOP = 320,         /* samples from row to row */
  ERN_CEPSTRA_FRAME = 400,       /* samples of a row's analysis window, which is centred on the row's hop */
  ERN_CEPSTRA_BANDS = 40,        /* mel bands */
  ERN_CEPSTRA_WIDTH = 13         /* values a row */
};

struct ern_cepstra;

/* warp: every frequency of the mel bands is multiplied by it, 0.5 to 2 (vocal tract length perturbation: the speech of
 * a longer or shorter vocal tract). */
ERN_NODISCARD ern_status ern_cepstra_check_warp(ern_context *context, float warp);
/* speech_file.c. ERN_E_ARGUMENT where `kind` is none of the built-in kinds. */
ERN_NODISCARD ern_status ern_speech_check_kind(ern_context *context, const char *kind);
ERN_NODISCARD ern_status ern_cepstra_make(ern_context *context, float warp, struct ern_cepstra **cepstra);
void ern_cepstra_free(ern_context *context, struct ern_cepstra *cepstra); /* accepts NULL */

/* The logarithms of the mel bands' powers, of the next row of the sound. The caller must ask for rows in order: each
 * depends on the loudness of the earlier ones. Returns whether the row is within 30 dB of the level, as speech is. */
bool ern_cepstra_bands(struct ern_cepstra *cepstra, const float frame[ERN_CEPSTRA_FRAME],
                       float band[ERN_CEPSTRA_BANDS]);

/* What ern_cepstra_bands gives for each band of a row of zeros. */
float ern_cepstra_silence(void);

/* The row of these bands: their cosine transform, normalised. */
void ern_cepstra_row(const struct ern_cepstra *cepstra, const float band[ERN_CEPSTRA_BANDS],
                     float row[ERN_CEPSTRA_WIDTH]);

#endif
