/* SPDX-License-Identifier: MIT
 * Speech that is silent, deafening or broken, region attention at its ends, and encodings of what is no direction and
 * no place (docs/numerics.md). */
#include "machines.h"
#include "mlp/encoding_ops.h"
#include "model/attention_ops.h"
#include "model/parameters.h"
#include "render/occupancy_ops.h"

enum { WIDTH = 5, LENGTH = 16, WINDOWS = 8 * LENGTH * WIDTH, CODE = 32 };

static struct ern_field field;
static struct ern_parameter_table rows;
static float *block;

static int open_speech(void **state) {
  const struct ern_model_config config = {
      .levels = 2, .feature_width = WIDTH, .window_length = LENGTH, .head = true, .bound = 1};
  open_hosts(state);
  support_ok(machines.context, ern_parameters_build(machines.context, &config, &field, &rows));
  block = calloc(field.parameters, sizeof *block);
  assert_non_null(block);
  ern_parameters_init(block, &rows, false, 3);
  return 0;
}
static int close_speech(void **state) {
  free(block);
  return close_machines(state);
}

/* ---- audio networks ---- */

struct heard {
  struct many code, frame, dparameters;
};
static struct heard hear(const float *windows, float gradient) {
  float gradients[CODE];
  for (size_t i = 0; i < CODE; i++) gradients[i] = i % 2 == 0 ? gradient : -gradient;
  machines_clear();
  const struct many in = many_reals(windows, WINDOWS), parameters = many_reals(block, field.parameters);
  const struct many dcode = many_reals(gradients, CODE), codes = many_zeros(8 * CODE);
  const struct heard out = {many_empty(CODE), many_empty(CODE), many_zeros(field.parameters)};
  struct ern_audio_fwd_args forward[MACHINES];
  for (int k = 0; k < machines.count; k++)
    forward[k] = (struct ern_audio_fwd_args){
        .code = out.code.on[k], .windows = in.on[k], .parameters = parameters.on[k], .net = field.audio};
  ON_EACH(audio_fwd, ern_audio_fwd_args, forward[k])
  ON_EACH(audio_bwd, ern_audio_bwd_args,
          {.dparameters = out.dparameters.on[k], .dcode = dcode.on[k], .forward = forward[k]})
  for (int k = 0; k < machines.count; k++) {
    struct ern_audio_frame_args args = {.audio = forward[k], .codes = codes.on[k]};
    args.audio.code = out.frame.on[k];
    support_ok(machines.context, machines.backend[k]->audio_frame(machines.stream[k], &args));
  }
  return out;
}

/* Relative to the largest: sums of 15 to 192 products in six layers, and the weights of the eight windows. */
static const double speech_rounding = 1024 * 0x1p-23;

/* case: speech of zeros, of -0 | plain code: normalised: 0/0 | here: the code of the biases; finite gradients | bound:
 * 1024 x 2^-23 of 10 */
static void test_speech_of_zeros(void **state) {
  (void)state;
  static const float silent[2] = {0, -0.0f};
  for (size_t s = 0; s < 2; s++) {
    float windows[WINDOWS];
    for (size_t i = 0; i < WINDOWS; i++) windows[i] = silent[s];
    const struct heard h = hear(windows, 1);
    expect_within("code", h.code, -10, 10); /* that of the biases */
    expect_truth("code", h.code, 0, 10 * speech_rounding);
    expect_truth("code of a frame", h.frame, 0, 10 * speech_rounding);
    expect_within("gradient", h.dparameters, -100, 100);
  }
}

/* case: speech of 1e5 to +-1e30 | plain code: `exp(score)` infinite | here: `exp(score - max)`; layers held at 1e6 |
 * bound: 1024 x 2^-23 of the largest */
/* Each layer's values are at most the sums of sizes before it, which 1e30 leaves in float, and are held at the limit
 * then. Scores whose order rounding decides may choose another window than in double. */
static void test_speech_of_1e30(void **state) {
  (void)state;
  static const float loud[] = {1e5f, 1e10f, 1e20f, 1e30f, -1e30f};
  for (size_t s = 0; s < COUNT_OF(loud); s++) {
    float windows[WINDOWS];
    for (size_t i = 0; i < WINDOWS; i++) windows[i] = loud[s] * (0.5f + machines_random(s, i, 0.5f));
    const struct heard h = hear(windows, 1e-6f);
    const double most = fmin(100 * fabs((double)loud[s]), ERN_AUDIO_LIMIT);
    expect_within("code", h.code, -most, most);
    expect_truth("code", h.code, 0, most * speech_rounding);
    expect_truth("code of a frame", h.frame, 0, most * speech_rounding);
    expect_within("gradient", h.dparameters, -(double)FLT_MAX, (double)FLT_MAX);
  }
}

/* case: weights of the speech networks at 10, +-120, 1e4, 1e12 | plain code: infinite, then NaN | here: held at 1e6, no
 * gradient beyond | bound: exactly 1e6, gradient exactly 0 */
/* All weights of a training at a hundred times the rates, which push them the same way for a thousand steps: eleven
 * layers that each upsample ten thousandfold. The code is at its limit, and AudioNet has no gradient there. */
static void test_speech_networks_that_have_grown(void **state) {
  (void)state;
  static const float grown[] = {10, 120, -120, 1e4f, 1e12f};
  const size_t first = field.audio.first, count = field.audio.count;
  float *kept = malloc(count * sizeof *kept), windows[WINDOWS];
  assert_non_null(kept);
  memcpy(kept, block + first, count * sizeof *kept);
  for (size_t i = 0; i < WINDOWS; i++) windows[i] = 0.5f + machines_random(6, i, 0.4f);
  for (size_t g = 0; g < COUNT_OF(grown); g++) {
    for (size_t i = 0; i < count; i++) block[first + i] = grown[g];
    const struct heard h = hear(windows, 1e20f);
    expect_truth("code", h.code, 0, 0.5);
    expect_truth("code of a frame", h.frame, 0, 0.5);
    expect_within("code", h.code, -ERN_AUDIO_LIMIT, ERN_AUDIO_LIMIT);
    if (grown[g] > 0) expect_at("code", h.code, 0, ERN_AUDIO_LIMIT, 0.5);
    expect_within("gradient", h.dparameters, -(double)FLT_MAX, (double)FLT_MAX);
    for (size_t i = field.audio.conv_weight[0]; i < field.audio.att_conv_weight[0]; i += 97)
      expect_at("gradient of AudioNet", h.dparameters, i, 0, 0);
  }
  memcpy(block + first, kept, count * sizeof *kept);
  free(kept);
}

/* case: speech of denormals | plain code: flush-to-zero differs | here: as of zeros | bound: 1024 x 2^-23 of 10 */
static void test_speech_of_denormals(void **state) {
  (void)state;
  float windows[WINDOWS];
  for (size_t i = 0; i < WINDOWS; i++) windows[i] = machines_random(4, i, 1e-40f);
  const struct heard h = hear(windows, 1e-30f);
  expect_truth("code", h.code, 0, 10 * speech_rounding);
  expect_within("gradient", h.dparameters, -1e-28, 1e-28);
}

/* case: one NaN in one window | plain code: `max(x, 0.02 x)` drops it | here: the code is NaN, where frame and training
 * look | bound: exact */
/* A NaN reaches the code, where the frame's check and the training's find it: LeakyReLU and softmax do not hide it. */
static void test_speech_with_one_nan(void **state) {
  (void)state;
  static const size_t places[] = {0, 3 * LENGTH * WIDTH + 8, WINDOWS - 1};
  for (size_t p = 0; p < COUNT_OF(places); p++) {
    float windows[WINDOWS];
    for (size_t i = 0; i < WINDOWS; i++) windows[i] = machines_random(5, i, 1);
    windows[places[p]] = NAN;
    const struct heard h = hear(windows, 1);
    for (size_t c = 0; c < CODE; c += 7)
      expect_at("code", h.code, c, (double)NAN, 0), expect_at("code of a frame", h.frame, c, (double)NAN, 0);
  }
}

/* ---- region attention ---- */

enum { N = 37 };
struct attended {
  struct many region, norm, dv, dcode;
};
static struct attended attend(const float *v, float code, float gradient) {
  float codes[CODE], gradients[CODE * N];
  for (size_t i = 0; i < CODE; i++) codes[i] = code;
  for (size_t i = 0; i < CODE * N; i++) gradients[i] = gradient;
  machines_clear();
  const struct many in = many_reals(v, CODE * N), code_of = many_reals(codes, CODE);
  const struct many by_region = many_reals(gradients, CODE * N), by_norm = many_reals(gradients, N);
  const struct attended out = {many_empty(CODE * N), many_empty(N), many_empty(CODE * N), many_zeros(CODE)};
  struct ern_attention_fwd_args forward[MACHINES];
  for (int k = 0; k < machines.count; k++)
    forward[k] = (struct ern_attention_fwd_args){.region = {out.region.on[k], N, CODE, ERN_PER_SAMPLE},
                                                 .norm = out.norm.on[k],
                                                 .v = {in.on[k], N, CODE, ERN_PER_SAMPLE},
                                                 .code = code_of.on[k],
                                                 .n = N};
  ON_EACH(attention_fwd, ern_attention_fwd_args, forward[k])
  ON_EACH(attention_bwd, ern_attention_bwd_args,
          {.dv = {out.dv.on[k], N, CODE, ERN_PER_SAMPLE},
           .dcode = out.dcode.on[k],
           .dregion = {by_region.on[k], N, CODE, ERN_PER_SAMPLE},
           .dnorm = by_norm.on[k],
           .forward = forward[k]})
  return out;
}

/* case: attention's norm 0, 1e-30, 1e35, its gradient | plain code: 0/0; squares leave float | here: squares in double,
 * on a device scaled; no gradient at 0 | bound: 64 x 2^-23 */
/* v/|v| is 0/0 at 0, and |v|^2 no float from 1e19 on and nothing below 1e-19. */
static void test_attention_norm_of_zero_tiny_and_huge(void **state) {
  (void)state;
  static const float sizes[] = {0, 1e-30f, 1e-22f, 1e-15f, 1, 1e18f, 1e25f, 1e35f};
  float v[CODE * N];
  for (size_t i = 0; i < CODE * N; i++) v[i] = sizes[i % N % COUNT_OF(sizes)];
  const struct attended a = attend(v, 1e-3f, 1);
  expect_truth("norm", a.norm, 64 * 0x1p-23, (double)FLT_MIN);
  for (size_t i = 0; i < COUNT_OF(sizes); i++)
    expect_at("norm", a.norm, i, sqrt(CODE) * (double)sizes[i], 64 * 0x1p-23 * 6 * (double)sizes[i] + (double)FLT_MIN);
  expect_within("dv", a.dv, 0, 0.2);
  expect_at("dv at 0", a.dv, 0, 1e-3, 1e-9); /* that of the region alone */
  expect_at("dv at 1e35", a.dv, 7, 1e-3 + 1 / sqrt(CODE), 1e-6);
  expect_at("dv at 1e-30", a.dv, 1, 1e-3 + 1 / sqrt(CODE), 1e-6);
  expect_truth("region", a.region, 4 * 0x1p-23, (double)FLT_MIN);
}

/* case: one sample's attention NaN | plain code: NaN in its register's sums | here: its own alone | bound: 1e-5 of the
 * others */
static void test_attention_of_a_nan(void **state) {
  (void)state;
  float v[CODE * N];
  for (size_t i = 0; i < CODE * N; i++) v[i] = i % N == 19 ? NAN : 1;
  const struct attended a = attend(v, 1, 1);
  expect_at("norm", a.norm, 19, (double)NAN, 0);
  for (size_t i = 0; i < N; i++)
    if (i != 19)
      expect_at("norm beside it", a.norm, i, sqrt(CODE), 1e-5), expect_at("dv", a.dv, i, 1 + 1 / sqrt(CODE), 1e-5);
}

/* ---- encodings ---- */

/* case: harmonics of directions of length 0, 1e-30, 17, NaN | plain code: divided by the length | here: polynomials, no
 * division | bound: 32 x 2^-23 */
/* Directions: of length 0, tiny, 1 along each axis, and ten times too long. */
static void test_harmonics_of_odd_directions(void **state) {
  (void)state;
  static const float d[][3] = {{0, 0, 0},    {1, 0, 0},      {0, -1, 0},
                               {0, 0, 1},    {-0.0f, 0, -1}, {1e-30f, 1e-30f, 1e-30f},
                               {10, 10, 10}, {NAN, 0, 1},    {0.6f, 0, 0.8f}};
  enum { COUNT = sizeof d / sizeof *d };
  float rows_of[3 * COUNT];
  for (size_t i = 0; i < 3 * COUNT; i++) rows_of[i] = d[i % COUNT][i / COUNT];
  machines_clear();
  const struct many in = many_reals(rows_of, 3 * COUNT), y = many_empty(16 * COUNT);
  ON_EACH(sh_fwd, ern_sh_fwd_args,
          {.y = {y.on[k], COUNT, 16, ERN_PER_RAY}, .d = {in.on[k], COUNT, 3, ERN_PER_RAY}, .n = COUNT})
  expect_truth("harmonics", y, 32 * 0x1p-23, 32 * 0x1p-23 * 3000);
  for (size_t c = 0; c < 16; c++) { /* of nothing: the constant, and -c20 */
    const double whole = c == 0 ? 0.28209479177387814 : c == 6 ? -0.31539156525252005 : 0;
    expect_at("of length 0", y, c * COUNT, whole, 1e-7);
  }
}

/* case: sines of 2^9 x for x to 1e35 | plain code: a float reduction by 2 pi | here: three parts to 4,096, the C
 * library beyond; in [-1, 1] | bound: sines 1e-6; cosines 2^-23 of their argument */
/* sin(2^o x) of places far outside: the argument is exact, its reduction must be. x of 1e38 has no 2^9 x. */
static void test_sines_of_huge_places(void **state) {
  (void)state;
  static const float x[] = {0,     -0.0f,        1,    -1,   8,     1e4f, -1e6f, 1e10f, 1e20f, -1e30f,
                            1e35f, FLT_TRUE_MIN, 0.3f, 0.7f, -0.2f, 2,    3};
  enum { COUNT = sizeof x / sizeof *x, OCTAVES = 10, ROWS = 1 + 2 * OCTAVES };
  float ones[ROWS * COUNT];
  for (size_t i = 0; i < ROWS * COUNT; i++) ones[i] = 1;
  machines_clear();
  const struct many in = many_reals(x, COUNT), by = many_reals(ones, ROWS * COUNT);
  const struct many y = many_empty(ROWS * COUNT), dx = many_zeros(COUNT);
  ON_EACH(freq_fwd, ern_freq_fwd_args,
          {.y = {y.on[k], COUNT, ROWS, ERN_PER_SAMPLE},
           .x = {in.on[k], COUNT, 1, ERN_PER_SAMPLE},
           .octaves = OCTAVES,
           .n = COUNT})
  ON_EACH(freq_bwd, ern_freq_bwd_args,
          {.dx = {dx.on[k], COUNT, 1, ERN_PER_SAMPLE},
           .dy = {by.on[k], COUNT, ROWS, ERN_PER_SAMPLE},
           .x = {in.on[k], COUNT, 1, ERN_PER_SAMPLE},
           .octaves = OCTAVES,
           .n = COUNT})
  expect_within("dx", dx, -3 * 1024, 3 * 1024); /* 1 + 2 sum 2^o */
  for (int k = 0; k < machines.count; k++) {
    double *all = many_values(k, y), *truth = many_values(0, y);
    for (size_t i = COUNT; i < ROWS * COUNT; i++) {
      const double found = all[MACHINE_GUARD + i], expected = truth[MACHINE_GUARD + i];
      if (!(found >= -1 - 1e-6 && found <= 1 + 1e-6))
        fail_msg("%s: row %zu of %g: %g", machines.name[k], i / COUNT, (double)x[i % COUNT], found);
      const bool sine = i / COUNT % 2 == 1; /* the other's argument, x + pi/2, is rounded */
      const double off = sine ? 1e-6 : 1e-6 + 0x1p-23 * fabs((double)x[i % COUNT]) * 512;
      if (fabs(found - expected) > off)
        fail_msg("%s: row %zu of %g: %g, in double %g", machines.name[k], i / COUNT, (double)x[i % COUNT], found,
                 expected);
    }
    free(all);
    free(truth);
  }
}

/* ---- occupancy of the head ---- */

/* case: a refresh that meets NaN, 5.5e34, denormals | plain code: every cell empty or full | here: NaN never is the
 * largest; the mean is a double | bound: 2 x 2^-23 */
/* Densities of NaN, infinity, 5.5e34 and denormals: NaN never is the largest, and the mean is a double. */
static void test_occupancy_of_odd_densities(void **state) {
  (void)state;
  float *grid = malloc(ERN_OCCUPANCY_CELLS * sizeof *grid), *fresh = malloc(ERN_OCCUPANCY_CELLS * sizeof *fresh);
  assert_true(grid != NULL && fresh != NULL);
  for (size_t i = 0; i < ERN_OCCUPANCY_CELLS; i++) {
    grid[i] = i % 5 == 0 ? -1 : i % 5 == 1 ? FLT_TRUE_MIN : 1;
    fresh[i] = i % 1001 == 0 ? NAN : i % 1003 == 0 ? 5.5e34f : 0.5f;
  }
  machines_clear();
  const struct many cells = many_reals(grid, ERN_OCCUPANCY_CELLS), news = many_reals(fresh, ERN_OCCUPANCY_CELLS);
  const struct many bits = many_of(ERN_ELEMENT_BYTE, NULL, ERN_OCCUPANCY_BYTES);
  double mean[MACHINES] = {0};
  for (int k = 0; k < machines.count; k++) {
    struct ern_occupancy_update_args args = {
        .grid = cells.on[k], .bits = bits.on[k], .fresh = news.on[k], .decay = {0.95f, 0.95f, {0, 0}}, .limit = 10};
    support_ok(machines.context, machines.backend[k]->occupancy_update(machines.stream[k], &args));
    mean[k] = args.mean;
    assert_true(isfinite(mean[k]) && fabs(mean[k] / mean[0] - 1) < 1e-6);
  }
  expect_truth("grid", cells, 2 * 0x1p-23, 0);
  expect_within("grid", cells, -1, 5.6e34);
  free(grid);
  free(fresh);
}

/* case: a refresh in turns of an empty scene, a full one, one cell | plain code: a share of none | here: a 16th of the
 * blocks; all; a 16th and one. Other cells keep their density | bound: exact */
/* A refresh in turns of an empty scene, a full one and one with a single cell: of blocks that are not due nothing
 * changes, be their densities 1e38 or denormal. */
static void test_occupancy_in_turns(void **state) {
  (void)state;
  enum { CELLS = ERN_OCCUPANCY_CELLS, ONE = 1000 };
  const struct ern_occupancy_decay decay = {0.5f, 0.25f, {.turn = 3, .mask = 15}};
  const float odd[] = {1e38f, FLT_TRUE_MIN, 0, 1};
  float *grid = malloc(CELLS * sizeof *grid), *fresh = calloc(CELLS, sizeof *fresh);
  uint8_t *bits = malloc(ERN_OCCUPANCY_BYTES);
  assert_true(grid != NULL && fresh != NULL && bits != NULL);
  for (size_t i = 0; i < CELLS; i++) grid[i] = odd[i % 4];
  for (int scene = 0; scene < 3; scene++) {
    memset(bits, scene == 1 ? 255 : 0, ERN_OCCUPANCY_BYTES);
    if (scene == 2) bits[ERN_OCCUPANCY_BLOCK / 8 * ONE] = 1;
    machines_clear();
    const struct many cells = many_of(ERN_ELEMENT_INT32, NULL, CELLS), values = many_reals(grid, CELLS),
                      news = many_reals(fresh, CELLS), occupied = many_of(ERN_ELEMENT_BYTE, bits, ERN_OCCUPANCY_BYTES);
    for (int k = 0; k < machines.count; k++) {
      struct ern_occupancy_list_args list = {cells.on[k], values.on[k], occupied.on[k], decay.turn, 0};
      support_ok(machines.context, machines.backend[k]->occupancy_list(machines.stream[k], &list));
      assert_int_equal(list.count, scene == 1 ? CELLS : CELLS / 16 + (scene == 2 ? ERN_OCCUPANCY_BLOCK : 0));
      struct ern_occupancy_update_args update = {
          .grid = values.on[k], .bits = occupied.on[k], .fresh = news.on[k], .decay = decay, .limit = 10};
      support_ok(machines.context, machines.backend[k]->occupancy_update(machines.stream[k], &update));
      const float *found = floats_of(k, values);
      for (uint32_t i = 0; i < CELLS; i++) {
        const uint32_t number = i / ERN_OCCUPANCY_BLOCK;
        const bool near = scene == 1 || (scene == 2 && number == ONE);
        assert_true(found[i] == grid[i] * (near ? 0.5f : number % 16 == 3 ? 0.25f : 1));
      }
    }
  }
  free(grid), free(fresh), free(bits);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_speech_of_zeros),
      cmocka_unit_test(test_speech_of_1e30),
      cmocka_unit_test(test_speech_networks_that_have_grown),
      cmocka_unit_test(test_speech_of_denormals),
      cmocka_unit_test(test_speech_with_one_nan),
      cmocka_unit_test(test_attention_norm_of_zero_tiny_and_huge),
      cmocka_unit_test(test_attention_of_a_nan),
      cmocka_unit_test(test_harmonics_of_odd_directions),
      cmocka_unit_test(test_sines_of_huge_places),
      cmocka_unit_test(test_occupancy_of_odd_densities),
      cmocka_unit_test(test_occupancy_in_turns),
  };
  return cmocka_run_group_tests(tests, open_speech, close_speech);
}
