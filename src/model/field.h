/* SPDX-License-Identifier: MIT
 * A model as plain data: what a kernel or a backend needs to know of it, and nothing else. Offsets count reals from the
 * start of the parameter block. */
#ifndef ERN_MODEL_FIELD_H
#define ERN_MODEL_FIELD_H

#include "ernerf/model.h"
#include "hashgrid/hashgrid_ops.h"
#include "mlp/audio_ops.h"
#include "mlp/mlp_ops.h"

enum {
  ERN_PLANES = 3, /* xy, yz, xz */
  ERN_TRUNKS = 2, /* stacks of the backbone `mlp`; the second takes the position again */
  ERN_TRUNK_WIDTH = 256,
  ERN_TRUNK_FEATURES = 36, /* features that it outputs in place of a grid encoder's */
  ERN_X_OCTAVES = 10,
  ERN_X_ROWS = 3 * (1 + 2 * ERN_X_OCTAVES), /* 63 */
  ERN_AUDIO_CODE = 32,
  ERN_GEOMETRY = 64,
  ERN_SH_ROWS = 16,
  ERN_CODE_WIDTH = 4, /* individual code of the head */
  ERN_TORSO_CODE_WIDTH = 8,
  ERN_Q_OCTAVES = 8,
  ERN_K_OCTAVES = 3,
  ERN_Q_ROWS = 2 * (1 + 2 * ERN_Q_OCTAVES), /* 34 */
  ERN_K_ROWS = 6 * (1 + 2 * ERN_K_OCTAVES)  /* 42 */
};

/* The configuration from which everything else is derived; stored in the model file. */
struct ern_model_config {
  ern_backbone backbone;
  ern_attention attention;
  ern_eye_attention eye_attention; /* sigmoid without a blink signal */
  int levels;                      /* of hash grids, 2..24; `triplane`: 1, `mlp`: 0 */
  int feature_width;               /* D */
  int window_length;               /* 1..16; 0: unknown, as in PyTorch files */
  bool head;                       /* false only while a table for the torso's tensors alone is built */
  bool eye;                        /* the clip has a blink signal */
  bool no_view;                    /* the colour does not depend on the ray's direction */
  bool torso;
  bool torso_gamma; /* the paper's trained scale of the key points */
  int codes;        /* rows of the individual codes, 0: no codes */
  float bound;
  float voice_fade[2]; /* of attention_fade; equal: the voice is whole everywhere */
};

/* From a position to features: three planes, one volume, or a network. */
struct ern_encoder {
  int grids; /* 3, 1, or 0 */
  struct ern_grid grid[ERN_PLANES];
  size_t table[ERN_PLANES];
  int axis[ERN_PLANES][ERN_GRID_MAX_DIMS]; /* the coordinates that a grid takes, as many as its dimensions */
  struct ern_mlp trunk[ERN_TRUNKS];        /* of `mlp`: [waves] -> hidden, [waves, relu(hidden)] -> features */
};

struct ern_field {
  struct ern_model_config config;
  size_t parameters; /* reals in the block */

  struct ern_encoder encoder;
  int feature_rows; /* of the encoder: 3*levels for `trihash` */
  struct ern_audio_net audio;
  struct ern_mlp attention, eye, density, colour, uncertainty; /* no layers: not in this configuration */
  size_t codes;

  struct ern_grid torso_grid;
  size_t torso_table;
  struct ern_mlp torso_deform, torso_net;
  size_t anchors, gamma, torso_codes;
};

/* Rows of the ray's direction in the colour network's input. */
static inline int ern_field_view_rows(const struct ern_field *field) { return field->config.no_view ? 0 : ERN_SH_ROWS; }

/* Whether region attention is computed: v, and the eye attention. */
static inline bool ern_field_attends(const struct ern_field *field) {
  return field->config.attention != ERN_ATTENTION_CONCAT;
}
static inline bool ern_field_attends_eye(const struct ern_field *field) {
  return field->config.eye && field->config.eye_attention == ERN_EYE_ATTENTION_SIGMOID;
}

/* Whether the voice ends at a height. */
static inline bool ern_field_fades(const struct ern_field *field) {
  return ern_field_attends(field) && field->config.voice_fade[1] > field->config.voice_fade[0];
}

/* Whether the head is the paper's own: three hashed planes, an attention weight for each channel of the audio code.
 * Fused passes support no other; the variants of the paper's ablation go through the stages. */
static inline bool ern_field_is_standard(const struct ern_field *field) {
  const struct ern_model_config *config = &field->config;
  return config->head && config->backbone == ERN_BACKBONE_TRIHASH && config->attention == ERN_ATTENTION_CHANNEL &&
         (!config->eye || config->eye_attention == ERN_EYE_ATTENTION_SIGMOID);
}

#endif
