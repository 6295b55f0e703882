/* SPDX-License-Identifier: MIT
 * The fused torso pass over a picture: terms that pixels have in common are computed once.
 *
 * The input of both MLPs is [.., encoding of q, encoding of k, code]. k and the code are constant in a frame, so their
 * part of the first layers is a bias. The encoding of q = (row, column) is that of the row followed by that of the
 * column, so the rest of a first layer is a term of the row plus a term of the column: H + W terms instead of H W:
 * hidden_j (row, column) = relu(row_term_j + column_term_j [+ W_grid f]), where the column's term includes the bias.
 *
 * A kernel call computes a band of ERN_TORSO_BAND rows of pixels in blocks of LANES/4 x 4 pixels, one block a register;
 * a tile of blocks goes through all layers together. Blocks without a chosen pixel are skipped. */
#ifndef ERN_FUSED_TORSO_H
#define ERN_FUSED_TORSO_H

#include "core/backend.h"

enum {
  ERN_TORSO_BAND = 16,                    /* rows of pixels a task */
  ERN_TORSO_HIDDEN = 32,                  /* units of each hidden layer */
  ERN_TORSO_TERMS = 2 * ERN_TORSO_HIDDEN, /* units of both first layers: deformation, layer */
  ERN_TORSO_AXIS_ROWS = 17,               /* encoding of one coordinate: x, sin and cos of 8 octaves */
};

/* Precomputed values of the rows or the columns: arrays of `padded` values, a multiple of ERN_TORSO_AXIS_UNIT. */
enum { ERN_TORSO_AXIS_UNIT = 16 };
struct ern_torso_axis {
  const float *q;      /* coordinate times shrink */
  const int32_t *cell; /* of the 2D occupancy: cell, and interpolation weight of the next cell */
  const float *weight;
  const float *terms; /* [padded/4][ERN_TORSO_TERMS][4] */
};

struct ern_torso_level {
  float scale;
  uint32_t column_step; /* entries from a cell to that of the next column; the rows of a column are contiguous */
  uint32_t mask;        /* entries - 1 where the index is taken modulo `entries`, else all ones */
  const float *table;   /* [entries][2] */
};

/* The levels as a structure of arrays, padded to ERN_TORSO_LEVELS; past the last level: scale 0, last -1. */
enum { ERN_TORSO_LEVELS = (ERN_GRID_MAX_LEVELS + 15) / 16 * 16 };
struct ern_torso_levels {
  float scale[ERN_TORSO_LEVELS];
  int32_t column_step[ERN_TORSO_LEVELS], mask[ERN_TORSO_LEVELS];
  int32_t last[ERN_TORSO_LEVELS]; /* the last index from which 4 rows of 4 columns lie in the table without wrapping */
};

struct ern_torso_frame {
  int width, height, levels;
  const float *motion; /* [ERN_MOTION_VALUES] of torso_move */
  float control;       /* columns of control points from one coordinate to that of 1 more */
  struct ern_torso_axis row, column;
  struct ern_torso_level level[ERN_GRID_MAX_LEVELS];
  struct ern_torso_levels abreast;
  const float *occupancy; /* cell (r, c) at c*128 + r */
  float threshold;
  const float *deform1, *deform2;        /* packed: [32][32], [2][32] */
  const float *layer0, *layer1, *layer2; /* [32][2 levels], [32][32], [4][32] */
  float *pixel;                          /* [3][stride], in and out */
  size_t stride;
  float *opacity; /* NULL: not wanted */
};

/* terms[i/4][j][i%4] = bias_j + sum_c weight[c][j] encoding[c][i] for `count` i, a multiple of ERN_TORSO_AXIS_UNIT;
 * weight: [ERN_TORSO_AXIS_ROWS][ERN_TORSO_TERMS], encoding: rows at `stride`. */
typedef void ern_torso_terms_kernel(float *terms, const float *bias, const float *weight, const float *encoding,
                                    size_t stride, size_t count);
/* Computes the ERN_TORSO_BAND rows from ERN_TORSO_BAND*band on. */
typedef void ern_torso_band_kernel(const struct ern_torso_frame *frame, size_t band);

struct ern_torso_kernels {
  ern_torso_terms_kernel *terms;
  ern_torso_band_kernel *band;
};
extern const struct ern_torso_kernels ern_torso_kernels_avx2, ern_torso_kernels_avx512, ern_torso_kernels_neon;

/* Overwrites render_torso of a float backend whose ern_cpu_backend has torso kernels. */
void ern_cpu_fuse_torso(struct ern_backend *backend);

#endif
