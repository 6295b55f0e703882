/* SPDX-License-Identifier: MIT
 * The three choices of the paper's ablation, by the words that the command line and model files have for them. */
#ifndef ERN_MODEL_KINDS_H
#define ERN_MODEL_KINDS_H

#include "model/field.h"

typedef enum ern_kind { ERN_KIND_BACKBONE, ERN_KIND_ATTENTION, ERN_KIND_EYE_ATTENTION } ern_kind;
enum { ERN_KINDS = 3 };

/* The field of a model file ("backbone"), and the words it may hold, for messages. */
const char *ern_kind_field(ern_kind kind);
const char *ern_kind_words(ern_kind kind);

/* The word of a configuration; NULL where its value is none of the kinds. */
const char *ern_kind_of(const struct ern_model_config *config, ern_kind kind);
/* Sets the configuration's value from a word; false for an unknown word. */
bool ern_kind_read(const char *word, ern_kind kind, struct ern_model_config *config);
/* Sets *pad from a word; false for an unknown word. */
bool ern_audio_pad_read(const char *word, ern_audio_pad *pad);

#endif
