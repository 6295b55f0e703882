/* SPDX-License-Identifier: MIT
 * MFCC features, the audio input of SyncNet: those of python_speech_features with its defaults (docs/evaluation.md). */
#ifndef ERN_CLI_SYNC_CEPSTRA_H
#define ERN_CLI_SYNC_CEPSTRA_H

#include <stddef.h>

enum { SYNC_RATE = 16000, SYNC_CEPSTRA = 13 };

/* Number of rows of 13 cepstra (100 rows a second) for a sound of `samples` samples (> 0). */
size_t sync_cepstra_rows(size_t samples);
/* rows[sync_cepstra_rows(samples)][13] of samples at 16000 Hz, full scale 32768. The caller frees them; NULL without
 * memory. */
double *sync_cepstra(const double *wave, size_t samples);

#endif
