/* SPDX-License-Identifier: MIT
 * Activations, positional encodings and region attention of an OpenCL device against the reference. */
#include "twin.h"

#include <float.h>
#include <time.h>

static ern_context *context;
static struct twin twin;

/* ---- activations ---- */

/* How far two good activations may be apart, in units of 2^-23 relative to the value. exp of OpenCL is within 3 units,
 * that of libm within 1; log1p 2 and 1. The others: that, and half a unit on each side for each of the sum, the product
 * and the quotient after it: 4 + 3. (The square of 1 + e counts the error of e twice, but e <= 1 is at most half of
 * it.) The colour's subtraction leaves the error of the minuend, 0.001 larger. Below the normal numbers only an
 * absolute error counts: a device may take denormal numbers as 0. */
static double activation_tolerance(ern_activation kind, double expected) {
  if (kind == ERN_ACT_RELU) return 0; /* nothing is rounded */
  const double units = kind == ERN_ACT_DENSITY ? 4.5 : 7;
  return units * 0x1p-23 * (fabs(expected) + (kind == ERN_ACT_COLOUR ? 0.001 : 0)) + FLT_MIN;
}

static float activation_input(size_t i) {
  static const float special[] = {0,      -0.0f, 1e-30f,  -1e-30f,  15,       -15,       15.5f, -15.5f, 80,
                                  79.99f, 81,    88.7f,   88.8f,    -87.3f,   -88,       -103,  -104,   -105,
                                  1e4f,   -1e4f, FLT_MAX, -FLT_MAX, INFINITY, -INFINITY, NAN};
  enum { SPECIAL = sizeof special / sizeof *special };
  if (i < SPECIAL) return special[i];
  return twin_random(70, i, i % 3 == 0 ? 1 : i % 3 == 1 ? 20 : 110);
}

static void check_near(const char *what, struct twin_rows rows, ern_activation kind) {
  static const char *const name[] = {"density", "colour", "sigmoid", "softplus", "relu"};
  float *expected = twin_down(&twin, 0, rows.on[0].span), *found = twin_down(&twin, 1, rows.on[1].span);
  for (size_t i = 0; i < rows.on[0].span.count + 2 * TWIN_GUARD; i++) {
    const bool poison = expected[i] == TWIN_POISON;
    const double tolerance = isfinite(expected[i]) && !poison ? activation_tolerance(kind, (double)expected[i]) : 0;
    if (!twin_near(found[i], expected[i], 0, tolerance))
      fail_msg("%s of %s [%zu]: %.9g, reference %.9g +- %.1e", what, name[kind], i, (double)found[i],
               (double)expected[i], tolerance);
  }
  free(expected);
  free(found);
}

static void check_activations(size_t n) {
  enum { ROWS = 3 };
  float *x = malloc(ROWS * n * sizeof *x), *dy = malloc(ROWS * n * sizeof *dy);
  assert_true(x != NULL && dy != NULL);
  for (size_t i = 0; i < ROWS * n; i++) {
    x[i] = activation_input(n < 50 ? (i + 4 * n) % 25 : i);
    dy[i] = i % 2 ? 1 : -1.5f;
  }
  for (ern_activation kind = ERN_ACT_DENSITY; kind <= ERN_ACT_RELU; kind++) {
    const struct twin_rows from = twin_rows_of(&twin, x, ROWS, n, ERN_PER_SAMPLE),
                           to = twin_rows_of(&twin, NULL, ROWS, n, ERN_PER_SAMPLE),
                           slope = twin_rows_of(&twin, dy, ROWS, n, ERN_PER_SAMPLE),
                           apart = twin_rows_of(&twin, NULL, ROWS, n, ERN_PER_SAMPLE);
    struct ern_activate_fwd_args forward[2];
    struct ern_activate_bwd_args backward[2], in_place[2];
    for (int k = 0; k < 2; k++) {
      forward[k] = (struct ern_activate_fwd_args){to.on[k], from.on[k], kind, n};
      backward[k] = (struct ern_activate_bwd_args){apart.on[k], slope.on[k], from.on[k], kind, n};
      in_place[k] = (struct ern_activate_bwd_args){slope.on[k], slope.on[k], from.on[k], kind, n};
    }
    TWIN_RUN(&twin, activate_fwd, forward);
    TWIN_RUN(&twin, activate_bwd, backward);
    TWIN_RUN(&twin, activate_bwd, in_place);
    check_near("y", to, kind);
    check_near("dx", apart, kind);
    check_near("dx in place", slope, kind);
    twin_clear(&twin);
  }
  free(x);
  free(dy);
}

static void test_activations(void **state) {
  (void)state;
  for (size_t s = 0; s < TWIN_SIZES; s++) check_activations(twin_sizes[s]);
  if (!twin_is_small()) check_activations(20000);
}

/* ---- directions ---- */

/* Products and sums are rounded one by one, in the reference's order: the same bits. */
static void test_harmonics(void **state) {
  (void)state;
  for (size_t s = 0; s < TWIN_SIZES; s++) {
    const size_t n = twin_sizes[s];
    static float d[3 * TWIN_MOST];
    twin_fill(d, 3 * n, s, 1);
    for (size_t i = 0; i < n; i++) {
      const float length = sqrtf(d[i] * d[i] + d[n + i] * d[n + i] + d[2 * n + i] * d[2 * n + i]);
      for (size_t c = 0; c < 3; c++) d[c * n + i] = i % 7 == 3 ? (float)(i % 3 == c) : d[c * n + i] / length;
    }
    if (n > 20) d[5] = NAN, d[n + 6] = INFINITY, d[2 * n + 7] = -0.0f;
    const struct twin_rows from = twin_rows_of(&twin, d, 3, n, ERN_PER_RAY),
                           y = twin_rows_of(&twin, NULL, 16, n, ERN_PER_RAY);
    struct ern_sh_fwd_args args[2] = {{y.on[0], from.on[0], n}, {y.on[1], from.on[1], n}};
    TWIN_RUN(&twin, sh_fwd, args);
    twin_same_rows(&twin, "harmonics", y, 0, 0);
    twin_clear(&twin);
  }
}

/* ---- sines ---- */

static float position(size_t i) {
  static const float odd[] = {0, -0.0f, NAN, INFINITY, -INFINITY, 1e-45f, 8.5f, -300, 1e5f, 1e30f, FLT_MAX};
  return i % 13 == 5 ? odd[i / 13 % 11] : twin_random(3, i, i % 3 == 0 ? 0.03f : i % 3 == 1 ? 1 : 4);
}

/* Of the same argument: OpenCL's sine is within 4 units of 2^-23, libm's within 1, of values up to 1. Of the gradient,
 * with |dy| <= 1: two such errors, the roundings of two products, a difference and a sum, for each octave times its
 * factor. */
static void check_freq(size_t dims, int octaves, size_t n) {
  const size_t rows = dims * (1 + 2 * (size_t)octaves);
  float *x = malloc(dims * n * sizeof *x), *dy = malloc(rows * n * sizeof *dy);
  assert_true(x != NULL && dy != NULL);
  for (size_t i = 0; i < dims * n; i++) x[i] = position(i);
  twin_fill(dy, rows * n, 4, 1);
  const struct twin_rows from = twin_rows_of(&twin, x, (int)dims, n, ERN_PER_SAMPLE),
                         y = twin_rows_of(&twin, NULL, (int)rows, n, ERN_PER_SAMPLE),
                         slope = twin_rows_of(&twin, dy, (int)rows, n, ERN_PER_SAMPLE);
  for (size_t i = 0; i < dims * n; i++) x[i] = twin_random(5, i, 1);
  const struct twin_rows dx = twin_rows_of(&twin, x, (int)dims, n, ERN_PER_SAMPLE);
  struct ern_freq_fwd_args forward[2];
  struct ern_freq_bwd_args backward[2];
  for (int k = 0; k < 2; k++) {
    forward[k] = (struct ern_freq_fwd_args){y.on[k], from.on[k], octaves, n};
    backward[k] = (struct ern_freq_bwd_args){dx.on[k], slope.on[k], from.on[k], octaves, n};
  }
  TWIN_RUN(&twin, freq_fwd, forward);
  TWIN_RUN(&twin, freq_bwd, backward);
  twin_same_rows(&twin, "sines", y, 0, 5 * 0x1p-23);
  twin_same_rows(&twin, "dx", dx, 0, 2 * (5 + 2) * ldexp(2, octaves) * 0x1p-23);
  twin_clear(&twin);
  free(x);
  free(dy);
}

static void test_sines(void **state) {
  (void)state;
  static const struct {
    size_t dims;
    int octaves;
  } shapes[] = {{2, 8}, {6, 3}, {1, 10}, {3, 0}};
  enum { SHAPES = sizeof shapes / sizeof *shapes };
  for (size_t s = 0; s < TWIN_SIZES * SHAPES; s++)
    check_freq(shapes[s % SHAPES].dims, shapes[s % SHAPES].octaves, twin_sizes[s / SHAPES]);
}

/* ---- attention ---- */

enum { USUAL, EXTREME };

/* Vectors of nothing, of denormal, tiny and huge numbers, whose squares are no floats; no numbers. */
static float value_of(uint64_t seed, size_t c, size_t i, int kind) {
  static const float scales[] = {1, 0, 1e-30f, 1e-42f, 1e25f, 3e38f, 1e-18f, 4};
  const float value = twin_random(seed, c * 65536 + i, 1);
  if (kind == USUAL) return value;
  if (i % 29 == 7 && c == i % 5) return i % 2 ? NAN : INFINITY;
  return value * scales[i % 8];
}

struct scene {
  int channels, values, kind; /* rows of the region and of v */
  size_t n;
  float eye;
  struct twin_rows v, dregion;
  struct twin_span code, eye_attention, dnorm, dregion_eye;
  struct twin_rows region;
  struct twin_span norm, region_eye;
};

static struct scene scene_make(int channels, int v_rows, size_t n, int kind) {
  struct scene s = {.channels = channels, .values = v_rows, .kind = kind, .n = n, .eye = 0.37f};
  const size_t rows = (size_t)channels;
  float *values = malloc((rows * n + rows) * sizeof *values);
  assert_non_null(values);
  for (size_t c = 0; c < (size_t)v_rows; c++)
    for (size_t i = 0; i < n; i++) values[c * n + i] = value_of(2, c, i, kind);
  s.v = twin_rows_of(&twin, values, v_rows, n, ERN_PER_SAMPLE);
  twin_fill(values, rows * n, 3, 1);
  s.dregion = twin_rows_of(&twin, values, channels, n, ERN_PER_SAMPLE);
  twin_fill(values, rows, 1, 2);
  s.code = twin_reals(&twin, values, rows);
  struct twin_span *const spans[] = {&s.dnorm, &s.eye_attention, &s.dregion_eye};
  for (size_t k = 0; k < 3; k++) {
    twin_fill(values, n, 4 + k, 1);
    *spans[k] = twin_reals(&twin, values, n);
  }
  s.region = twin_rows_of(&twin, NULL, channels, n, ERN_PER_SAMPLE);
  s.norm = twin_take(&twin, ERN_ELEMENT_REAL, n);
  s.region_eye = twin_take(&twin, ERN_ELEMENT_REAL, n);
  free(values);
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

/* Products: the same bits. The norm: the sum of squares is good to 2^-40 and rounded once, which the root halves, then
 * the root's own half unit, where the reference has half a unit: 1.25 units of 2^-24. Denormal norms are rounded once
 * more, by half of the smallest number. */
static void check_fwd(const struct scene *s, bool eye) {
  struct ern_attention_fwd_args args[2] = {forward_of(s, eye, 0), forward_of(s, eye, 1)};
  TWIN_RUN(&twin, attention_fwd, args);
  twin_same_rows(&twin, "region", s->region, 0, 0);
  twin_same(&twin, "norm", s->norm, 1.25 * 0x1p-23, 0x1p-149);
  twin_same(&twin, "region_eye", s->region_eye, 0, 0);
}

/* |dcode_c - reference| <= units * 2^-24 * (what was there + sum of |dregion_c v_c|): a lane adds n/(64*64) products,
 * rounded up, each with its own rounding, then 6 halvings of lanes and 6 of parts; the sum with what was there; the
 * reference has the last two. */
static void check_dcode(const struct scene *s, struct twin_span dcode) {
  float *expected = twin_down(&twin, 0, dcode.on[0]), *found = twin_down(&twin, 1, dcode.on[1]);
  float *v = twin_down(&twin, 0, s->v.on[0].span), *dregion = twin_down(&twin, 0, s->dregion.on[0].span);
  const double units = ceil((double)s->n / 4096) + 1 + 6 + 6 + 1 + 2;
  for (size_t c = 0; c < dcode.on[0].count + 2 * TWIN_GUARD; c++) {
    const bool guard = c < TWIN_GUARD || c >= dcode.on[0].count + TWIN_GUARD;
    double size = 1;
    for (size_t i = 0; i < s->n && !guard; i++) {
      const size_t stride = s->v.on[0].stride, row = c - TWIN_GUARD;
      size += fabs((double)v[TWIN_GUARD + (s->values > 1 ? row : 0) * stride + i] *
                   (double)dregion[TWIN_GUARD + row * stride + i]);
    }
    const double tolerance = guard || !isfinite(size) ? 0 : units * 0x1p-24 * size;
    if (!twin_near(found[c], expected[c], 0, tolerance))
      fail_msg("dcode [%zu] of %zu samples: %.9g, reference %.9g +- %.1e", c, s->n, (double)found[c],
               (double)expected[c], tolerance);
  }
  free(expected), free(found), free(v), free(dregion);
}

/* dv: the reference's order and roundings, so the same bits. */
static void check_bwd(const struct scene *s, bool region, bool norm, bool code, bool eye) {
  static float values[20000];
  const struct twin_rows dv = twin_rows_of(&twin, NULL, s->values, s->n, ERN_PER_SAMPLE);
  twin_fill(values, sizeof values / sizeof *values, 8, 1);
  assert_true(s->n <= sizeof values / sizeof *values);
  const struct twin_span dcode = twin_reals(&twin, values, (size_t)s->channels), deye = twin_reals(&twin, values, s->n);
  struct ern_attention_bwd_args args[2];
  /* one norm for both */
  float *norms = twin_down(&twin, 0, s->norm.on[0]);
  support_ok(context, twin.backend[1]->upload_reals(twin.stream[1], s->norm.on[1], norms + TWIN_GUARD, s->n));
  free(norms);
  for (int k = 0; k < 2; k++) {
    args[k] = (struct ern_attention_bwd_args){.dv = dv.on[k], .forward = forward_of(s, eye, k)};
    if (code) args[k].dcode = dcode.on[k];
    if (region) args[k].dregion = s->dregion.on[k];
    if (norm) args[k].dnorm = s->dnorm.on[k];
    if (eye) args[k].deye_attention = deye.on[k];
    if (eye) args[k].dregion_eye = s->dregion_eye.on[k];
  }
  TWIN_RUN(&twin, attention_bwd, args);
  twin_same_rows(&twin, "dv", dv, 0, 0);
  twin_same(&twin, "deye_attention", deye, 0, 0);
  check_dcode(s, dcode);
}

static void check_attention(int channels, int values, size_t n, int kind) {
  const struct scene s = scene_make(channels, values, n, kind);
  check_fwd(&s, n % 2 == 0);
  /* sums of squares of huge numbers: beyond a float where the reference's doubles are not */
  const bool code = kind == USUAL;
  check_bwd(&s, true, true, code, true);
  check_bwd(&s, true, false, code, false);
  check_bwd(&s, false, true, true, true);
  check_bwd(&s, true, true, false, false);
  check_bwd(&s, false, false, true, false);
  twin_clear(&twin);
}

static void check_kind(int kind) {
  const int channels = twin_is_small() ? 3 : 32;
  for (size_t n = 0; n < TWIN_SIZES; n++) check_attention(channels, channels, twin_sizes[n], kind);
  for (size_t n = 0; n < TWIN_SIZES; n += 2) check_attention(channels, 1, twin_sizes[n], kind);
  check_attention(1, 1, 100, kind);
  if (twin_is_small()) return;
  check_attention(130, 130, 257, kind);
  check_attention(130, 1, 257, kind);
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
  for (size_t k = 0; k < TWIN_SIZES; k += 3) {
    struct scene s = scene_make(1, 1, twin_sizes[k], USUAL);
    const struct twin_span deye = twin_reals(&twin, (const float[TWIN_MOST]){0}, s.n);
    struct ern_attention_fwd_args fwd[2];
    struct ern_attention_bwd_args bwd[2];
    for (int with = 0; with < 2; with++) {
      fwd[with] = (struct ern_attention_fwd_args){.region_eye = s.region_eye.on[with],
                                                  .code = s.code.on[with],
                                                  .eye_attention = s.eye_attention.on[with],
                                                  .eye = s.eye,
                                                  .n = s.n};
      bwd[with] = (struct ern_attention_bwd_args){
          .deye_attention = deye.on[with], .dregion_eye = s.dregion_eye.on[with], .forward = fwd[with]};
    }
    TWIN_RUN(&twin, attention_fwd, fwd);
    TWIN_RUN(&twin, attention_bwd, bwd);
    twin_same(&twin, "region_eye alone", s.region_eye, 0, 0);
    twin_same(&twin, "deye_attention alone", deye, 0, 0);
    twin_clear(&twin);
  }
}

static void test_nothing(void **state) {
  (void)state;
  struct scene s = scene_make(4, 4, 1, USUAL);
  const struct twin_rows dv = twin_rows_of(&twin, NULL, 4, 1, ERN_PER_SAMPLE);
  const float before[4] = {1, 2, 3, 4};
  const struct twin_span dcode = twin_reals(&twin, before, 4);
  s.n = 0;
  struct ern_attention_fwd_args attention[2] = {forward_of(&s, true, 0), forward_of(&s, true, 1)};
  TWIN_RUN(&twin, attention_fwd, attention);
  for (int k = 0; k < 2; k++) {
    struct ern_backend *backend = twin.backend[k];
    struct ern_attention_bwd_args attention_bwd = {
        .dv = dv.on[k], .dcode = dcode.on[k], .dregion = s.dregion.on[k], .forward = attention[k]};
    struct ern_activate_fwd_args activate = {s.region.on[k], s.v.on[k], ERN_ACT_COLOUR, 0};
    struct ern_activate_bwd_args activate_bwd = {dv.on[k], s.dregion.on[k], s.v.on[k], ERN_ACT_COLOUR, 0};
    support_ok(context, backend->attention_bwd(twin.stream[k], &attention_bwd));
    support_ok(context, backend->activate_fwd(twin.stream[k], &activate));
    support_ok(context, backend->activate_bwd(twin.stream[k], &activate_bwd));
    struct ern_sh_fwd_args sh = {s.region.on[k], s.v.on[k], 0};
    struct ern_freq_fwd_args freq = {s.region.on[k], s.v.on[k], 0, 0};
    struct ern_freq_bwd_args freq_bwd = {dv.on[k], s.dregion.on[k], s.v.on[k], 0, 0};
    support_ok(context, backend->sh_fwd(twin.stream[k], &sh));
    support_ok(context, backend->freq_fwd(twin.stream[k], &freq));
    support_ok(context, backend->freq_bwd(twin.stream[k], &freq_bwd));
  }
  twin_same_rows(&twin, "region", s.region, 0, 0);
  twin_same(&twin, "norm", s.norm, 0, 0);
  twin_same_rows(&twin, "dv", dv, 0, 0);
  twin_same(&twin, "dcode", dcode, 0, 0);
  twin_clear(&twin);
}

/* ---- measure ---- */

static double now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

enum { COLOURS, COLOURS_BWD, HARMONICS, SINES, ATTENTION, ATTENTION_BWD, MEASURED };
static const char *const measured[] = {"3 colours",           "3 colours' gradient", "harmonics",
                                       "8 octaves of 2 axes", "attention",           "attention's gradient"};

static ern_status once(int what, struct scene *s, struct twin_rows y, struct twin_rows dv, int k) {
  struct ern_backend *backend = twin.backend[k];
  struct ern_stream *stream = twin.stream[k];
  const ern_rows three = ern_rows_part(s->v.on[k], 0, 3), two = ern_rows_part(s->v.on[k], 0, 2);
  struct ern_activate_fwd_args activate = {ern_rows_part(y.on[k], 0, 3), three, ERN_ACT_COLOUR, s->n};
  struct ern_activate_bwd_args activate_bwd = {ern_rows_part(dv.on[k], 0, 3), ern_rows_part(s->dregion.on[k], 0, 3),
                                               three, ERN_ACT_COLOUR, s->n};
  struct ern_sh_fwd_args sh = {ern_rows_part(y.on[k], 0, 16), three, s->n};
  struct ern_freq_fwd_args freq = {y.on[k], two, 8, s->n};
  struct ern_attention_fwd_args attention = forward_of(s, true, k);
  struct ern_attention_bwd_args attention_bwd = {.dv = dv.on[k],
                                                 .dcode = s->code.on[k],
                                                 .dregion = s->dregion.on[k],
                                                 .dnorm = s->dnorm.on[k],
                                                 .forward = attention};
  switch (what) {
    case COLOURS: return backend->activate_fwd(stream, &activate);
    case COLOURS_BWD: return backend->activate_bwd(stream, &activate_bwd);
    case HARMONICS: return backend->sh_fwd(stream, &sh);
    case SINES: return backend->freq_fwd(stream, &freq);
    case ATTENTION: return backend->attention_fwd(stream, &attention);
    default: return backend->attention_bwd(stream, &attention_bwd);
  }
}

static void measure(size_t n) {
  enum { REPEATS = 5 };
  struct scene s = scene_make(32, 32, n, USUAL);
  const struct twin_rows y = twin_rows_of(&twin, NULL, 34, n, ERN_PER_SAMPLE),
                         dv = twin_rows_of(&twin, NULL, 32, n, ERN_PER_SAMPLE);
  for (int what = 0; what < MEASURED; what++) {
    double best[2] = {1e9, 1e9};
    for (int repeat = 0; repeat < REPEATS; repeat++) {
      for (int k = 0; k < 2; k++) {
        const double start = now();
        float sink;
        support_ok(context, once(what, &s, y, dv, k));
        support_ok(context, twin.backend[k]->download_reals(twin.stream[k], &sink, s.code.on[k], 1)); /* it is done */
        const double seconds = now() - start;
        if (seconds < best[k]) best[k] = seconds;
      }
    }
    printf("%zu samples, %-20s: reference (1 thread) %7.2f ms, device %7.2f ms, %.2f times\n", n, measured[what],
           best[0] * 1e3, best[1] * 1e3, best[0] / best[1]);
  }
  twin_clear(&twin);
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    set_up(NULL);
    measure(183000);
    measure(2000);
    return tear_down(NULL);
  }
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_activations), cmocka_unit_test(test_harmonics),
                                     cmocka_unit_test(test_sines),       cmocka_unit_test(test_usual),
                                     cmocka_unit_test(test_extreme),     cmocka_unit_test(test_eye_alone),
                                     cmocka_unit_test(test_nothing)};
  return cmocka_run_group_tests_name("opencl encodings", tests, set_up, tear_down);
}
