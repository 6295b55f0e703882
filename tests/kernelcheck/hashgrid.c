/* SPDX-License-Identifier: MIT
 * The grids. Their kernels round every product by themselves and take every sum in the reference's order, so nothing
 * but the same numbers is accepted (a device without correctly rounded division may differ where 2*bound is no power of
 * two); but for the table's gradient by atomics, which add in any order. */
#include "harness.h"

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/cpu_state.h"
#include "hashgrid/hashgrid.h"

static const struct ern_grid_shape triplane = {2, 14, 1, 64, 512, 1 << 14, true, 1};
static const struct ern_grid_shape space = {3, 16, 2, 64, 512, 1 << 12, true, 1};
static const struct ern_grid_shape torso = {2, 16, 2, 16, 2048, 1 << 12, false, 1};
static const struct ern_grid_shape line = {1, 5, 3, 5, 900, 64, true, 0.7f};
static const struct ern_grid_shape tiled_space = {3, 4, 1, 3, 60, 512, false, 3};
static const struct ern_grid_shape wide = {2, 3, 5, 9, 100, 1 << 10, true, 1.5f};
static const struct ern_grid_shape dense = {2, 1, 12, 127, 127, 1 << 14, false, 1};
static const struct ern_grid_shape most = {1, ERN_GRID_MAX_LEVELS, 1, 2, 5000, 256, true, 1};

/* Coordinates of all kinds: anywhere inside, exactly on the border of a cell and next to it, at the ends, one step
 * outside, far, no number. */
static float coordinate(const struct ern_grid *grid, size_t i, uint64_t seed) {
  const struct ern_random random = words_at(seed, 1, i);
  const float bound = grid->bound;
  const struct ern_grid_level *level = &grid->level[random.word[1] % (uint32_t)grid->levels];
  switch (random.word[0] % 16) {
    case 0: return bound;
    case 1: return -bound;
    case 2: return random.word[1] % 2 ? nextafterf(bound, INFINITY) : nextafterf(-bound, -INFINITY);
    case 3: return random.word[1] % 3 == 0 ? NAN : random.word[1] % 3 == 1 ? -1e30f : INFINITY;
    case 4: return random.word[1] % 3 == 0 ? 0.0f : random.word[1] % 3 == 1 ? -0.0f : 1e-42f;
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

static float *random_values(size_t count, uint64_t seed, float scale) {
  float *values = floats(count);
  fill_random(values, count, seed, scale);
  return values;
}

struct scene {
  struct ern_grid grid;
  size_t n, entries;
  struct many x[ERN_GRID_MAX_DIMS], table;
  struct many_rows df, size_of_df; /* the same without sign */
};

/* odd: some gradients are infinite or no number */
static struct scene scene_make(const struct ern_grid *grid, size_t n, bool odd) {
  struct scene s = {.grid = *grid, .n = n, .entries = (size_t)grid->entries * (size_t)grid->features};
  const size_t rows = (size_t)(grid->levels * grid->features);
  for (int d = 0; d < grid->dims; d++) {
    float *x = random_values(n, 0, 0);
    for (size_t i = 0; i < n; i++) x[i] = coordinate(grid, i, 10 + (uint64_t)d);
    s.x[d] = many_reals(x, n);
  }
  float *table = random_values(s.entries, 5, 1), *df = random_values(rows * n, 6, 1);
  for (size_t k = 0; k < rows * n; k++)
    if (k % 5 == 3) df[k] = 0;
  for (size_t k = 17; odd && k < rows * n; k += 97) df[k] = k % 3 == 0 ? NAN : k % 3 == 1 ? INFINITY : -INFINITY;
  for (size_t k = 3; odd && k < s.entries; k += 1013) table[k] = k % 2 ? NAN : 1e-41f;
  s.table = many_reals(table, s.entries);
  s.df = many_strided(df, (int)rows, n, ERN_PER_SAMPLE);
  for (size_t k = 0; k < rows * n; k++) df[k] = fabsf(df[k]);
  s.size_of_df = many_strided(df, (int)rows, n, ERN_PER_SAMPLE);
  return s;
}

static struct ern_grid_fwd_args forward_of(const struct scene *s, struct many_rows f, int k) {
  struct ern_grid_fwd_args args = {.f = f.on[k], .table = s->table.on[k], .grid = &s->grid, .n = s->n};
  for (int d = 0; d < s->grid.dims; d++) args.x[d] = s->x[d].on[k];
  return args;
}

static void check_fwd(const struct scene *s) {
  const struct many_rows f = many_strided(NULL, s->grid.levels * s->grid.features, s->n, ERN_PER_SAMPLE);
  struct ern_grid_fwd_args args[MACHINES];
  EACH_MACHINE (k) args[k] = forward_of(s, f, k);
  RUN(grid_fwd, args);
  expect_near("f", of_rows(f), 0, 0);
}

enum { BY_TABLE = 1, BY_POSITION = 2 };
struct gradients {
  struct many dtable, dx[ERN_GRID_MAX_DIMS];
};

/* On top of what is there: `scale` times random numbers. */
static struct gradients gradients_of(const struct scene *s, struct many_rows df, int parts, float scale) {
  struct gradients g = {0};
  float *values = random_values(s->entries > s->n ? s->entries : s->n, 8, scale);
  g.dtable = many_reals(values, s->entries);
  for (int d = 0; d < s->grid.dims; d++) g.dx[d] = many_reals(values, s->n);
  struct ern_grid_bwd_args args[MACHINES];
  EACH_MACHINE (k) {
    args[k] = (struct ern_grid_bwd_args){.df = df.on[k], .forward = forward_of(s, df, k)};
    if (parts & BY_TABLE) args[k].dtable = g.dtable.on[k];
    for (int d = 0; d < s->grid.dims && parts & BY_POSITION; d++) args[k].dx[d] = g.dx[d].on[k];
  }
  RUN(grid_bwd, args);
  return g;
}

static void check_bwd(const struct scene *s, int parts) {
  const struct gradients g = gradients_of(s, s->df, parts, 0.1f);
  expect_near("dtable", g.dtable, 0, 0);
  for (int d = 0; d < s->grid.dims; d++) expect_near("dx", g.dx[d], 0, 0);
}

/* In any order: of an entry's terms, at most n, each addition rounds by half a unit of a partial sum, which is at most
 * the sum of the terms' sizes; on both sides: n * 2^-23 * that sum. */
static void check_atomics(const struct scene *s) {
  const struct gradients g = gradients_of(s, s->df, BY_TABLE, 0.1f),
                         sizes = gradients_of(s, s->size_of_df, BY_TABLE, 0);
  const float *expected = floats_of(0, g.dtable), *size = floats_of(0, sizes.dtable);
  EACH_OTHER (k) {
    if (!is_device(k)) continue;
    const float *found = floats_of(k, g.dtable);
    for (size_t i = 0; i < s->entries; i++) {
      const double tolerance = (double)s->n * (0.1 + (double)size[i]) * 0x1p-23;
      if (!is_near(found[i], expected[i], 0, isfinite(tolerance) ? tolerance : 0))
        fail_msg("%s: dtable by atomics [%zu]: %.9g, reference %.9g +- %.1e", machines.name[k], i, (double)found[i],
                 (double)expected[i], tolerance);
    }
  }
}

/* A device that may add in any order, or that must not. */
static void set_deterministic(bool deterministic) {
  EACH_OTHER (k)
    if (is_device(k)) machines.backend[k]->deterministic = deterministic;
}
static bool has_device(void) { return is_device(machines.count - 1); }

/* Some of the levels, by the kernels that the slots deal them to. */
static void check_levels(const struct ern_grid *grid, size_t n) {
  if (grid->levels < 3) return;
  const struct scene s = scene_make(grid, n, false);
  const size_t rows = (size_t)(grid->levels * grid->features), stride = n + 5;
  struct many_rows f = many_strided(NULL, (int)rows, n, ERN_PER_SAMPLE);
  float *values = random_values(s.entries > n ? s.entries : n, 8, 0.1f);
  const struct many dtable = many_reals(values, s.entries);
  struct many dx[ERN_GRID_MAX_DIMS];
  for (int d = 0; d < grid->dims; d++) dx[d] = many_reals(values, n);
  EACH_MACHINE (k) {
    const struct ern_cpu_kernels *kernels = kernels_of(k);
    const float *x[ERN_GRID_MAX_DIMS] = {NULL}, *table = host_reals(k, s.table.on[k]);
    float *to[ERN_GRID_MAX_DIMS] = {NULL};
    if (kernels == NULL) continue;
    for (int d = 0; d < grid->dims; d++) x[d] = host_reals(k, s.x[d].on[k]), to[d] = host_reals(k, dx[d].on[k]);
    kernels->grid_fwd(host_reals(k, f.on[k].span), stride, x, table, grid, 1, grid->levels - 1, n);
    kernels->grid_bwd(host_reals(k, dtable.on[k]), to, host_reals(k, s.df.on[k].span), stride, x, table, grid, 1, 2, n);
  }
  EACH_OTHER (k) {
    if (is_device(k)) continue;
    expect_near_on(k, "f of some levels", of_rows(f), 0, 0);
    expect_near_on(k, "dtable of some levels", dtable, 0, 0);
    for (int d = 0; d < grid->dims; d++) expect_near_on(k, "dx of some levels", dx[d], 0, 0);
  }
  machines_clear();
}

static void check_grid(const struct ern_grid *grid) {
  for (size_t s = 0; s <= size_count(); s += is_small() ? 4 : 1) {
    const size_t n = s < size_count() ? test_sizes[s] : 2100; /* the last: more than are prepared together */
    if (s == size_count() && is_small()) break;
    const bool deterministic = machines.backend[machines.count - 1]->deterministic;
    const struct scene scene = scene_make(grid, n, s % 5 == 4);
    set_deterministic(true);
    check_fwd(&scene);
    check_bwd(&scene, BY_TABLE | BY_POSITION);
    if (s % 4 == 1) check_bwd(&scene, BY_TABLE);
    if (s % 4 == 2) check_bwd(&scene, BY_POSITION);
    set_deterministic(false);
    if (has_device()) check_atomics(&scene);
    set_deterministic(deterministic);
    machines_clear();
    if (s % 4 == 1) check_levels(grid, n);
  }
}

static void check_shape(const struct ern_grid_shape *shape) {
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, shape), ERN_OK);
  check_grid(&grid);
}

/* A device builds kernels for each shape: the `other` ones with ERNERF_TEST_LONG alone. */
#define SHAPE_TEST(shape, other)                     \
  static void test_##shape(void **state) {           \
    (void)state;                                     \
    if (other && has_device() && !is_long()) skip(); \
    check_shape(&shape);                             \
  }
SHAPE_TEST(triplane, false)
SHAPE_TEST(space, false)
SHAPE_TEST(torso, false)
SHAPE_TEST(line, true)
SHAPE_TEST(tiled_space, true)
SHAPE_TEST(wide, true)
SHAPE_TEST(dense, false)
SHAPE_TEST(most, true)
#undef SHAPE_TEST

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

static void test_nothing(void **state) {
  (void)state;
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, &line), ERN_OK);
  struct scene s = scene_make(&grid, 1, false);
  s.n = 0;
  check_fwd(&s);
  check_bwd(&s, BY_TABLE | BY_POSITION);
  machines_clear();
}

/* One plane's levels for `n` samples along rays, 16 a ray, as a marcher makes them. */
static void bench_shape(const struct ern_grid_shape *shape, size_t n, bool by_position) {
  enum { STEPS = 16 };
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, shape), ERN_OK);
  struct scene s = scene_make(&grid, n, false);
  for (int d = 0; d < grid.dims; d++) {
    float *x = floats(n);
    for (size_t i = 0; i < n; i++) {
      const float from = random_at(20 + (uint64_t)d, i / STEPS, 0.4f),
                  to = random_at(30 + (uint64_t)d, i / STEPS, 0.4f);
      x[i] = from + (to - from) * (float)(i % STEPS) / STEPS;
    }
    s.x[d] = many_reals(x, n);
  }
  const struct many_rows f = many_strided(NULL, grid.levels * grid.features, n, ERN_PER_SAMPLE);
  const struct many dtable = many_zeros(s.entries), dx = many_zeros(n);
  struct ern_grid_fwd_args forward[MACHINES];
  struct ern_grid_bwd_args by_table[MACHINES], position[MACHINES];
  EACH_MACHINE (k) {
    forward[k] = forward_of(&s, f, k);
    by_table[k] = (struct ern_grid_bwd_args){.dtable = dtable.on[k], .df = s.df.on[k], .forward = forward[k]};
    position[k] = (struct ern_grid_bwd_args){.df = s.df.on[k], .forward = forward[k]};
    for (int d = 0; d < grid.dims; d++) position[k].dx[d] = dx.on[k];
  }
  const size_t items = n * (size_t)grid.levels;
  printf("%d levels, %zu samples, by level and sample\n", grid.levels, n);
  set_deterministic(true);
  BENCH("forward", items, grid_fwd, forward);
  BENCH("table's gradient", items, grid_bwd, by_table);
  set_deterministic(false);
  if (has_device()) BENCH("the same by atomics", items, grid_bwd, by_table);
  if (by_position) BENCH("positions' gradient", items, grid_bwd, position);
  machines_clear();
}

static void bench(void) {
  bench_shape(&triplane, 183000, false);
  bench_shape(&triplane, 2000, false);
  bench_shape(&torso, 65536, true);
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_triplane),   cmocka_unit_test(test_space),
                                          cmocka_unit_test(test_torso),      cmocka_unit_test(test_line),
                                          cmocka_unit_test(test_wide),       cmocka_unit_test(test_tiled_space),
                                          cmocka_unit_test(test_dense),      cmocka_unit_test(test_most),
                                          cmocka_unit_test(test_odd_modulo), cmocka_unit_test(test_nothing)};
NOUN(hashgrid, bench, .isa = NULL)
