/* SPDX-License-Identifier: MIT
 * The loss over patches against its definition in double, pixel by pixel with the whole window. */
#include "harness.h"

#include "train/patch_filter.h"
#include "train/patches_ops.h"

enum { SCALES = ERN_PATCH_SCALES };

typedef enum kinds { NOISE, FLAT, SAME, SATURATED, EDGE, KINDS } kinds;

static float value_at(kinds kind, bool truth, size_t patch, size_t c, size_t r, size_t col, uint64_t seed) {
  const struct ern_random random = words_at(seed, patch * 3 + c, r * 64 + col);
  const float noise = ern_uniform(random.word[truth ? 1 : 0]);
  switch (kind) {
    case NOISE: return noise;
    case FLAT: return truth ? 0.3f : 0.6f;
    case SAME: return ern_uniform(random.word[0]);
    case SATURATED: return noise < 0.5f ? 0 : 1;
    default: return (col < 9 ? 0.02f : 0.95f) + 0.02f * noise;
  }
}

/* ---- the definition; what the errors of single precision may be, beside it ---- */

struct plane {
  size_t side;
  const double *x, *y;
  double *window;     /* [side][side]: weight of pixel c of a line in the mean around pixel r */
  double *dx, *error; /* of weight times the sum of 1 - SSIM */
};

static double window(size_t a, size_t b, size_t side) {
  double sum = 0;
  const double apart = fabs((double)a - (double)b);
  if (apart > ERN_PATCH_RADIUS) return 0;
  for (size_t k = 0; k < side; k++) {
    const double d = fabs((double)a - (double)k);
    if (d <= ERN_PATCH_RADIUS) sum += exp(-d * d / 4.5);
  }
  return exp(-apart * apart / 4.5) / sum;
}

static size_t first(size_t at) { return at > ERN_PATCH_RADIUS ? at - ERN_PATCH_RADIUS : 0; }

/* A filtered value is two sums of 11 products of numbers that are rounded themselves: 30 roundings of the mean of their
 * sizes. Differences of such numbers, the variances, are what loses digits: `lost` is that over the denominator. */
static const double roundings = 30, unit = 0x1p-23;

static double pixel(const struct plane *p, size_t r, size_t c, double base, double factor, double *value_error) {
  const size_t side = p->side;
  double ux = 0, uy = 0, xx = 0, yy = 0, xy = 0;
  for (size_t j = first(r); j < side && j <= r + ERN_PATCH_RADIUS; j++)
    for (size_t i = first(c); i < side && i <= c + ERN_PATCH_RADIUS; i++) {
      const double w = p->window[r * side + j] * p->window[c * side + i], x = p->x[j * side + i] - base,
                   y = p->y[j * side + i] - base;
      ux += w * x, uy += w * y, xx += w * x * x, yy += w * y * y, xy += w * x * y;
    }
  const double mx = base + ux, my = base + uy, n1 = 2 * mx * my + 1e-4, n2 = 2 * (xy - ux * uy) + 9e-4;
  const double d1 = mx * mx + my * my + 1e-4, d2 = xx - ux * ux + yy - uy * uy + 9e-4, ssim = n1 * n2 / (d1 * d2);
  const double by_n1 = n2 / (d1 * d2), by_n2 = n1 / (d1 * d2), by_d1 = ssim / d1, by_d2 = ssim / d2;
  const double e = roundings * unit, lost = e * (xx + yy) / d2, shaken = 4 * e * (mx * mx + my * my) / d1 + e;
  const double e_ssim = fabs(by_n2) * 2 * e * (xx + yy) + fabs(ssim) * (lost + shaken);
  const double e_n1 = 2 * e * (xx + yy) / (d1 * d2) + fabs(by_n1) * (lost + shaken);
  const double e_n2 = fabs(by_n2) * (lost + shaken), e_d1 = e_ssim / d1 + fabs(by_d1) * shaken,
               e_d2 = e_ssim / d2 + fabs(by_d2) * lost;
  const double g[3] = {2 * (by_n1 * my - by_d1 * mx) + 2 * (by_d2 * ux - by_n2 * uy), -by_d2, 2 * by_n2};
  const double size = 2 * (fabs(by_n1 * my) + fabs(by_d1 * mx) + fabs(by_d2 * ux) + fabs(by_n2 * uy));
  const double eg[3] = {2 * (e_n1 * fabs(my) + e_d1 * fabs(mx) + e_d2 * fabs(ux) + e_n2 * fabs(uy)) + e * size, e_d2,
                        2 * e_n2};
  for (size_t j = first(r); j < side && j <= r + ERN_PATCH_RADIUS; j++)
    for (size_t i = first(c); i < side && i <= c + ERN_PATCH_RADIUS; i++) {
      const double w = factor * p->window[r * side + j] * p->window[c * side + i], x = p->x[j * side + i] - base,
                   y = p->y[j * side + i] - base;
      p->dx[j * side + i] -= w * (g[0] + 2 * x * g[1] + y * g[2]);
      p->error[j * side + i] +=
          w * (eg[0] + fabs(2 * x) * eg[1] + fabs(y) * eg[2] + e * (fabs(g[0]) + fabs(2 * x * g[1]) + fabs(y * g[2])));
    }
  *value_error += factor * (e_ssim + unit);
  return factor * (1 - ssim);
}

static double plane_loss(double *dx, double *error, const double *x, const double *y, size_t side, double weight,
                         double *value_error) {
  double *values = held_memory(5 * side * side, sizeof(double)), base = 0, sum = 0;
  for (size_t i = 0; i < side * side; i++) base += y[i] / (double)(side * side);
  for (size_t k = 0; k < SCALES; k++) {
    const size_t n = side >> k, block = (size_t)1 << k;
    struct plane p = {n, values, values + n * n, values + 4 * n * n, values + 2 * n * n, values + 3 * n * n};
    memset(values, 0, 4 * n * n * sizeof *values);
    for (size_t j = 0; j < n * n; j++) p.window[j] = window(j / n, j % n, n);
    for (size_t j = 0; j < side; j++)
      for (size_t i = 0; i < side; i++) {
        values[j / block * n + i / block] += x[j * side + i] / (double)(block * block);
        values[n * n + j / block * n + i / block] += y[j * side + i] / (double)(block * block);
      }
    for (size_t j = 0; j < n; j++)
      for (size_t i = 0; i < n; i++) sum += pixel(&p, j, i, base, weight / (double)(n * n), value_error);
    for (size_t j = 0; j < side; j++)
      for (size_t i = 0; i < side; i++) {
        dx[j * side + i] += p.dx[j / block * n + i / block] / (double)(block * block);
        error[j * side + i] += p.error[j / block * n + i / block] / (double)(block * block);
      }
  }
  return sum;
}

/* ---- against it ---- */

static void check_kind(kinds kind, int side, size_t patches) {
  const size_t n = (size_t)side * (size_t)side, rays = patches * n;
  float *pixels = floats(3 * rays), *truths = floats(3 * rays), *before = floats(3 * rays),
        *filters = floats(ern_patch_filter_count((size_t)side));
  double *x = held_memory(3 * rays, sizeof(double)), *y = held_memory(3 * rays, sizeof(double)),
         *dx = held_memory(3 * rays, sizeof(double)), *error = held_memory(3 * rays, sizeof(double));
  const float weight = 0.7f;
  double term = 0, term_error = 0;
  for (size_t c = 0; c < 3; c++)
    for (size_t i = 0; i < rays; i++) {
      const size_t at = c * rays + i, r = i % n / (size_t)side, col = i % (size_t)side;
      pixels[at] = value_at(kind, false, i / n, c, r, col, machines.seed + 5);
      truths[at] = value_at(kind, kind != SAME, i / n, c, r, col, machines.seed + 5);
      before[at] = 1e-3f * (float)(at % 7);
      const size_t p = (i / n * 3 + c) * n + i % n; /* by plane */
      x[p] = (double)pixels[at], y[p] = (double)truths[at];
    }
  for (size_t plane = 0; plane < 3 * patches; plane++)
    term += plane_loss(dx + plane * n, error + plane * n, x + plane * n, y + plane * n, (size_t)side,
                       (double)weight / (double)(3 * SCALES * patches), &term_error);
  ern_patch_filter(filters, side);
  const struct many_rows pixel = many_strided(pixels, 3, rays, ERN_PER_RAY),
                         truth = many_strided(truths, 3, rays, ERN_PER_RAY),
                         dpixel = many_strided(before, 3, rays, ERN_PER_RAY);
  const struct many filter = many_reals(filters, ern_patch_filter_count((size_t)side));
  struct ern_patch_loss_args args[MACHINES];
  EACH_MACHINE (k)
    args[k] =
        (struct ern_patch_loss_args){dpixel.on[k], -1, pixel.on[k], truth.on[k], filter.on[k], weight, side, patches};
  RUN(patch_loss, args);
  const struct many out = of_rows(dpixel);
  EACH_MACHINE (k) {
    const float *found = floats_of(k, out);
    const size_t stride = dpixel.on[k].stride;
    if (!(fabs(args[k].term - term) <= term_error + 1e-9 * term))
      fail_msg("%s: patch_loss, kind %d of side %d: %.9g, expected %.12g +- %.1e", machines.name[k], kind, side,
               args[k].term, term, term_error);
    for (size_t at = 0; at < 3 * rays; at++) {
      const size_t c = at / rays, i = at % rays, plane = i / n * 3 + c, p = plane * n + i % n;
      const double expected = (double)before[at] + dx[p],
                   allowed = error[p] + 2 * unit * (fabs((double)before[at]) + fabs(dx[p]));
      if (!(fabs((double)found[c * stride + i] - expected) <= allowed))
        fail_msg("%s: patch_loss, kind %d of side %d: gradient [%zu][%zu] %.9g, expected %.9g +- %.1e",
                 machines.name[k], kind, side, c, i, (double)found[c * stride + i], expected, allowed);
    }
  }
  machines_clear();
}

static void test_definition(void **state) {
  (void)state;
  static const int sides[] = {16, 32, 48};
  for (size_t s = 0; s < (is_small() || is_emulated() ? 1 : COUNT_OF(sides)); s++)
    for (int kind = 0; kind < KINDS; kind++)
      check_kind((kinds)kind, sides[s], kind == NOISE && s == 0 && !is_emulated() ? 7 : 1);
}

/* Without patches there is no term, and nothing is written. */
static void test_none(void **state) {
  (void)state;
  const struct many_rows rows = many_strided(NULL, 3, 1, ERN_PER_RAY);
  struct ern_patch_loss_args args[MACHINES];
  EACH_MACHINE (k)
    args[k] = (struct ern_patch_loss_args){
        .dpixel = rows.on[k], .term = 3, .pixel = rows.on[k], .truth = rows.on[k], .weight = 1, .side = 16};
  RUN(patch_loss, args);
  EACH_MACHINE (k) assert_true(args[k].term == 0);
  machines_clear();
}

/* A pixel that is no number reaches the term and its gradient: the step says so (trainer_finite.c). */
static void test_not_finite(void **state) {
  (void)state;
  enum { N = 16 * 16 };
  float pixels[3 * N], filters[2 * (16 * 16 + 8 * 8 + 4 * 4)];
  for (size_t i = 0; i < 3 * N; i++) pixels[i] = 0.5f;
  const struct many_rows truth = many_strided(pixels, 3, N, ERN_PER_RAY);
  pixels[N + 7] = NAN;
  ern_patch_filter(filters, 16);
  const struct many_rows pixel = many_strided(pixels, 3, N, ERN_PER_RAY);
  const struct many zeros = many_zeros(3 * N), filter = many_reals(filters, COUNT_OF(filters));
  const struct many_rows dpixel = many_rows_of(zeros, 3, N, ERN_PER_RAY);
  struct ern_patch_loss_args args[MACHINES];
  EACH_MACHINE (k)
    args[k] = (struct ern_patch_loss_args){dpixel.on[k], 0, pixel.on[k], truth.on[k], filter.on[k], 1, 16, 1};
  RUN(patch_loss, args);
  EACH_MACHINE (k) {
    assert_true(isnan(args[k].term));
    assert_true(isnan(floats_of(k, of_rows(dpixel))[N + 7]));
  }
  machines_clear();
}

static void bench(void) {
  enum { PATCHES = 4, RAYS = PATCHES * 32 * 32 };
  float *values = floats(6 * RAYS), *filters = floats(ern_patch_filter_count(32));
  for (size_t i = 0; i < 6 * RAYS; i++) values[i] = random_at(1, i, 2);
  ern_patch_filter(filters, 32);
  const struct many_rows pixel = many_strided(values, 3, RAYS, ERN_PER_RAY),
                         truth = many_strided(values + 3 * RAYS, 3, RAYS, ERN_PER_RAY),
                         dpixel = many_rows_of(many_zeros(3 * RAYS), 3, RAYS, ERN_PER_RAY);
  const struct many filter = many_reals(filters, ern_patch_filter_count(32));
  struct ern_patch_loss_args args[MACHINES];
  EACH_MACHINE (k)
    args[k] = (struct ern_patch_loss_args){dpixel.on[k], 0, pixel.on[k], truth.on[k], filter.on[k], 1, 32, PATCHES};
  BENCH("patch_loss", RAYS, patch_loss, args);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_definition),
    cmocka_unit_test(test_none),
    cmocka_unit_test(test_not_finite),
};
NOUN(patches, bench, .isa = NULL)
