/* SPDX-License-Identifier: MIT
 * Region attention: the forward pass to the bit but for a device's norm, the gradient to rounding. */
#include "harness.h"
#include "model/attention_ops.h"

enum { USUAL, EXTREME };

/* Vectors of nothing, of denormal, tiny and huge numbers, whose squares are no floats; no numbers. */
static float value_of(uint64_t seed, size_t c, size_t i, int kind) {
  static const float scales[] = {1, 0, 1e-30f, 1e-42f, 1e25f, 3e38f, 1e-18f, 4};
  const float value = random_at(seed, c * 65536 + i, 1);
  if (kind == USUAL) return value;
  if (i % 29 == 7 && c == i % 5) return i % 2 ? NAN : INFINITY;
  return value * scales[i % 8];
}

struct scene {
  int channels, values, kind; /* rows of the region and of v */
  size_t n;
  float eye;
  struct many_rows v, dregion;
  struct many code, eye_attention, dnorm, dregion_eye;
  struct many_rows region;
  struct many norm, region_eye;
};

static struct scene scene_make(int channels, int v_rows, size_t n, int kind) {
  struct scene s = {.channels = channels, .values = v_rows, .kind = kind, .n = n, .eye = 0.37f};
  const size_t rows = (size_t)channels;
  float *values = floats(rows * n + rows);
  for (size_t c = 0; c < (size_t)v_rows; c++)
    for (size_t i = 0; i < n; i++) values[c * n + i] = value_of(2, c, i, kind);
  s.v = many_strided(values, v_rows, n, ERN_PER_SAMPLE);
  fill_random(values, rows * n, 3, 1);
  s.dregion = many_strided(values, channels, n, ERN_PER_SAMPLE);
  fill_random(values, rows, 1, 2);
  s.code = many_reals(values, rows);
  struct many *const spans[] = {&s.dnorm, &s.eye_attention, &s.dregion_eye};
  for (size_t k = 0; k < 3; k++) {
    fill_random(values, n, 4 + k, 1);
    *spans[k] = many_reals(values, n);
  }
  s.region = many_strided(NULL, channels, n, ERN_PER_SAMPLE);
  s.norm = many_empty(n);
  s.region_eye = many_empty(n);
  return s;
}

static struct ern_attention_fwd_args forward_of(const struct scene *s, bool eye, int k) {
  struct ern_attention_fwd_args args = {.region = s->region.on[k],
                                        .norm = s->norm.on[k],
                                        .v = s->v.on[k],
                                        .code = s->code.on[k],
                                        .eye = s->eye,
                                        .n = s->n};
  if (eye) {
    args.region_eye = s->region_eye.on[k];
    args.eye_attention = s->eye_attention.on[k];
  }
  return args;
}

/* Products: the same bits, and on the CPU the norm's too. A device's norm: the sum of squares is good to 2^-40 and
 * rounded once, which the root halves, then the root's own half unit, where the reference has half a unit: 1.25 units
 * of 2^-24. Denormal norms are rounded once more, by half of the smallest number. */
static void check_fwd(const struct scene *s, bool eye) {
  struct ern_attention_fwd_args args[MACHINES];
  EACH_MACHINE (k) args[k] = forward_of(s, eye, k);
  RUN(attention_fwd, args);
  expect_bits("region", of_rows(s->region));
  EACH_OTHER (k) {
    const bool device = is_device(k);
    expect_near_on(k, "norm", s->norm, device ? 1.25 * 0x1p-23 : 0, device ? 0x1p-149 : 0);
  }
  expect_bits("region_eye", s->region_eye);
}

/* |dcode_c - reference|. A device: units * 2^-24 * (what was there + sum of |dregion_c v_c|): a lane adds n/(64*64)
 * products, rounded up, each with its own rounding, then 6 halvings of lanes and 6 of parts; the sum with what was
 * there; the reference has the last two. An instruction set: sums in double, half a unit for its rounding to float and
 * half for the sum with what was there. */
static void check_dcode(const struct scene *s, struct many dcode, bool wanted) {
  const float *expected = floats_of(0, dcode), *v = floats_of(0, of_rows(s->v)),
              *dregion = floats_of(0, of_rows(s->dregion));
  const double units = ceil((double)s->n / 4096) + 1 + 6 + 6 + 1 + 2;
  const size_t stride = s->v.on[0].stride;
  const float *found[MACHINES];
  EACH_OTHER (k) found[k] = floats_of(k, dcode);
  for (size_t c = 0; c < (size_t)s->channels; c++) {
    double size = 1;
    for (size_t i = 0; i < s->n && wanted; i++)
      size += fabs((double)v[(s->values > 1 ? c : 0) * stride + i] * (double)dregion[c * stride + i]);
    EACH_OTHER (k) {
      const double tolerance = !isfinite(size) ? 0
                               : is_device(k)  ? units * 0x1p-24 * size
                                               : 0x1p-22 * fabs((double)expected[c]) + 0x1p-24;
      if (!is_near(found[k][c], expected[c], 0, tolerance))
        fail_msg("%s: dcode [%zu] of %zu samples: %.9g, reference %.9g +- %.1e", machines.name[k], c, s->n,
                 (double)found[k][c], (double)expected[c], tolerance);
    }
  }
}

/* What the terms of dv (row r, sample i) add up to in size. */
static double dv_size(const struct scene *s, const float *dregion, const float *dnorm, const float *code, size_t r,
                      size_t i) {
  const size_t end = s->values == 1 ? (size_t)s->channels : r + 1;
  double size = fabs((double)dnorm[i]);
  for (size_t c = r; c < end; c++) size += fabs((double)code[c] * (double)dregion[c * s->dregion.on[0].stride + i]);
  return size;
}

/* A device: the reference's order and roundings, so the same bits. An instruction set: a product for the region; for
 * the norm the inverse, its product with v and that with dnorm, so 3 roundings of half a unit where the reference has
 * 2; the sum. Of one v for all channels those of the region are added up as in the reference. */
static void check_dv(const struct scene *s, struct many_rows dv) {
  const float *expected = floats_of(0, of_rows(dv)), *dregion = floats_of(0, of_rows(s->dregion)),
              *dnorm = floats_of(0, s->dnorm), *code = floats_of(0, s->code);
  const size_t stride = dv.on[0].stride;
  EACH_OTHER (k) {
    const float *found = floats_of(k, of_rows(dv));
    for (size_t at = 0; at < (size_t)s->values * stride; at++) {
      const size_t r = at / stride, i = at % stride;
      const double tolerance = i < s->n && !is_device(k) ? 4 * 0x1p-23 * dv_size(s, dregion, dnorm, code, r, i) : 0;
      if (!is_near(found[at], expected[at], 0, tolerance))
        fail_msg("%s: dv [%zu][%zu] of %zu: %.9g, reference %.9g +- %.1e", machines.name[k], r, i, s->n,
                 (double)found[at], (double)expected[at], tolerance);
    }
  }
}

static void check_bwd(const struct scene *s, bool region, bool norm, bool code, bool eye) {
  float *values = floats(s->n + (size_t)s->channels);
  const struct many_rows dv = many_strided(NULL, s->values, s->n, ERN_PER_SAMPLE);
  fill_random(values, s->n + (size_t)s->channels, 8, 1);
  const struct many dcode = many_reals(values, (size_t)s->channels), deye = many_reals(values, s->n);
  struct ern_attention_bwd_args args[MACHINES];
  many_set(s->norm, 0, floats_of(0, s->norm), s->n); /* one norm for all */
  EACH_MACHINE (k) {
    args[k] = (struct ern_attention_bwd_args){.dv = dv.on[k], .forward = forward_of(s, eye, k)};
    if (code) args[k].dcode = dcode.on[k];
    if (region) args[k].dregion = s->dregion.on[k];
    if (norm) args[k].dnorm = s->dnorm.on[k];
    if (eye) args[k].deye_attention = deye.on[k];
    if (eye) args[k].dregion_eye = s->dregion_eye.on[k];
  }
  RUN(attention_bwd, args);
  check_dv(s, dv);
  expect_bits("deye_attention", deye);
  check_dcode(s, dcode, code && region);
}

/* parts: which of the gradients, as bits. Sums of squares of huge numbers are beyond a float where doubles are not: a
 * device is not asked for the code's gradient of extreme values. */
static void check_attention(int channels, int values, size_t n, int kind) {
  const struct scene s = scene_make(channels, values, n, kind);
  const struct machines_mark kept = machines_mark();
  check_fwd(&s, n % 2 == 0);
  const bool code = kind == USUAL || !is_device(machines.count - 1);
  for (unsigned parts = 0; parts < 8; parts++) {
    check_bwd(&s, (parts & 1) != 0, (parts & 2) != 0, (parts & 4) != 0 && (code || (parts & 1) == 0), parts % 3 != 1);
    machines_clear_to(kept);
  }
  machines_clear();
}

static void check_kind(int kind) {
  const int channels = is_small() ? 3 : 32;
  for (size_t n = 0; n < size_count(); n++) check_attention(channels, channels, test_sizes[n], kind);
  for (size_t n = 0; n < size_count(); n += is_small() ? 2 : 1) check_attention(channels, 1, test_sizes[n], kind);
  check_attention(1, 1, 100, kind);
  if (is_small()) return;
  static const int shapes[][2] = {{1, 1}, {64, 64}, {65, 65}, {130, 130}, {2, 1}, {130, 1}};
  static const size_t sizes[] = {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33, 100, 257, 511, 512, 513, 1100};
  for (size_t c = 0; c < COUNT_OF(shapes); c++)
    for (size_t n = 0; n < COUNT_OF(sizes); n++) check_attention(shapes[c][0], shapes[c][1], sizes[n], kind);
  check_attention(3, 3, 20000, kind);
  check_attention(3, 1, 20000, kind);
}
static void test_usual(void **state) {
  (void)state;
  check_kind(USUAL);
}
static void test_extreme(void **state) {
  (void)state;
  check_kind(EXTREME);
}

/* Without v the eye alone. */
static void test_eye_alone(void **state) {
  (void)state;
  for (size_t size = 0; size < size_count(); size++) {
    struct scene s = scene_make(1, 1, test_sizes[size], USUAL);
    const struct many deye = many_reals((const float[MOST_SIZE]){0}, s.n);
    struct ern_attention_fwd_args fwd[MACHINES];
    struct ern_attention_bwd_args bwd[MACHINES];
    EACH_MACHINE (with) {
      fwd[with] = (struct ern_attention_fwd_args){.region_eye = s.region_eye.on[with],
                                                  .code = s.code.on[with],
                                                  .eye_attention = s.eye_attention.on[with],
                                                  .eye = s.eye,
                                                  .n = s.n};
      bwd[with] = (struct ern_attention_bwd_args){
          .deye_attention = deye.on[with], .dregion_eye = s.dregion_eye.on[with], .forward = fwd[with]};
    }
    RUN(attention_fwd, fwd);
    RUN(attention_bwd, bwd);
    expect_near("region_eye alone", s.region_eye, 0, 0);
    expect_near("deye_attention alone", deye, 0, 0);
    machines_clear();
  }
}

static void test_nothing(void **state) {
  (void)state;
  struct scene s = scene_make(4, 4, 1, USUAL);
  const struct many_rows dv = many_strided(NULL, 4, 1, ERN_PER_SAMPLE);
  const float before[4] = {1, 2, 3, 4};
  const struct many dcode = many_reals(before, 4);
  s.n = 0;
  ON_EACH(attention_fwd, ern_attention_fwd_args, forward_of(&s, true, k))
  ON_EACH(attention_bwd, ern_attention_bwd_args,
          {.dv = dv.on[k], .dcode = dcode.on[k], .dregion = s.dregion.on[k], .forward = forward_of(&s, true, k)})
  expect_bits("region", of_rows(s.region));
  expect_bits("norm", s.norm);
  expect_bits("dv", of_rows(dv));
  expect_bits("dcode", dcode);
  machines_clear();
}

/* Heights below, at, between and above the two ends. A device: the quotient within 2.5 units of 2^-23
 * (OpenCL 1.2, 7.4), times the slope of at most 1.5; a product and a sum more of sizes up to 3, fused or not; the
 * product with v. */
static void test_fade(void **state) {
  (void)state;
  static const float ends[2] = {-0.07f, 0.14f};
  for (size_t size = 0; size < size_count(); size++) {
    const size_t n = test_sizes[size];
    const struct scene s = scene_make(is_small() ? 3 : 32, 1, n, USUAL);
    float *values = floats((size_t)s.channels * n), *height = floats(n);
    for (size_t i = 0; i < n; i++) height[i] = i % 7 < 2 ? ends[i % 7] : random_at(9, i, 0.3f);
    fill_random(values, (size_t)s.channels * n, 3, 1);
    const struct many_rows v = many_strided(values, s.channels, n, ERN_PER_SAMPLE);
    const struct many heights = many_reals(height, n);
    struct ern_attention_fade_args args[MACHINES];
    EACH_MACHINE (k)
      args[k] =
          (struct ern_attention_fade_args){.v = v.on[k], .height = heights.on[k], .fade = {ends[0], ends[1]}, .n = n};
    RUN(attention_fade, args);
    const float *faded = floats_of(0, of_rows(v));
    for (size_t i = 0; i < n; i++) {
      if (height[i] <= ends[0]) assert_true(faded[i] == values[i]);
      if (height[i] >= ends[1]) assert_true(faded[i] == 0);
    }
    EACH_OTHER (k) expect_near_on(k, "faded", of_rows(v), 0, is_device(k) ? 10 * 0x1p-23 : 0);
    machines_clear();
  }
}

/* n samples: of a tile, in the cache, or of a batch, in memory. */
static void bench_of(size_t n) {
  const struct scene s = scene_make(32, 32, n, USUAL);
  const struct many_rows dv = many_strided(NULL, 32, n, ERN_PER_SAMPLE);
  struct ern_attention_fwd_args forward[MACHINES];
  struct ern_attention_bwd_args backward[MACHINES];
  EACH_MACHINE (k) {
    forward[k] = forward_of(&s, true, k);
    backward[k] = (struct ern_attention_bwd_args){.dv = dv.on[k],
                                                  .dcode = s.code.on[k],
                                                  .dregion = s.dregion.on[k],
                                                  .dnorm = s.dnorm.on[k],
                                                  .forward = forward[k]};
  }
  printf("32 channels, %zu samples\n", n);
  BENCH("forward", n, attention_fwd, forward);
  BENCH("gradient", n, attention_bwd, backward);
  machines_clear();
}

static void bench(void) {
  bench_of(1024);
  bench_of(183000);
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_usual), cmocka_unit_test(test_extreme),
                                          cmocka_unit_test(test_eye_alone), cmocka_unit_test(test_nothing),
                                          cmocka_unit_test(test_fade)};
NOUN(attention, bench, .isa = NULL)
