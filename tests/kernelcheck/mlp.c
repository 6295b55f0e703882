/* SPDX-License-Identifier: MIT
 * The fully connected stacks: to the bit where sums are exact, to rounding elsewhere. */
#include "harness.h"

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
    {"attention of one", {32, 64, 1}, {32}, {SAMPLE}},
    {"eye, 36 levels", {36, 16, 1}, {36}, {SAMPLE}},
    {"odd, 3 pieces", {17, 31, 9, 15, 2}, {3, 13, 1}, {RAY, SAMPLE, BATCH}},
    {"trunk", {63, 256, 256, 256, 256}, {63}, {SAMPLE}},
    {"trunk, again", {319, 256, 256, 256, 256, 36}, {63, 256}, {SAMPLE, SAMPLE}},
};
enum {
  ATTENTION = 0,
  DENSITY = 2,
  CONCAT = 3,
  OF_MODEL = 6,
  ODD = 9,
  WIDE = 11,
  OF_CPUS = 12,
  DEEP = 15,
  SHAPES = COUNT_OF(shapes)
};

/* Values that make sums exact whatever their order: small integers, weights of -1 and 1 of which few are there. */
typedef enum values { EXACT, REAL } values;

struct scene {
  struct ern_mlp mlp;
  size_t shape, n, count; /* count: of the parameter block */
  int pieces;
  struct many_rows x[ERN_MAX_PIECES], dx[ERN_MAX_PIECES], y, dy;
  struct many ray, parameters, dparameters;
};

static size_t items_of(ern_per per, size_t n) { return per == SAMPLE ? n : per == RAY ? RAYS : 1; }

static float integer(uint64_t seed, size_t at, int most) {
  return floorf(random_at(seed, at, (float)most + 0.5f) + 0.5f);
}

static struct many_rows rows_of(int rows, size_t n, ern_per per, values kind, uint64_t seed, float scale) {
  const size_t count = (size_t)rows * n;
  float *made = floats(count);
  for (size_t i = 0; i < count; i++) made[i] = kind == EXACT ? integer(seed, i, 3) : random_at(seed, i, scale);
  return many_strided(made, rows, n, per);
}

static void fill_weights(float *to, const struct ern_mlp *mlp, int l, values kind, float scale) {
  const size_t count = (size_t)(mlp->width[l] * mlp->width[l + 1]);
  const float deviation = scale * sqrtf(6.0f / (float)mlp->width[l]), there = 2.0f / (float)mlp->width[l];
  for (size_t i = 0; i < count; i++) {
    const float any = random_at(40 + (uint64_t)l, i, 1);
    to[i] = kind == REAL ? any * deviation : fabsf(any) > there ? 0 : any < 0 ? -1.0f : 1.0f;
  }
}

static void scene_make(struct scene *scene, size_t number, size_t n, values kind, float weight_scale, float x_scale) {
  const struct shape *shape = &shapes[number];
  *scene = (struct scene){.shape = number, .n = n};
  size_t at = FRONT;
  for (int l = 0; shape->width[l] != 0; l++) {
    scene->mlp.width[l] = shape->width[l];
    scene->mlp.layers = l;
    if (l == 0) continue;
    scene->mlp.weight[l - 1] = at;
    at += (size_t)(shape->width[l] * shape->width[l - 1]);
  }
  scene->count = at + BACK;
  float *weights = floats(scene->count), *gradient = floats(scene->count);
  for (size_t i = 0; i < scene->count; i++)
    weights[i] = machines_poison(), gradient[i] = kind == EXACT ? integer(9, i, 5) : 0;
  for (int l = 0; l < scene->mlp.layers; l++)
    fill_weights(weights + scene->mlp.weight[l], &scene->mlp, l, kind, weight_scale);
  scene->parameters = many_reals(weights, scene->count);
  scene->dparameters = many_reals(gradient, scene->count);
  for (scene->pieces = 0; shape->rows[scene->pieces] != 0; scene->pieces++) {
    const int p = scene->pieces;
    const size_t items = items_of(shape->per[p], n);
    scene->x[p] = rows_of(shape->rows[p], items, shape->per[p], kind, 50 + (uint64_t)p, x_scale);
    scene->dx[p] = rows_of(shape->rows[p], items, shape->per[p], kind, 60 + (uint64_t)p, 0);
  }
  int32_t *ray = held_memory(n, sizeof *ray);
  for (size_t i = 0; i < n; i++) ray[i] = (int32_t)(i * RAYS / n);
  scene->ray = many_int32s(ray, n);
  scene->y = many_strided(NULL, scene->mlp.width[scene->mlp.layers], n, SAMPLE);
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

/* PoCL builds a shape for seconds, and layers of width 256 for minutes: on a device two of eight shapes, with
 * ERNERF_TEST_LONG all; three shapes on the CPU alone. */
static bool is_run(int k, size_t s) {
  if (!is_device(k)) return true;
  if (!is_long() && (s >= WIDE || (s % 8 != ATTENTION && s % 8 != DENSITY))) return false;
  return s < OF_CPUS || (s >= DEEP && compiles_for_cpus(k)); /* PoCL builds its form for GPUs for minutes */
}
static bool is_run_here(size_t s) {
  bool any = false;
  EACH_OTHER (k) any = any || is_run(k, s);
  return any;
}

static void run_fwd(const struct scene *scene) {
  EACH_MACHINE (k) {
    struct ern_mlp_fwd_args args;
    if (!is_run(k, scene->shape)) continue;
    args_of(scene, k, &args);
    RUN_ON(k, mlp_fwd, &args);
  }
}

/* wanted: a bit a piece */
static void run_bwd_on(int k, const struct scene *scene, struct many dparameters, unsigned wanted) {
  struct ern_mlp_bwd_args args = {.dparameters = dparameters.on[k], .dy = scene->dy.on[k]};
  if (!is_run(k, scene->shape)) return;
  args_of(scene, k, &args.forward);
  for (int p = 0; p < scene->pieces; p++)
    if ((wanted >> p & 1) != 0) args.dx[p] = scene->dx[p].on[k];
  RUN_ON(k, mlp_bwd, &args);
}
static void run_bwd(const struct scene *scene, unsigned wanted) {
  EACH_MACHINE (k) run_bwd_on(k, scene, scene->dparameters, wanted);
}

static void same_outputs(const struct scene *scene, double absolute) {
  EACH_OTHER (k)
    if (is_run(k, scene->shape)) expect_near_on(k, shapes[scene->shape].name, of_rows(scene->y), 0, absolute);
}
static void same_gradients(const struct scene *scene, double absolute) {
  const char *name = shapes[scene->shape].name;
  EACH_OTHER (k) {
    if (!is_run(k, scene->shape)) continue;
    expect_near_on(k, name, scene->dparameters, 0, absolute);
    for (int p = 0; p < scene->pieces; p++) expect_near_on(k, name, of_rows(scene->dx[p]), 0, absolute);
  }
}

static void check_exact(size_t shape, size_t n, unsigned wanted) {
  struct scene scene;
  scene_make(&scene, shape, n, EXACT, 1, 1);
  run_fwd(&scene);
  same_outputs(&scene, 0);
  run_bwd(&scene, wanted);
  same_gradients(&scene, 0);
  machines_clear();
}

/* Shapes at sizes, to the bit; gradients of pieces in all combinations. */
static void test_exact(void **state) {
  (void)state;
  for (size_t s = 0; s < SHAPES; s++) {
    const bool large = shapes[s].width[1] == 256; /* up to 500,000 weights: some sizes are enough */
    for (size_t i = large ? size_count() - 3 : 0; is_run_here(s) && i < size_count() - (large ? 1 : 0); i++)
      if ((s + i) % one_of() == 0) check_exact(s, test_sizes[i], 15);
  }
  for (unsigned wanted = 0; wanted < 15; wanted += 5) check_exact(ODD, 100, wanted);
  check_exact(ODD, is_small() || is_emulated() ? 1000 : 30000, 15); /* several tiles a part */
}

/* A device with little local memory takes smaller tiles. */
static void test_little_memory(void **state) {
  (void)state;
  for (size_t bytes = 1 << 15; bytes >= 1 << 14; bytes /= 2) {
    size_t own[MACHINES] = {0};
    EACH_OTHER (k)
      if (is_device(k)) own[k] = set_local_bytes(k, bytes);
    check_exact(ODD, 100, 15);
    if (is_long()) check_exact(WIDE, 20, 15);
    EACH_OTHER (k)
      if (is_device(k)) set_local_bytes(k, own[k]);
  }
}

/* Vectors of every length, whatever this processor's. */
static void test_lanes(void **state) {
  (void)state;
  for (int width = 1; width <= 16; width *= 2) {
    int own[MACHINES] = {0};
    EACH_OTHER (k)
      if (compiles_for_cpus(k)) own[k] = set_vector_width(k, width);
    if (width != 2) check_exact(ODD, 100, 15);
    EACH_OTHER (k)
      if (compiles_for_cpus(k)) set_vector_width(k, own[k]);
  }
}

static void test_none(void **state) {
  (void)state;
  struct scene scene;
  scene_make(&scene, DENSITY, 1, EXACT, 1, 1);
  scene.n = 0;
  run_fwd(&scene);
  run_bwd(&scene, 15);
  same_outputs(&scene, 0);
  same_gradients(&scene, 0);
  machines_clear();
}

/* The same call leaves the same bits. */
static void test_again(void **state) {
  (void)state;
  struct scene scene;
  scene_make(&scene, DENSITY, is_small() || is_emulated() ? 300 : 20000, REAL, 1, 1);
  const float *zeros = floats(scene.count);
  EACH_OTHER (k) {
    const float *first = NULL;
    for (int turn = 0; turn < (is_device(k) ? 4 : 2); turn++) {
      machines_fill(k, scene.dparameters.on[k], zeros, ERN_ELEMENT_REAL);
      run_bwd_on(k, &scene, scene.dparameters, 15);
      const float *found = floats_of(k, scene.dparameters);
      if (first != NULL) assert_memory_equal(found, first, scene.count * sizeof *first);
      first = found;
    }
  }
  machines_clear();
}

/* Unwanted gradients are not written, and the weights' do not change for it. */
static void test_unwanted(void **state) {
  (void)state;
  struct scene scene;
  scene_make(&scene, DENSITY, 70, REAL, 1, 1);
  const float *zeros = floats(scene.count);
  const struct many some = many_reals(zeros, scene.count), none = many_reals(zeros, scene.count);
  machines_fill(0, scene.dparameters.on[0], zeros, ERN_ELEMENT_REAL);
  EACH_MACHINE (k) {
    run_bwd_on(k, &scene, scene.dparameters, 15);
    const float *all = floats_of(k, scene.dparameters), *before = floats_of(k, of_rows(scene.dx[0]));
    run_bwd_on(k, &scene, some, 2);
    run_bwd_on(k, &scene, none, 0);
    assert_memory_equal(floats_of(k, some), all, scene.count * sizeof *all);
    assert_memory_equal(floats_of(k, none), all, scene.count * sizeof *all);
    assert_memory_equal(floats_of(k, of_rows(scene.dx[0])), before, scene.dx[0].on[k].span.count * sizeof *all);
  }
  machines_clear();
}

/* The same input gives the same output wherever in a tile it lies. */
static void test_place(void **state) {
  (void)state;
  enum { N = 101 };
  struct scene scene;
  scene_make(&scene, ATTENTION, N, REAL, 1, 1);
  for (size_t r = 0; r < 42; r++) {
    float row[N];
    for (size_t i = 0; i < N; i++) row[i] = random_at(3, r, 1);
    many_set(of_rows(scene.x[0]), r * scene.x[0].on[0].stride, row, N);
  }
  run_fwd(&scene);
  EACH_MACHINE (k) {
    const float *y = floats_of(k, of_rows(scene.y));
    const size_t stride = scene.y.on[k].stride;
    for (size_t j = 0; j < 32; j++)
      for (size_t i = 1; i < N; i++) assert_memory_equal(&y[j * stride + i], &y[j * stride], sizeof *y);
  }
  machines_clear();
}

/* ---- bounds along the data, and the reference against the equations ---- */

/* How far two float evaluations in different orders may be apart, by an error analysis in double along the data.
 * Rounding errors are independent, so they add like a random walk: a sum of K products, in any order, fused or not, is
 * off by about sqrt(K) u sum|a b| / sqrt(3) at most, where all have one sign (u = 2^-24). Two kernels, and four
 * standard deviations with it, make 4 sqrt(K) u sum|a b|. The errors e of the factors are carried as sqrt(sum (w e)^2).
 * This holds away from the ReLU's kink alone: see leave_kinks. */
struct bound {
  double *h[ERN_MLP_MAX_LAYERS + 1], *e[ERN_MLP_MAX_LAYERS + 1]; /* [width][n]: values before the ReLU, errors */
  double *dw, *dw_error;                                         /* the block */
  double *dx, *dx_error;                                         /* [width 0][n] */
};

static double *doubles(size_t count) { return held_memory(count, sizeof(double)); }

static const double unit = 0x1p-24, tiny = 0x1p-140; /* tiny: a few denormals */
static double square(double x) { return x * x; }
static double rounding(size_t terms, double absolute) { return 4 * sqrt((double)terms) * unit * absolute; }

/* Value i of layer l behind its ReLU, and its error: a unit that is off has none. */
static double value_at(const struct bound *bound, int l, size_t i) {
  return l > 0 && bound->h[l][i] < 0 ? 0 : bound->h[l][i];
}
static double error_at(const struct bound *bound, int l, size_t i) {
  return l > 0 && bound->h[l][i] < -bound->e[l][i] ? 0 : bound->e[l][i];
}

static void bound_fwd(struct bound *bound, const struct scene *scene) {
  const struct ern_mlp *mlp = &scene->mlp;
  const float *parameters = floats_of(0, scene->parameters), *x_of[ERN_MAX_PIECES];
  for (int p = 0; p < scene->pieces; p++) x_of[p] = floats_of(0, of_rows(scene->x[p]));
  const size_t n = scene->n;
  for (int l = 0; l <= mlp->layers; l++) {
    bound->h[l] = doubles((size_t)mlp->width[l] * n);
    bound->e[l] = doubles((size_t)mlp->width[l] * n);
  }
  size_t k = 0;
  for (int p = 0; p < scene->pieces; p++) {
    const ern_rows *x = &scene->x[p].on[0];
    for (size_t r = 0; r < (size_t)x->rows; r++, k++) {
      for (size_t i = 0; i < n; i++) {
        const size_t at = x->per == ERN_PER_SAMPLE ? i : x->per == ERN_PER_RAY ? i * RAYS / n : 0;
        bound->h[0][k * n + i] = (double)x_of[p][r * x->stride + at];
      }
    }
  }
  for (int l = 0; l < mlp->layers; l++) {
    const size_t ins = (size_t)mlp->width[l], outs = (size_t)mlp->width[l + 1];
    for (size_t j = 0; j < outs; j++) {
      for (size_t i = 0; i < n; i++) {
        double sum = 0, absolute = 0, carried = 0;
        for (size_t c = 0; c < ins; c++) {
          const double w = (double)parameters[mlp->weight[l] + j * ins + c];
          const double h = value_at(bound, l, c * n + i);
          sum += w * h;
          absolute += fabs(w * h);
          carried += square(w * error_at(bound, l, c * n + i));
        }
        bound->h[l + 1][j * n + i] = sum;
        bound->e[l + 1][j * n + i] = sqrt(carried) + rounding(ins, absolute) + (absolute > 0 ? tiny : 0);
      }
    }
  }
}

/* A unit whose error reaches across 0 may be on in one kernel and off in the other, and then its whole gradient is
 * error in all that it is added to. So samples that have such a unit get no gradient; most must be left. Sums of zeros
 * are exact. */
static void leave_kinks(const struct scene *scene, const struct bound *bound) {
  const struct many dy = of_rows(scene->dy);
  const size_t n = scene->n, stride = scene->dy.on[0].stride, count = dy.on[0].count;
  float *gradients = floats(count);
  size_t left = n;
  memcpy(gradients, floats_of(0, dy), count * sizeof *gradients);
  for (size_t i = 0; i < n; i++) {
    bool kink = false;
    for (int l = 1; l < scene->mlp.layers; l++)
      for (size_t j = 0; j < (size_t)scene->mlp.width[l]; j++)
        kink = kink || (bound->e[l][j * n + i] > 0 && fabs(bound->h[l][j * n + i]) <= bound->e[l][j * n + i]);
    for (size_t j = 0; kink && j < (size_t)scene->mlp.width[scene->mlp.layers]; j++) gradients[j * stride + i] = 0;
    left -= kink;
  }
  if (n >= 16 && 2 * left < n) fail_msg("%s: of %zu samples %zu are left", shapes[scene->shape].name, n, left);
  many_set(dy, 0, gradients, count);
}

static void bound_bwd(struct bound *bound, const struct scene *scene) {
  const struct ern_mlp *mlp = &scene->mlp;
  const float *parameters = floats_of(0, scene->parameters), *dy = floats_of(0, of_rows(scene->dy));
  const size_t n = scene->n, last = (size_t)mlp->width[mlp->layers];
  bound->dw = doubles(scene->count);
  bound->dw_error = doubles(scene->count);
  double *gradient = doubles(last * n), *error = doubles(last * n);
  for (size_t i = 0; i < last * n; i++) gradient[i] = (double)dy[i / n * scene->dy.on[0].stride + i % n];
  for (int l = mlp->layers - 1; l >= 0; l--) {
    const size_t ins = (size_t)mlp->width[l], outs = (size_t)mlp->width[l + 1];
    double *next = doubles(ins * n), *next_error = doubles(ins * n), *next_absolute = doubles(ins * n);
    for (size_t j = 0; j < outs; j++) {
      for (size_t c = 0; c < ins; c++) {
        const size_t at = mlp->weight[l] + j * ins + c;
        const double w = (double)parameters[at];
        double sum = 0, absolute = 0, carried = 0;
        for (size_t i = 0; i < n; i++) {
          const double h = value_at(bound, l, c * n + i), s = gradient[j * n + i];
          sum += s * h;
          absolute += fabs(s * h);
          carried += square(s * error_at(bound, l, c * n + i)) + square(error[j * n + i] * h);
          next[c * n + i] += w * s;
          next_absolute[c * n + i] += fabs(w * s);
          next_error[c * n + i] += square(w * error[j * n + i]);
        }
        bound->dw[at] = sum;
        bound->dw_error[at] = sqrt(carried) + rounding(n + 1, absolute) + tiny;
      }
    }
    for (size_t i = 0; i < ins * n; i++) {
      next_error[i] = sqrt(next_error[i]) + rounding(outs, next_absolute[i]) + tiny;
      if (l > 0 && bound->h[l][i] <= 0) next[i] = next_error[i] = 0;
    }
    gradient = next;
    error = next_error;
  }
  bound->dx = gradient;
  bound->dx_error = error;
}

static void expect_bound(int k, size_t shape, const char *what, double found, double expected, double tolerance,
                         size_t at) {
  if (fabs(found - expected) <= tolerance || (isnan(found) && isnan(expected))) return;
  fail_msg("%s: %s %s [%zu]: %.9g, expected %.9g +- %.1e", machines.name[k], shapes[shape].name, what, at, found,
           expected, tolerance);
}

static void compare_outputs(const struct scene *scene, const struct bound *bound, int k) {
  const size_t n = scene->n, outs = (size_t)scene->mlp.width[scene->mlp.layers], stride = scene->y.on[0].stride;
  const float *y = floats_of(k, of_rows(scene->y)), *expected = floats_of(0, of_rows(scene->y));
  const float *dw = floats_of(k, scene->dparameters), *dw_expected = floats_of(0, scene->dparameters);
  const double *h = bound->h[scene->mlp.layers], *e = bound->e[scene->mlp.layers];
  for (size_t at = 0; at < outs * stride; at++) {
    const size_t b = at / stride * n + at % stride;
    if (at % stride >= n) {
      assert_true(is_poison(y[at]));
      continue;
    }
    expect_bound(k, scene->shape, "y", (double)y[at], k == 0 ? h[b] : (double)expected[at], e[b], at);
  }
  for (size_t i = 0; i < scene->count; i++) {
    const bool inside = i >= FRONT && i < scene->count - BACK;
    expect_bound(k, scene->shape, "dW", (double)dw[i], k == 0 ? bound->dw[i] : (double)dw_expected[i],
                 inside ? bound->dw_error[i] : 0, i);
  }
}

/* Machine k against the reference; the reference against the equations in double. */
static void compare(const struct scene *scene, const struct bound *bound, int k) {
  const size_t n = scene->n;
  size_t row = 0;
  compare_outputs(scene, bound, k);
  for (int p = 0; p < scene->pieces; p++) {
    const ern_rows *x = &scene->x[p].on[0];
    const float *found = floats_of(k, of_rows(scene->dx[p])), *expected = floats_of(0, of_rows(scene->dx[p]));
    for (size_t r = 0; r < (size_t)x->rows; r++, row++) {
      double sum = 0, absolute = 0, error = 0;
      for (size_t i = 0; i < n; i++) {
        const double dx = bound->dx[row * n + i], dx_error = bound->dx_error[row * n + i];
        const size_t at = r * x->stride + i;
        sum += dx;
        absolute += fabs(dx);
        error += square(dx_error);
        if (x->per == SAMPLE)
          expect_bound(k, scene->shape, "dx", (double)found[at], k == 0 ? dx : (double)expected[at],
                       dx_error + rounding(2, fabs(dx)), at);
      }
      if (x->per == SAMPLE) continue;
      double tolerance = sqrt(error) + rounding(n + 1, absolute);
      if (x->per == RAY) sum = tolerance = 0; /* no gradient: what was there, exactly */
      for (size_t i = 0; i < items_of(x->per, n); i++) {
        const size_t at = r * x->stride + i;
        expect_bound(k, scene->shape, "dx", (double)found[at], k == 0 ? sum : (double)expected[at], tolerance, at);
      }
    }
  }
}

static void check_bounds(size_t shape, size_t n, float weight_scale, float x_scale) {
  struct scene scene;
  struct bound bound;
  scene_make(&scene, shape, n, REAL, weight_scale, x_scale);
  bound_fwd(&bound, &scene);
  leave_kinks(&scene, &bound);
  bound_bwd(&bound, &scene);
  run_fwd(&scene);
  run_bwd(&scene, 15);
  EACH_MACHINE (k)
    if (is_run(k, shape)) compare(&scene, &bound, k);
  machines_clear();
}

/* Sizes around the lanes of every instruction set and around a tile of 48. */
static void test_bounds(void **state) {
  (void)state;
  static const size_t sizes[] = {1, 7, 8, 9, 15, 16, 17, 47, 48, 49, 95, 97, 333};
  static const float scale[][2] = {{0, 1}, {1e10f, 1e3f}, {1e-10f, 1}, {1, 1e-30f}, {1e4f, 1e-38f}};
  for (size_t s = 0; s < SHAPES; s++) {
    const size_t most = shapes[s].width[1] == 256 ? 3 : is_small() ? 10 : COUNT_OF(sizes); /* 300,000 weights: some */
    for (size_t i = 0; is_run_here(s) && i < most; i++)
      if ((s + i) % one_of() == 0) check_bounds(s, sizes[i], 1, 1);
  }
  /* everything stays finite, nothing is lost in the order of sums; a device may take denormals as zeros */
  for (size_t i = 0; i < COUNT_OF(scale); i++)
    if (scale[i][1] >= FLT_MIN || !is_device(machines.count - 1)) check_bounds(DENSITY, 50, scale[i][0], scale[i][1]);
}

/* ---- sums in another order, to what data of this size leave ---- */

/* With weights of +-sqrt(6/K) and inputs of +-1 partial sums stay within 3 or so, and each of the K <= 116 roundings of
 * a sum is u 3 at most (u = 2^-24), evenly spread: they add up like a random walk to a standard deviation of sqrt(K) u
 * 3/sqrt(3) = 1.1e-6. Two such sums, three layers, four deviations: sqrt(2) sqrt(3) 4 1.1e-6. Gradients are sums over
 * samples of terms that are each 1e-6 off and cancel as the terms do: they are held to their size as a whole. */
static const double output_apart = 1.1e-5, gradient_apart = 2e-6;

static void check_real(size_t shape, size_t n, float weight_scale, float x_scale) {
  struct scene scene;
  struct bound bound;
  scene_make(&scene, shape, n, REAL, weight_scale, x_scale);
  bound_fwd(&bound, &scene);
  leave_kinks(&scene, &bound);
  run_fwd(&scene);
  double size = (double)x_scale;
  for (int l = 0; l < scene.mlp.layers; l++) size *= (double)weight_scale;
  same_outputs(&scene, output_apart * size);
  run_bwd(&scene, 15);
  EACH_OTHER (k) {
    if (!is_run(k, shape)) continue;
    double apart = distance_of(k, scene.dparameters);
    for (int p = 0; p < scene.pieces; p++) apart = fmax(apart, distance_of(k, of_rows(scene.dx[p])));
    if (!(apart <= gradient_apart))
      fail_msg("%s: %s: gradients are %g apart", machines.name[k], shapes[shape].name, apart);
  }
  machines_clear();
}

static void test_real(void **state) {
  (void)state;
  static const float scale[][2] = {{0, 1}, {1e10f, 1e3f}, {1e-10f, 1}, {1, 1e-30f}, {1, 1e36f}, {1e4f, 1e-34f}};
  for (size_t s = 0; s < OF_MODEL; s++)
    if (is_run_here(s)) check_real(s, is_small() ? 33 : is_gpu(machines.count - 1) ? 5000 : 1000, 1, 1);
  for (size_t i = 0; i < COUNT_OF(scale); i++) check_real(DENSITY, 129, scale[i][0], scale[i][1]);
}

/* What is no number, or infinite, comes out as in the reference, and stays with its sample. */
static void test_not_finite(void **state) {
  (void)state;
  static const float special[] = {NAN, INFINITY, -INFINITY};
  for (size_t v = 0; v < 3; v++) {
    struct scene scene;
    struct bound bound;
    scene_make(&scene, DENSITY, 129, REAL, 1, 1);
    bound_fwd(&bound, &scene);
    leave_kinks(&scene, &bound);
    many_set(of_rows(scene.x[0]), 3 * scene.x[0].on[0].stride + 49, &special[v], 1);
    run_fwd(&scene);
    same_outputs(&scene, output_apart);
    run_bwd(&scene, 15);
    /* sums over 129 samples of gradients and values of a few units */
    same_gradients(&scene, 129 * output_apart);
    EACH_MACHINE (k) {
      const float *y = floats_of(k, of_rows(scene.y)), *dw = floats_of(k, scene.dparameters);
      const float *dx = floats_of(k, of_rows(scene.dx[0]));
      for (size_t j = 0; v == 0 && j < 65; j++)
        for (size_t i = 0; i < 129; i++) assert_true(isnan(y[j * scene.y.on[k].stride + i]) == (i == 49));
      for (size_t i = 0; v == 0 && i < 64 * 65; i++) assert_true(isnan(dw[scene.mlp.weight[2] + i]));
      for (size_t i = 0; i < 49; i++) assert_true(isfinite(dx[i]));
    }
    machines_clear();
  }
}

/* By multiply-add. */
static void bench(void) {
  static const size_t sizes[] = {96, 4096, 65536};
  for (size_t s = 0; s < 5; s++) {
    for (size_t i = 0; i < COUNT_OF(sizes); i++) {
      struct scene scene;
      struct ern_mlp_fwd_args forward[MACHINES];
      struct ern_mlp_bwd_args backward[MACHINES];
      scene_make(&scene, s, sizes[i], REAL, 1, 1);
      EACH_MACHINE (k) {
        args_of(&scene, k, &forward[k]);
        backward[k] = (struct ern_mlp_bwd_args){
            .dparameters = scene.dparameters.on[k], .dy = scene.dy.on[k], .forward = forward[k]};
        for (int p = 0; p < scene.pieces; p++) backward[k].dx[p] = scene.dx[p].on[k];
      }
      printf("%s, %zu samples, by multiply-add\n", shapes[s].name, sizes[i]);
      const double n = (double)sizes[i], there = n * products_of(&scene.mlp, false);
      const double back = n * products_of(&scene.mlp, true);
      BENCH_PRODUCTS("forward", there, there, mlp_fwd, forward);
      BENCH_PRODUCTS("backward", back, back, mlp_bwd, backward);
      machines_clear();
    }
  }
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_exact), cmocka_unit_test(test_bounds),     cmocka_unit_test(test_little_memory),
    cmocka_unit_test(test_lanes), cmocka_unit_test(test_none),       cmocka_unit_test(test_real),
    cmocka_unit_test(test_again), cmocka_unit_test(test_not_finite), cmocka_unit_test(test_unwanted),
    cmocka_unit_test(test_place),
};
NOUN(mlp, bench, .tensor = true)
