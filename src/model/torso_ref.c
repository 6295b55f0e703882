/* SPDX-License-Identifier: MIT
 * The torso: adaptive pose encoding, coordinates, deformation, compositing, 2D occupancy (docs/maths.md, Torso, paper
 * eq. 9-11). Coordinates and the selection of pixels are in float in every build, so that float and double builds use
 * the same ones. */
#include <math.h>
#include <stdbool.h>

#include "core/rng.h"
#include "model/torso_ops.h"

static const int last_cell = ERN_TORSO_SIDE - 1;

/* ---- pose ---- */

/* The inverse of a 4x4 matrix by Gauss-Jordan elimination with row pivoting; in double in every build. */
static void invert(double inverse[4][4], const float matrix[16]) {
  double a[4][8];
  for (int i = 0; i < 4; i++) {
    for (int j = 0; j < 4; j++) {
      a[i][j] = matrix[4 * i + j];
      a[i][4 + j] = i == j;
    }
  }
  for (int column = 0; column < 4; column++) {
    int pivot = column;
    for (int i = column + 1; i < 4; i++) {
      if (fabs(a[i][column]) > fabs(a[pivot][column])) pivot = i;
    }
    for (int j = 0; j < 8; j++) {
      const double swapped = a[pivot][j];
      a[pivot][j] = a[column][j];
      a[column][j] = swapped;
    }
    const double scale = 1 / a[column][column];
    for (int j = 0; j < 8; j++) a[column][j] *= scale;
    for (int i = 0; i < 4; i++) {
      const double factor = a[i][column];
      if (i == column) continue;
      for (int j = 0; j < 8; j++) a[i][j] -= factor * a[column][j];
    }
  }
  for (int i = 0; i < 4; i++) {
    for (int j = 0; j < 4; j++) inverse[i][j] = a[i][4 + j];
  }
}

/* X = anchor transpose(inverse), as a row vector: X_i = sum_j inverse_ij anchor_j. */
static void transform(ern_real moved[4], const double inverse[4][4], const ern_real anchor[4]) {
  for (int i = 0; i < 4; i++) {
    double sum = 0;
    for (int j = 0; j < 4; j++) sum += inverse[i][j] * (double)anchor[j];
    moved[i] = (ern_real)sum;
  }
}

/* A key point on the camera's plane has no projection. Its distance to the plane is clamped to at least `nearest`
 * (scene units; a head is some 3 of them away), on its side, and its projection to at most `farthest`: k is finite, and
 * clamped values have no gradient. A NaN stays one. */
static const ern_real nearest = (ern_real)1e-3, farthest = (ern_real)1e6;

static bool is_near_zero(ern_real x) { return x > -nearest && x < nearest; }
static ern_real off_zero(ern_real x) { return is_near_zero(x) ? (signbit(x) ? -nearest : nearest) : x; }
static bool is_far(ern_real h) { return h < -farthest || h > farthest; }
static ern_real projected(const ern_real moved[4], int a) {
  const ern_real h = moved[a] / off_zero(moved[3]) / off_zero(moved[2]);
  return is_far(h) ? (h < 0 ? -farthest : farthest) : h;
}

/* k[2p + a] = gamma X_a/X_3/X_2, a = 0, 1 */
void ERN_REF(ern_torso_pose_fwd)(ern_real *k, const ern_real *anchors, const ern_real *gamma, const float pose[16]) {
  double inverse[4][4];
  invert(inverse, pose);
  const ern_real scale = gamma ? *gamma : 1;
  for (int p = 0; p < ERN_TORSO_POINTS; p++) {
    ern_real moved[4];
    transform(moved, inverse, &anchors[4 * p]);
    for (int a = 0; a < 2; a++) k[2 * p + a] = scale * projected(moved, a);
  }
}

/* With h_a = X_a/X_3/X_2 and dh = gamma dk:  dX_a = dh_a/X_3/X_2,  dX_2 = -sum_a dh_a h_a/X_2, dX_3 = -sum_a dh_a
 * h_a/X_3; danchor_j += sum_i dX_i inverse_ij;  dgamma += sum dk_a h_a. */
void ERN_REF(ern_torso_pose_bwd)(ern_real *danchors, ern_real *dgamma, const ern_real *dk, const ern_real *anchors,
                                 const ern_real *gamma, const float pose[16]) {
  double inverse[4][4];
  invert(inverse, pose);
  const ern_real scale = gamma ? *gamma : 1;
  for (int p = 0; p < ERN_TORSO_POINTS; p++) {
    ern_real moved[4], dmoved[4], along = 0, free_along = 0; /* along = sum_a dk_a h_a; without clamped ones */
    transform(moved, inverse, &anchors[4 * p]);
    for (int a = 0; a < 2; a++) {
      const ern_real h = projected(moved, a);
      const bool held = h == farthest || h == -farthest;
      along += dk[2 * p + a] * h;
      if (!held) free_along += dk[2 * p + a] * h;
      dmoved[a] = held ? 0 : scale * dk[2 * p + a] / off_zero(moved[3]) / off_zero(moved[2]);
    }
    for (int i = 2; i < 4; i++) dmoved[i] = is_near_zero(moved[i]) ? 0 : -scale * free_along / moved[i];
    for (int j = 0; j < 4; j++) {
      double sum = 0;
      for (int i = 0; i < 4; i++) sum += (double)dmoved[i] * inverse[i][j];
      danchors[4 * p + j] += (ern_real)sum;
    }
    if (dgamma) *dgamma += along;
  }
}

/* ---- pixels ---- */

/* 2i/(side-1) - 1; a side of one pixel is at 0. */
static float coordinate(int i, int side) { return side > 1 ? (float)(2 * i - (side - 1)) / (float)(side - 1) : 0.0f; }

void ERN_REF(ern_torso_coords)(ern_real *q, size_t stride, const int32_t *pixel, int width, int height, float shrink,
                               size_t n) {
  for (size_t i = 0; i < n; i++) {
    q[i] = shrink * coordinate(pixel[i] / width, height);
    q[stride + i] = shrink * coordinate(pixel[i] % width, width);
  }
}

/* Bilinear, corners aligned: coordinate -1 is cell 0, 1 is cell 127. */
static float grid_at(const ern_real *grid, float row, float column) {
  const float r = (row + 1) / 2 * (float)last_cell, c = (column + 1) / 2 * (float)last_cell;
  int r0 = (int)r, c0 = (int)c;
  if (r0 > last_cell - 1) r0 = last_cell - 1;
  if (c0 > last_cell - 1) c0 = last_cell - 1;
  const float wr = r - (float)r0, wc = c - (float)c0;
  const ern_real *at = &grid[c0 * ERN_TORSO_SIDE + r0]; /* cell (r, c) at c*128 + r */
  const float left = (1 - wr) * (float)at[0] + wr * (float)at[1];
  const float right = (1 - wr) * (float)at[ERN_TORSO_SIDE] + wr * (float)at[ERN_TORSO_SIDE + 1];
  return (1 - wc) * left + wc * right;
}

size_t ERN_REF(ern_torso_select)(int32_t *index, int32_t *selected, const int32_t *pixel, const ern_real *grid,
                                 float threshold, int width, int height, size_t n) {
  size_t count = 0;
  for (size_t i = 0; i < n; i++) {
    const float row = coordinate(pixel[i] / width, height), column = coordinate(pixel[i] % width, width);
    if (grid_at(grid, row, column) > threshold) {
      index[count] = (int32_t)i;
      selected[count++] = pixel[i];
    }
  }
  return count;
}

/* ---- deformation ---- */

/* q'_r = q_r + m_r, bilinear; beyond the outermost control points as at them */
void ERN_REF(ern_torso_move)(ern_real *moved, const ern_real *q, const float *motion, float shrink, size_t stride,
                             size_t n) {
  enum { SIDE = ERN_MOTION_SIDE };
  const ern_real middle = (ern_real)(SIDE - 1) / 2, scale = middle / (ern_real)shrink;
  for (size_t i = 0; i < n; i++) {
    ern_real toward[2];
    size_t cell[2];
    for (size_t d = 0; d < 2; d++) {
      const ern_real free = q[d * stride + i] * scale + middle;
      const ern_real at = free > 0 ? free < 2 * middle ? free : 2 * middle : 0;
      cell[d] = at < SIDE - 2 ? (size_t)at : SIDE - 2;
      toward[d] = at - (ern_real)cell[d];
    }
    for (size_t d = 0; d < 2; d++) {
      const float *m = motion + (d * SIDE + cell[0]) * SIDE + cell[1];
      const ern_real upper = (1 - toward[1]) * m[0] + toward[1] * m[1];
      const ern_real lower = (1 - toward[1]) * m[SIDE] + toward[1] * m[SIDE + 1];
      moved[d * stride + i] = q[d * stride + i] + ((1 - toward[0]) * upper + toward[0] * lower);
    }
  }
}

/* x = clamp(q + d, -1, 1), two rows */
void ERN_REF(ern_torso_deform_fwd)(ern_real *x, const ern_real *q, const ern_real *d, size_t stride, size_t n) {
  for (size_t row = 0; row < 2; row++) {
    for (size_t i = 0; i < n; i++) {
      const size_t at = row * stride + i;
      const ern_real moved = q[at] + d[at];
      x[at] = moved < -1 ? -1 : moved > 1 ? 1 : moved;
    }
  }
}

void ERN_REF(ern_torso_deform_bwd)(ern_real *dd, const ern_real *dx, const ern_real *q, const ern_real *d,
                                   size_t stride, size_t n) {
  for (size_t row = 0; row < 2; row++) {
    for (size_t i = 0; i < n; i++) {
      const size_t at = row * stride + i;
      const ern_real moved = q[at] + d[at];
      dd[at] = moved >= -1 && moved <= 1 ? dx[at] : 0;
    }
  }
}

/* ---- compositing: pixel = a rgb + (1 - a) background ---- */

void ERN_REF(ern_torso_composite_fwd)(ern_real *pixel, ern_real *opacity, const ern_real *layer, size_t layer_stride,
                                      const int32_t *index, const ern_real *background, size_t ray_stride, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const size_t r = (size_t)index[i];
    const ern_real alpha = layer[i];
    for (size_t c = 0; c < 3; c++) {
      const ern_real colour = layer[(c + 1) * layer_stride + i];
      pixel[c * ray_stride + r] = alpha * colour + (1 - alpha) * background[c * ray_stride + r];
    }
    if (opacity) opacity[r] = alpha;
  }
}

/* da = sum_c dpixel_c (rgb_c - background_c), drgb = a dpixel */
void ERN_REF(ern_torso_composite_bwd)(ern_real *dlayer, size_t layer_stride, const ern_real *dpixel,
                                      const ern_real *layer, const int32_t *index, const ern_real *background,
                                      size_t ray_stride, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const size_t r = (size_t)index[i];
    ern_real dalpha = 0;
    for (size_t c = 0; c < 3; c++) {
      const ern_real d = dpixel[c * ray_stride + r];
      dalpha += d * (layer[(c + 1) * layer_stride + i] - background[c * ray_stride + r]);
      dlayer[(c + 1) * layer_stride + i] = layer[i] * d;
    }
    dlayer[i] = dalpha;
  }
}

/* ---- occupancy ---- */

/* ((2c/127 - 1)(127/128) + uniform(-1, 1)/128) shrink */
static float look_at(int c, uint32_t word, float shrink) {
  const float centre = coordinate(c, ERN_TORSO_SIDE) * (127.0f / 128.0f);
  return (centre + (2 * ern_uniform(word) - 1) / ERN_TORSO_SIDE) * shrink;
}

void ERN_REF(ern_torso_points)(ern_real *q, size_t stride, float shrink, uint64_t seed, uint64_t step) {
  for (int cell = 0; cell < ERN_TORSO_CELLS; cell++) {
    const struct ern_random random = ern_random_at(seed, step, (uint32_t)cell, ERN_RNG_REFRESH_CELL);
    q[cell] = look_at(cell % ERN_TORSO_SIDE, random.word[0], shrink);
    q[stride + (size_t)cell] = look_at(cell / ERN_TORSO_SIDE, random.word[1], shrink);
  }
}

/* grid = max(decay grid, 5 x 5 maximum of alpha, cut at the edges); the mean is returned. */
double ERN_REF(ern_torso_update)(ern_real *grid, const ern_real *alpha, float decay) {
  double sum = 0;
  for (int cell = 0; cell < ERN_TORSO_CELLS; cell++) {
    const int r = cell % ERN_TORSO_SIDE, c = cell / ERN_TORSO_SIDE;
    ern_real most = grid[cell] * decay;
    for (int j = c > 2 ? c - 2 : 0; j <= (c + 2 < last_cell ? c + 2 : last_cell); j++) {
      for (int i = r > 2 ? r - 2 : 0; i <= (r + 2 < last_cell ? r + 2 : last_cell); i++) {
        const ern_real value = alpha[j * ERN_TORSO_SIDE + i];
        if (value > most) most = value;
      }
    }
    grid[cell] = most;
    sum += most;
  }
  return sum / ERN_TORSO_CELLS;
}
