/* SPDX-License-Identifier: MIT
 * The grids of an OpenCL device against the reference. Its kernels round every product by itself and take every sum in
 * the reference's order, so nothing but the same bits is accepted (a device without correctly rounded division may
 * differ where 2*bound is no power of two); but for the table's gradient by atomics, which add in any order. */
#include "twin.h"

#include <time.h>

#include "hashgrid/hashgrid.h"

static ern_context *context;
static struct twin twin;

static const struct ern_grid_shape triplane = {2, 14, 1, 64, 512, 1 << 14, true, 1};
static const struct ern_grid_shape space = {3, 5, 2, 64, 512, 1 << 12, true, 1};
static const struct ern_grid_shape torso = {2, 16, 2, 16, 2048, 1 << 12, false, 1};
static const struct ern_grid_shape line = {1, 5, 3, 5, 900, 64, true, 0.7f};
static const struct ern_grid_shape tiled_space = {3, 4, 1, 3, 60, 512, false, 3};
static const struct ern_grid_shape wide = {2, 3, 5, 9, 100, 1 << 10, true, 1.5f};
static const struct ern_grid_shape plane = {2, 1, 12, 127, 127, 1 << 14, false, 1};
static const struct ern_grid_shape most = {1, ERN_GRID_MAX_LEVELS, 1, 2, 5000, 256, true, 1};

/* Coordinates of all kinds: anywhere inside, exactly on the border of a cell and next to it, at the ends, one step
 * outside, far, no number. */
static float coordinate(const struct ern_grid *grid, size_t i, uint64_t seed) {
  const struct ern_random random = ern_random_at(seed, 1, (uint32_t)i, ERN_RNG_INIT);
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
  float *values = malloc((count > 0 ? count : 1) * sizeof *values);
  assert_non_null(values);
  twin_fill(values, count, seed, scale);
  return values;
}

struct scene {
  struct ern_grid grid;
  size_t n, entries;
  struct twin_span x[ERN_GRID_MAX_DIMS], table;
  struct twin_rows df, size_of_df; /* the same without sign */
};

/* odd: some gradients are infinite or no number */
static struct scene scene_make(const struct ern_grid *grid, size_t n, bool odd) {
  struct scene s = {.grid = *grid, .n = n, .entries = (size_t)grid->entries * (size_t)grid->features};
  const size_t rows = (size_t)(grid->levels * grid->features);
  for (int d = 0; d < grid->dims; d++) {
    float *x = random_values(n, 0, 0);
    for (size_t i = 0; i < n; i++) x[i] = coordinate(grid, i, 10 + (uint64_t)d);
    s.x[d] = twin_reals(&twin, x, n);
    free(x);
  }
  float *table = random_values(s.entries, 5, 1), *df = random_values(rows * n, 6, 1);
  for (size_t k = 0; k < rows * n; k++)
    if (k % 5 == 3) df[k] = 0;
  for (size_t k = 17; odd && k < rows * n; k += 97) df[k] = k % 3 == 0 ? NAN : k % 3 == 1 ? INFINITY : -INFINITY;
  for (size_t k = 3; odd && k < s.entries; k += 1013) table[k] = k % 2 ? NAN : 1e-41f;
  s.table = twin_reals(&twin, table, s.entries);
  s.df = twin_rows_of(&twin, df, (int)rows, n, ERN_PER_SAMPLE);
  for (size_t k = 0; k < rows * n; k++) df[k] = fabsf(df[k]);
  s.size_of_df = twin_rows_of(&twin, df, (int)rows, n, ERN_PER_SAMPLE);
  free(table);
  free(df);
  return s;
}

static struct ern_grid_fwd_args forward_of(const struct scene *s, struct twin_rows f, int k) {
  struct ern_grid_fwd_args args = {.f = f.on[k], .table = s->table.on[k], .grid = &s->grid, .n = s->n};
  for (int d = 0; d < s->grid.dims; d++) args.x[d] = s->x[d].on[k];
  return args;
}

static void check_fwd(const struct scene *s) {
  const struct twin_rows f = twin_rows_of(&twin, NULL, s->grid.levels * s->grid.features, s->n, ERN_PER_SAMPLE);
  struct ern_grid_fwd_args args[2] = {forward_of(s, f, 0), forward_of(s, f, 1)};
  TWIN_RUN(&twin, grid_fwd, args);
  twin_same_rows(&twin, "f", f, 0, 0);
}

enum { BY_TABLE = 1, BY_POSITION = 2 };
struct gradients {
  struct twin_span dtable, dx[ERN_GRID_MAX_DIMS];
};

/* On top of what is there: `scale` times random numbers. */
static struct gradients gradients_of(const struct scene *s, struct twin_rows df, int parts, float scale) {
  struct gradients g = {0};
  float *values = random_values(s->entries > s->n ? s->entries : s->n, 8, scale);
  g.dtable = twin_reals(&twin, values, s->entries);
  for (int d = 0; d < s->grid.dims; d++) g.dx[d] = twin_reals(&twin, values, s->n);
  free(values);
  struct ern_grid_bwd_args args[2];
  for (int k = 0; k < 2; k++) {
    args[k] = (struct ern_grid_bwd_args){.df = df.on[k], .forward = forward_of(s, df, k)};
    if (parts & BY_TABLE) args[k].dtable = g.dtable.on[k];
    for (int d = 0; d < s->grid.dims && parts & BY_POSITION; d++) args[k].dx[d] = g.dx[d].on[k];
  }
  TWIN_RUN(&twin, grid_bwd, args);
  return g;
}

static void check_bwd(const struct scene *s, int parts) {
  const struct gradients g = gradients_of(s, s->df, parts, 0.1f);
  twin_same(&twin, "dtable", g.dtable, 0, 0);
  for (int d = 0; d < s->grid.dims; d++) twin_same(&twin, "dx", g.dx[d], 0, 0);
}

/* In any order: of an entry's terms, at most n, each addition rounds by half a unit of a partial sum, which is at most
 * the sum of the terms' sizes; on both sides: n * 2^-23 * that sum. */
static void check_atomics(const struct scene *s) {
  const struct gradients g = gradients_of(s, s->df, BY_TABLE, 0.1f),
                         sizes = gradients_of(s, s->size_of_df, BY_TABLE, 0);
  float *expected = twin_down(&twin, 0, g.dtable.on[0]), *found = twin_down(&twin, 1, g.dtable.on[1]);
  float *size = twin_down(&twin, 0, sizes.dtable.on[0]);
  for (size_t i = 0; i < s->entries + 2 * TWIN_GUARD; i++) {
    const bool guard = i < TWIN_GUARD || i >= s->entries + TWIN_GUARD;
    const double tolerance = guard ? 0 : (double)s->n * (0.1 + (double)size[i]) * 0x1p-23;
    if (!twin_near(found[i], expected[i], 0, isfinite(tolerance) ? tolerance : 0))
      fail_msg("dtable by atomics [%zu]: %.9g, reference %.9g +- %.1e", i, (double)found[i], (double)expected[i],
               tolerance);
  }
  free(expected);
  free(found);
  free(size);
}

static void check_grid(const struct ern_grid *grid) {
  struct ern_backend *device = twin.backend[1];
  const bool deterministic = device->deterministic;
  for (size_t s = 0; s < TWIN_SIZES; s += twin_is_small() ? 4 : 1) {
    const struct scene scene = scene_make(grid, twin_sizes[s], s % 5 == 4);
    device->deterministic = true;
    check_fwd(&scene);
    check_bwd(&scene, BY_TABLE | BY_POSITION);
    if (s % 4 == 1) check_bwd(&scene, BY_TABLE);
    if (s % 4 == 2) check_bwd(&scene, BY_POSITION);
    device->deterministic = false;
    check_atomics(&scene);
    device->deterministic = deterministic;
    twin_clear(&twin);
  }
}

static void check_shape(const struct ern_grid_shape *shape) {
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, shape), ERN_OK);
  check_grid(&grid);
}

#define SHAPE_TEST(shape)                  \
  static void test_##shape(void **state) { \
    (void)state;                           \
    check_shape(&shape);                   \
  }
SHAPE_TEST(triplane)
SHAPE_TEST(space)
SHAPE_TEST(torso)
SHAPE_TEST(line)
SHAPE_TEST(tiled_space)
SHAPE_TEST(wide)
SHAPE_TEST(plane)
SHAPE_TEST(most)
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
  twin_clear(&twin);
}

/* ---- measure ---- */

static double now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* One plane's levels for `n` samples along rays, 16 a ray, as a marcher makes them. */
static void measure(const struct ern_grid_shape *shape, size_t n, bool by_position) {
  enum { STEPS = 16, REPEATS = 5 };
  static const char *const name[] = {"forward", "table's gradient", "the same by atomics", "positions' gradient"};
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, shape), ERN_OK);
  struct scene s = scene_make(&grid, n, false);
  for (int d = 0; d < grid.dims; d++) {
    float *x = random_values(n, 0, 0);
    for (size_t i = 0; i < n; i++) {
      const float from = twin_random(20 + (uint64_t)d, i / STEPS, 0.4f),
                  to = twin_random(30 + (uint64_t)d, i / STEPS, 0.4f);
      x[i] = from + (to - from) * (float)(i % STEPS) / STEPS;
    }
    s.x[d] = twin_reals(&twin, x, n);
    free(x);
  }
  const struct twin_rows f = twin_rows_of(&twin, NULL, grid.levels * grid.features, n, ERN_PER_SAMPLE);
  const struct twin_span dtable = twin_take(&twin, ERN_ELEMENT_REAL, s.entries),
                         dx = twin_take(&twin, ERN_ELEMENT_REAL, n);
  for (int what = 0; what < (by_position ? 4 : 3); what++) {
    double best[2] = {1e9, 1e9};
    twin.backend[1]->deterministic = what != 2;
    for (int repeat = 0; repeat < REPEATS; repeat++) {
      for (int k = 0; k < 2; k++) {
        struct ern_grid_fwd_args forward = forward_of(&s, f, k);
        struct ern_grid_bwd_args backward = {.df = s.df.on[k], .forward = forward};
        float sink;
        if (what != 3) backward.dtable = dtable.on[k];
        for (int d = 0; d < grid.dims && what == 3; d++) backward.dx[d] = dx.on[k];
        const double start = now();
        struct ern_backend *backend = twin.backend[k];
        support_ok(context, what == 0 ? backend->grid_fwd(twin.stream[k], &forward)
                                      : backend->grid_bwd(twin.stream[k], &backward));
        support_ok(context, backend->download_reals(twin.stream[k], &sink, dtable.on[k], 1)); /* it is done */
        const double seconds = now() - start;
        if (seconds < best[k]) best[k] = seconds;
      }
    }
    printf("%d levels, %zu samples, %-20s: reference (1 thread) %7.2f ms, device %7.2f ms, %.2f times\n", grid.levels,
           n, name[what], best[0] * 1e3, best[1] * 1e3, best[0] / best[1]);
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
    const struct ern_grid_shape portrait = {2, 16, 2, 16, 2048, 1 << 16, false, 1};
    set_up(NULL);
    measure(&triplane, 183000, false);
    measure(&triplane, 2000, false);
    measure(&portrait, 65536, true);
    return tear_down(NULL);
  }
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_triplane),   cmocka_unit_test(test_space),
                                     cmocka_unit_test(test_torso),      cmocka_unit_test(test_line),
                                     cmocka_unit_test(test_wide),       cmocka_unit_test(test_tiled_space),
                                     cmocka_unit_test(test_plane),      cmocka_unit_test(test_most),
                                     cmocka_unit_test(test_odd_modulo), cmocka_unit_test(test_nothing)};
  return cmocka_run_group_tests_name("opencl grids", tests, set_up, tear_down);
}
