/* SPDX-License-Identifier: MIT
 * The fully connected stacks on an OpenCL device. */
#include "kernelcheck.h"
#include "twin.h"

#include "backend_opencl/opencl.h"

static ern_context *context;
static struct twin twin;

enum { RAYS = 6, FRONT = 5, BACK = 9 };

struct shape {
  const char *name;
  int width[ERN_MLP_MAX_LAYERS + 2]; /* ends with 0 */
  int rows[ERN_MAX_PIECES + 1];      /* ends with 0 */
  ern_per per[ERN_MAX_PIECES];
};

#define SAMPLE ERN_PER_SAMPLE
#define RAY ERN_PER_RAY
#define BATCH ERN_PER_BATCH
static const struct shape shapes[] = {
    {"attention", {42, 64, 32}, {42}, {SAMPLE}},
    {"eye", {42, 16, 1}, {42}, {SAMPLE}},
    {"density", {75, 64, 64, 65}, {42, 32, 1}, {SAMPLE, SAMPLE, SAMPLE}},
    {"density, concat", {75, 64, 64, 65}, {42, 32, 1}, {SAMPLE, BATCH, SAMPLE}},
    {"colour", {84, 64, 3}, {16, 64, 4}, {RAY, SAMPLE, BATCH}},
    {"torso", {116, 32, 32, 4}, {32, 34, 42, 8}, {SAMPLE, SAMPLE, BATCH, BATCH}},
    {"one layer", {7, 5}, {7}, {SAMPLE}},
    {"of width 1", {1, 1, 1}, {1}, {SAMPLE}},
    {"no samples", {5, 9, 2}, {2, 3}, {RAY, BATCH}},
    {"odd", {17, 31, 9, 15, 33, 2}, {3, 8, 1, 5}, {RAY, SAMPLE, BATCH, SAMPLE}},
    {"nine layers", {3, 2, 1, 4, 5, 1, 7, 2, 3, 2}, {1, 2}, {SAMPLE, BATCH}},
    {"of width 256", {256, 256, 256}, {100, 156}, {SAMPLE, SAMPLE}},
    {"trunk", {63, 256, 256, 256, 256}, {63}, {SAMPLE}},
    {"trunk, again", {319, 256, 256, 256, 256, 36}, {63, 256}, {SAMPLE, SAMPLE}},
};
enum { OF_MODEL = 6, ODD = 9, WIDE = 11, DEEP = 12, SHAPES = sizeof shapes / sizeof *shapes };

/* Values that make sums exact whatever their order: small integers, weights of -1 and 1 of which few are there. */
typedef enum values { EXACT, REAL } values;

struct scene {
  struct ern_mlp mlp;
  size_t n, count; /* count: of the parameter block */
  int pieces;
  struct twin_rows x[ERN_MAX_PIECES], dx[ERN_MAX_PIECES], y, dy;
  struct twin_span ray, parameters, dparameters;
};

static size_t items_of(ern_per per, size_t n) { return per == SAMPLE ? n : per == RAY ? RAYS : 1; }

static float integer(uint64_t seed, size_t at, int most) {
  return floorf(twin_random(seed, at, (float)most + 0.5f) + 0.5f);
}

static struct twin_rows rows_of(int rows, size_t n, ern_per per, values kind, uint64_t seed, float scale) {
  const size_t count = (size_t)rows * n;
  float *made = malloc((count + 1) * sizeof *made);
  assert_non_null(made);
  for (size_t i = 0; i < count; i++) made[i] = kind == EXACT ? integer(seed, i, 3) : twin_random(seed, i, scale);
  const struct twin_rows out = twin_rows_of(&twin, made, rows, n, per);
  free(made);
  return out;
}

static void fill_weights(float *to, const struct ern_mlp *mlp, int l, values kind, float scale) {
  const size_t count = (size_t)(mlp->width[l] * mlp->width[l + 1]);
  const float deviation = scale * sqrtf(6.0f / (float)mlp->width[l]), there = 2.0f / (float)mlp->width[l];
  for (size_t i = 0; i < count; i++) {
    const float any = twin_random(40 + (uint64_t)l, i, 1);
    to[i] = kind == REAL ? any * deviation : fabsf(any) > there ? 0 : any < 0 ? -1.0f : 1.0f;
  }
}

static void scene_make(struct scene *scene, const struct shape *shape, size_t n, values kind, float weight_scale,
                       float x_scale) {
  *scene = (struct scene){.n = n};
  size_t at = FRONT;
  for (int l = 0; shape->width[l] != 0; l++) {
    scene->mlp.width[l] = shape->width[l];
    scene->mlp.layers = l;
    if (l == 0) continue;
    scene->mlp.weight[l - 1] = at;
    at += (size_t)(shape->width[l] * shape->width[l - 1]);
  }
  scene->count = at + BACK;
  float *weights = malloc(scene->count * sizeof *weights), *gradient = malloc(scene->count * sizeof *gradient);
  assert_true(weights != NULL && gradient != NULL);
  for (size_t i = 0; i < scene->count; i++)
    weights[i] = TWIN_POISON, gradient[i] = kind == EXACT ? integer(9, i, 5) : 0;
  for (int l = 0; l < scene->mlp.layers; l++)
    fill_weights(weights + scene->mlp.weight[l], &scene->mlp, l, kind, weight_scale);
  scene->parameters = twin_reals(&twin, weights, scene->count);
  scene->dparameters = twin_reals(&twin, gradient, scene->count);
  free(weights), free(gradient);
  for (scene->pieces = 0; shape->rows[scene->pieces] != 0; scene->pieces++) {
    const int p = scene->pieces;
    const size_t items = items_of(shape->per[p], n);
    scene->x[p] = rows_of(shape->rows[p], items, shape->per[p], kind, 50 + (uint64_t)p, x_scale);
    scene->dx[p] = rows_of(shape->rows[p], items, shape->per[p], kind, 60 + (uint64_t)p, 0);
  }
  int32_t *ray = malloc(n * sizeof *ray);
  assert_non_null(ray);
  for (size_t i = 0; i < n; i++) ray[i] = (int32_t)(i * RAYS / n);
  scene->ray = twin_int32s(&twin, ray, n);
  free(ray);
  scene->y = twin_rows_of(&twin, NULL, scene->mlp.width[scene->mlp.layers], n, SAMPLE);
  scene->dy = rows_of(scene->mlp.width[scene->mlp.layers], n, SAMPLE, kind, 70, 1);
}

static void args_of(const struct scene *scene, int k, struct ern_mlp_fwd_args *args) {
  *args = (struct ern_mlp_fwd_args){.y = scene->y.on[k],
                                    .pieces = scene->pieces,
                                    .ray = scene->ray.on[k],
                                    .parameters = scene->parameters.on[k],
                                    .mlp = scene->mlp,
                                    .n = scene->n};
  for (int p = 0; p < scene->pieces; p++) args->x[p] = scene->x[p].on[k];
}

static void run_fwd(const struct scene *scene) {
  struct ern_mlp_fwd_args args[2];
  for (int k = 0; k < 2; k++) args_of(scene, k, &args[k]);
  TWIN_RUN(&twin, mlp_fwd, args)
}

/* wanted: a bit a piece */
static void run_bwd(const struct scene *scene, unsigned wanted) {
  struct ern_mlp_bwd_args args[2] = {{.dparameters = scene->dparameters.on[0], .dy = scene->dy.on[0]},
                                     {.dparameters = scene->dparameters.on[1], .dy = scene->dy.on[1]}};
  for (int k = 0; k < 2; k++) {
    args_of(scene, k, &args[k].forward);
    for (int p = 0; p < scene->pieces; p++)
      if ((wanted >> p & 1) != 0) args[k].dx[p] = scene->dx[p].on[k];
  }
  TWIN_RUN(&twin, mlp_bwd, args)
}

static void same_gradients(const char *what, const struct scene *scene, double relative, double absolute) {
  twin_same(&twin, what, scene->dparameters, relative, absolute);
  for (int p = 0; p < scene->pieces; p++) twin_same_rows(&twin, what, scene->dx[p], relative, absolute);
}

static void check_exact(const struct shape *shape, size_t n, unsigned wanted) {
  struct scene scene;
  scene_make(&scene, shape, n, EXACT, 1, 1);
  run_fwd(&scene);
  twin_same_rows(&twin, shape->name, scene.y, 0, 0);
  run_bwd(&scene, wanted);
  same_gradients(shape->name, &scene, 0, 0);
  twin_clear(&twin);
}

/* PoCL builds a shape for seconds, and layers of width 256 for minutes: every second shape of the model's sizes, with
 * ERNERF_TEST_LONG all. */
static bool is_long(void) {
  const char *text = getenv("ERNERF_TEST_LONG");
  return text != NULL && text[0] != 0;
}

/* All shapes at all sizes, to the bit; gradients of pieces in all combinations. */
static void test_exact(void **state) {
  (void)state;
  const bool cpu = ((struct ern_cl_backend *)twin.backend[1])->device.cpu;
  for (size_t s = 0; s < SHAPES; s++) {
    if ((s >= WIDE || s % 2 == 1) && !is_long()) continue;
    if (s >= DEEP && !cpu) continue;              /* PoCL builds its form for GPUs for minutes */
    const bool large = shapes[s].width[1] == 256; /* up to 500,000 weights: some sizes are enough */
    for (size_t k = large ? TWIN_SIZES - 3 : 0; k < TWIN_SIZES - (large ? 1 : 0); k++)
      check_exact(&shapes[s], twin_sizes[k], 15);
  }
  for (unsigned wanted = 0; wanted < 15; wanted += 5) check_exact(&shapes[ODD], 100, wanted);
  check_exact(&shapes[ODD], 30000, 15); /* several tiles a part */
}

/* A device with little local memory takes smaller tiles. */
static void test_little_memory(void **state) {
  (void)state;
  struct ern_cl_device *device = &((struct ern_cl_backend *)twin.backend[1])->device;
  const size_t all = device->local_bytes;
  for (size_t bytes = 1 << 15; bytes >= 1 << 14; bytes /= 2) {
    device->local_bytes = bytes;
    check_exact(&shapes[ODD], 100, 15);
    if (is_long()) check_exact(&shapes[WIDE], 20, 15);
  }
  device->local_bytes = all;
}

/* Vectors of every length, whatever this processor's. */
static void test_lanes(void **state) {
  (void)state;
  struct ern_cl_device *device = &((struct ern_cl_backend *)twin.backend[1])->device;
  const int own = device->width;
  for (int width = 1; device->cpu && width <= 16; width *= 2) {
    device->width = width;
    if (width != 2) check_exact(&shapes[ODD], 100, 15);
  }
  device->width = own;
}

static void test_none(void **state) {
  (void)state;
  struct scene scene;
  scene_make(&scene, &shapes[3], 1, EXACT, 1, 1);
  scene.n = 0;
  run_fwd(&scene);
  run_bwd(&scene, 15);
  twin_same_rows(&twin, "no samples", scene.y, 0, 0);
  same_gradients("no samples", &scene, 0, 0);
  twin_clear(&twin);
}

/* Sums in another order. With weights of +-sqrt(6/K) and inputs of +-1 partial sums stay within 3 or so, and each of
 * the K <= 116 roundings of a sum is u 3 at most (u = 2^-24), evenly spread: they add up like a random walk to a
 * standard deviation of sqrt(K) u 3/sqrt(3) = 1.1e-6. Two such sums, three layers, four deviations: sqrt(2) sqrt(3)
 * 4 1.1e-6. Gradients are held to their size as a whole, for a unit within an error of 0 may be on here and off there:
 * sums over 1,000 samples of terms that are each 1e-6 off and cancel as the terms do; one flipped unit of 128,000 adds
 * 1e-6. */
static const double output_apart = 1.1e-5, gradient_apart = 2e-6;

static void check_real(const struct shape *shape, size_t n, float weight_scale, float x_scale) {
  struct scene scene;
  scene_make(&scene, shape, n, REAL, weight_scale, x_scale);
  run_fwd(&scene);
  double size = x_scale;
  for (int l = 0; l < scene.mlp.layers; l++) size *= weight_scale;
  twin_same_rows(&twin, shape->name, scene.y, 0, output_apart * size);
  run_bwd(&scene, 15);
  double apart = twin_distance(&twin, scene.dparameters);
  for (int p = 0; p < scene.pieces; p++)
    apart = fmax(apart, twin_distance(&twin, (struct twin_span){{scene.dx[p].on[0].span, scene.dx[p].on[1].span}}));
  if (!(apart <= gradient_apart)) fail_msg("%s: gradients are %g apart", shape->name, apart);
  twin_clear(&twin);
}

static void test_real(void **state) {
  (void)state;
  for (size_t s = 0; s < OF_MODEL; s += is_long() ? 1 : 2) check_real(&shapes[s], 1000, 1, 1);
  static const float scale[][2] = {{0, 1}, {1e10f, 1e3f}, {1e-10f, 1}, {1, 1e-30f}, {1, 1e36f}, {1e4f, 1e-34f}};
  for (size_t k = 0; k < sizeof scale / sizeof *scale; k++) check_real(&shapes[2], 129, scale[k][0], scale[k][1]);
}

/* What is no number, or infinite, comes out as in the reference, and stays with its sample. */
static void test_not_finite(void **state) {
  (void)state;
  static const float special[] = {NAN, INFINITY, -INFINITY};
  for (size_t v = 0; v < 3; v++) {
    struct scene scene;
    scene_make(&scene, &shapes[2], 129, REAL, 1, 1);
    for (int k = 0; k < 2; k++) {
      const ern_rows x = scene.x[0].on[k];
      const ern_span at = ern_span_part(x.span, 3 * x.stride + 49, 1);
      support_ok(context, twin.backend[k]->upload_reals(twin.stream[k], at, &special[v], 1));
    }
    run_fwd(&scene);
    twin_same_rows(&twin, "y", scene.y, 0, output_apart);
    run_bwd(&scene, 15);
    /* sums over 129 samples of slopes and values of a few units */
    same_gradients("gradient", &scene, 0, 129 * output_apart);
    twin_clear(&twin);
  }
}

/* The same call leaves the same bits. */
static void test_again(void **state) {
  (void)state;
  float *first = NULL;
  size_t count = 0;
  for (int turn = 0; turn < 4; turn++) {
    struct scene scene;
    scene_make(&scene, &shapes[3], 20000, REAL, 1, 1);
    struct ern_mlp_bwd_args args = {.dparameters = scene.dparameters.on[1], .dy = scene.dy.on[1]};
    args_of(&scene, 1, &args.forward);
    for (int p = 0; p < scene.pieces; p++) args.dx[p] = scene.dx[p].on[1];
    support_ok(context, twin.backend[1]->mlp_bwd(twin.stream[1], &args));
    float *found = twin_down(&twin, 1, scene.dparameters.on[1]);
    count = scene.count + 2 * TWIN_GUARD;
    if (first != NULL) assert_memory_equal(found, first, count * sizeof *first);
    free(first);
    first = found;
    twin_clear(&twin);
  }
  free(first);
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

/* ---- --bench: the CPU's best kernels and the device in turns, in one process ------------------------------------- */

struct bench {
  ern_backend *backend[2];
  struct ern_stream *stream[2];
  struct ern_mlp_bwd_args args[2];
  bool backward;
  int k;
};

static void bench_run(void *user) {
  struct bench *bench = user;
  const int k = bench->k;
  struct ern_backend *backend = bench->backend[k];
  if (bench->backward)
    support_ok(context, backend->mlp_bwd(bench->stream[k], &bench->args[k]));
  else
    support_ok(context, backend->mlp_fwd(bench->stream[k], &bench->args[k].forward));
  /* in-order queue: waits for all */
  float one = 0;
  support_ok(context, backend->download_reals(bench->stream[k], &one, bench->args[k].dparameters, 1));
}

static ern_rows bench_rows(struct bench *bench, int k, int rows, size_t n, ern_per per) {
  ern_rows out;
  const size_t items = items_of(per, n);
  support_ok(context, ern_take_rows(bench->stream[k], rows, items, &out));
  float *made = malloc((size_t)rows * out.stride * sizeof *made);
  assert_non_null(made);
  twin_fill(made, (size_t)rows * out.stride, 3, 1);
  support_ok(context, bench->backend[k]->upload_reals(bench->stream[k], out.span, made, (size_t)rows * out.stride));
  free(made);
  out.per = per;
  return out;
}

static void bench_args(struct bench *bench, int k, const struct shape *shape, size_t n) {
  struct ern_mlp_fwd_args f = {.n = n};
  size_t count = 0;
  for (int l = 0; shape->width[l] != 0; l++) {
    f.mlp.width[l] = shape->width[l];
    f.mlp.layers = l;
    if (l == 0) continue;
    f.mlp.weight[l - 1] = count;
    count += (size_t)(shape->width[l] * shape->width[l - 1]);
  }
  const ern_rows weights = bench_rows(bench, k, 1, count, SAMPLE);
  f.parameters = weights.span;
  int32_t *ray = malloc(n * sizeof *ray);
  assert_non_null(ray);
  for (size_t i = 0; i < n; i++) ray[i] = (int32_t)(i * RAYS / n);
  support_ok(context, ern_take(bench->stream[k], ERN_ELEMENT_INT32, n, &f.ray));
  support_ok(context, bench->backend[k]->upload_int32(bench->stream[k], f.ray, ray, n));
  free(ray);
  bench->args[k] = (struct ern_mlp_bwd_args){.dparameters = bench_rows(bench, k, 1, count, SAMPLE).span};
  for (; shape->rows[f.pieces] != 0; f.pieces++) {
    f.x[f.pieces] = bench_rows(bench, k, shape->rows[f.pieces], n, shape->per[f.pieces]);
    bench->args[k].dx[f.pieces] = bench_rows(bench, k, shape->rows[f.pieces], n, shape->per[f.pieces]);
  }
  f.y = bench_rows(bench, k, f.mlp.width[f.mlp.layers], n, SAMPLE);
  bench->args[k].dy = bench_rows(bench, k, f.mlp.width[f.mlp.layers], n, SAMPLE);
  bench->args[k].forward = f;
}

/* Operations as needed: forward 2 a weight; backward 4 a weight, and 2 for those of the hidden layers again. */
static double operations(const struct ern_mlp *mlp, size_t n, bool backward) {
  double all = 0, hidden = 0;
  for (int l = 0; l < mlp->layers; l++) {
    const double weights = (double)mlp->width[l] * mlp->width[l + 1];
    all += weights;
    if (l + 1 < mlp->layers) hidden += weights;
  }
  return (double)n * (backward ? 4 * all + 2 * hidden : 2 * all);
}

/* Seconds of all threads of the process. */
static double seconds_used(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* The least time of one call: on the clock, and used by all threads, which other programs disturb less. */
static void time_call(struct bench *bench, int times, double best[2]) {
  const double used = seconds_used(), clock = seconds_now();
  for (int i = 0; i < times; i++) bench_run(bench);
  best[0] = fmin(best[0], (seconds_now() - clock) / times);
  best[1] = fmin(best[1], (seconds_used() - used) / times);
}

static void measure_shape(struct bench *bench, const struct shape *shape, size_t n) {
  struct ern_arena_mark marks[2];
  for (int k = 0; k < 2; k++) {
    marks[k] = ern_arena_mark(bench->stream[k]);
    bench_args(bench, k, shape, n);
  }
  for (int backward = 0; backward < 2; backward++) {
    double best[2][2] = {{INFINITY, INFINITY}, {INFINITY, INFINITY}};
    bench->backward = backward != 0;
    for (bench->k = 0; bench->k < 2; bench->k++) bench_run(bench); /* builds the program */
    for (int repeat = 0; repeat < 20; repeat++) {
      bench->k = repeat % 2;
      time_call(bench, n < 10000 ? 10 : 1, best[bench->k]);
    }
    const double work = operations(&bench->args[0].forward.mlp, n, bench->backward) * 1e-9;
    printf("%-16s n = %6zu %s: GFLOP/s of one core: CPU %6.1f, device %6.1f; on the clock: CPU %6.1f, device %6.1f\n",
           shape->name, n, backward ? "backward" : "forward ", work / best[0][1], work / best[1][1], work / best[0][0],
           work / best[1][0]);
  }
  for (int k = 0; k < 2; k++) ern_arena_release(bench->stream[k], marks[k]);
}

static int measure(void) {
  static const size_t sizes[] = {5000, 65536, 183000};
  struct bench bench = {.k = 0};
  const char *const names[] = {"cpu", "opencl"};
  context = support_context();
  for (int k = 0; k < 2; k++) {
    ern_backend_config config = ern_backend_config_default();
    config.name = names[k];
    support_ok(context, ern_backend_create(&bench.backend[k], context, &config));
    support_ok(context, bench.backend[k]->stream_make(bench.backend[k], 2, &bench.stream[k]));
    printf("%s: %s\n", bench.backend[k]->name, bench.backend[k]->isa);
  }
  for (size_t s = 0; s < 5; s++)
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) measure_shape(&bench, &shapes[s], sizes[i]);
  for (int k = 0; k < 2; k++) {
    bench.backend[k]->stream_free(bench.stream[k]);
    ern_backend_free(&bench.backend[k]);
  }
  ern_context_free(&context);
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) return measure();
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_exact), cmocka_unit_test(test_little_memory),
                                     cmocka_unit_test(test_lanes), cmocka_unit_test(test_none),
                                     cmocka_unit_test(test_real),  cmocka_unit_test(test_not_finite),
                                     cmocka_unit_test(test_again)};
  return cmocka_run_group_tests_name("opencl mlp", tests, set_up, tear_down);
}
