/* SPDX-License-Identifier: MIT
 * The fully connected stacks for any instruction set (simd/isa.h).
 *
 * Everything is one product, out [rows][columns] = A [rows][count] B [count][columns], columns in registers:
 *   forward   y  [outs][samples] = W   [outs][ins]     x   [ins][samples]
 *   backward  dx [ins][samples]  = W^T [ins][outs]     dy  [outs][samples]
 *             dW [outs][ins]    += dy  [outs][samples] x^T [samples][ins] */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes.h"
#include "mlp/mlp_ops.h"
#include "mlp/mlp_tile.h"

/* A block of ROWS x VECTORS sums lives in registers: 8 x 3 of 32, or 4 x 3 of 16, with three for B and one for A. */
enum { TILE = ERN_MLP_TILE, VECTORS = 3, ROWS = LANES == 8 ? 4 : 8 };

typedef enum finish { STORE, STORE_RELU, ADD } finish;

/* out [row][column] at row*out_row + column and so on; A (row, k) at row*a_row + k*a_step. */
struct product {
  float *out;
  const float *a, *b;
  size_t out_row, a_row, a_step, b_row;
  size_t count; /* terms of each sum */
  finish finish;
};

/* Computes one block. `rows`, `vectors` and one of a_row, a_step are constants after inlining. */
LANES_INLINE void block(const struct product *p, size_t row, size_t column, const size_t rows, const size_t vectors,
                        const size_t a_row, const size_t a_step) {
  vf sum[ROWS][VECTORS] = {{{0}}};
  const float *a = p->a + row * a_row, *b = p->b + column;
  for (size_t k = 0; k < p->count; k++) {
    vf values[VECTORS] = {{0}};
#pragma GCC unroll 3
    for (size_t v = 0; v < vectors; v++) values[v] = vf_load(b + v * LANES);
#pragma GCC unroll 8
    for (size_t r = 0; r < rows; r++) {
      const vf weight = vf_all(a[r * a_row]);
#pragma GCC unroll 3
      for (size_t v = 0; v < vectors; v++) sum[r][v] += weight * values[v];
    }
    a += a_step;
    b += p->b_row;
  }
  float *out = p->out + row * p->out_row + column;
#define EACH_SUM(statement)                                                     \
  _Pragma("GCC unroll 8") for (size_t r = 0; r < rows; r++) {                   \
    _Pragma("GCC unroll 3") for (size_t v = 0; v < vectors; v++) { statement; } \
  }
  if (p->finish == STORE_RELU) EACH_SUM(sum[r][v] = vf_select(sum[r][v] < 0, (vf){0}, sum[r][v])) /* NaN stays NaN */
  if (p->finish == ADD) EACH_SUM(sum[r][v] += vf_load(out + r * p->out_row + v * LANES))
  EACH_SUM(vf_store(out + r * p->out_row + v * LANES, sum[r][v]))
#undef EACH_SUM
}

/* All rows of one group of columns. */
LANES_INLINE void block_rows(const struct product *p, size_t rows, size_t column, const size_t vectors,
                             const size_t a_row, const size_t a_step) {
  size_t row = 0;
  for (; row + ROWS <= rows; row += ROWS) block(p, row, column, ROWS, vectors, a_row, a_step);
  if (ROWS > 4 && rows - row >= 4) block(p, row, column, 4, vectors, a_row, a_step), row += 4;
  if (rows - row >= 2) block(p, row, column, 2, vectors, a_row, a_step), row += 2;
  if (rows - row >= 1) block(p, row, column, 1, vectors, a_row, a_step);
}

/* Columns in groups of three registers; four are split 2 + 2, which is faster than 3 + 1. */
LANES_INLINE void product_any(const struct product *p, size_t rows, size_t columns, const size_t a_row,
                              const size_t a_step) {
  size_t left = (columns + LANES - 1) / LANES, column = 0;
  while (left > 0) {
    const size_t take = left == 4 ? 2 : left < 3 ? left : 3;
    switch (take) {
      case 3: block_rows(p, rows, column, 3, a_row, a_step); break;
      case 2: block_rows(p, rows, column, 2, a_row, a_step); break;
      default: block_rows(p, rows, column, 1, a_row, a_step); break;
    }
    column += take * LANES;
    left -= take;
  }
}

static __attribute__((noinline)) void product(const struct product *p, size_t rows, size_t columns) {
  if (p->a_step == 1) {
    product_any(p, rows, columns, p->a_row, 1);
  } else {
    product_any(p, rows, columns, 1, p->a_step);
  }
}

/* One row of a tile: samples first .. first+count-1 of a channel, then zeros. */
LANES_INLINE void gather_row(float *to, const struct ern_rows_view *x, size_t channel, const int32_t *ray, size_t first,
                             size_t count) {
  const float *row = x->data + channel * x->stride;
  switch (x->per) {
    case ERN_PER_SAMPLE:
      if (count == TILE) {
        memcpy(to, row + first, TILE * sizeof *to);
      } else {
        memcpy(to, row + first, count * sizeof *to);
      }
      break;
    case ERN_PER_RAY:
      for (size_t i = 0; i < count; i++) to[i] = row[ray[first + i]];
      break;
    case ERN_PER_BATCH:
      for (size_t i = 0; i < count; i++) to[i] = row[0];
      break;
  }
  if (count < TILE) memset(to + count, 0, (TILE - count) * sizeof *to);
}

/* The concatenation of the pieces, [width][TILE]. */
static void gather(float *tile, const struct ern_rows_view *x, int pieces, const int32_t *ray, size_t first,
                   size_t count) {
  for (int p = 0; p < pieces; p++) {
    for (size_t c = 0; c < (size_t)x[p].rows; c++, tile += TILE) gather_row(tile, &x[p], c, ray, first, count);
  }
}

static void layer_fwd(float *y, size_t y_stride, const float *x, const float *w, int outs, int ins, finish how) {
  const struct product p = {.out = y,
                            .out_row = y_stride,
                            .a = w,
                            .a_row = (size_t)ins,
                            .a_step = 1,
                            .b = x,
                            .b_row = TILE,
                            .count = (size_t)ins,
                            .finish = how};
  product(&p, (size_t)outs, TILE);
}

static void hidden_fwd(float *scratch, const struct ern_mlp_layout *at, const float *parameters,
                       const struct ern_mlp *mlp) {
  for (int l = 0; l + 1 < mlp->layers; l++) {
    layer_fwd(scratch + at->value[l + 1], TILE, scratch + at->value[l], parameters + mlp->weight[l], mlp->width[l + 1],
              mlp->width[l], STORE_RELU);
  }
}

void ERN_ISA(ern_mlp_fwd)(float *y, size_t y_stride, const struct ern_rows_view *x, int pieces, const int32_t *ray,
                          const float *parameters, const struct ern_mlp *mlp, size_t n, float *scratch) {
  const struct ern_mlp_layout at = ern_mlp_layout_make(mlp);
  const int last = mlp->layers - 1, outs = mlp->width[last + 1], ins = mlp->width[last];
  const float *w = parameters + mlp->weight[last], *input = scratch + at.value[last];
  for (size_t first = 0; first < n; first += TILE) {
    const size_t count = n - first < TILE ? n - first : TILE;
    gather(scratch + at.value[0], x, pieces, ray, first, count);
    hidden_fwd(scratch, &at, parameters, mlp);
    if (count == TILE) {
      layer_fwd(y + first, y_stride, input, w, outs, ins, STORE);
      continue;
    }
    float *part = scratch + at.value[last + 1];
    layer_fwd(part, TILE, input, w, outs, ins, STORE);
    for (size_t j = 0; j < (size_t)outs; j++) memcpy(y + j * y_stride + first, part + j * TILE, count * sizeof *y);
  }
}

/* Transposes: lane l of row r and lane r of row l are exchanged, in log2(LANES) rounds with distance d. */
#define TURN_LOW(l, d) ((l) & (d) ? LANES + (l) - (d) : (l))
#define TURN_HIGH(l, d) ((l) & (d) ? LANES + (l) : (l) + (d))
#define TURN_ROUND(d)                                                            \
  for (int r = 0; r < LANES; r++) {                                              \
    if (r & (d)) continue;                                                       \
    const vf low = row[r], high = row[r + (d)];                                  \
    row[r] = __builtin_shufflevector(low, high, LANES_EACH(TURN_LOW, d));        \
    row[r + (d)] = __builtin_shufflevector(low, high, LANES_EACH(TURN_HIGH, d)); \
  }

LANES_INLINE void turn_block(float *out, size_t out_row, const float *in, size_t in_row, size_t rows) {
  vf row[LANES] = {{0}};
#pragma GCC unroll 16
  for (size_t r = 0; r < LANES; r++) {
    if (r < rows) row[r] = vf_load(in + r * in_row);
  }
#pragma GCC unroll 16
  TURN_ROUND(1)
#pragma GCC unroll 16
  TURN_ROUND(2)
#if defined(__AVX2__)
#pragma GCC unroll 16
  TURN_ROUND(4)
#endif
#if defined(__AVX512F__)
#pragma GCC unroll 16
  TURN_ROUND(8)
#endif
#pragma GCC unroll 16
  for (size_t r = 0; r < LANES; r++) vf_store(out + r * out_row, row[r]);
}

/* out [TILE][padded width] = the transpose of tile [width][TILE]; zeros past the width */
static void turn(float *out, const float *tile, int width) {
  const size_t out_row = ern_mlp_padded(width);
  for (size_t c = 0; c < (size_t)width; c += LANES) {
    const size_t rows = (size_t)width - c;
    for (size_t i = 0; i < TILE; i += LANES) {
      if (rows >= LANES) {
        turn_block(out + i * out_row + c, out_row, tile + c * TILE + i, TILE, LANES);
      } else {
        turn_block(out + i * out_row + c, out_row, tile + c * TILE + i, TILE, rows);
      }
    }
  }
}

/* derivative of the ReLU: 0 where the unit was inactive */
static void relu_bwd(float *gradient, const float *value, int rows) {
  for (size_t i = 0; i < (size_t)rows * TILE; i += LANES) {
    vf_store(gradient + i, vf_select(vf_load(value + i) <= 0, (vf){0}, vf_load(gradient + i)));
  }
}

/* dx += the rows of a tile; for a row that the whole batch shares, adds their sum. */
static void scatter(const struct ern_rows_view *dx, const struct ern_rows_view *x, int pieces, const float *gradient,
                    size_t first, size_t count) {
  for (int p = 0; p < pieces; p++) {
    for (size_t c = 0; c < (size_t)x[p].rows; c++, gradient += TILE) {
      if (dx[p].data == NULL || x[p].per == ERN_PER_RAY) continue;
      float *row = dx[p].data + c * dx[p].stride;
      if (x[p].per == ERN_PER_SAMPLE) {
        for (size_t i = 0; i < count; i++) row[first + i] += gradient[i];
      } else {
        float sum = 0;
        for (size_t i = 0; i < count; i++) sum += gradient[i];
        row[0] += sum;
      }
    }
  }
}

/* Backward pass of one tile from the gradient at its output; accumulates the weights' gradients in the scratch. Returns
 * the gradient at the input, or NULL where that is not wanted. */
static float *tile_bwd(float *scratch, const struct ern_mlp_layout *at, const float *parameters,
                       const struct ern_mlp *mlp, bool dx_wanted) {
  float *gradient = scratch + at->gradient[0], *next = scratch + at->gradient[1],
        *transposed = scratch + at->transposed;
  for (int l = mlp->layers - 1; l >= 0; l--) {
    const size_t outs = (size_t)mlp->width[l + 1], ins = (size_t)mlp->width[l], padded = ern_mlp_padded(mlp->width[l]);
    turn(transposed, scratch + at->value[l], mlp->width[l]);
    const struct product dw = {.out = scratch + at->dweight[l],
                               .out_row = padded,
                               .a = gradient,
                               .a_row = TILE,
                               .a_step = 1,
                               .b = transposed,
                               .b_row = padded,
                               .count = TILE,
                               .finish = ADD};
    product(&dw, outs, ins);
    if (l == 0 && !dx_wanted) return NULL;
    const struct product dx = {.out = next,
                               .out_row = TILE,
                               .a = parameters + mlp->weight[l],
                               .a_row = 1,
                               .a_step = ins,
                               .b = gradient,
                               .b_row = TILE,
                               .count = outs,
                               .finish = STORE};
    product(&dx, ins, TILE);
    if (l > 0) relu_bwd(next, scratch + at->value[l], mlp->width[l]);
    float *const swap = gradient;
    gradient = next;
    next = swap;
  }
  return gradient;
}

void ERN_ISA(ern_mlp_bwd)(const struct ern_rows_view *dx, float *dparameters, const float *dy, size_t dy_stride,
                          const struct ern_rows_view *x, int pieces, const int32_t *ray, const float *parameters,
                          const struct ern_mlp *mlp, size_t n, float *scratch) {
  const struct ern_mlp_layout at = ern_mlp_layout_make(mlp);
  bool dx_wanted = false;
  for (int p = 0; p < pieces; p++) dx_wanted = dx_wanted || (dx[p].data != NULL && x[p].per != ERN_PER_RAY);
  const struct ern_rows_view dy_view = {(float *)dy, dy_stride, mlp->width[mlp->layers], ERN_PER_SAMPLE};
  memset(scratch + at.dweight[0], 0, (at.count - at.dweight[0]) * sizeof *scratch);
  for (size_t first = 0; first < n; first += TILE) {
    const size_t count = n - first < TILE ? n - first : TILE;
    gather(scratch + at.value[0], x, pieces, ray, first, count);
    hidden_fwd(scratch, &at, parameters, mlp);
    gather(scratch + at.gradient[0], &dy_view, 1, NULL, first, count);
    const float *gradient = tile_bwd(scratch, &at, parameters, mlp, dx_wanted);
    if (gradient != NULL) scatter(dx, x, pieces, gradient, first, count);
  }
  for (int l = 0; l < mlp->layers; l++) {
    const size_t ins = (size_t)mlp->width[l], padded = ern_mlp_padded(mlp->width[l]);
    for (size_t j = 0; j < (size_t)mlp->width[l + 1]; j++) {
      float *to = dparameters + mlp->weight[l] + j * ins;
      const float *from = scratch + at.dweight[l] + j * padded;
      for (size_t k = 0; k < ins; k++) to[k] += from[k];
    }
  }
}
