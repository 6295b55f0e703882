/* SPDX-License-Identifier: MIT
 * A model as plain data: what a kernel or a backend needs to know of it, and nothing else. Offsets count reals from the
 * start of the parameter block. */
#ifndef ERN_MODEL_FIELD_H
#define ERN_MODEL_FIELD_H

#include "hashgrid/hashgrid_ops.h"
#include "mlp/audio_ops.h"
#include "mlp/mlp_ops.h"

enum {
  ERN_PLANES = 3, /* xy, yz, xz */
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

/* The small configuration that all else follows from; stored in the model file. */
struct ern_model_config {
  int levels;        /* of the tri-plane encoder, 2..24 */
  int feature_width; /* D */
  int window_length; /* 1..16 */
  bool head;         /* false only while a table for the torso's tensors alone is built */
  bool eye;          /* the clip has a blink signal */
  bool torso;
  bool torso_gamma; /* the paper's scale of the key points, trained */
  int codes;        /* rows of the individual codes, 0: no codes */
  float bound;
};

struct ern_field {
  struct ern_model_config config;
  size_t parameters; /* reals in the block */

  struct ern_grid plane[ERN_PLANES];
  size_t plane_table[ERN_PLANES];
  int plane_axis[ERN_PLANES][2]; /* which coordinates a plane looks at */
  int feature_rows;              /* D3 = 3*levels */
  struct ern_audio_net audio;
  struct ern_mlp attention, eye, density, colour, uncertainty;
  size_t codes;

  struct ern_grid torso_grid;
  size_t torso_table;
  struct ern_mlp torso_deform, torso_net;
  size_t anchors, gamma, torso_codes;
};

#endif
