/* SPDX-License-Identifier: MIT
 * Structural similarity of a patch at several scales, and its gradient (patches_ops.h). The truth's mean is subtracted
 * first: variances, small differences of large numbers, then lose fewer digits. */
#include "train/patches_ops.h"

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

/* Filtered pixels of a scale, minus the mean `base` of the recorded picture. */
struct filtered {
  ern_real *x, *y, *xx, *yy, *xy; /* filtered: x, y, x^2, y^2, xy */
};

/* Sum of 1 - SSIM; f->x, xx, xy become the gradients of the sum of SSIM by A x, A x^2, A xy. */
static double gradients(const struct filtered *f, ern_real base, size_t n) {
  const ern_real c1 = (ern_real)1e-4, c2 = (ern_real)9e-4;
  double sum = 0;
  for (size_t i = 0; i < n; i++) {
    const ern_real ux = f->x[i], uy = f->y[i], mx = base + ux, my = base + uy;
    const ern_real vx = f->xx[i] - ux * ux, vy = f->yy[i] - uy * uy, vxy = f->xy[i] - ux * uy;
    const ern_real n1 = 2 * mx * my + c1, n2 = 2 * vxy + c2, d1 = mx * mx + my * my + c1, d2 = vx + vy + c2;
    const ern_real product = d1 * d2, ssim = n1 * n2 / product;
    const ern_real by_n1 = n2 / product, by_n2 = n1 / product, by_d1 = ssim / d1, by_d2 = ssim / d2;
    sum += 1 - (double)ssim;
    f->x[i] = 2 * (by_n1 * my - by_d1 * mx) + 2 * (by_d2 * ux - by_n2 * uy);
    f->xx[i] = -by_d2;
    f->xy[i] = 2 * by_n2;
  }
  return sum;
}

double ERN_REF(ern_patch_scale)(ern_real *dx, const ern_real *x, const ern_real *y, ern_real base, const ern_real *a,
                                size_t side, ern_real factor, ern_real *scratch) {
  const size_t n = side * side;
  const ern_real *at = a + n;
  ern_real *const product = scratch + 5 * n, *const between = scratch + 6 * n;
  const struct filtered f = {scratch, scratch + n, scratch + 2 * n, scratch + 3 * n, scratch + 4 * n};
  filter(f.x, x, a, at, side, between);
  filter(f.y, y, a, at, side, between);
  for (size_t i = 0; i < n; i++) product[i] = x[i] * x[i];
  filter(f.xx, product, a, at, side, between);
  for (size_t i = 0; i < n; i++) product[i] = y[i] * y[i];
  filter(f.yy, product, a, at, side, between);
  for (size_t i = 0; i < n; i++) product[i] = x[i] * y[i];
  filter(f.xy, product, a, at, side, between);
  const double sum = gradients(&f, base, n);
  filter(product, f.x, at, a, side, between);
  for (size_t i = 0; i < n; i++) dx[i] -= factor * product[i];
  filter(product, f.xx, at, a, side, between);
  for (size_t i = 0; i < n; i++) dx[i] -= factor * 2 * x[i] * product[i];
  filter(product, f.xy, at, a, side, between);
  for (size_t i = 0; i < n; i++) dx[i] -= factor * y[i] * product[i];
  return sum;
}

/* ---- the scales -------------------------------------------------------------------------------------------------- */

/* Means of 2 x 2 pixels. side: of `half` */
static void halve(ern_real *half, const ern_real *whole, size_t side) {
  for (size_t r = 0; r < side; r++)
    for (size_t c = 0; c < side; c++) {
      const ern_real *from = whole + 4 * r * side + 2 * c;
      half[r * side + c] = ((from[0] + from[1]) + (from[2 * side] + from[2 * side + 1])) / 4;
    }
}

/* Its backward. */
static void halve_bwd(ern_real *dwhole, const ern_real *dhalf, size_t side) {
  for (size_t r = 0; r < 2 * side; r++)
    for (size_t c = 0; c < 2 * side; c++) dwhole[r * 2 * side + c] += dhalf[r / 2 * side + c / 2] / 4;
}

double ERN_REF(ern_patch_pyramid)(ern_patch_scale_kernel *kernel, ern_real *dx, const ern_real *x, const ern_real *y,
                                  const ern_real *filters, int side, float weight, ern_real *scratch) {
  const size_t whole = (size_t)side, n = whole * whole;
  ern_real *own_x[ERN_PATCH_SCALES], *own_y[ERN_PATCH_SCALES], *own_dx[ERN_PATCH_SCALES] = {dx},
                                                               *next = scratch + ERN_PATCH_SCALE_SCRATCH * n;
  double mean = 0, sum = 0;
  for (size_t i = 0; i < n; i++) mean += (double)y[i];
  const ern_real base = (ern_real)(mean / (double)n);
  for (size_t k = 0; k < ERN_PATCH_SCALES; k++) {
    const size_t at = whole >> k;
    own_x[k] = next;
    own_y[k] = next + at * at;
    next += 2 * at * at;
    for (size_t i = 0; k == 0 && i < n; i++) own_x[0][i] = x[i] - base, own_y[0][i] = y[i] - base;
    if (k == 0) continue;
    halve(own_x[k], own_x[k - 1], at);
    halve(own_y[k], own_y[k - 1], at);
    own_dx[k] = next;
    next += at * at;
    for (size_t i = 0; i < at * at; i++) own_dx[k][i] = 0;
  }
  for (size_t k = 0; k < ERN_PATCH_SCALES; k++) {
    const size_t at = whole >> k;
    const double part = (double)weight / (double)(at * at);
    sum += part * kernel(own_dx[k], own_x[k], own_y[k], base, filters, at, (ern_real)part, scratch);
    filters += 2 * at * at;
  }
  for (size_t k = ERN_PATCH_SCALES - 1; k > 0; k--) halve_bwd(own_dx[k - 1], own_dx[k], whole >> k);
  return sum;
}
