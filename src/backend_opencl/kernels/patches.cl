/* SPDX-License-Identifier: MIT
 * Structural similarity of patches at several scales, and its gradient (train/patches_ops.h). One work-item per pixel.
 * A channel of a patch is a plane; plane p is channel p % 3 of patch p/3. The mean of the recorded plane is subtracted
 * from values. Arrays of a scale are [planes][side][side]; `total` is their length. */

#pragma OPENCL FP_CONTRACT OFF

#define RADIUS 5 /* ERN_PATCH_RADIUS */

/* base[p] = mean of the recorded plane. */
kernel void patch_base(SPAN(float, base), ROWS(const float, truth), ulong n, ulong planes) {
  OPEN(float, base);
  OPEN(const float, truth);
  const ulong p = get_global_id(0);
  if (p >= planes) return;
  global const float *from = truth + p % 3 * truth_stride + p / 3 * n;
  float sum = 0;
  for (ulong i = 0; i < n; i += 16) {
    float part = 0;
    for (ulong k = 0; k < 16; k++) part += from[i + k];
    sum += part;
  }
  base[p] = sum / n;
}

kernel void patch_shift(SPAN(float, x), SPAN(float, y), ROWS(const float, pixel), ROWS(const float, truth),
                        SPAN(const float, base), ulong n, ulong total) {
  OPEN(float, x);
  OPEN(float, y);
  OPEN(const float, pixel);
  OPEN(const float, truth);
  OPEN(const float, base);
  const ulong i = get_global_id(0), p = i / n, at = p / 3 * n + i % n;
  if (i >= total) return;
  x[i] = pixel[p % 3 * pixel_stride + at] - base[p];
  y[i] = truth[p % 3 * truth_stride + at] - base[p];
}

float mean_of_four(global const float *whole, ulong i, ulong side) {
  const ulong n = side * side, plane = i / n, r = i % n / side, c = i % side;
  global const float *from = whole + plane * 4 * n + 2 * r * 2 * side + 2 * c;
  return ((from[0] + from[1]) + (from[2 * side] + from[2 * side + 1])) / 4;
}

/* x, y: the smaller scale, of which side is the side */
kernel void patch_halve(SPAN(float, x), SPAN(float, y), SPAN(const float, whole_x), SPAN(const float, whole_y),
                        ulong side, ulong total) {
  OPEN(float, x);
  OPEN(float, y);
  OPEN(const float, whole_x);
  OPEN(const float, whole_y);
  const ulong i = get_global_id(0);
  if (i >= total) return;
  x[i] = mean_of_four(whole_x, i, side);
  y[i] = mean_of_four(whole_y, i, side);
}

/* The filter around pixel `at` of a line covers the pixels FIRST .. PAST - 1. */
#define FIRST(at) ((at) > RADIUS ? (at)-RADIUS : 0)
#define PAST(at, side) min((at) + RADIUS + 1, side)

/* between [5][total] = the filter A applied along columns to x, y, x^2, y^2, xy */
kernel void patch_columns(SPAN(float, between), SPAN(const float, x), SPAN(const float, y), SPAN(const float, filter),
                          ulong side, ulong total) {
  OPEN(float, between);
  OPEN(const float, x);
  OPEN(const float, y);
  OPEN(const float, filter);
  const ulong i = get_global_id(0), r = i / side % side, c = i % side, plane = i - r * side - c;
  if (i >= total) return;
  float sum[5] = {0, 0, 0, 0, 0};
  for (ulong k = FIRST(r); k < PAST(r, side); k++) {
    const float a = filter[r * side + k], u = x[plane + k * side + c], v = y[plane + k * side + c];
    sum[0] += a * u;
    sum[1] += a * v;
    sum[2] += a * (u * u);
    sum[3] += a * (v * v);
    sum[4] += a * (u * v);
  }
  for (ulong q = 0; q < 5; q++) between[q * total + i] = sum[q];
}

/* gradient [4][total]: derivatives of the sum of SSIM with respect to A x, A x^2, A xy; then 1 - SSIM */
kernel void patch_gradients(SPAN(float, gradient), SPAN(const float, between), SPAN(const float, base),
                         SPAN(const float, filter), ulong side, ulong total) {
  OPEN(float, gradient);
  OPEN(const float, between);
  OPEN(const float, base);
  OPEN(const float, filter);
  const ulong i = get_global_id(0), c = i % side, line = i - c;
  if (i >= total) return;
  float of[5] = {0, 0, 0, 0, 0};
  for (ulong k = FIRST(c); k < PAST(c, side); k++)
    for (ulong q = 0; q < 5; q++) of[q] += filter[c * side + k] * between[q * total + line + k];
  const float shift = base[i / (side * side)], ux = of[0], uy = of[1], mx = shift + ux, my = shift + uy;
  const float vx = of[2] - ux * ux, vy = of[3] - uy * uy, vxy = of[4] - ux * uy;
  const float n1 = 2 * mx * my + 1e-4f, n2 = 2 * vxy + 9e-4f, d1 = mx * mx + my * my + 1e-4f, d2 = vx + vy + 9e-4f;
  const float product = d1 * d2, ssim = n1 * n2 / product;
  const float by_n1 = n2 / product, by_n2 = n1 / product, by_d1 = ssim / d1, by_d2 = ssim / d2;
  gradient[i] = 2 * (by_n1 * my - by_d1 * mx) + 2 * (by_d2 * ux - by_n2 * uy);
  gradient[total + i] = -by_d2;
  gradient[2 * total + i] = 2 * by_n2;
  gradient[3 * total + i] = 1 - ssim;
}

/* figure[line] = factor times the sum of 1 - SSIM over a line; lines: planes * side */
kernel void patch_sums(SPAN(float, figure), SPAN(const float, gradient), float factor, ulong side, ulong total) {
  OPEN(float, figure);
  OPEN(const float, gradient);
  const ulong line = get_global_id(0);
  if (line >= total / side) return;
  float sum = 0;
  for (ulong c = 0; c < side; c++) sum += gradient[3 * total + line * side + c];
  figure[line] = factor * sum;
}

/* between [3][total] = A^T applied along columns to the first three gradients */
kernel void patch_columns_bwd(SPAN(float, between), SPAN(const float, gradient), SPAN(const float, filter), ulong side,
                              ulong total) {
  OPEN(float, between);
  OPEN(const float, gradient);
  OPEN(const float, filter);
  const ulong i = get_global_id(0), r = i / side % side, c = i % side, plane = i - r * side - c;
  if (i >= total) return;
  float sum[3] = {0, 0, 0};
  for (ulong k = FIRST(r); k < PAST(r, side); k++)
    for (ulong q = 0; q < 3; q++) sum[q] += filter[k * side + r] * gradient[q * total + plane + k * side + c];
  for (ulong q = 0; q < 3; q++) between[q * total + i] = sum[q];
}

/* The gradient of a pixel of a scale: its own, and a quarter of the gradient of the pixel that contains it in the next
 * scale (`smaller`; null: none). */
float gradient_of(global const float *x, global const float *y, global const float *between, global const float *filter,
               global const float *smaller, float factor, ulong side, ulong total, ulong i) {
  const ulong r = i / side % side, c = i % side, line = i - c, plane = i / (side * side);
  float of[3] = {0, 0, 0};
  for (ulong k = FIRST(c); k < PAST(c, side); k++)
    for (ulong q = 0; q < 3; q++) of[q] += filter[k * side + c] * between[q * total + line + k];
  const float own = -factor * (of[0] + 2 * x[i] * of[1] + y[i] * of[2]);
  return smaller ? own + smaller[plane * (side / 2) * (side / 2) + r / 2 * (side / 2) + c / 2] / 4 : own;
}

kernel void patch_bwd(SPAN(float, d), SPAN(const float, x), SPAN(const float, y), SPAN(const float, between),
                      SPAN(const float, filter), SPAN(const float, smaller), float factor, ulong side, ulong total) {
  OPEN(float, d);
  OPEN(const float, x);
  OPEN(const float, y);
  OPEN(const float, between);
  OPEN(const float, filter);
  OPEN(const float, smaller);
  const ulong i = get_global_id(0);
  if (i < total) d[i] = gradient_of(x, y, between, filter, smaller, factor, side, total, i);
}

/* The same for the patch at full size, added to the gradient of its rays. */
kernel void patch_rays_bwd(ROWS(float, dpixel), SPAN(const float, x), SPAN(const float, y), SPAN(const float, between),
                           SPAN(const float, filter), SPAN(const float, smaller), float factor, ulong side,
                           ulong total) {
  OPEN(float, dpixel);
  OPEN(const float, x);
  OPEN(const float, y);
  OPEN(const float, between);
  OPEN(const float, filter);
  OPEN(const float, smaller);
  const ulong i = get_global_id(0), n = side * side, p = i / n;
  if (i >= total) return;
  dpixel[p % 3 * dpixel_stride + p / 3 * n + i % n] +=
      gradient_of(x, y, between, filter, smaller, factor, side, total, i);
}
