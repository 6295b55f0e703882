/* SPDX-License-Identifier: MIT
 * The losses on an OpenCL device against the reference; points and differences to the bit. */
#include "twin.h"

#include <float.h>

#include "backend_opencl/opencl.h"

enum { STEPS = 16, MANY = 70000 /* several rounds of every group */ };

static ern_context *context;
static struct twin twin;

static float *room(size_t count) {
  float *made = calloc(count + 1, sizeof *made);
  assert_non_null(made);
  return made;
}

/* ---- a batch of rays ---- */

enum { PIXEL, TRUTH = 3, OPACITY = 6, ATTENTION, EYE, UNCERTAINTY, FACE, IN_ROWS };
enum { DOPACITY, DATTENTION, DEYE, DUNCERTAINTY, OUT_SPANS };
enum { TERMS = ERN_LOSS_EYE_AMBIENT + 1 };

typedef enum kinds { USUAL, EXTREME, SPIKE, KINDS } kinds;

struct batch {
  size_t n;
  float *in; /* [IN_ROWS][n] */
  struct twin_rows dpixel;
  struct twin_span out[OUT_SPANS];
  struct ern_head_loss_args args[2];
};

/* Uncertainties as a softplus leaves them, from nothing to 3e38, or one that takes the whole softmax; opacities at both
 * ends and just inside. in: [IN_ROWS][n] */
static float *inputs_make(size_t n, kinds kind, uint64_t seed) {
  static const float opacities[] = {0, 1, 1e-5f, 1 - 1e-5f, 9e-6f, 0.9999999f, -1e-3f, 1.0001f};
  static const float uncertainties[] = {0, 1e-45f, 1e-38f, 1e-8f, 88, 1e4f, 1e20f, 3e38f};
  float *in = room(IN_ROWS * n);
  for (size_t row = 0; row < IN_ROWS; row++) {
    for (size_t r = 0; r < n; r++) {
      const struct ern_random random = ern_random_at(seed, row, (uint32_t)r, ERN_RNG_INIT);
      const uint32_t pick = random.word[1] % 8;
      float *to = &in[row * n + r];
      *to = ern_uniform(random.word[0]);
      if (row == FACE) *to = random.word[0] % 3 == 0;
      if (row == ATTENTION || row == UNCERTAINTY) *to *= 4;
      if (kind == EXTREME && row == OPACITY) *to = opacities[pick];
      if (kind == EXTREME && row == UNCERTAINTY && random.word[2] % 2) *to = uncertainties[pick];
      if (kind == EXTREME && row < OPACITY && pick == 0) *to = 0;
      if (kind == SPIKE && row == UNCERTAINTY && r == n / 2) *to = 95;
    }
  }
  return in;
}

static struct batch batch_make(float *in, size_t n, bool adaptive, bool eye) {
  struct batch b = {.n = n, .in = in};
  struct twin_span value[IN_ROWS];
  const struct twin_rows pixel = twin_rows_of(&twin, in + PIXEL * n, 3, n, ERN_PER_RAY);
  const struct twin_rows truth = twin_rows_of(&twin, in + TRUTH * n, 3, n, ERN_PER_RAY);
  for (size_t row = OPACITY; row < IN_ROWS; row++) value[row] = twin_reals(&twin, in + row * n, n);
  for (size_t k = 0; k < OUT_SPANS; k++) b.out[k] = twin_take(&twin, ERN_ELEMENT_REAL, n);
  b.dpixel = twin_rows_of(&twin, NULL, 3, n, ERN_PER_RAY);
  for (int k = 0; k < 2; k++)
    b.args[k] = (struct ern_head_loss_args){.dpixel = b.dpixel.on[k],
                                            .dopacity = b.out[DOPACITY].on[k],
                                            .dattention = b.out[DATTENTION].on[k],
                                            .deye = eye ? b.out[DEYE].on[k] : (ern_span){0},
                                            .duncertainty = b.out[DUNCERTAINTY].on[k],
                                            .terms = {-1, -1, -1, -1, -1, -1, -1, -1},
                                            .pixel = pixel.on[k],
                                            .truth = truth.on[k],
                                            .opacity = value[OPACITY].on[k],
                                            .attention = value[ATTENTION].on[k],
                                            .eye = eye ? value[EYE].on[k] : (ern_span){0},
                                            .uncertainty = value[UNCERTAINTY].on[k],
                                            .face = value[FACE].on[k],
                                            .weights = {0.4f, 1, 1e-3f, 1e-4f, 1e-4f, 1e-4f, 1e-5f, adaptive},
                                            .max_steps = STEPS,
                                            .n = n};
  return b;
}

static void batch_free(struct batch *b) {
  free(b->in);
  twin_clear(&twin);
}

/* Units of 2^-23 of the sum of the terms' sizes. The longest chain: an exponential or logarithm, 3 on a device and 1 in
 * the reference; the quotient and its square, 5 where division is not correctly rounded; products and sums 0.5 each and
 * in both: less than 24. The softmax has more: in the sum u - most of a part and that from most to most are rounded,
 * half a unit of their sizes, which is an error of as many units of the exponential; by share, so that their mean is
 * below log(n) + 1, 12. Its two exponentials and its additions are 12 more. The sum of a term: a part's share of n in
 * 64 items one after the other. */
static const double units = 24, share_units = 24;
static double sum_units(size_t n) { return 6 + (double)n / (64 * 64) / 2; }

static void expect_near(const char *what, size_t at, double found, double expected, double tolerance) {
  if (found == expected || fabs(found - expected) <= tolerance + 2 * (double)FLT_MIN) return;
  fail_msg("%s [%zu]: device %.9g, reference %.12g +- %.1e", what, at, found, expected, tolerance);
}

/* What the values of one output are the sum of, without signs. */
static double size_of(const struct batch *b, int out, size_t r) {
  const struct ern_loss_weights *w = &b->args[0].weights;
  const size_t n = b->n;
  const double u = (double)b->in[UNCERTAINTY * n + r], face = (double)b->in[FACE * n + r], beta = u + 1;
  if (out == DUNCERTAINTY) {
    double squares = 0;
    for (size_t c = 0; c < 3; c++) squares += pow((double)(b->in[(PIXEL + c) * n + r] - b->in[(TRUTH + c) * n + r]), 2);
    const double parts = face * (log1p(u) / beta + sqrt(squares) / (beta * beta * beta));
    return (double)w->s * ((double)w->uncertainty * parts + (double)w->static_uncertainty * (1 - face)) / (double)n;
  }
  const float low = 1e-5f, opacity = b->in[OPACITY * n + r];
  const double held = (double)fminf(fmaxf(opacity, low), 1 - low);
  return (double)w->entropy / (double)n * (fabs(log2(held)) + fabs(log2(1 - held)));
}

static void check_head(size_t n, bool adaptive, kinds kind) {
  const bool eye = n % 2 == 0;
  struct batch b = batch_make(inputs_make(n, kind, n), n, adaptive, eye);
  TWIN_RUN(&twin, head_loss, b.args)
  const double pixel_units = (units + (adaptive ? share_units : 0)) * 0x1p-23;
  twin_same_rows(&twin, "dpixel", b.dpixel, pixel_units, 2 * (double)FLT_MIN);
  twin_same(&twin, "dattention", b.out[DATTENTION], 0, 0);
  twin_same(&twin, "deye", b.out[DEYE], 0, 0);
  for (int out = DOPACITY; out <= DUNCERTAINTY; out += DUNCERTAINTY - DOPACITY) {
    twin_same(&twin, "gradient", b.out[out], 0, INFINITY); /* the guards */
    float *expected = twin_down(&twin, 0, b.out[out].on[0]), *found = twin_down(&twin, 1, b.out[out].on[1]);
    for (size_t r = 0; r < n; r++)
      expect_near(out == DOPACITY ? "dopacity" : "duncertainty", r, (double)found[TWIN_GUARD + r],
                  (double)expected[TWIN_GUARD + r], units * 0x1p-23 * size_of(&b, out, r));
    free(expected);
    free(found);
  }
  for (size_t t = 0; t < TERMS; t++) { /* sums of what is positive */
    const double allowed = units + sum_units(n) + (t == ERN_LOSS_PHOTOMETRIC && adaptive ? share_units : 0);
    expect_near("term", t, b.args[1].terms[t], b.args[0].terms[t], allowed * 0x1p-23 * b.args[0].terms[t]);
  }
  assert_true(b.args[1].terms[ERN_LOSS_SMOOTHNESS] == -1 && b.args[1].terms[ERN_LOSS_KEY_POINTS] == -1);
  batch_free(&b);
}

static void test_head(void **state) {
  (void)state;
  for (int kind = 0; kind < KINDS; kind++) {
    for (int adaptive = 0; adaptive < 2; adaptive++) {
      for (size_t s = 0; s < TWIN_SIZES; s++) check_head(twin_sizes[s], adaptive == 1, (kinds)kind);
      check_head(4097, adaptive == 1, (kinds)kind);
      if (!twin_is_small()) check_head(MANY, adaptive == 1, (kinds)kind);
    }
  }
}

/* s = 1 and one uncertainty far above the others: its weight is 8.2 (the most there is) and theirs 0.2, not a bit more;
 * or all the same, however large: 1 each. */
static void test_softmax(void **state) {
  (void)state;
  for (int spike = 0; spike < 2; spike++) {
    const size_t n = 1000;
    float *in = inputs_make(n, USUAL, 3);
    for (size_t r = 0; r < n; r++) in[UNCERTAINTY * n + r] = spike && r == 777 ? 1e5f : 300;
    struct batch b = batch_make(in, n, true, true);
    b.args[0].weights.s = b.args[1].weights.s = 1;
    TWIN_RUN(&twin, head_loss, b.args)
    float *d = twin_down(&twin, 1, b.dpixel.on[1].span);
    for (size_t r = 0; r < n; r++) {
      const float weight = !spike ? 1 : r == 777 ? 8.2f : 0.2f;
      const float plain = (float)(2 / (3 * (double)n)) * weight * (in[PIXEL * n + r] - in[TRUTH * n + r]);
      expect_near("dpixel", r, (double)d[TWIN_GUARD + r], (double)plain, 8 * 0x1p-23 * fabs((double)plain));
    }
    free(d);
    batch_free(&b);
  }
}

/* Whatever is no number in the reference is none here, and nothing else; nor is anything infinite but there. */
static void test_head_broken(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, -INFINITY, -1, -3, 1e38f};
  for (size_t row = 0; row < IN_ROWS; row++) {
    for (size_t which = 0; which <= 6; which++) { /* one of them, or all */
      const size_t n = 130;
      float *in = inputs_make(n, USUAL, 5);
      for (size_t i = 0; i < 6; i++)
        if (which == i || which == 6) in[row * n + 20 * i] = odd[i];
      struct batch b = batch_make(in, n, row % 2 == 0 || row == UNCERTAINTY, true);
      TWIN_RUN(&twin, head_loss, b.args)
      for (size_t k = 0; k <= OUT_SPANS; k++) {
        const struct twin_span rows = {{b.dpixel.on[0].span, b.dpixel.on[1].span}};
        const struct twin_span span = k < OUT_SPANS ? b.out[k] : rows;
        float *expected = twin_down(&twin, 0, span.on[0]), *found = twin_down(&twin, 1, span.on[1]);
        for (size_t i = 0; i < span.on[0].count + 2 * TWIN_GUARD; i++)
          if (isnan(found[i]) != isnan(expected[i]) || isfinite(found[i]) != isfinite(expected[i]))
            fail_msg("gradient %zu [%ld] of odd input %zu (%zu): device %g, reference %g", k, (long)i - TWIN_GUARD, row,
                     which, (double)found[i], (double)expected[i]);
        free(expected);
        free(found);
      }
      for (size_t t = 0; t < TERMS; t++)
        if (isfinite(b.args[0].terms[t]) != isfinite(b.args[1].terms[t]))
          fail_msg("term %zu of odd input %zu (%zu): device %g, reference %g", t, row, which, b.args[1].terms[t],
                   b.args[0].terms[t]);
      batch_free(&b);
    }
  }
}

static void test_nothing(void **state) {
  (void)state;
  struct batch b = batch_make(inputs_make(8, USUAL, 1), 8, true, true);
  struct ern_mse_args mse[2] = {{.dpixel = b.dpixel.on[0], .term = 3}, {.dpixel = b.dpixel.on[1], .term = 3}};
  struct ern_smooth_loss_args smooth[2] = {{.dmoved = b.out[0].on[0], .term = 3},
                                           {.dmoved = b.out[0].on[1], .term = 3}};
  struct ern_smooth_points_args points[2] = {{.moved = b.dpixel.on[0]}, {.moved = b.dpixel.on[1]}};
  b.args[0].n = b.args[1].n = 0;
  TWIN_RUN(&twin, head_loss, b.args)
  TWIN_RUN(&twin, mse, mse)
  TWIN_RUN(&twin, smooth_loss, smooth)
  TWIN_RUN(&twin, smooth_points, points)
  for (size_t t = 0; t < TERMS; t++) assert_true(b.args[1].terms[t] == 0 && b.args[0].terms[t] == 0);
  assert_true(mse[1].term == 0 && smooth[1].term == 0 && mse[0].term == 0 && smooth[0].term == 0);
  twin_same_rows(&twin, "dpixel", b.dpixel, 0, 0);
  for (size_t k = 0; k < OUT_SPANS; k++) twin_same(&twin, "gradient", b.out[k], 0, 0);
  batch_free(&b);
}

/* ---- squared differences ---- */

/* Usual ones; with a huge one, whose square no float holds; none but tiny ones, whose squares it loses; all sizes. */
static float difference_at(int kind, size_t i) {
  const float usual = twin_random(1, i, 1);
  if (kind == 1 && i == 0) return 1e30f;
  if (kind == 2) return usual * 1e-30f;
  if (kind == 3) return usual * powf(10, twin_random(2, i, 37));
  return usual;
}

/* Gradients to the bit. Terms in units of 2^-23: a square 1/2, three of them an element, and the additions. */
static double square_units(size_t n) { return 3 * sum_units(n) * 0x1p-23; }

static void check_differences(int kind, size_t n) {
  float *a = room(3 * n), *b = room(3 * n);
  for (size_t i = 0; i < 3 * n; i++) b[i] = kind == 0 ? twin_random(3, i, 1) : 0, a[i] = difference_at(kind, i);
  const struct twin_rows pixel = twin_rows_of(&twin, a, 3, n, ERN_PER_RAY);
  const struct twin_rows truth = twin_rows_of(&twin, b, 3, n, ERN_PER_RAY);
  const struct twin_rows dpixel = twin_rows_of(&twin, NULL, 3, n, ERN_PER_RAY);
  const struct twin_span moved = twin_reals(&twin, a, n), still = twin_reals(&twin, b, n);
  const struct twin_span dmoved = twin_take(&twin, ERN_ELEMENT_REAL, n);
  struct ern_mse_args mse[2];
  struct ern_smooth_loss_args smooth[2];
  for (int k = 0; k < 2; k++) {
    mse[k] = (struct ern_mse_args){dpixel.on[k], -1, pixel.on[k], truth.on[k], n};
    smooth[k] = (struct ern_smooth_loss_args){dmoved.on[k], -1, still.on[k], moved.on[k], 0.3f, n + 9, n};
  }
  TWIN_RUN(&twin, mse, mse)
  TWIN_RUN(&twin, smooth_loss, smooth)
  twin_same_rows(&twin, "dpixel", dpixel, 0, 0);
  twin_same(&twin, "dmoved", dmoved, 0, 0);
  if (fabs(mse[1].term - mse[0].term) > square_units(n) * mse[0].term)
    fail_msg("mse of %zu, kind %d: device %.9g, reference %.9g", n, kind, mse[1].term, mse[0].term);
  if (fabs(smooth[1].term - smooth[0].term) > square_units(n) * smooth[0].term)
    fail_msg("smooth_loss of %zu, kind %d: device %.9g, reference %.9g", n, kind, smooth[1].term, smooth[0].term);
  twin_clear(&twin);
  free(a);
  free(b);
}

static void test_differences(void **state) {
  (void)state;
  for (int kind = 0; kind < 4; kind++) {
    for (size_t s = 0; s < TWIN_SIZES; s++) check_differences(kind, twin_sizes[s]);
    check_differences(kind, twin_is_small() ? 4097 : MANY);
  }
}

static void test_broken_differences(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, -INFINITY};
  for (size_t i = 0; i < 3; i++) {
    float a[65] = {0}, b[65] = {0};
    a[64] = odd[i];
    const struct twin_span moved = twin_reals(&twin, a, 65), still = twin_reals(&twin, b, 65);
    const struct twin_span dmoved = twin_take(&twin, ERN_ELEMENT_REAL, 65);
    struct ern_smooth_loss_args smooth[2];
    for (int k = 0; k < 2; k++)
      smooth[k] = (struct ern_smooth_loss_args){dmoved.on[k], 0, still.on[k], moved.on[k], 1, 65, 65};
    TWIN_RUN(&twin, smooth_loss, smooth)
    twin_same(&twin, "dmoved", dmoved, 0, 0);
    assert_true(i == 0 ? isnan(smooth[1].term) && isnan(smooth[0].term)
                       : smooth[1].term == INFINITY && smooth[0].term == INFINITY);
    twin_clear(&twin);
  }
}

/* To the bit, where division is. Accumulates. */
static void test_key_points(void **state) {
  (void)state;
  const bool exact = ((const struct ern_cl_backend *)twin.backend[1])->device.exact_divide;
  for (int kind = 0; kind < 4; kind++) {
    float anchors[12], danchors[12];
    for (size_t i = 0; i < 12; i++) anchors[i] = difference_at(kind, 12 - i) * 3, danchors[i] = twin_random(9, i, 1);
    const struct twin_span at = twin_reals(&twin, anchors, 12), d = twin_reals(&twin, danchors, 12);
    struct ern_key_points_loss_args args[2] = {{d.on[0], -1, at.on[0]}, {d.on[1], -1, at.on[1]}};
    TWIN_RUN(&twin, key_points_loss, args)
    twin_same(&twin, "danchors", d, exact ? 0 : 0x1p-21, 0);
    assert_true(args[1].term == args[0].term);
    twin_clear(&twin);
  }
}

static void test_points(void **state) {
  (void)state;
  static const uint64_t seeds[] = {0, 1, 0xffffffffffffffffu, 0x123456789abcdef0u};
  for (size_t s = 0; s < TWIN_SIZES; s++) {
    const size_t n = twin_sizes[s];
    float *values = room(3 * n);
    twin_fill(values, 3 * n, s, 1);
    const struct twin_rows x = twin_rows_of(&twin, values, 3, n, ERN_PER_SAMPLE);
    const struct twin_rows moved = twin_rows_of(&twin, NULL, 3, n, ERN_PER_SAMPLE);
    struct ern_smooth_points_args args[2];
    for (int k = 0; k < 2; k++)
      args[k] = (struct ern_smooth_points_args){.moved = moved.on[k],
                                                .x = x.on[k],
                                                .reach = 1e-3f,
                                                .seed = seeds[s % 4],
                                                .step = seeds[(s / 4) % 4] + s,
                                                .first = s * 1000 + 5,
                                                .n = n};
    TWIN_RUN(&twin, smooth_points, args)
    twin_same_rows(&twin, "moved", moved, 0, 0);
    twin_clear(&twin);
    free(values);
  }
}

/* ---- figures ---- */

/* More figures than there is room for come one after the other, each its own; the same ones on every run. */
static void test_many_figures(void **state) {
  (void)state;
  enum { CALLS = 100, N = 300 };
  static struct ern_mse_args mse[2][CALLS];
  static struct ern_head_loss_args head[2][CALLS];
  struct batch b = batch_make(inputs_make(N, USUAL, 4), N, true, true);
  for (int run = 0; run < 2; run++) {
    for (size_t i = 0; i < CALLS; i++) {
      mse[run][i] = (struct ern_mse_args){b.dpixel.on[1], -1, b.args[1].pixel, b.args[1].truth, N - 2 * i};
      head[run][i] = b.args[1];
      head[run][i].n = N - 2 * i;
      support_ok(context, twin.backend[1]->mse(twin.stream[1], &mse[run][i]));
      support_ok(context, twin.backend[1]->head_loss(twin.stream[1], &head[run][i]));
    }
    support_ok(context, twin.backend[1]->settle(twin.stream[1]));
  }
  for (size_t i = 0; i < CALLS; i++) {
    struct ern_mse_args expected = {b.dpixel.on[0], -1, b.args[0].pixel, b.args[0].truth, N - 2 * i};
    support_ok(context, twin.backend[0]->mse(twin.stream[0], &expected));
    expect_near("mse", i, mse[0][i].term, expected.term, square_units(N) * expected.term);
    assert_true(mse[0][i].term == mse[1][i].term);
    assert_memory_equal(head[0][i].terms, head[1][i].terms, sizeof head[0][i].terms);
  }
  batch_free(&b);
}

static ern_status no_select(struct ern_stream *stream, struct ern_torso_select_args *args) {
  (void)stream, (void)args;
  return ERN_E_DEVICE;
}

/* A step that fails leaves no figure behind that would be written to its arguments later. */
static void test_failed_step(void **state) {
  (void)state;
  struct batch b = batch_make(inputs_make(8, USUAL, 1), 8, true, true);
  struct ern_backend *backend = twin.backend[1];
  struct ern_mse_args mse = {b.dpixel.on[1], 0, b.args[1].pixel, b.args[1].truth, 8};
  const struct ern_view view = {.width = 8, .height = 8};
  struct ern_torso_step_args step = {.view = &view, .n = 8};
  ern_status (*const select)(struct ern_stream *, struct ern_torso_select_args *) = backend->torso_select;
  support_ok(context, backend->mse(twin.stream[1], &mse));
  mse.term = -5;
  backend->torso_select = no_select;
  assert_int_equal(backend->torso_step(twin.stream[1], &step), ERN_E_DEVICE);
  backend->torso_select = select;
  support_ok(context, backend->settle(twin.stream[1]));
  assert_true(mse.term == -5);
  support_ok(context, backend->mse(twin.stream[1], &mse));
  support_ok(context, backend->settle(twin.stream[1]));
  assert_true(mse.term > 0);
  batch_free(&b);
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

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_head),        cmocka_unit_test(test_softmax),     cmocka_unit_test(test_head_broken),
      cmocka_unit_test(test_nothing),     cmocka_unit_test(test_differences), cmocka_unit_test(test_broken_differences),
      cmocka_unit_test(test_key_points),  cmocka_unit_test(test_points),      cmocka_unit_test(test_many_figures),
      cmocka_unit_test(test_failed_step),
  };
  return cmocka_run_group_tests_name("opencl losses", tests, set_up, tear_down);
}
