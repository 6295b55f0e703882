/* SPDX-License-Identifier: MIT
 * The grids of each instruction set against the reference. They take every sum in the reference's order and round every
 * product by itself, so nothing but the same bits is accepted. */
#include "kernelcheck.h"

#include "core/kernels.h"
#include "hashgrid/hashgrid.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_grid_fwd_kernel *fwd;
  ern_grid_bwd_kernel *bwd;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_grid_fwd_ref, ern_grid_bwd_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_grid_fwd_avx2, ern_grid_bwd_avx2},
    {"avx512", MACHINE_AVX512, ern_grid_fwd_avx512, ern_grid_bwd_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_grid_fwd_neon, ern_grid_bwd_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

/* Sizes around the lanes of every instruction set, and around the samples that are prepared together. */
static const size_t sizes[] = {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 33, 100, 1023, 1024, 1025, 2100};
enum { SIZES = sizeof sizes / sizeof *sizes, MAX_N = 2100 };

static const struct ern_grid_shape triplane = {2, 14, 1, 64, 512, 1 << 14, true, 1};
static const struct ern_grid_shape space = {3, 16, 2, 64, 512, 1 << 14, true, 1};
static const struct ern_grid_shape dense = {2, 1, 12, 127, 127, 1 << 14, false, 1};
static const struct ern_grid_shape torso = {2, 16, 2, 16, 2048, 1 << 16, false, 1};
static const struct ern_grid_shape line = {1, 5, 3, 5, 900, 64, true, 0.7f};
static const struct ern_grid_shape tiled_space = {3, 4, 1, 3, 60, 512, false, 3};
static const struct ern_grid_shape wide = {2, 3, 5, 9, 100, 1 << 10, true, 1.5f};

/* Coordinates of all kinds: anywhere inside, exactly on the border of a cell, at the ends, just outside, far, no
 * number. */
static float coordinate(const struct ern_grid *grid, size_t i, uint64_t seed) {
  const struct ern_random random = ern_random_at(seed, 1, (uint32_t)i, ERN_RNG_INIT);
  const float bound = grid->bound;
  const struct ern_grid_level *level = &grid->level[random.word[1] % (uint32_t)grid->levels];
  switch (random.word[0] % 16) {
    case 0: return bound;
    case 1: return -bound;
    case 2: return random.word[1] % 2 ? nextafterf(bound, INFINITY) : nextafterf(-bound, -INFINITY);
    case 3: return random.word[1] % 3 == 0 ? NAN : random.word[1] % 3 == 1 ? -1e30f : INFINITY;
    case 4: return random.word[1] % 2 ? 0.0f : -0.0f;
    case 5:
    case 6:
    case 7: { /* u*scale + 0.5 is a whole number, or next to it */
      const float cell = (float)(1 + ern_below(random.word[2], level->resolution - 1));
      const float x = fminf(fmaxf((cell - 0.5f) / level->scale * 2 * bound - bound, -bound), bound);
      return random.word[3] % 3 == 0 ? x : nextafterf(x, random.word[3] % 3 == 1 ? -bound : bound);
    }
    default: return (ern_uniform(random.word[2]) * 2 - 1) * bound;
  }
}

struct scene {
  struct ern_grid grid;
  size_t n, stride, rows;
  struct guarded x[ERN_GRID_MAX_DIMS], table, df;
};

static void scene_make(struct scene *scene, const struct ern_grid *grid, size_t n) {
  scene->grid = *grid;
  scene->n = n;
  scene->stride = n + 7;
  scene->rows = (size_t)(grid->levels * grid->features);
  for (int d = 0; d < grid->dims; d++) {
    scene->x[d] = guarded_make(n);
    for (size_t i = 0; i < n; i++) scene->x[d].data[i] = coordinate(grid, i, 10 + (uint64_t)d);
  }
  scene->table = guarded_make((size_t)grid->entries * (size_t)grid->features);
  random_rows(&scene->table, 1, 0, scene->table.count, 1, 5);
  scene->df = guarded_make(scene->rows * scene->stride);
  random_rows(&scene->df, scene->rows, scene->stride, n, 1, 6);
}

static void scene_free(struct scene *scene) {
  for (int d = 0; d < scene->grid.dims; d++) guarded_free(&scene->x[d]);
  guarded_free(&scene->table);
  guarded_free(&scene->df);
}

static const float *const *scene_x(const struct scene *scene, const float *x[ERN_GRID_MAX_DIMS]) {
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) x[d] = d < scene->grid.dims ? scene->x[d].data : NULL;
  return x;
}

/* Same bits; zeros of either sign are the same. */
static void expect_same(const char *kernel, const char *what, const float *found, const float *expected, size_t count) {
  for (size_t i = 0; i < count; i++) {
    if (memcmp(&found[i], &expected[i], sizeof found[i]) == 0 || found[i] == expected[i]) continue;
    fail_msg("%s %s [%zu]: %.9g, reference %.9g", kernel, what, i, found[i], expected[i]);
  }
}

static void check_fwd(const struct scene *scene, const struct kernel *kernel, int begin, int end) {
  const float *x[ERN_GRID_MAX_DIMS];
  struct guarded found = guarded_make(scene->rows * scene->stride),
                 expected = guarded_make(scene->rows * scene->stride);
  kernels[0].fwd(expected.data, scene->stride, scene_x(scene, x), scene->table.data, &scene->grid, begin, end,
                 scene->n);
  kernel->fwd(found.data, scene->stride, scene_x(scene, x), scene->table.data, &scene->grid, begin, end, scene->n);
  expect_same(kernel->name, "f", found.data, expected.data, found.count); /* rows of other levels: poison in both */
  guarded_check(&found, scene->rows, scene->stride, scene->n, "f");
  guarded_free(&found);
  guarded_free(&expected);
}

/* Both gradients, or one of them, on top of what is there. */
static void check_bwd(const struct scene *scene, const struct kernel *kernel, int begin, int end, bool by_table,
                      bool by_position) {
  const float *x[ERN_GRID_MAX_DIMS];
  struct guarded dtable[2], dx[2][ERN_GRID_MAX_DIMS];
  for (int k = 0; k < 2; k++) {
    const struct kernel *with = k == 0 ? &kernels[0] : kernel;
    float *to[ERN_GRID_MAX_DIMS] = {NULL};
    dtable[k] = guarded_make(scene->table.count);
    random_rows(&dtable[k], 1, 0, scene->table.count, 0.1f, 8);
    for (int d = 0; d < scene->grid.dims; d++) {
      dx[k][d] = guarded_make(scene->n);
      random_rows(&dx[k][d], 1, 0, scene->n, 0.1f, 9);
      if (by_position) to[d] = dx[k][d].data;
    }
    with->bwd(by_table ? dtable[k].data : NULL, to, scene->df.data, scene->stride, scene_x(scene, x), scene->table.data,
              &scene->grid, begin, end, scene->n);
  }
  expect_same(kernel->name, "dtable", dtable[1].data, dtable[0].data, dtable[1].count);
  guarded_check(&dtable[1], 1, dtable[1].count, dtable[1].count, "dtable");
  for (int d = 0; d < scene->grid.dims; d++) {
    expect_same(kernel->name, "dx", dx[1][d].data, dx[0][d].data, scene->n);
    guarded_check(&dx[1][d], 1, scene->n, scene->n, "dx");
  }
  for (int k = 0; k < 2; k++) {
    guarded_free(&dtable[k]);
    for (int d = 0; d < scene->grid.dims; d++) guarded_free(&dx[k][d]);
  }
}

static void check_grid(const struct ern_grid *grid) {
  if (KERNELS == 1) skip(); /* built without instruction sets */
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) {
      print_message("%s: not on this machine\n", kernels[k].name);
      continue;
    }
    for (size_t s = 0; s < SIZES; s++) {
      struct scene scene;
      scene_make(&scene, grid, sizes[s]);
      check_fwd(&scene, &kernels[k], 0, grid->levels);
      check_bwd(&scene, &kernels[k], 0, grid->levels, true, true);
      if (s % 4 == 1 && grid->levels > 2) { /* some of the levels */
        check_fwd(&scene, &kernels[k], 1, grid->levels - 1);
        check_bwd(&scene, &kernels[k], 1, 2, true, true);
      }
      if (s % 4 == 1) {
        check_bwd(&scene, &kernels[k], 0, grid->levels, true, false);
        check_bwd(&scene, &kernels[k], 0, grid->levels, false, true);
      }
      scene_free(&scene);
    }
  }
}

static void check_shape(const struct ern_grid_shape *shape) {
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, shape), ERN_OK);
  check_grid(&grid);
}

static void test_triplane(void **state) {
  (void)state;
  check_shape(&triplane);
}
static void test_space(void **state) {
  (void)state;
  check_shape(&space);
}
static void test_dense(void **state) {
  (void)state;
  check_shape(&dense);
}
static void test_torso(void **state) {
  (void)state;
  check_shape(&torso);
}
static void test_line(void **state) {
  (void)state;
  check_shape(&line);
}
static void test_tiled_space(void **state) {
  (void)state;
  check_shape(&tiled_space);
}
static void test_wide(void **state) {
  (void)state;
  check_shape(&wide);
}

/* Hashed and tiled levels at the edges of the index rule: sizes that are no power of two, as rounding may leave them; a
 * row, and a whole plane, of exactly the level's size. */
static void test_odd_modulo(void **state) {
  (void)state;
  for (int hashed = 0; hashed < 2; hashed++) {
    struct ern_grid grid = {.dims = 2, .levels = 4, .features = 2, .hashed = hashed != 0, .bound = 1, .entries = 2144};
    grid.level[0] = (struct ern_grid_level){.scale = 20.3f, .resolution = 22, .offset = 0, .size = 120};
    grid.level[1] = (struct ern_grid_level){.scale = 99.9f, .resolution = 101, .offset = 120, .size = 488};
    grid.level[2] = (struct ern_grid_level){.scale = 509.5f, .resolution = 511, .offset = 608, .size = 512};
    grid.level[3] = (struct ern_grid_level){.scale = 30, .resolution = 31, .offset = 1120, .size = 1024};
    check_grid(&grid);
  }
}

/* 42 levels of a tri-plane for samples along rays, as a marcher makes them. */
struct bench {
  const struct kernel *kernel;
  struct ern_grid grid;
  size_t n;
  float *x[3], *f, *table[3], *dtable[3];
  bool backward;
};

static void bench_run(void *user) {
  static const int axis[3][2] = {{0, 1}, {1, 2}, {0, 2}};
  struct bench *bench = user;
  const size_t rows = (size_t)bench->grid.levels * bench->n;
  float *const none[ERN_GRID_MAX_DIMS] = {NULL};
  for (int plane = 0; plane < 3; plane++) {
    const float *const x[ERN_GRID_MAX_DIMS] = {bench->x[axis[plane][0]], bench->x[axis[plane][1]]};
    float *f = bench->f + (size_t)plane * rows;
    if (bench->backward) {
      bench->kernel->bwd(bench->dtable[plane], none, f, bench->n, x, bench->table[plane], &bench->grid, 0,
                         bench->grid.levels, bench->n);
    } else {
      bench->kernel->fwd(f, bench->n, x, bench->table[plane], &bench->grid, 0, bench->grid.levels, bench->n);
    }
  }
}

static int measure(void) {
  enum { N = 16384, STEPS = 16 };
  struct bench bench = {.n = N};
  if (ern_grid_build(&bench.grid, &triplane) != ERN_OK) return 1;
  struct guarded arrays[3], values = guarded_make((size_t)(3 * bench.grid.levels) * N), tables[6];
  for (int d = 0; d < 3; d++) {
    arrays[d] = guarded_make(N);
    bench.x[d] = arrays[d].data;
    for (size_t i = 0; i < N; i++) {
      const float from = random_at(20 + (uint64_t)d, i / STEPS, 0.4f),
                  to = random_at(30 + (uint64_t)d, i / STEPS, 0.4f);
      bench.x[d][i] = from + (to - from) * (float)(i % STEPS) / STEPS;
    }
    tables[d] = guarded_make(bench.grid.entries);
    tables[3 + d] = guarded_make(bench.grid.entries);
    random_rows(&tables[d], 1, 0, bench.grid.entries, 1e-2f, 3);
    random_rows(&tables[3 + d], 1, 0, bench.grid.entries, 1e-2f, 3);
    bench.table[d] = tables[d].data;
    bench.dtable[d] = tables[3 + d].data;
  }
  bench.f = values.data;
  double first[2] = {0};
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    bench.kernel = &kernels[k];
    for (int backward = 0; backward < 2; backward++) {
      bench.backward = backward != 0;
      const double seconds = seconds_of(bench_run, &bench);
      if (k == 0) first[backward] = seconds;
      printf("tri-plane of %d levels, %s, %-6s: %6.2f million samples/s, %.2f times ref\n", 3 * bench.grid.levels,
             backward ? "backward" : "forward ", kernels[k].name, N / seconds * 1e-6, first[backward] / seconds);
    }
  }
  for (int k = 0; k < 6; k++) guarded_free(&tables[k]);
  for (int d = 0; d < 3; d++) guarded_free(&arrays[d]);
  guarded_free(&values);
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) return measure();
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_triplane),    cmocka_unit_test(test_space),      cmocka_unit_test(test_dense),
      cmocka_unit_test(test_torso),       cmocka_unit_test(test_line),       cmocka_unit_test(test_wide),
      cmocka_unit_test(test_tiled_space), cmocka_unit_test(test_odd_modulo),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
