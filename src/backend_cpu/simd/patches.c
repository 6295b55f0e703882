/* SPDX-License-Identifier: MIT
 * The loss over patches for any instruction set (simd/isa.h). The number of pixels of a scale is a multiple of 16, so
 * of LANES; a line of a small scale may be shorter than a register. */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_double.h"
#include "train/patches_ops.h"

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
        const vf values = vf_load_partial(right + k * side + c, count);
        for (size_t i = 0; i < ROWS; i++) sum[i] += left[(r + i) * side + k] * values;
      }
      for (size_t i = 0; i < ROWS; i++) vf_store_partial(out + (r + i) * side + c, sum[i], count);
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

/* Filtered values of a scale's pixels, minus the mean `base` of the recorded picture. */
struct filtered {
  float *x, *y, *xx, *yy, *xy; /* filtered: x, y, x^2, y^2, xy */
};

/* Sum of 1 - SSIM; f->x, xx, xy become the derivatives of the sum of SSIM by A x, A x^2, A xy. */
static double gradients(const struct filtered *f, float base, size_t n) {
  struct vd_pair sum = {{{0}}};
  for (size_t i = 0; i < n; i += LANES) {
    const vf ux = vf_load(f->x + i), uy = vf_load(f->y + i), mx = base + ux, my = base + uy;
    const vf vx = vf_load(f->xx + i) - ux * ux, vy = vf_load(f->yy + i) - uy * uy, vxy = vf_load(f->xy + i) - ux * uy;
    const vf n1 = 2 * mx * my + 1e-4f, n2 = 2 * vxy + 9e-4f, d1 = mx * mx + my * my + 1e-4f, d2 = vx + vy + 9e-4f;
    const vf product = d1 * d2, ssim = n1 * n2 / product;
    const vf by_n1 = n2 / product, by_n2 = n1 / product, by_d1 = ssim / d1, by_d2 = ssim / d2;
    vd_add(&sum, ssim);
    vf_store(f->x + i, 2 * (by_n1 * my - by_d1 * mx) + 2 * (by_d2 * ux - by_n2 * uy));
    vf_store(f->xx + i, -by_d2);
    vf_store(f->xy + i, 2 * by_n2);
  }
  return (double)n - vd_total(sum);
}

double ERN_ISA(ern_patch_scale)(float *dx, const float *x, const float *y, float base, const float *a, size_t side,
                                float factor, float *scratch) {
  const size_t n = side * side;
  const float *at = a + n;
  float *const product = scratch + 5 * n, *const between = scratch + 6 * n;
  const struct filtered f = {scratch, scratch + n, scratch + 2 * n, scratch + 3 * n, scratch + 4 * n};
  filter(f.x, x, a, at, side, between);
  filter(f.y, y, a, at, side, between);
  products(product, x, x, n);
  filter(f.xx, product, a, at, side, between);
  products(product, y, y, n);
  filter(f.yy, product, a, at, side, between);
  products(product, x, y, n);
  filter(f.xy, product, a, at, side, between);
  const double sum = gradients(&f, base, n);
  filter(f.y, f.x, at, a, side, between);
  filter(f.yy, f.xx, at, a, side, between);
  filter(product, f.xy, at, a, side, between);
  for (size_t i = 0; i < n; i += LANES) {
    const vf gradient =
        vf_load(f.y + i) + 2 * vf_load(x + i) * vf_load(f.yy + i) + vf_load(y + i) * vf_load(product + i);
    vf_store(dx + i, vf_load(dx + i) - factor * gradient);
  }
  return sum;
}
