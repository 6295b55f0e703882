/* SPDX-License-Identifier: MIT
 * The torso: pose encoding, coordinates, choice of pixels, deformation, compositing, 2D occupancy (docs/maths.md,
 * Torso). Products are rounded before they are added, as in the reference: all backends evaluate the same pixels and
 * points. */
#pragma OPENCL FP_CONTRACT OFF

enum { SIDE = 128, CELLS = SIDE * SIDE };
constant int last_cell = SIDE - 1;

/* ---- pose ---- */

/* inverse(pose), 4 x 4 row by row, as float pairs: high + low is the value in double to 48 bits. */
struct inverse {
  float high[16], low[16];
};

/* sum_i m[step*i] x[i], four terms, as if computed in double and rounded once: `rest` collects the rounding errors of
 * the products and sums. It is not used where the sum overflows. */
static float dot4(const float *high, const float *low, int step, const float *x) {
  float sum = 0, rest = 0;
  for (int i = 0; i < 4; i++) {
    const float product = high[step * i] * x[i], next = sum + product, added = next - sum;
    rest += fma(high[step * i], x[i], -product) + ((sum - (next - added)) + (product - added)) + low[step * i] * x[i];
    sum = next;
  }
  return isfinite(sum) ? sum + rest : sum;
}

/* X_i = sum_j inverse_ij anchor_j */
static void transform(float *moved, const struct inverse *inverse, global const float *anchor) {
  const float x[4] = {anchor[0], anchor[1], anchor[2], anchor[3]};
  for (int i = 0; i < 4; i++) moved[i] = dot4(inverse->high + 4 * i, inverse->low + 4 * i, 1, x);
}

/* A key point closer than NEAREST to the camera's plane is moved to that distance, and projections are clamped to
 * +-FARTHEST, as in the reference. */
#define NEAREST 1e-3f
#define FARTHEST 1e6f
static bool is_near_zero(float x) { return x > -NEAREST && x < NEAREST; }
static float off_zero(float x) { return is_near_zero(x) ? (signbit(x) ? -NEAREST : NEAREST) : x; }
static float projected(const float *moved, int a) {
  const float h = moved[a] / off_zero(moved[3]) / off_zero(moved[2]);
  return h < -FARTHEST ? -FARTHEST : h > FARTHEST ? FARTHEST : h;
}

/* k[2p + a] = gamma X_a/X_3/X_2, a = 0, 1; one work-item */
kernel void torso_pose_fwd(SPAN(float, k), SPAN(const float, anchors), SPAN(const float, gamma),
                           struct inverse inverse) {
  OPEN(float, k);
  OPEN(const float, anchors);
  OPEN(const float, gamma);
  const float scale = gamma ? *gamma : 1;
  for (int p = 0; p < 3; p++) {
    float moved[4];
    transform(moved, &inverse, anchors + 4 * p);
    for (int a = 0; a < 2; a++) k[2 * p + a] = scale * projected(moved, a);
  }
}

/* With h_a = X_a/X_3/X_2 and dh = gamma dk:  dX_a = dh_a/X_3/X_2,  dX_2 = -sum_a dh_a h_a/X_2,
 * dX_3 = -sum_a dh_a h_a/X_3; danchor_j += sum_i dX_i inverse_ij;  dgamma += sum_a dk_a h_a. One work-item. */
kernel void torso_pose_bwd(SPAN(float, danchors), SPAN(float, dgamma), SPAN(const float, dk),
                           SPAN(const float, anchors), SPAN(const float, gamma), struct inverse inverse) {
  OPEN(float, danchors);
  OPEN(float, dgamma);
  OPEN(const float, dk);
  OPEN(const float, anchors);
  OPEN(const float, gamma);
  const float scale = gamma ? *gamma : 1;
  for (int p = 0; p < 3; p++) {
    float moved[4], dmoved[4], along = 0, free_along = 0;
    transform(moved, &inverse, anchors + 4 * p);
    for (int a = 0; a < 2; a++) {
      const float h = projected(moved, a);
      const bool held = h == FARTHEST || h == -FARTHEST;
      along += dk[2 * p + a] * h;
      if (!held) free_along += dk[2 * p + a] * h;
      dmoved[a] = held ? 0 : scale * dk[2 * p + a] / off_zero(moved[3]) / off_zero(moved[2]);
    }
    for (int i = 2; i < 4; i++) dmoved[i] = is_near_zero(moved[i]) ? 0 : -scale * free_along / moved[i];
    for (int j = 0; j < 4; j++) danchors[4 * p + j] += dot4(inverse.high + j, inverse.low + j, 4, dmoved);
    if (dgamma) *dgamma += along;
  }
}

/* ---- pixels ---- */

/* 2i/(side-1) - 1; 0 where the side is one pixel. */
static float coordinate(int i, int side) { return side > 1 ? (float)(2 * i - (side - 1)) / (float)(side - 1) : 0.0f; }

/* q [2][n] */
kernel void torso_coords(ROWS(float, q), SPAN(const int, pixel), int width, int height, float shrink, ulong n) {
  OPEN(float, q);
  OPEN(const int, pixel);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const int row = pixel[i] / width, column = pixel[i] - row * width;
  q[i] = shrink * coordinate(row, height);
  q[q_stride + i] = shrink * coordinate(column, width);
}

/* Bilinear, corners aligned: coordinate -1 is cell 0, 1 is cell 127. grid: cell (r, c) at c*128 + r */
static float interpolate(global const float *grid, float row, float column) {
  const float r = (row + 1) / 2 * (float)last_cell, c = (column + 1) / 2 * (float)last_cell;
  const int r0 = min((int)r, last_cell - 1), c0 = min((int)c, last_cell - 1);
  const float wr = r - (float)r0, wc = c - (float)c0;
  global const float *at = &grid[c0 * SIDE + r0];
  const float left = (1 - wr) * at[0] + wr * at[1];
  const float right = (1 - wr) * at[SIDE] + wr * at[SIDE + 1];
  return (1 - wc) * left + wc * right;
}

/* reached[i] = 1 where the occupancy at pixel i is above the threshold, else 0 */
kernel void torso_reached(SPAN(int, reached), SPAN(const int, pixel), SPAN(const float, grid), float threshold,
                          int width, int height, ulong n) {
  OPEN(int, reached);
  OPEN(const int, pixel);
  OPEN(const float, grid);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const int row = pixel[i] / width, column = pixel[i] - row * width;
  reached[i] = interpolate(grid, coordinate(row, height), coordinate(column, width)) > threshold ? 1 : 0;
}

/* first[i]: how many pixels before i are reached. index, selected: those reached, ascending */
kernel void torso_gather(SPAN(int, index), SPAN(int, selected), SPAN(const int, reached), SPAN(const int, first),
                         SPAN(const int, pixel), ulong n) {
  OPEN(int, index);
  OPEN(int, selected);
  OPEN(const int, reached);
  OPEN(const int, first);
  OPEN(const int, pixel);
  const ulong i = get_global_id(0);
  if (i >= n || !reached[i]) return;
  index[first[i]] = (int)i;
  selected[first[i]] = pixel[i];
}

/* ---- deformation ---- */

enum { CONTROL = 16 }; /* rows and columns of control points */

/* q'_r = q_r + m_r, bilinear (torso_ref.c). motion [2][CONTROL][CONTROL]; scale: control points to a coordinate of 1 */
kernel void torso_move(ROWS(float, moved), ROWS(const float, q), SPAN(const float, motion), float scale, ulong n) {
#pragma OPENCL FP_CONTRACT OFF
  OPEN(float, moved);
  OPEN(const float, q);
  OPEN(const float, motion);
  const ulong i = get_global_id(0);
  float toward[2];
  int cell[2];
  if (i >= n) return;
  for (int d = 0; d < 2; d++) {
    const float at = clamp(q[d * q_stride + i] * scale + (CONTROL - 1) / 2.0f, 0.0f, (float)(CONTROL - 1));
    cell[d] = min((int)at, CONTROL - 2);
    toward[d] = at - (float)cell[d];
  }
  for (int d = 0; d < 2; d++) {
    global const float *m = motion + (d * CONTROL + cell[0]) * CONTROL + cell[1];
    const float upper = (1 - toward[1]) * m[0] + toward[1] * m[1];
    const float lower = (1 - toward[1]) * m[CONTROL] + toward[1] * m[CONTROL + 1];
    moved[d * moved_stride + i] = q[d * q_stride + i] + ((1 - toward[0]) * upper + toward[0] * lower);
  }
}

/* x = clamp(q + d, -1, 1), two rows; NaN stays */
kernel void torso_deform_fwd(ROWS(float, x), ROWS(const float, q), ROWS(const float, d), ulong n) {
  OPEN(float, x);
  OPEN(const float, q);
  OPEN(const float, d);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  for (int row = 0; row < 2; row++) {
    const float moved = q[row * q_stride + i] + d[row * d_stride + i];
    x[row * x_stride + i] = moved < -1 ? -1 : moved > 1 ? 1 : moved;
  }
}

/* dd = dx where the clamp does not change x, the ends -1 and 1 included; else 0 */
kernel void torso_deform_bwd(ROWS(float, dd), ROWS(const float, dx), ROWS(const float, q), ROWS(const float, d),
                             ulong n) {
  OPEN(float, dd);
  OPEN(const float, dx);
  OPEN(const float, q);
  OPEN(const float, d);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  for (int row = 0; row < 2; row++) {
    const float moved = q[row * q_stride + i] + d[row * d_stride + i];
    dd[row * dd_stride + i] = moved >= -1 && moved <= 1 ? dx[row * dx_stride + i] : 0;
  }
}

/* ---- compositing: pixel = a rgb + (1 - a) background; layer [4][n]: alpha, r, g, b ---- */

/* Fills pixels as where there is no torso: the background, and opacity 0. background null: pixel already holds it. */
kernel void torso_untouched(ROWS(float, pixel), SPAN(float, opacity), ROWS(const float, background), ulong rays) {
  OPEN(float, pixel);
  OPEN(float, opacity);
  OPEN(const float, background);
  const ulong r = get_global_id(0);
  if (r >= rays) return;
  if (background) {
    for (int c = 0; c < 3; c++) pixel[c * pixel_stride + r] = background[c * background_stride + r];
  }
  if (opacity) opacity[r] = 0;
}

/* pixel and background may be the same rows */
kernel void torso_composite_fwd(ROWS(float, pixel), SPAN(float, opacity), ROWS(const float, layer),
                                SPAN(const int, index), ROWS(const float, background), ulong n) {
  OPEN(float, pixel);
  OPEN(float, opacity);
  OPEN(const float, layer);
  OPEN(const int, index);
  OPEN(const float, background);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const ulong r = (ulong)index[i];
  const float alpha = layer[i];
  for (int c = 0; c < 3; c++) {
    const float colour = layer[(c + 1) * layer_stride + i];
    pixel[c * pixel_stride + r] = alpha * colour + (1 - alpha) * background[c * background_stride + r];
  }
  if (opacity) opacity[r] = alpha;
}

/* da = sum_c dpixel_c (rgb_c - background_c), drgb = a dpixel */
kernel void torso_composite_bwd(ROWS(float, dlayer), ROWS(const float, dpixel), ROWS(const float, layer),
                                SPAN(const int, index), ROWS(const float, background), ulong n) {
  OPEN(float, dlayer);
  OPEN(const float, dpixel);
  OPEN(const float, layer);
  OPEN(const int, index);
  OPEN(const float, background);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const ulong r = (ulong)index[i];
  const float alpha = layer[i];
  float dalpha = 0;
  for (int c = 0; c < 3; c++) {
    const float d = dpixel[c * dpixel_stride + r];
    dalpha += d * (layer[(c + 1) * layer_stride + i] - background[c * background_stride + r]);
    dlayer[(c + 1) * dlayer_stride + i] = alpha * d;
  }
  dlayer[i] = dalpha;
}

/* ---- occupancy ---- */

/* ((2c/127 - 1)(127/128) + uniform(-1, 1)/128) shrink */
static float look_at(int c, uint word, float shrink) {
  const float centre = coordinate(c, SIDE) * (127.0f / 128.0f), uniform_01 = (float)(word >> 8) * 0x1p-24f;
  return (centre + (2 * uniform_01 - 1) / SIDE) * shrink;
}

/* q [2][CELLS], in cell order */
kernel void torso_points(ROWS(float, q), float shrink, ulong seed, ulong step, uint purpose) {
  OPEN(float, q);
  const uint cell = get_global_id(0);
  if (cell >= CELLS) return;
  uint word[3];
  random_of_one(word, seed, step, cell, purpose);
  q[cell] = look_at(cell % SIDE, word[0], shrink);
  q[q_stride + cell] = look_at(cell / SIDE, word[1], shrink);
}

/* grid = max(decay grid, 5 x 5 maximum of alpha, cut at the edges); NaN in alpha is ignored */
kernel void torso_update(SPAN(float, grid), SPAN(const float, alpha), float decay) {
  OPEN(float, grid);
  OPEN(const float, alpha);
  const int cell = get_global_id(0);
  if (cell >= CELLS) return;
  const int r = cell % SIDE, c = cell / SIDE;
  float most = grid[cell] * decay;
  for (int j = max(c - 2, 0); j <= min(c + 2, last_cell); j++) {
    for (int i = max(r - 2, 0); i <= min(r + 2, last_cell); i++) {
      const float value = alpha[j * SIDE + i];
      if (value > most) most = value;
    }
  }
  grid[cell] = most;
}
