/* SPDX-License-Identifier: MIT
 * The fused training step and the fused densities of each instruction set against the stages of the reference.
 *
 * Both are held against the double reference, and the fused one may be off by no more than a few times what the float
 * reference, whose sums are made in another order, is off by: FACTOR, and a floor of FLOOR where that happens to be
 * nearly exact. A tensor's error is the L2 norm of the difference over that of the gradient. */
#include "kernelcheck.h"

#include "backend_cpu/backend_cpu.h"
#include "core/profile.h"
#include "model/parameters.h"
#include "train/step.h"

static const double FACTOR = 6, FLOOR = 3e-6;
/* The softmax of AudioAttNet hands on differences of numbers that agree in their first digits. */
static const double FLOOR_ATT = 1e-4;

enum { MAX_RAYS = 400, SIDE = 24 };

struct scene {
  const char *name;
  int levels;
  bool eye, smooth;
  int codes;
  size_t rays;
  float density;  /* factor of the density's last weights: large ones spend the light of a ray at its first sample */
  unsigned cells; /* of 8 cells in a row these are occupied, as bits */
  float height;   /* of the camera: at the side of the cube points are moved out of it */
  bool no_view;   /* the colour is not told the direction */
};

static const struct scene scenes[] = {
    {"plain", 12, true, false, 3, 64, 1, 0xff, 0.02f, false},
    {"16 samples a ray, smooth", 14, true, true, 3, 333, 1, 0xff, 0.02f, false},
    {"no eye", 14, false, true, 3, 100, 1, 0xff, 0.02f, false},
    {"no codes", 12, true, true, 0, 100, 4, 0x0f, 0.02f, false},
    {"neither", 4, false, false, 0, 47, 4, 0xff, 0.02f, false},
    {"dense", 14, true, true, 3, 400, 1000, 0xff, 0.02f, false},
    {"dense, not smooth", 14, true, false, 3, 400, 1000, 0x7e, 0.02f, false},
    {"light spent slowly", 12, true, false, 3, 400, 300, 0xff, 0.02f, false},
    {"one ray", 12, true, true, 3, 1, 1, 0xff, 0.02f, false},
    {"at the side of the cube", 14, true, true, 3, 200, 1, 0xff, 0.93f, false},
    {"as many levels as there may be", 24, true, true, 3, 60, 4, 0xff, 0.02f, false},
    {"features a whole number of registers", 16, true, true, 3, 60, 4, 0xff, 0.02f, false},
    {"no samples", 12, true, true, 3, 64, 1, 0, 0.02f, false},
    {"no view", 14, true, true, 3, 200, 1, 0xff, 0.02f, true},
    {"no view, eye or codes", 12, false, false, 0, 100, 300, 0xff, 0.02f, true},
};
enum { SCENES = sizeof scenes / sizeof *scenes };

/* Most time goes into making the parameters of a scene: under emulation two are looked at, the smallest and a dense
 * one, with fewer rays. */
static bool left_out(int number) { return is_emulated() && number != 4 && number != 5; }

/* What a step leaves behind. */
struct result {
  float *gradient;
  double terms[ERN_LOSS_TERMS], squared_error;
  size_t samples, counted; /* counted: those before the light is spent, where the fused pass tells */
};

struct bench {
  ern_context *context;
  struct ern_backend *backend;
  struct ern_stream *stream;
  struct ern_field field;
  struct ern_parameter_table table;
  struct ern_view view;
  struct ern_march_settings settings;
  struct ern_head_step_args args;
  const struct scene *scene;
};

static ern_span take(struct bench *b, const float *values, size_t count) {
  ern_span span;
  support_ok(b->context, ern_take(b->stream, ERN_ELEMENT_REAL, count, &span));
  support_ok(b->context, b->backend->upload_reals(b->stream, span, values, count));
  return span;
}

static ern_rows take_rows(struct bench *b, int rows, size_t n, float low, float high, uint64_t seed) {
  ern_rows out;
  float *values = calloc(n + 1, sizeof *values);
  assert_non_null(values);
  support_ok(b->context, ern_take_rows(b->stream, rows, n, &out));
  for (int r = 0; r < rows; r++) {
    for (size_t i = 0; i < n; i++)
      values[i] = low + (high - low) * 0.5f * (1 + random_at(seed, (size_t)r * MAX_RAYS + i, 1));
    support_ok(b->context, b->backend->upload_reals(b->stream, ern_span_of_row(out, r, n), values, n));
  }
  free(values);
  return out;
}

/* Fresh values, tables large enough to matter. */
static ern_span take_values(struct bench *b) {
  float *values = calloc(b->field.parameters, sizeof *values);
  assert_non_null(values);
  ern_parameters_init(values, &b->table, false, 3);
  for (int r = 0; r < b->table.rows; r++) {
    const struct ern_parameter *row = &b->table.row[r];
    if (row->group != ERN_GROUP_GRID) continue;
    for (size_t i = row->at; i < row->at + row->count; i++) values[i] *= 3e3f;
  }
  float *last = values + b->field.density.weight[2];
  for (int i = 0; i < b->field.density.width[2]; i++) last[i] = b->scene->density * (fabsf(last[i]) - 0.02f);
  const ern_span span = take(b, values, b->field.parameters);
  free(values);
  return span;
}

static void bench_open(struct bench *b, const struct scene *scene, ern_isa isa, int threads) {
  const struct ern_model_config config = {.levels = scene->levels,
                                          .feature_width = 5,
                                          .window_length = 16,
                                          .head = true,
                                          .eye = scene->eye,
                                          .no_view = scene->no_view,
                                          .codes = scene->codes,
                                          .bound = 1};
  const size_t n = is_emulated() && scene->rays > 60 ? 60 : scene->rays;
  *b = (struct bench){.context = support_context(), .scene = scene};
  support_ok(b->context, ern_cpu_backend_make(b->context, isa, &b->backend));
  support_ok(b->context, b->backend->stream_make(b->backend, threads, &b->stream));
  support_ok(b->context, ern_parameters_build(b->context, &config, &b->field, &b->table));
  b->settings = (struct ern_march_settings){.bound = 1, .max_steps = 16, .dt_gamma = 1.0f / 256, .near = 0.05f};
  b->view = (struct ern_view){.pose = {1, 0, 0, scene->height, 0, 0, -1, 3.4f, 0, 1, 0, 0.03f, 0, 0, 0, 1},
                              .focal = 60,
                              .cx = SIDE / 2,
                              .cy = SIDE / 2,
                              .width = SIDE,
                              .height = SIDE};
  ern_span pixel, bits;
  int32_t number[MAX_RAYS];
  uint8_t *cells = malloc(ERN_OCCUPANCY_BYTES);
  assert_non_null(cells);
  memset(cells, (int)scene->cells, ERN_OCCUPANCY_BYTES);
  for (size_t i = 0; i < n; i++) number[i] = (int32_t)((i * 37 + 60) % (SIDE * SIDE));
  support_ok(b->context, ern_take(b->stream, ERN_ELEMENT_INT32, n, &pixel));
  support_ok(b->context, ern_take(b->stream, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &bits));
  support_ok(b->context, b->backend->upload_int32(b->stream, pixel, number, n));
  support_ok(b->context, b->backend->upload_bytes(b->stream, bits, cells, ERN_OCCUPANCY_BYTES));
  free(cells);
  b->args = (struct ern_head_step_args){.parameters = take_values(b),
                                        .field = &b->field,
                                        .view = &b->view,
                                        .settings = &b->settings,
                                        .bits = bits,
                                        .pixel_number = pixel,
                                        .jitter = take_rows(b, 1, n, 0, 0.999f, 1).span,
                                        .truth = take_rows(b, 3, n, 0, 1, 2),
                                        .background = take_rows(b, 3, n, 0, 1, 3),
                                        .face = take_rows(b, 1, n, 0, 1, 4).span,
                                        .windows = take_rows(b, 1, 8 * 16 * 5, -1, 1, 5).span,
                                        .eye_value = 0.4f,
                                        .individual = scene->codes > 0 ? 1 : 0,
                                        .weights = {0.5f, 1, 0.5f, 0.5f, 0.1f, 0.1f, 1e3f, true},
                                        .transmittance_stop = 1e-4f,
                                        .smooth = scene->smooth,
                                        .seed = 9,
                                        .step = 4,
                                        .n = n};
}

static void bench_close(struct bench *b) {
  b->backend->stream_free(b->stream);
  b->backend->free(b->backend);
  ern_context_free(&b->context);
}

/* A step on top of a gradient of zero, or of one that it must add to. */
static void step(struct bench *b, struct result *result) {
  const size_t count = b->field.parameters;
  const struct ern_arena_mark mark = ern_arena_mark(b->stream);
  result->gradient = calloc(count, sizeof(float));
  assert_non_null(result->gradient);
  struct ern_profile profile = {.timed = true};
  b->args.dparameters = take(b, result->gradient, count);
  b->args.profile = &profile;
  support_ok(b->context, b->backend->head_step(b->stream, &b->args));
  support_ok(b->context, b->backend->download_reals(b->stream, result->gradient, b->args.dparameters, count));
  memcpy(result->terms, b->args.terms, sizeof result->terms);
  result->squared_error = b->args.squared_error;
  result->samples = b->args.samples;
  result->counted = profile.count[ERN_PROFILE_COLOURS];
  b->args.profile = NULL;
  ern_arena_release(b->stream, mark);
}

static void run(const struct scene *scene, ern_isa isa, int threads, struct result *result) {
  struct bench b;
  bench_open(&b, scene, isa, threads);
  step(&b, result);
  bench_close(&b);
}

static double distance(const float *a, const float *b, size_t count) {
  double sum = 0;
  for (size_t i = 0; i < count; i++) sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
  return sqrt(sum);
}
static double norm(const float *a, size_t count) {
  double sum = 0;
  for (size_t i = 0; i < count; i++) sum += (double)a[i] * (double)a[i];
  return sqrt(sum);
}

static void compare(const char *isa, const struct scene *scene, const struct result *fused, const struct result *plain,
                    const struct result *truth) {
  struct bench b;
  bench_open(&b, scene, ERN_ISA_REF, 1); /* for its table */
  assert_int_equal(fused->samples, truth->samples);
  for (int t = 0; t < ERN_LOSS_TERMS; t++) {
    const double allowed = FACTOR * fabs(plain->terms[t] - truth->terms[t]) + FLOOR * fabs(truth->terms[t]);
    if (!(fabs(fused->terms[t] - truth->terms[t]) <= allowed))
      fail_msg("%s, %s: term %d is %.9g, expected %.9g", isa, scene->name, t, fused->terms[t], truth->terms[t]);
  }
  assert_true(fabs(fused->squared_error - truth->squared_error) <= 1e-5 * truth->squared_error);
  for (int r = 0; r < b.table.rows; r++) {
    const struct ern_parameter *row = &b.table.row[r];
    const float *expected = truth->gradient + row->at;
    const double size = norm(expected, row->count);
    const double found = distance(fused->gradient + row->at, expected, row->count);
    const double usual = distance(plain->gradient + row->at, expected, row->count);
    const double floor = row->group == ERN_GROUP_AUDIO_ATT ? FLOOR_ATT : FLOOR;
    if (!(found <= FACTOR * usual + floor * size))
      fail_msg("%s, %s: gradient of %s is off by %.2e, the float reference by %.2e", isa, scene->name, row->name,
               found / size, usual / size);
  }
  bench_close(&b);
}

struct fast {
  const char *name;
  machine_isa machine;
  ern_isa isa;
};
static const struct fast fast[] = {
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ERN_ISA_AVX2},
    {"avx512", MACHINE_AVX512, ERN_ISA_AVX512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ERN_ISA_NEON},
#endif
    {"ref", MACHINE_REF, ERN_ISA_REF},
};
enum { FAST = sizeof fast / sizeof *fast };

static void test_step(void **state) {
  (void)state;
  for (int s = 0; s < SCENES; s++) {
    if (left_out(s)) continue;
    struct result truth, plain;
    run(&scenes[s], ERN_ISA_REF64, 2, &truth);
    run(&scenes[s], ERN_ISA_REF, 2, &plain);
    assert_true(scenes[s].cells == 0 || truth.samples > 0);
    for (int k = 0; k < FAST; k++) {
      struct result fused;
      if (!machine_has(fast[k].machine)) continue;
      run(&scenes[s], fast[k].isa, 2, &fused);
      compare(fast[k].name, &scenes[s], &fused, &plain, &truth);
      if (scenes[s].density >= 300 && fast[k].isa != ERN_ISA_REF) {
        print_message("%s: %zu of %zu samples count\n", scenes[s].name, fused.counted, fused.samples);
        assert_true(fused.counted > 0 && 10 * fused.counted < 9 * fused.samples);
      }
      free(fused.gradient);
    }
    free(truth.gradient);
    free(plain.gradient);
  }
}

static void test_threads(void **state) {
  (void)state;
  for (int s = 0; s < SCENES; s++) {
    if (left_out(s)) continue;
    for (int k = 0; k < FAST; k++) {
      struct result one, other;
      if (!machine_has(fast[k].machine)) continue;
      struct bench b;
      bench_open(&b, &scenes[s], fast[k].isa, 1);
      step(&b, &one);
      for (int threads = 2; threads <= 4; threads += 2) {
        run(&scenes[s], fast[k].isa, threads, &other);
        assert_memory_equal(one.gradient, other.gradient, b.field.parameters * sizeof(float));
        assert_memory_equal(one.terms, other.terms, sizeof one.terms);
        free(other.gradient);
      }
      step(&b, &other); /* nothing is left of the first one */
      assert_memory_equal(one.gradient, other.gradient, b.field.parameters * sizeof(float));
      free(other.gradient);
      free(one.gradient);
      bench_close(&b);
    }
  }
}

/* The gradient is added to what is there. */
static void test_accumulates(void **state) {
  (void)state;
  for (int k = 0; k < FAST; k++) {
    struct bench b;
    struct result once;
    if (!machine_has(fast[k].machine)) continue;
    bench_open(&b, &scenes[1], fast[k].isa, 2);
    step(&b, &once);
    const size_t count = b.field.parameters;
    float *twice = calloc(count, sizeof *twice);
    assert_non_null(twice);
    b.args.dparameters = take(&b, twice, count);
    for (int turn = 0; turn < 2; turn++) support_ok(b.context, b.backend->head_step(b.stream, &b.args));
    support_ok(b.context, b.backend->download_reals(b.stream, twice, b.args.dparameters, count));
    for (size_t i = 0; i < count; i++) twice[i] /= 2;
    assert_true(distance(twice, once.gradient, count) <= 1e-6 * norm(once.gradient, count));
    free(twice);
    free(once.gradient);
    bench_close(&b);
  }
}

/* A few rays at a time give the same step, in double to its rounding: sums are made in another order. */
static void test_parts(void **state) {
  (void)state;
  static const size_t at_once[] = {1, 7, 63, 64, 332};
  for (int s = 0; s < SCENES; s++) {
    struct bench b;
    struct result whole;
    if (is_emulated() || (s != 1 && s != 2 && s != 5 && s != 12)) continue;
    bench_open(&b, &scenes[s], ERN_ISA_REF64, 2);
    step(&b, &whole);
    const size_t count = b.field.parameters;
    float *found = calloc(count, sizeof *found);
    assert_non_null(found);
    for (size_t k = 0; k < sizeof at_once / sizeof *at_once; k++) {
      const struct ern_arena_mark mark = ern_arena_mark(b.stream);
      memset(found, 0, count * sizeof *found);
      b.args.dparameters = take(&b, found, count);
      support_ok(b.context, ern_head_step_parts(b.stream, &b.args, at_once[k]));
      support_ok(b.context, b.backend->download_reals(b.stream, found, b.args.dparameters, count));
      ern_arena_release(b.stream, mark);
      assert_int_equal(b.args.samples, whole.samples);
      for (int t = 0; t < ERN_LOSS_TERMS; t++)
        assert_true(fabs(b.args.terms[t] - whole.terms[t]) <= 1e-12 * fabs(whole.terms[t]));
      /* the gradients are compared as floats, half a unit in the last place each */
      for (int r = 0; r < b.table.rows; r++) {
        const struct ern_parameter *row = &b.table.row[r];
        const float *expected = whole.gradient + row->at;
        assert_true(distance(found + row->at, expected, row->count) <= 1e-6 * norm(expected, row->count));
      }
    }
    free(found);
    free(whole.gradient);
    bench_close(&b);
  }
}

/* Densities at n points, some of them outside the cube. */
static void densities(const struct scene *scene, ern_isa isa, int threads, float *sigma, size_t n) {
  struct bench b;
  float code[32];
  ern_span out;
  bench_open(&b, scene, isa, threads);
  for (size_t c = 0; c < 32; c++) code[c] = random_at(8, c, 1);
  support_ok(b.context, ern_take(b.stream, ERN_ELEMENT_REAL, n, &out));
  struct ern_head_density_args args = {.sigma = out,
                                       .x = take_rows(&b, 3, n, -1.02f, 1.02f, 7),
                                       .parameters = b.args.parameters,
                                       .field = &b.field,
                                       .code = take(&b, code, 32),
                                       .eye_value = 0.7f,
                                       .n = n};
  support_ok(b.context, b.backend->head_density(b.stream, &args));
  support_ok(b.context, b.backend->download_reals(b.stream, sigma, out, n));
  bench_close(&b);
}

static void test_densities(void **state) {
  static const size_t sizes[] = {1, 47, 48, 49, 192, 193, 1920, 2000, 5000};
  (void)state;
  for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++) {
    if (left_out((int)k)) continue;
    const size_t n = sizes[k];
    const struct scene *scene = &scenes[k % 5];
    float *truth = calloc(n, sizeof *truth), *plain = calloc(n, sizeof *plain), *fused = calloc(n, sizeof *fused),
          *other = calloc(n, sizeof *other);
    densities(scene, ERN_ISA_REF64, 2, truth, n);
    densities(scene, ERN_ISA_REF, 2, plain, n);
    for (int f = 0; f < FAST; f++) {
      if (!machine_has(fast[f].machine)) continue;
      densities(scene, fast[f].isa, 1, fused, n);
      densities(scene, fast[f].isa, 3, other, n);
      assert_memory_equal(fused, other, n * sizeof *fused);
      for (size_t i = 0; i < n; i++)
        if (!(fabsf(fused[i] - truth[i]) <= 2e-5f * truth[i]))
          fail_msg("%s, %s: density %zu of %zu is %.9g, expected %.9g (float reference %.9g)", fast[f].name,
                   scene->name, i, n, fused[i], truth[i], plain[i]);
    }
    free(truth), free(plain), free(fused), free(other);
  }
}

static void bench_run(void *user) {
  struct bench *b = user;
  support_ok(b->context, b->backend->head_step(b->stream, &b->args));
}

static void bench(void) {
  for (int s = 1; s < SCENES; s += 4) {
    for (int k = 0; k < FAST; k++) {
      struct bench b;
      if (!machine_has(fast[k].machine)) continue;
      bench_open(&b, &scenes[s], fast[k].isa, 1);
      float *zeros = calloc(b.field.parameters, sizeof *zeros);
      b.args.dparameters = take(&b, zeros, b.field.parameters);
      const double seconds = seconds_of(bench_run, &b);
      printf("%-8s %-28s %6.2f ms, %5.2f us a sample, one core\n", fast[k].name, b.scene->name, 1e3 * seconds,
             1e6 * seconds / (double)b.args.samples);
      free(zeros);
      bench_close(&b);
    }
  }
}

int main(int argc, char **argv) {
  if (argc > 1 && strcmp(argv[1], "--bench") == 0) {
    bench();
    return 0;
  }
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_step), cmocka_unit_test(test_threads),
                                     cmocka_unit_test(test_accumulates), cmocka_unit_test(test_parts),
                                     cmocka_unit_test(test_densities)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
