/* SPDX-License-Identifier: MIT
 * The JSON object that describes a network which computes speech features, beside the network's file
 * (docs/speech.md). */
#ifndef ERN_IO_SPEECH_DESCRIPTION_H
#define ERN_IO_SPEECH_DESCRIPTION_H

#include "core/status.h"

/* What is normalised to mean 0 and variance 1: nothing, each piece, or the whole sound. */
enum ern_speech_normalisation { ERN_SPEECH_AS_IT_IS, ERN_SPEECH_PIECE, ERN_SPEECH_SOUND };

enum { ERN_SPEECH_DESCRIPTION_BYTES = 512 };

struct ern_speech_description {
  char kind[64];
  int rate; /* samples a second, a multiple of 50: rows are rate/50 samples apart */
  enum ern_speech_normalisation normalisation;
  int piece_samples;   /* input of the network */
  int context_samples; /* at either end of a piece; their rows are dropped; a multiple of rate/50 */
  int row_samples;     /* receptive field of a row */
  int width;           /* numbers a row */
  int window_rows;     /* 16: rows 2t-8 .. 2t+7, zeros past the ends; 2: rows 2t, 2t+1 */
  char output[128];    /* "": the only one */
  char sha256[65];     /* of the network's file; "": unknown */
};

/* Every field is checked. `where` is for messages. ERN_E_FORMAT. */
ERN_NODISCARD ern_status ern_speech_description_parse(ern_context *context, const char *where, const char *text,
                                                      struct ern_speech_description *description);

/* The description as JSON text in one line. */
ERN_NODISCARD ern_status ern_speech_description_text(ern_context *context,
                                                     const struct ern_speech_description *description,
                                                     char text[ERN_SPEECH_DESCRIPTION_BYTES]);

#endif
