/* SPDX-License-Identifier: MIT
 * Structural similarity of a patch at several scales, and its gradient (patches_ops.h). Means are of values less the
 * truth's mean: variances, small differences of large numbers, lose fewer digits then. */
#include "core/kernels.h"

/* out = A in A^T; all [side][side]. at: A transposed. Exchanging a and at makes it out = A^T in A. */
static void filter(ern_real *out, const ern_real *in, const ern_real *a, const ern_real *at, size_t side,
                   ern_real *between) {
  for (size_t r = 0; r < side; r++) {
    const size_t from = r > ERN_PATCH_RADIUS ? r - ERN_PATCH_RADIUS : 0;
    const size_t to = r + ERN_PATCH_RADIUS < side ? r + ERN_PATCH_RADIUS + 1 : side;
    for (size_t c = 0; c < side; c++) between[r * side + c] = 0;
    for (size_t k = from; k < to; k++)
      for (size_t c = 0; c < side; c++) between[r * side + c] += a[r * side + k] * in[k * side + c];
  }
  for (size_t r = 0; r < side; r++)
    for (size_t c = 0; c < side; c++) {
      const size_t from = c > ERN_PATCH_RADIUS ? c - ERN_PATCH_RADIUS : 0;
      const size_t to = c + ERN_PATCH_RADIUS < side ? c + ERN_PATCH_RADIUS + 1 : side;
      ern_real sum = 0;
      for (size_t k = from; k < to; k++) sum += between[r * side + k] * at[k * side + c];
      out[r * side + c] = sum;
    }
}

/* Means of 2 x 2 pixels. */
static void halve(ern_real *half, const ern_real *whole, size_t side) {
  for (size_t r = 0; r < side / 2; r++)
    for (size_t c = 0; c < side / 2; c++) {
      const ern_real *from = whole + 2 * r * side + 2 * c;
      half[r * (side / 2) + c] = ((from[0] + from[1]) + (from[side] + from[side + 1])) / 4;
    }
}

/* What the pixels of one scale need. */
struct scale {
  const ern_real *x, *y; /* less the mean `base` */
  ern_real base;
  ern_real *mx, *my, *xx, *yy, *xy; /* filtered: x, y, x^2, y^2, xy */
};

/* Sum of 1 - SSIM; mx, xx, xy become the slopes of the sum of SSIM by A x, A x^2, A xy. */
static double slopes(const struct scale *s, size_t n) {
  const ern_real c1 = (ern_real)1e-4, c2 = (ern_real)9e-4;
  double sum = 0;
  for (size_t i = 0; i < n; i++) {
    const ern_real ux = s->mx[i], uy = s->my[i], mx = s->base + ux, my = s->base + uy;
    const ern_real vx = s->xx[i] - ux * ux, vy = s->yy[i] - uy * uy, vxy = s->xy[i] - ux * uy;
    const ern_real n1 = 2 * mx * my + c1, n2 = 2 * vxy + c2, d1 = mx * mx + my * my + c1, d2 = vx + vy + c2;
    const ern_real product = d1 * d2, ssim = n1 * n2 / product;
    const ern_real by_n1 = n2 / product, by_n2 = n1 / product, by_d1 = ssim / d1, by_d2 = ssim / d2;
    sum += 1 - (double)ssim;
    s->mx[i] = 2 * (by_n1 * my - by_d1 * mx) + 2 * (by_d2 * ux - by_n2 * uy);
    s->xx[i] = -by_d2;
    s->xy[i] = 2 * by_n2;
  }
  return sum;
}

/* One scale: adds factor times the slope of the sum of 1 - SSIM to dx. Returns that sum. */
static double scale_loss(ern_real *dx, const struct scale *s, const ern_real *a, size_t side, ern_real factor,
                         ern_real *product, ern_real *between) {
  const ern_real *at = a + side * side;
  const size_t n = side * side;
  filter(s->mx, s->x, a, at, side, between);
  filter(s->my, s->y, a, at, side, between);
  for (size_t i = 0; i < n; i++) product[i] = s->x[i] * s->x[i];
  filter(s->xx, product, a, at, side, between);
  for (size_t i = 0; i < n; i++) product[i] = s->y[i] * s->y[i];
  filter(s->yy, product, a, at, side, between);
  for (size_t i = 0; i < n; i++) product[i] = s->x[i] * s->y[i];
  filter(s->xy, product, a, at, side, between);
  const double sum = slopes(s, n);
  filter(product, s->mx, at, a, side, between);
  for (size_t i = 0; i < n; i++) dx[i] -= factor * product[i];
  filter(product, s->xx, at, a, side, between);
  for (size_t i = 0; i < n; i++) dx[i] -= factor * 2 * s->x[i] * product[i];
  filter(product, s->xy, at, a, side, between);
  for (size_t i = 0; i < n; i++) dx[i] -= factor * s->y[i] * product[i];
  return sum;
}

double ERN_REF(ern_patch_loss)(ern_real *dx, const ern_real *x, const ern_real *y, const ern_real *filters, int side,
                               float weight, ern_real *scratch) {
  const size_t whole = (size_t)side, n = whole * whole;
  ern_real *own_x[ERN_PATCH_SCALES], *own_y[ERN_PATCH_SCALES], *own_dx[ERN_PATCH_SCALES] = {dx}, *next = scratch;
  struct scale s = {.mx = next, .my = next + n, .xx = next + 2 * n, .yy = next + 3 * n, .xy = next + 4 * n};
  ern_real *const product = next + 5 * n, *const between = next + 6 * n;
  double mean = 0, sum = 0;
  next += 7 * n;
  for (size_t i = 0; i < n; i++) mean += (double)y[i];
  s.base = (ern_real)(mean / (double)n);
  for (size_t k = 0; k < ERN_PATCH_SCALES; k++) {
    const size_t at = whole >> k;
    own_x[k] = next;
    own_y[k] = next + at * at;
    next += 2 * at * at;
    for (size_t i = 0; k == 0 && i < n; i++) own_x[0][i] = x[i] - s.base, own_y[0][i] = y[i] - s.base;
    if (k == 0) continue;
    halve(own_x[k], own_x[k - 1], 2 * at);
    halve(own_y[k], own_y[k - 1], 2 * at);
    own_dx[k] = next;
    next += at * at;
    for (size_t i = 0; i < at * at; i++) own_dx[k][i] = 0;
  }
  for (size_t k = 0; k < ERN_PATCH_SCALES; k++) {
    const size_t at = whole >> k;
    s.x = own_x[k], s.y = own_y[k];
    const double part = (double)weight / (double)(at * at);
    sum += part * scale_loss(own_dx[k], &s, filters, at, (ern_real)part, product, between);
    filters += 2 * at * at;
  }
  for (size_t k = ERN_PATCH_SCALES - 1; k > 0; k--) {
    const size_t at = whole >> k;
    for (size_t r = 0; r < 2 * at; r++)
      for (size_t c = 0; c < 2 * at; c++) own_dx[k - 1][r * 2 * at + c] += own_dx[k][r / 2 * at + c / 2] / 4;
  }
  return sum;
}
