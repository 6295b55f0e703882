/* SPDX-License-Identifier: MIT
 * Reference of the fully connected stacks. Samples are processed in tiles, padded with zeros to full size, so that
 * every inner loop has a constant length. */
#include "mlp/mlp_tile.h"

enum { TILE = ERN_MLP_TILE, PARTS = 8 };

/* tile [rows][TILE] = samples first .. first+count-1 of a row group, zeros behind */
static void gather_piece(ern_real *restrict tile, const struct ern_rows_view *x, const int32_t *ray, size_t first,
                         size_t count) {
  for (int c = 0; c < x->rows; c++) {
    const ern_real *row = x->data + (size_t)c * x->stride;
    ern_real *to = tile + (size_t)c * TILE;
    for (size_t i = 0; i < count; i++) {
      switch (x->per) {
        case ERN_PER_SAMPLE: to[i] = row[first + i]; break;
        case ERN_PER_RAY: to[i] = row[ray[first + i]]; break;
        case ERN_PER_BATCH: to[i] = row[0]; break;
      }
    }
    for (size_t i = count; i < TILE; i++) to[i] = 0;
  }
}

/* The concatenation of the pieces. */
static void gather(ern_real *tile, const struct ern_rows_view *x, int pieces, const int32_t *ray, size_t first,
                   size_t count) {
  for (int p = 0; p < pieces; p++) {
    gather_piece(tile, &x[p], ray, first, count);
    tile += (size_t)x[p].rows * TILE;
  }
}

/* y [outs][TILE] = W [outs][ins] * x [ins][TILE] */
static void layer_fwd(ern_real *restrict y, const ern_real *restrict x, const ern_real *restrict w, int outs, int ins) {
  for (int j = 0; j < outs; j++) {
    ern_real *to = y + (size_t)j * TILE;
    for (int i = 0; i < TILE; i++) to[i] = 0;
    for (int k = 0; k < ins; k++) {
      const ern_real weight = w[(size_t)j * (size_t)ins + (size_t)k];
      const ern_real *from = x + (size_t)k * TILE;
      for (int i = 0; i < TILE; i++) to[i] += weight * from[i];
    }
  }
}

/* max(x, 0); a NaN stays one, so that it is noticed. */
static void relu(ern_real *values, int rows) {
  for (size_t i = 0; i < (size_t)rows * TILE; i++) values[i] = values[i] < 0 ? 0 : values[i];
}

/* Input and all hidden values of a tile: h_0 = x, h_{l+1} = relu(W_l h_l). */
static void hidden_fwd(ern_real *scratch, const struct ern_mlp_layout *at, const ern_real *parameters,
                       const struct ern_mlp *mlp) {
  for (int l = 0; l + 1 < mlp->layers; l++) {
    ern_real *h = scratch + at->value[l + 1];
    layer_fwd(h, scratch + at->value[l], parameters + mlp->weight[l], mlp->width[l + 1], mlp->width[l]);
    relu(h, mlp->width[l + 1]);
  }
}

void ERN_REF(ern_mlp_fwd)(ern_real *y, size_t y_stride, const struct ern_rows_view *x, int pieces, const int32_t *ray,
                          const ern_real *parameters, const struct ern_mlp *mlp, size_t n, ern_real *scratch) {
  const struct ern_mlp_layout at = ern_mlp_layout_make(mlp);
  const int last = mlp->layers - 1;
  for (size_t first = 0; first < n; first += TILE) {
    const size_t count = n - first < TILE ? n - first : TILE;
    gather(scratch + at.value[0], x, pieces, ray, first, count);
    hidden_fwd(scratch, &at, parameters, mlp);
    ern_real *out = scratch + at.value[last + 1];
    layer_fwd(out, scratch + at.value[last], parameters + mlp->weight[last], mlp->width[last + 1], mlp->width[last]);
    for (int j = 0; j < mlp->width[last + 1]; j++) {
      for (size_t i = 0; i < count; i++) y[(size_t)j * y_stride + first + i] = out[(size_t)j * TILE + i];
    }
  }
}

/* sum_i a_i b_i over a tile, in PARTS independent sums */
static ern_real dot(const ern_real *a, const ern_real *b) {
  ern_real part[PARTS] = {0};
  for (int i = 0; i < TILE; i += PARTS) {
    for (int k = 0; k < PARTS; k++) part[k] += a[i + k] * b[i + k];
  }
  ern_real sum = 0;
  for (int k = 0; k < PARTS; k++) sum += part[k];
  return sum;
}

/* dW [outs][ins] += dy x^T, summed over the tile */
static void layer_bwd_weight(ern_real *restrict dw, const ern_real *restrict dy, const ern_real *restrict x, int outs,
                             int ins) {
  for (int j = 0; j < outs; j++) {
    for (int k = 0; k < ins; k++) {
      dw[(size_t)j * (size_t)ins + (size_t)k] += dot(dy + (size_t)j * TILE, x + (size_t)k * TILE);
    }
  }
}

/* dx [ins][TILE] = W^T dy */
static void layer_bwd_input(ern_real *restrict dx, const ern_real *restrict dy, const ern_real *restrict w, int outs,
                            int ins) {
  for (int k = 0; k < ins; k++) {
    ern_real *to = dx + (size_t)k * TILE;
    for (int i = 0; i < TILE; i++) to[i] = 0;
    for (int j = 0; j < outs; j++) {
      const ern_real weight = w[(size_t)j * (size_t)ins + (size_t)k];
      const ern_real *from = dy + (size_t)j * TILE;
      for (int i = 0; i < TILE; i++) to[i] += weight * from[i];
    }
  }
}

/* d relu: 0 where the unit was inactive, that is where its value is 0 */
static void relu_bwd(ern_real *restrict gradient, const ern_real *restrict value, int rows) {
  for (size_t i = 0; i < (size_t)rows * TILE; i++) gradient[i] = value[i] <= 0 ? 0 : gradient[i];
}

/* dx += the rows of a tile; for a row that the whole batch shares, the sum over the tile. */
static void scatter(const struct ern_rows_view *dx, const struct ern_rows_view *x, int pieces, const ern_real *gradient,
                    size_t first, size_t count) {
  for (int p = 0; p < pieces; p++) {
    for (int c = 0; c < x[p].rows; c++, gradient += TILE) {
      if (dx[p].data == NULL || x[p].per == ERN_PER_RAY) continue;
      ern_real *row = dx[p].data + (size_t)c * dx[p].stride;
      for (size_t i = 0; i < count; i++) row[x[p].per == ERN_PER_SAMPLE ? first + i : 0] += gradient[i];
    }
  }
}

void ERN_REF(ern_mlp_bwd)(const struct ern_rows_view *dx, ern_real *dparameters, const ern_real *dy, size_t dy_stride,
                          const struct ern_rows_view *x, int pieces, const int32_t *ray, const ern_real *parameters,
                          const struct ern_mlp *mlp, size_t n, ern_real *scratch) {
  const struct ern_mlp_layout at = ern_mlp_layout_make(mlp);
  bool dx_wanted = false;
  for (int p = 0; p < pieces; p++) dx_wanted = dx_wanted || (dx[p].data != NULL && x[p].per != ERN_PER_RAY);
  const struct ern_rows_view dy_view = {(ern_real *)dy, dy_stride, mlp->width[mlp->layers], ERN_PER_SAMPLE};
  for (size_t first = 0; first < n; first += TILE) {
    const size_t count = n - first < TILE ? n - first : TILE;
    gather(scratch + at.value[0], x, pieces, ray, first, count);
    hidden_fwd(scratch, &at, parameters, mlp);
    ern_real *gradient = scratch + at.gradient[0], *next = scratch + at.gradient[1];
    gather(gradient, &dy_view, 1, NULL, first, count);
    for (int l = mlp->layers - 1; l >= 0; l--) {
      const int outs = mlp->width[l + 1], ins = mlp->width[l];
      const ern_real *value = scratch + at.value[l];
      layer_bwd_weight(dparameters + mlp->weight[l], gradient, value, outs, ins);
      if (l == 0 && !dx_wanted) break;
      layer_bwd_input(next, gradient, parameters + mlp->weight[l], outs, ins);
      if (l > 0) relu_bwd(next, value, ins);
      ern_real *const swap = gradient;
      gradient = next;
      next = swap;
    }
    if (dx_wanted) scatter(dx, x, pieces, gradient, first, count);
  }
}
