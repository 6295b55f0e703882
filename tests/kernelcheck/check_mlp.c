/* SPDX-License-Identifier: MIT
 * The fully connected stacks of each instruction set against the reference. */
#include "kernelcheck.h"

#include "core/kernels.h"
#include "mlp/mlp_tile.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_mlp_fwd_kernel *fwd;
  ern_mlp_bwd_kernel *bwd;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_mlp_fwd_ref, ern_mlp_bwd_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_mlp_fwd_avx2, ern_mlp_bwd_avx2},
    {"avx512", MACHINE_AVX512, ern_mlp_fwd_avx512, ern_mlp_bwd_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_mlp_fwd_neon, ern_mlp_bwd_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

enum { PIECES = 3, RAYS = 6, FRONT = 5, BACK = 9 };

struct shape {
  const char *name;
  int width[ERN_MLP_MAX_LAYERS + 2]; /* ends with 0 */
  int rows[PIECES + 1];              /* ends with 0 */
  ern_per per[PIECES];
};

static const struct shape shapes[] = {
    {"density", {75, 64, 64, 65}, {42, 32, 1}, {ERN_PER_SAMPLE, ERN_PER_SAMPLE, ERN_PER_BATCH}},
    {"colour", {84, 64, 3}, {16, 64, 4}, {ERN_PER_RAY, ERN_PER_SAMPLE, ERN_PER_BATCH}},
    {"attention", {42, 64, 32}, {42}, {ERN_PER_SAMPLE}},
    {"eye", {36, 16, 1}, {36}, {ERN_PER_SAMPLE}},
    {"torso", {116, 32, 32, 4}, {32, 34, 50}, {ERN_PER_SAMPLE, ERN_PER_SAMPLE, ERN_PER_BATCH}},
    {"one layer", {7, 5}, {7}, {ERN_PER_SAMPLE}},
    {"tiny", {1, 1, 1}, {1}, {ERN_PER_SAMPLE}},
    {"odd", {17, 31, 9, 15, 2}, {3, 13, 1}, {ERN_PER_RAY, ERN_PER_SAMPLE, ERN_PER_BATCH}},
    {"trunk", {63, 256, 256, 256, 256}, {63}, {ERN_PER_SAMPLE}},
    {"trunk, again", {319, 256, 256, 256, 256, 36}, {63, 256}, {ERN_PER_SAMPLE, ERN_PER_SAMPLE}},
    {"density, concat", {69, 64, 64, 65}, {36, 32, 1}, {ERN_PER_SAMPLE, ERN_PER_BATCH, ERN_PER_BATCH}},
    {"attention of one", {32, 64, 1}, {32}, {ERN_PER_SAMPLE}},
};
enum { SHAPES = sizeof shapes / sizeof *shapes };

/* Sizes around the lanes of every instruction set and around a tile of 48. */
static const size_t sizes[] = {1, 7, 8, 9, 15, 16, 17, 47, 48, 49, 95, 97, 333};
enum { SIZES = sizeof sizes / sizeof *sizes };

struct scene {
  struct ern_mlp mlp;
  size_t n, stride, values; /* values: of the parameter block */
  int pieces;
  int32_t *ray;
  struct guarded x[PIECES], parameters, dy;
  struct ern_rows_view views[PIECES];
};

static size_t piece_items(const struct scene *scene, ern_per per) {
  return per == ERN_PER_SAMPLE ? scene->n : per == ERN_PER_RAY ? RAYS : 1;
}

static void scene_make(struct scene *scene, const struct shape *shape, size_t n, float weight_scale, float x_scale) {
  *scene = (struct scene){.n = n, .stride = n + 11};
  size_t at = FRONT;
  for (int l = 0; shape->width[l] != 0; l++) {
    scene->mlp.width[l] = shape->width[l];
    scene->mlp.layers = l;
    if (l == 0) continue;
    scene->mlp.weight[l - 1] = at;
    at += (size_t)(shape->width[l] * shape->width[l - 1]);
  }
  scene->values = at + BACK;
  scene->parameters = guarded_make(scene->values);
  for (int l = 0; l < scene->mlp.layers; l++) {
    const size_t count = (size_t)(shape->width[l] * shape->width[l + 1]);
    for (size_t i = 0; i < count; i++) {
      const float scale = weight_scale * sqrtf(6.0f / (float)shape->width[l]);
      scene->parameters.data[scene->mlp.weight[l] + i] = random_at(40 + (uint64_t)l, i, scale);
    }
  }
  for (scene->pieces = 0; shape->rows[scene->pieces] != 0; scene->pieces++) {
    const int p = scene->pieces;
    const size_t items = piece_items(scene, shape->per[p]), stride = items + 3, rows = (size_t)shape->rows[p];
    scene->x[p] = guarded_make(rows * stride);
    random_rows(&scene->x[p], rows, stride, items, x_scale, 50 + (uint64_t)p);
    scene->views[p] = (struct ern_rows_view){scene->x[p].data, stride, shape->rows[p], shape->per[p]};
  }
  scene->ray = malloc(n * sizeof *scene->ray);
  assert_non_null(scene->ray);
  for (size_t i = 0; i < n; i++) scene->ray[i] = (int32_t)(i * RAYS / n);
  const size_t outs = (size_t)scene->mlp.width[scene->mlp.layers];
  scene->dy = guarded_make(outs * scene->stride);
  random_rows(&scene->dy, outs, scene->stride, n, 1, 60);
}

static void scene_free(struct scene *scene) {
  guarded_free(&scene->parameters);
  guarded_free(&scene->dy);
  for (int p = 0; p < scene->pieces; p++) guarded_free(&scene->x[p]);
  free(scene->ray);
}

/* What a kernel left behind; the gradients come on top of 0.25. */
struct result {
  struct guarded y, scratch, dparameters, dx[PIECES];
};

static void result_make(struct result *result, const struct scene *scene, const struct kernel *kernel) {
  struct ern_rows_view dx[PIECES] = {{.data = NULL}};
  result->y = guarded_make((size_t)scene->mlp.width[scene->mlp.layers] * scene->stride);
  result->scratch = guarded_make(ern_mlp_scratch(&scene->mlp));
  result->dparameters = guarded_make(scene->values);
  for (int l = 0; l < scene->mlp.layers; l++) {
    const size_t count = (size_t)(scene->mlp.width[l] * scene->mlp.width[l + 1]);
    for (size_t i = 0; i < count; i++) result->dparameters.data[scene->mlp.weight[l] + i] = 0.25f;
  }
  for (int p = 0; p < scene->pieces; p++) {
    const struct ern_rows_view *x = &scene->views[p];
    result->dx[p] = guarded_make(scene->x[p].count);
    for (size_t r = 0; r < (size_t)x->rows; r++) {
      for (size_t i = 0; i < piece_items(scene, x->per); i++) result->dx[p].data[r * x->stride + i] = 0.25f;
    }
    dx[p] = (struct ern_rows_view){result->dx[p].data, x->stride, x->rows, x->per};
  }
  kernel->fwd(result->y.data, scene->stride, scene->views, scene->pieces, scene->ray, scene->parameters.data,
              &scene->mlp, scene->n, result->scratch.data);
  poison(result->scratch.data, result->scratch.count); /* nothing may be left to the backward pass in it */
  kernel->bwd(dx, result->dparameters.data, scene->dy.data, scene->stride, scene->views, scene->pieces, scene->ray,
              scene->parameters.data, &scene->mlp, scene->n, result->scratch.data);
}

static void result_free(struct result *result, const struct scene *scene) {
  guarded_free(&result->y);
  guarded_free(&result->scratch);
  guarded_free(&result->dparameters);
  for (int p = 0; p < scene->pieces; p++) guarded_free(&result->dx[p]);
}

static void result_check_guards(const struct result *result, const struct scene *scene) {
  guarded_check(&result->y, (size_t)scene->mlp.width[scene->mlp.layers], scene->stride, scene->n, "y");
  guarded_check(&result->scratch, 0, 0, 0, "scratch");
  guarded_check(&result->dparameters, 0, 0, 0, "dparameters");
  for (size_t i = 0; i < scene->values; i++) {
    if (i < FRONT || i >= scene->values - BACK) assert_true(is_poison(result->dparameters.data[i]));
  }
  for (int p = 0; p < scene->pieces; p++) {
    const struct ern_rows_view *x = &scene->views[p];
    guarded_check(&result->dx[p], (size_t)x->rows, x->stride, piece_items(scene, x->per), "dx");
  }
}

/* How far two float evaluations in different orders may be apart, by an error analysis in double along the data.
 * Rounding errors are independent, so they add like a random walk: a sum of K products, in any order, fused or not, is
 * off by about sqrt(K) u sum|a b| / sqrt(3) at most, where all have one sign (u = 2^-24). Two kernels, and four
 * standard deviations with it, make 4 sqrt(K) u sum|a b|. The errors e of the factors are carried as sqrt(sum (w e)^2).
 * A unit whose error reaches across 0 may be on in one kernel and off in the other: its whole slope counts as error. */
struct bound {
  double *h[ERN_MLP_MAX_LAYERS + 1], *e[ERN_MLP_MAX_LAYERS + 1]; /* [width][n]: values before the ReLU, errors */
  double *dw, *dw_error;                                         /* the block */
  double *dx, *dx_error;                                         /* [width 0][n] */
};

static double *doubles(size_t count) {
  double *values = calloc(count, sizeof *values);
  assert_non_null(values);
  return values;
}

static const double unit = 0x1p-24, tiny = 0x1p-140; /* tiny: a few denormals */

static double square(double x) { return x * x; }

static double rounding(size_t terms, double absolute) { return 4 * sqrt((double)terms) * unit * absolute; }

static double relu_value(double h, int layer) { return layer > 0 && h < 0 ? 0 : h; }

static void bound_fwd(struct bound *bound, const struct scene *scene) {
  const struct ern_mlp *mlp = &scene->mlp;
  const size_t n = scene->n;
  for (int l = 0; l <= mlp->layers; l++) {
    bound->h[l] = doubles((size_t)mlp->width[l] * n);
    bound->e[l] = doubles((size_t)mlp->width[l] * n);
  }
  size_t k = 0;
  for (int p = 0; p < scene->pieces; p++) {
    const struct ern_rows_view *x = &scene->views[p];
    for (size_t r = 0; r < (size_t)x->rows; r++, k++) {
      for (size_t i = 0; i < n; i++) {
        const size_t at = x->per == ERN_PER_SAMPLE ? i : x->per == ERN_PER_RAY ? (size_t)scene->ray[i] : 0;
        bound->h[0][k * n + i] = x->data[r * x->stride + at];
      }
    }
  }
  for (int l = 0; l < mlp->layers; l++) {
    const size_t ins = (size_t)mlp->width[l], outs = (size_t)mlp->width[l + 1];
    for (size_t j = 0; j < outs; j++) {
      for (size_t i = 0; i < n; i++) {
        double sum = 0, absolute = 0, carried = 0;
        for (size_t c = 0; c < ins; c++) {
          const double w = scene->parameters.data[mlp->weight[l] + j * ins + c];
          const double h = relu_value(bound->h[l][c * n + i], l);
          sum += w * h;
          absolute += fabs(w * h);
          carried += square(w * bound->e[l][c * n + i]);
        }
        bound->h[l + 1][j * n + i] = sum;
        bound->e[l + 1][j * n + i] = sqrt(carried) + rounding(ins, absolute) + tiny;
      }
    }
  }
}

static void bound_bwd(struct bound *bound, const struct scene *scene) {
  const struct ern_mlp *mlp = &scene->mlp;
  const size_t n = scene->n;
  bound->dw = doubles(scene->values);
  bound->dw_error = doubles(scene->values);
  double *slope = NULL, *error = NULL;
  for (int l = mlp->layers - 1; l >= 0; l--) {
    const size_t ins = (size_t)mlp->width[l], outs = (size_t)mlp->width[l + 1];
    if (slope == NULL) {
      slope = doubles(outs * n);
      error = doubles(outs * n);
      for (size_t j = 0; j < outs; j++) {
        for (size_t i = 0; i < n; i++) slope[j * n + i] = scene->dy.data[j * scene->stride + i];
      }
    }
    double *next = doubles(ins * n), *next_error = doubles(ins * n), *next_absolute = doubles(ins * n);
    for (size_t j = 0; j < outs; j++) {
      for (size_t c = 0; c < ins; c++) {
        const size_t at = mlp->weight[l] + j * ins + c;
        const double w = scene->parameters.data[at];
        double sum = 0, absolute = 0, carried = 0;
        for (size_t i = 0; i < n; i++) {
          const double h = relu_value(bound->h[l][c * n + i], l), s = slope[j * n + i];
          sum += s * h;
          absolute += fabs(s * h);
          carried += square(s * bound->e[l][c * n + i]) + square(error[j * n + i] * h);
          next[c * n + i] += w * s;
          next_absolute[c * n + i] += fabs(w * s);
          next_error[c * n + i] += square(w * error[j * n + i]);
        }
        bound->dw[at] = sum;
        bound->dw_error[at] = sqrt(carried) + rounding(n + 1, absolute + 0.25) + tiny;
      }
    }
    for (size_t i = 0; i < ins * n; i++) {
      const double h = bound->h[l][i], e = bound->e[l][i];
      next_error[i] = sqrt(next_error[i]) + rounding(outs, next_absolute[i]) + tiny;
      if (l == 0) continue;
      if (fabs(h) <= e) {
        next_error[i] += fabs(next[i]);
      } else if (h < 0) {
        next[i] = next_error[i] = 0;
      }
    }
    free(slope), free(error), free(next_absolute);
    slope = next;
    error = next_error;
  }
  bound->dx = slope;
  bound->dx_error = error;
}

static void bound_free(struct bound *bound, const struct scene *scene) {
  for (int l = 0; l <= scene->mlp.layers; l++) free(bound->h[l]), free(bound->e[l]);
  free(bound->dw), free(bound->dw_error), free(bound->dx), free(bound->dx_error);
}

static void expect_near(const char *shape, const char *kernel, const char *what, double found, double expected,
                        double tolerance, size_t at) {
  if (fabs(found - expected) <= tolerance || (isnan(found) && isnan(expected))) return;
  fail_msg("%s %s %s [%zu]: %.9g, expected %.9g +- %.1e", shape, kernel, what, at, found, expected, tolerance);
}

/* `found` against the reference `expected`, and the reference against the equations in double. */
static void compare(const char *shape, const char *kernel, const struct scene *scene, const struct bound *bound,
                    const struct result *found, const struct result *expected) {
  const size_t n = scene->n, outs = (size_t)scene->mlp.width[scene->mlp.layers];
  const double *h = bound->h[scene->mlp.layers], *e = bound->e[scene->mlp.layers];
  for (size_t j = 0; j < outs; j++) {
    for (size_t i = 0; i < n; i++) {
      const size_t at = j * scene->stride + i;
      expect_near(shape, "ref", "y", expected->y.data[at], h[j * n + i], e[j * n + i], at);
      expect_near(shape, kernel, "y", found->y.data[at], expected->y.data[at], e[j * n + i], at);
    }
  }
  for (size_t i = FRONT; i < scene->values - BACK; i++) {
    expect_near(shape, "ref", "dW", expected->dparameters.data[i] - 0.25, bound->dw[i], bound->dw_error[i], i);
    expect_near(shape, kernel, "dW", found->dparameters.data[i], expected->dparameters.data[i], bound->dw_error[i], i);
  }
  size_t row = 0;
  for (int p = 0; p < scene->pieces; p++) {
    const struct ern_rows_view *x = &scene->views[p];
    for (size_t r = 0; r < (size_t)x->rows; r++, row++) {
      double sum = 0, absolute = 0, error = 0;
      for (size_t i = 0; i < n; i++) {
        const double dx = bound->dx[row * n + i], dx_error = bound->dx_error[row * n + i];
        sum += dx;
        absolute += fabs(dx);
        error += square(dx_error);
        if (x->per != ERN_PER_SAMPLE) continue;
        const size_t at = r * x->stride + i;
        const double tolerance = dx_error + rounding(2, fabs(dx) + 0.25);
        expect_near(shape, "ref", "dx", expected->dx[p].data[at] - 0.25, dx, tolerance, at);
        expect_near(shape, kernel, "dx", found->dx[p].data[at], expected->dx[p].data[at], tolerance, at);
      }
      if (x->per == ERN_PER_SAMPLE) continue;
      double tolerance = sqrt(error) + rounding(n + 1, absolute + 0.25);
      if (x->per == ERN_PER_RAY) sum = tolerance = 0; /* no gradient: what was there, exactly */
      for (size_t i = 0; i < piece_items(scene, x->per); i++) {
        const size_t at = r * x->stride + i;
        expect_near(shape, "ref", "dx", expected->dx[p].data[at] - 0.25, sum, tolerance, at);
        expect_near(shape, kernel, "dx", found->dx[p].data[at], expected->dx[p].data[at], tolerance, at);
      }
    }
  }
}

static void check_scene(const char *shape, const struct scene *scene) {
  struct bound bound;
  struct result expected;
  bound_fwd(&bound, scene);
  bound_bwd(&bound, scene);
  result_make(&expected, scene, &kernels[0]);
  result_check_guards(&expected, scene);
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    struct result found;
    result_make(&found, scene, &kernels[k]);
    result_check_guards(&found, scene);
    compare(shape, kernels[k].name, scene, &bound, &found, &expected);
    result_free(&found, scene);
  }
  result_free(&expected, scene);
  bound_free(&bound, scene);
}

static void test_shapes(void **state) {
  (void)state;
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) print_message("%s: not on this machine\n", kernels[k].name);
  }
  for (size_t s = 0; s < SHAPES; s++) {
    const size_t most =
        strncmp(shapes[s].name, "trunk", 5) == 0 ? 3 : SIZES; /* 300,000 weights: a few sizes are enough */
    for (size_t k = 0; k < most; k++) {
      struct scene scene;
      scene_make(&scene, &shapes[s], sizes[k], 1, 1);
      check_scene(shapes[s].name, &scene);
      scene_free(&scene);
    }
  }
}

/* Weights of 0, of 1e10 and of 1e-10, inputs of 1e-30: everything stays finite, nothing is lost in the order of sums.
 */
static void test_extremes(void **state) {
  (void)state;
  static const float scale[][2] = {{0, 1}, {1e10f, 1e3f}, {1e-10f, 1}, {1, 1e-30f}, {1e4f, 1e-38f}};
  for (size_t k = 0; k < sizeof scale / sizeof *scale; k++) {
    struct scene scene;
    scene_make(&scene, &shapes[0], 50, scale[k][0], scale[k][1]);
    check_scene("extreme", &scene);
    scene_free(&scene);
  }
}

/* A sample that is no number makes its own outputs none, and no others; its gradient is seen in the weights'. */
static void test_not_a_number(void **state) {
  (void)state;
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    struct scene scene;
    struct result result;
    scene_make(&scene, &shapes[2], 50, 1, 1);
    scene.x[0].data[3 * scene.views[0].stride + 49] = NAN;
    result_make(&result, &scene, &kernels[k]);
    result_check_guards(&result, &scene);
    for (size_t j = 0; j < 32; j++) {
      for (size_t i = 0; i < 50; i++) assert_true(isnan(result.y.data[j * scene.stride + i]) == (i == 49));
    }
    for (size_t i = 0; i < 64 * 32; i++) assert_true(isnan(result.dparameters.data[scene.mlp.weight[1] + i]));
    for (size_t i = 0; i < 49; i++) assert_true(isfinite(result.dx[0].data[i]));
    result_free(&result, &scene);
    scene_free(&scene);
  }
}

/* Unwanted gradients are not written, and the weights' do not change for it. */
static void test_unwanted(void **state) {
  (void)state;
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    struct scene scene;
    struct result result;
    scene_make(&scene, &shapes[0], 70, 1, 1);
    result_make(&result, &scene, &kernels[k]);
    struct guarded again = guarded_make(scene.values);
    for (int some = 0; some < 2; some++) {
      struct ern_rows_view dx[PIECES] = {{.data = NULL}};
      struct guarded second = guarded_make(scene.x[1].count);
      for (size_t i = 0; i < second.count; i++) second.data[i] = 0.25f;
      if (some) dx[1] = (struct ern_rows_view){second.data, scene.views[1].stride, 32, ERN_PER_SAMPLE};
      for (size_t i = FRONT; i < scene.values - BACK; i++) again.data[i] = 0.25f;
      kernels[k].bwd(dx, again.data, scene.dy.data, scene.stride, scene.views, 3, scene.ray, scene.parameters.data,
                     &scene.mlp, scene.n, result.scratch.data);
      assert_memory_equal(again.data, result.dparameters.data, scene.values * sizeof(float));
      for (size_t r = 0; r < 32; r++) {
        const size_t at = r * scene.views[1].stride;
        if (some) assert_memory_equal(second.data + at, result.dx[1].data + at, scene.n * sizeof(float));
      }
      guarded_check(&second, 0, 0, 0, "dx");
      guarded_free(&second);
    }
    guarded_free(&again);
    result_free(&result, &scene);
    scene_free(&scene);
  }
}

/* The same input gives the same output wherever in a tile it lies. */
static void test_place(void **state) {
  (void)state;
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    enum { N = 101 };
    struct scene scene;
    struct result result;
    scene_make(&scene, &shapes[2], N, 1, 1);
    for (size_t r = 0; r < 42; r++) {
      for (size_t i = 0; i < N; i++) scene.x[0].data[r * scene.views[0].stride + i] = random_at(3, r, 1);
    }
    result_make(&result, &scene, &kernels[k]);
    for (size_t j = 0; j < 32; j++) {
      const float *row = result.y.data + j * scene.stride;
      for (size_t i = 1; i < N; i++) assert_memory_equal(&row[i], &row[0], sizeof row[0]);
    }
    result_free(&result, &scene);
    scene_free(&scene);
  }
}

struct bench {
  const struct kernel *kernel;
  struct scene scene;
  struct guarded y, scratch, dparameters, dx[PIECES];
  bool backward;
};

static void bench_run(void *user) {
  struct bench *bench = user;
  const struct scene *scene = &bench->scene;
  struct ern_rows_view dx[PIECES];
  for (int p = 0; p < scene->pieces; p++) {
    dx[p] = scene->views[p];
    dx[p].data = bench->dx[p].data;
  }
  if (bench->backward) {
    bench->kernel->bwd(dx, bench->dparameters.data, scene->dy.data, scene->stride, scene->views, scene->pieces,
                       scene->ray, scene->parameters.data, &scene->mlp, scene->n, bench->scratch.data);
  } else {
    bench->kernel->fwd(bench->y.data, scene->stride, scene->views, scene->pieces, scene->ray, scene->parameters.data,
                       &scene->mlp, scene->n, bench->scratch.data);
  }
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

static void measure_shape(const struct shape *shape, size_t n) {
  struct bench bench;
  scene_make(&bench.scene, shape, n, 1, 1);
  const struct ern_mlp *mlp = &bench.scene.mlp;
  bench.y = guarded_make((size_t)mlp->width[mlp->layers] * bench.scene.stride);
  bench.scratch = guarded_make(ern_mlp_scratch(mlp));
  bench.dparameters = guarded_make(bench.scene.values);
  memset(bench.dparameters.data, 0, bench.scene.values * sizeof(float));
  for (int p = 0; p < bench.scene.pieces; p++) {
    bench.dx[p] = guarded_make(bench.scene.x[p].count);
    memset(bench.dx[p].data, 0, bench.dx[p].count * sizeof(float));
  }
  double first[2] = {0};
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    bench.kernel = &kernels[k];
    const double peak = peak_flops(kernels[k].isa);
    for (int backward = 0; backward < 2; backward++) {
      bench.backward = backward != 0;
      const double seconds = seconds_of(bench_run, &bench), rate = operations(mlp, n, bench.backward) / seconds;
      if (k == 0) first[backward] = seconds;
      printf("%-9s n = %5zu %s %-6s: %7.1f GFLOP/s", shape->name, n, backward ? "backward" : "forward ",
             kernels[k].name, rate * 1e-9);
      if (peak > 0) printf(", %3.0f%% of %.1f", 100 * rate / peak, peak * 1e-9);
      printf(", %.1f times ref\n", first[backward] / seconds);
    }
  }
  for (int p = 0; p < bench.scene.pieces; p++) guarded_free(&bench.dx[p]);
  guarded_free(&bench.y);
  guarded_free(&bench.scratch);
  guarded_free(&bench.dparameters);
  scene_free(&bench.scene);
}

static int measure(void) {
  measure_shape(&shapes[0], 4096);
  measure_shape(&shapes[0], 96);
  measure_shape(&shapes[1], 4096);
  measure_shape(&shapes[2], 4096);
  measure_shape(&shapes[3], 4096);
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) return measure();
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_shapes),   cmocka_unit_test(test_extremes), cmocka_unit_test(test_not_a_number),
      cmocka_unit_test(test_unwanted), cmocka_unit_test(test_place),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
