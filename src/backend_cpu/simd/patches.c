/* SPDX-License-Identifier: MIT
 * The loss over patches for any instruction set (simd/isa.h). Pixels of a scale are a multiple of 16, so of LANES;
 * a line of a small scale may be shorter than a register. */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_double.h"
#include "core/kernels.h"

enum { ROWS = 4 /* of a block; sides are multiples of it */ };

/* out = left right, all [side][side]. One of them is a filter, 0 beyond ERN_PATCH_RADIUS of its diagonal: `left`
 * where left_filter. */
static void multiply(float *out, const float *left, const float *right, size_t side, bool left_filter) {
  for (size_t c = 0; c < side; c += LANES) {
    const size_t count = side - c < LANES ? side - c : LANES;
    for (size_t r = 0; r < side; r += ROWS) {
      const size_t begin = left_filter ? r : c, end = left_filter ? r + ROWS : c + count;
      const size_t from = begin > ERN_PATCH_RADIUS ? begin - ERN_PATCH_RADIUS : 0;
      const size_t to = end + ERN_PATCH_RADIUS < side ? end + ERN_PATCH_RADIUS : side;
      vf sum[ROWS] = {{0}};
      for (size_t k = from; k < to; k++) {
        const vf values = vf_load_some(right + k * side + c, count);
        for (size_t i = 0; i < ROWS; i++) sum[i] += left[(r + i) * side + k] * values;
      }
      for (size_t i = 0; i < ROWS; i++) vf_store_some(out + (r + i) * side + c, sum[i], count);
    }
  }
}

/* out = A in A^T. at: A transposed. Exchanging a and at makes it out = A^T in A. */
static void filter(float *out, const float *in, const float *a, const float *at, size_t side, float *between) {
  multiply(between, a, in, side, true);
  multiply(out, between, at, side, false);
}

static void products(float *out, const float *a, const float *b, size_t n) {
  for (size_t i = 0; i < n; i += LANES) vf_store(out + i, vf_load(a + i) * vf_load(b + i));
}

static void halve(float *half, const float *whole, size_t side) {
  for (size_t r = 0; r < side / 2; r++)
    for (size_t c = 0; c < side / 2; c++) {
      const float *from = whole + 2 * r * side + 2 * c;
      half[r * (side / 2) + c] = ((from[0] + from[1]) + (from[side] + from[side + 1])) / 4;
    }
}

/* What the pixels of one scale need. */
struct scale {
  const float *x, *y; /* less the mean `base` */
  float base;
  float *mx, *my, *xx, *yy, *xy; /* filtered: x, y, x^2, y^2, xy */
};

/* Sum of 1 - SSIM; mx, xx, xy become the slopes of the sum of SSIM by A x, A x^2, A xy. */
static double slopes(const struct scale *s, size_t n) {
  struct vd_pair sum = {{{0}}};
  for (size_t i = 0; i < n; i += LANES) {
    const vf ux = vf_load(s->mx + i), uy = vf_load(s->my + i), mx = s->base + ux, my = s->base + uy;
    const vf vx = vf_load(s->xx + i) - ux * ux, vy = vf_load(s->yy + i) - uy * uy, vxy = vf_load(s->xy + i) - ux * uy;
    const vf n1 = 2 * mx * my + 1e-4f, n2 = 2 * vxy + 9e-4f, d1 = mx * mx + my * my + 1e-4f, d2 = vx + vy + 9e-4f;
    const vf product = d1 * d2, ssim = n1 * n2 / product;
    const vf by_n1 = n2 / product, by_n2 = n1 / product, by_d1 = ssim / d1, by_d2 = ssim / d2;
    vd_add(&sum, ssim);
    vf_store(s->mx + i, 2 * (by_n1 * my - by_d1 * mx) + 2 * (by_d2 * ux - by_n2 * uy));
    vf_store(s->xx + i, -by_d2);
    vf_store(s->xy + i, 2 * by_n2);
  }
  return (double)n - vd_total(sum);
}

/* One scale: adds factor times the slope of the sum of 1 - SSIM to dx. Returns that sum. */
static double scale_loss(float *dx, const struct scale *s, const float *a, size_t side, float factor, float *product,
                         float *between) {
  const float *at = a + side * side;
  const size_t n = side * side;
  filter(s->mx, s->x, a, at, side, between);
  filter(s->my, s->y, a, at, side, between);
  products(product, s->x, s->x, n);
  filter(s->xx, product, a, at, side, between);
  products(product, s->y, s->y, n);
  filter(s->yy, product, a, at, side, between);
  products(product, s->x, s->y, n);
  filter(s->xy, product, a, at, side, between);
  const double sum = slopes(s, n);
  filter(s->my, s->mx, at, a, side, between);
  filter(s->yy, s->xx, at, a, side, between);
  filter(product, s->xy, at, a, side, between);
  for (size_t i = 0; i < n; i += LANES) {
    const vf slope =
        vf_load(s->my + i) + 2 * vf_load(s->x + i) * vf_load(s->yy + i) + vf_load(s->y + i) * vf_load(product + i);
    vf_store(dx + i, vf_load(dx + i) - factor * slope);
  }
  return sum;
}

static float mean_of(const float *values, size_t n) {
  struct vd_pair sum = {{{0}}};
  for (size_t i = 0; i < n; i += LANES) vd_add(&sum, vf_load(values + i));
  return (float)(vd_total(sum) / (double)n);
}

double ERN_ISA(ern_patch_loss)(float *dx, const float *x, const float *y, const float *filters, int side, float weight,
                               float *scratch) {
  const size_t whole = (size_t)side, n = whole * whole;
  float *own_x[ERN_PATCH_SCALES], *own_y[ERN_PATCH_SCALES], *own_dx[ERN_PATCH_SCALES] = {dx}, *next = scratch;
  struct scale s = {.mx = next, .my = next + n, .xx = next + 2 * n, .yy = next + 3 * n, .xy = next + 4 * n};
  float *const product = next + 5 * n, *const between = next + 6 * n;
  double sum = 0;
  next += 7 * n;
  s.base = mean_of(y, n);
  for (size_t k = 0; k < ERN_PATCH_SCALES; k++) {
    const size_t at = whole >> k;
    own_x[k] = next;
    own_y[k] = next + at * at;
    next += 2 * at * at;
    for (size_t i = 0; k == 0 && i < n; i += LANES) {
      vf_store(own_x[0] + i, vf_load(x + i) - s.base);
      vf_store(own_y[0] + i, vf_load(y + i) - s.base);
    }
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
    sum += part * scale_loss(own_dx[k], &s, filters, at, (float)part, product, between);
    filters += 2 * at * at;
  }
  for (size_t k = ERN_PATCH_SCALES - 1; k > 0; k--) {
    const size_t at = whole >> k;
    for (size_t r = 0; r < 2 * at; r++)
      for (size_t c = 0; c < 2 * at; c++) own_dx[k - 1][r * 2 * at + c] += own_dx[k][r / 2 * at + c / 2] / 4;
  }
  return sum;
}
