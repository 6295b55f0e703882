/* SPDX-License-Identifier: MIT
 * The words for the variants of a head (docs/maths.md, Other backbones; the paper's ablation). */
#include "model/kinds.h"

#include <string.h>

static const char *const backbones[] = {"trihash", "hash3d", "triplane", "mlp", NULL};
static const char *const attentions[] = {"channel", "feature", "concat", NULL};
static const char *const eye_attentions[] = {"sigmoid", "concat", NULL};
static const char *const audio_pads[] = {"edge", "zero", NULL};

static const char *word_at(const char *const *words, int index) {
  int count = 0;
  while (words[count] != NULL) count++;
  return index >= 0 && index < count ? words[index] : NULL;
}

const char *ern_backbone_name(ern_backbone backbone) { return word_at(backbones, (int)backbone); }
const char *ern_attention_name(ern_attention attention) { return word_at(attentions, (int)attention); }
const char *ern_eye_attention_name(ern_eye_attention kind) { return word_at(eye_attentions, (int)kind); }
const char *ern_audio_pad_name(ern_audio_pad pad) { return word_at(audio_pads, (int)pad); }

static int find(const char *const *words, const char *word) {
  for (int i = 0; words[i] != NULL; i++)
    if (strcmp(words[i], word) == 0) return i;
  return -1;
}

bool ern_audio_pad_read(const char *word, ern_audio_pad *pad) {
  const int found = find(audio_pads, word);
  if (found >= 0) *pad = (ern_audio_pad)found;
  return found >= 0;
}

bool ern_kind_read(const char *word, ern_kind kind, struct ern_model_config *config) {
  const char *const *const words[] = {backbones, attentions, eye_attentions};
  const int found = find(words[kind], word);
  if (found < 0) return false;
  switch (kind) {
    case ERN_KIND_BACKBONE: config->backbone = (ern_backbone)found; break;
    case ERN_KIND_ATTENTION: config->attention = (ern_attention)found; break;
    case ERN_KIND_EYE_ATTENTION: config->eye_attention = (ern_eye_attention)found; break;
  }
  return true;
}

const char *ern_kind_of(const struct ern_model_config *config, ern_kind kind) {
  switch (kind) {
    case ERN_KIND_BACKBONE: return ern_backbone_name(config->backbone);
    case ERN_KIND_ATTENTION: return ern_attention_name(config->attention);
    case ERN_KIND_EYE_ATTENTION: return ern_eye_attention_name(config->eye_attention);
  }
  return NULL;
}

const char *ern_kind_field(ern_kind kind) {
  static const char *const fields[] = {"backbone", "attention", "eye_attention"};
  return fields[kind];
}
const char *ern_kind_words(ern_kind kind) {
  static const char *const words[] = {"trihash, hash3d, triplane or mlp", "channel, feature or concat",
                                      "sigmoid or concat"};
  return words[kind];
}
