/* SPDX-License-Identifier: MIT
 * Looking up a multiresolution grid where a coordinate has no cell, or float has no digits left for it, and the sums
 * into one cell (docs/numerics.md). Everywhere the same bits as in float. */
#include "hashgrid/hashgrid.h"
#include "machines.h"

static struct ern_grid hashed2d, hashed3d, torso2d;

static void make(struct ern_grid *grid, int dims, int levels, int features, int base, int finest, uint32_t limit,
                 bool hashed, float bound) {
  const struct ern_grid_shape shape = {dims, levels, features, base, finest, limit, hashed, bound};
  assert_int_equal(ern_grid_build(grid, &shape), ERN_OK);
}

/* A grid at n points: values, gradients of table and points, for df = `gradient`. */
struct look {
  const struct ern_grid *grid;
  struct many f, dtable, dx[ERN_GRID_MAX_DIMS];
};
static struct look look;

static void look_up(const struct ern_grid *grid, const float *table, const float *x, size_t n, float gradient) {
  machines_clear();
  const size_t rows = (size_t)(grid->levels * grid->features), values = (size_t)grid->entries * (size_t)grid->features;
  float *ones = malloc((rows * n + 1) * sizeof *ones);
  assert_non_null(ones);
  for (size_t i = 0; i < rows * n; i++) ones[i] = gradient;
  const struct many held = many_reals(table, values), df = many_reals(ones, rows * n);
  struct many at[ERN_GRID_MAX_DIMS] = {0};
  look = (struct look){.grid = grid, .f = many_empty(rows * n), .dtable = many_zeros(values)};
  for (size_t d = 0; d < (size_t)grid->dims; d++) at[d] = many_reals(x + d * n, n), look.dx[d] = many_zeros(n);
  struct ern_grid_fwd_args forward[MACHINES];
  for (int k = 0; k < machines.count; k++) {
    forward[k] = (struct ern_grid_fwd_args){
        .f = {look.f.on[k], n, (int)rows, ERN_PER_SAMPLE}, .table = held.on[k], .grid = grid, .n = n};
    for (int d = 0; d < grid->dims; d++) forward[k].x[d] = at[d].on[k];
  }
  ON_EACH(grid_fwd, ern_grid_fwd_args, forward[k])
  ON_EACH(grid_bwd, ern_grid_bwd_args,
          {.dtable = look.dtable.on[k],
           .dx = {look.dx[0].on[k], look.dx[1].on[k], look.dx[2].on[k]},
           .df = {df.on[k], n, (int)rows, ERN_PER_SAMPLE},
           .forward = forward[k]})
  free(ones);
}

static float *table_of(const struct ern_grid *grid, float base, float spread) {
  const size_t count = (size_t)grid->entries * (size_t)grid->features;
  float *table = malloc(count * sizeof *table);
  assert_non_null(table);
  for (size_t i = 0; i < count; i++) table[i] = base + (spread != 0 ? machines_random(5, i, spread) : 0);
  return table;
}

/* All pairs (or triples with a fixed third) of hard coordinates, [dims][n]. */
enum { HARD = 17, HARD_POINTS = HARD * HARD };
static void hard_points(float x[3 * HARD_POINTS], bool inside[HARD_POINTS]) {
  const float at[HARD] = {
      0,          -0.0f,    1,         -1,      nextafterf(1, 2), nextafterf(-1, -2), nextafterf(1, 0), NAN,
      -NAN,       INFINITY, -INFINITY, FLT_MAX, -FLT_MAX,         FLT_TRUE_MIN,       -FLT_TRUE_MIN,    0.5f,
      -0.9999999f};
  for (size_t i = 0; i < HARD_POINTS; i++) {
    x[i] = at[i / HARD], x[HARD_POINTS + i] = at[i % HARD], x[2 * HARD_POINTS + i] = 1;
    inside[i] = fabsf(x[i]) <= 1 && fabsf(x[HARD_POINTS + i]) <= 1;
  }
}

static void each_grid(void (*check)(const struct ern_grid *grid)) {
  check(&hashed2d);
  check(&hashed3d);
  check(&torso2d);
}

/* A table of ones is 1 inside and 0 outside: weights are a partition of unity, to the rounding of 3 products and 8
 * sums. */
static void check_ends(const struct ern_grid *grid) {
  static float x[3 * HARD_POINTS];
  bool inside[HARD_POINTS];
  hard_points(x, inside);
  float *table = table_of(grid, 1, 0);
  look_up(grid, table, x, HARD_POINTS, 1);
  expect_within("f", look.f, 0, 1 + 8 * 0x1p-23);
  expect_truth("f", look.f, 0, 12 * 0x1p-23);
  double *f = many_values(0, look.f);
  for (size_t i = 0; i < look.f.on[0].count; i++) {
    const double found = f[MACHINE_GUARD + i];
    if (inside[i % HARD_POINTS] ? fabs(found - 1) > 1e-12 : found != 0)
      fail_msg("point %zu: %g", i % HARD_POINTS, found);
  }
  free(f);
  free(table);
}
/* case: pairs of 0, -0, 1, -1, one ulp more and less, NaN, infinity, denormal | plain code: reads beyond the last cell
 * | here: inside: weights sum to 1; outside: 0 | bound: 8 x 2^-23 */
static void test_coordinates_at_the_ends_long(void **state) {
  (void)state;
  each_grid(check_ends);
}

/* case: one ulp outside the cube | plain code: clamped or wrapped | here: 0, no gradient | bound: exact */
/* One ulp outside is outside: the entry beyond the last cell is another cell's. */
static void test_coordinate_one_ulp_outside(void **state) {
  (void)state;
  const float y[8] = {1, nextafterf(1, 2), -1, nextafterf(-1, -2), 0, 0, 0, 0};
  float *table = table_of(&hashed2d, 2, 0.5f);
  look_up(&hashed2d, table, y, 4, 1);
  for (size_t l = 0; l < 14; l++) {
    expect_at("one ulp above", look.f, 4 * l + 1, 0, 0);
    expect_at("one ulp below", look.f, 4 * l + 3, 0, 0);
  }
  expect_within("f", look.f, 0, 2.5001);
  expect_at("dx above", look.dx[0], 1, 0, 0);
  expect_at("dx below", look.dx[0], 3, 0, 0);
  free(table);
}

/* Not a number, or infinite: zeros, and no gradient anywhere. (uint32_t)NaN, as an index, would be read anywhere.) */
static void check_no_number(const struct ern_grid *grid) {
  const float odd[] = {NAN, INFINITY, -INFINITY, -NAN, FLT_MAX};
  enum { N = 19 };
  float x[3 * N] = {0};
  for (size_t i = 0; i < N; i++) x[(i % (size_t)grid->dims) * N + i] = odd[i % COUNT_OF(odd)];
  float *table = table_of(grid, 1, 1);
  look_up(grid, table, x, N, 1);
  expect_within("f", look.f, 0, 0);
  expect_within("dtable", look.dtable, 0, 0);
  for (int d = 0; d < grid->dims; d++) expect_within("dx", look.dx[d], 0, 0);
  free(table);
}
/* case: NaN, infinity, FLT_MAX | plain code: `(uint32_t)NaN` is an index | here: 0; no gradient | bound: exact */
static void test_coordinate_that_is_no_number(void **state) {
  (void)state;
  each_grid(check_no_number);
}

/* case: -0 and the smallest denormal beside 0 | plain code: the sign picks a cell | here: as 0 | bound: exact, 1e-9 */
static void test_coordinate_minus_zero(void **state) {
  (void)state;
  const float x[6] = {0, -0.0f, -FLT_TRUE_MIN, 0, -0.0f, FLT_TRUE_MIN};
  float *table = table_of(&hashed2d, 0, 1);
  look_up(&hashed2d, table, x, 3, 1);
  for (int k = 0; k < machines.count; k++) {
    double *f = many_values(k, look.f) + MACHINE_GUARD;
    for (size_t l = 0; l < 14; l++) {
      assert_true(f[3 * l] == f[3 * l + 1]);
      assert_true(fabs(f[3 * l] - f[3 * l + 2]) < 1e-30 * 512 + 1e-9);
    }
    free(f - MACHINE_GUARD);
  }
  free(table);
}

/* case: a level of 2^20 cells: an eighth of a cell is lost | plain code: values outside the corners' | here: weights in
 * [0, 1] | bound: 8 x scale x 2^-23 */
/* p = u scale + 1/2 has 2^-23 scale of error: at 2^20, the finest that can be built, an eighth of a cell. A value stays
 * between those of the corners, as float and double are at most that far apart on a surface of gradient 2 a cell. */
static void test_level_positions_lose_the_cell(void **state) {
  (void)state;
  struct ern_grid fine;
  enum { N = 400 };
  float x[2 * N];
  make(&fine, 2, 14, 1, 64, 1 << 20, 1 << 14, true, 1);
  for (size_t i = 0; i < 2 * N; i++)
    x[i] = i % 3 == 0 ? 1 - fabsf(machines_random(8, i, 1e-6f)) : machines_random(9, i, 1);
  float *table = table_of(&fine, 0, 1);
  look_up(&fine, table, x, N, 1);
  expect_within("f", look.f, -1 - 8 * 0x1p-23, 1 + 8 * 0x1p-23);
  const double lost = (double)fine.level[13].scale * 0x1p-23;
  assert_true(lost > 0.1); /* the case is one */
  expect_truth("f", look.f, 0, 2 * 2 * 2 * lost);
  /* each of 14 levels adds at most scale/2 times the range of the values, 2 */
  expect_within("dx", look.dx[0], -14 * 0x1p20, 14 * 0x1p20);
  free(table);
}

/* On a border t is 0 or rounds to 1: the value is the corner's, the gradient finite. */
static void check_borders(const struct ern_grid *grid) {
  enum { N = 257 };
  static float x[3 * N];
  for (size_t i = 0; i < N; i++) {
    const struct ern_grid_level *level = &grid->level[i % (size_t)grid->levels];
    const float u = ((float)(i % level->resolution) + 0.5f) / level->scale, border = fminf(2 * u - 1, 1);
    for (size_t d = 0; d < 3; d++) x[d * N + i] = i % 3 == d ? nextafterf(border, (float)d - 1) : border;
  }
  float *table = table_of(grid, 0, 1);
  look_up(grid, table, x, N, 1);
  expect_within("f", look.f, -1.0001, 1.0001);
  const double steepest = (double)grid->level[grid->levels - 1].scale;
  for (int d = 0; d < grid->dims; d++)
    expect_within("dx", look.dx[d], -steepest * grid->levels * grid->features,
                  steepest * grid->levels * grid->features);
  free(table);
}
/* case: on borders of cells, one ulp beside | plain code: cell and weight from different roundings | here: both from
 * one rounded position | bound: within the table's range */
static void test_coordinates_on_cell_borders(void **state) {
  (void)state;
  each_grid(check_borders);
}

static void check_huge(const struct ern_grid *grid) {
  enum { N = 35 };
  static float x[3 * N];
  for (size_t i = 0; i < 3 * N; i++) x[i] = machines_random(4, i, 1);
  float *table = table_of(grid, 0, 1e38f);
  look_up(grid, table, x, N, 1e-8f);
  expect_within("f of 1e38", look.f, -1.00001e38, 1.00001e38);
  expect_truth("f of 1e38", look.f, 0, 3e35); /* positions: 2^-23 of 2048 cells, times two corners */
  for (int d = 0; d < grid->dims; d++) expect_within("dx of 1e38", look.dx[d], -1e36, 1e36);
  for (size_t i = 0; i < (size_t)grid->entries * (size_t)grid->features; i++)
    table[i] = (float)(1 + i % 7) * FLT_TRUE_MIN;
  look_up(grid, table, x, N, 1e30f);
  expect_within("f of denormals", look.f, 0, 8 * (double)FLT_TRUE_MIN);
  expect_within("dtable of 1e30", look.dtable, 0, 36e30);
  free(table);
}
/* case: tables of 1e38 and denormals, gradients of 1e30 | plain code: differences overflow | here: products with
 * weights in [0, 1] only | bound: within the table's range */
static void test_tables_of_huge_and_denormal_values(void **state) {
  (void)state;
  each_grid(check_huge);
}

/* case: 2^20 gradients into one cell | plain code: sums in float lose 2^-4 | here: the same: entries share a batch,
 * AdamW divides by the gradient's size | bound: 2^-4 */
/* A batch whose samples lie in one cell: 2^20 gradients into the same four entries of a level, in float, in order. Each
 * sum is rounded 2^20 times at most, by 2^-24 of what it has come to: 2^-4 in the worst case, where all round alike. */
static void test_million_gradients_into_one_cell(void **state) {
  (void)state;
  enum { N = 1 << 20 };
  struct ern_grid small;
  make(&small, 2, 1, 1, 64, 64, 1 << 14, true, 1);
  float *x = malloc(2 * N * sizeof *x), *table = table_of(&small, 0, 1);
  assert_non_null(x);
  for (size_t i = 0; i < 2 * N; i++) x[i] = 0.3f;
  look_up(&small, table, x, N, 0.1f);
  expect_truth("dtable", look.dtable, N * 0x1p-24, 0);
  expect_within("dtable", look.dtable, 0, 0.1 * N * (1 + 0x1p-4));
  free(x);
  free(table);
}

/* case: no point, one point | plain code: a full register is read | here: nothing touched, one written | bound: exact
 */
static void test_no_point_and_one_point(void **state) {
  (void)state;
  const float x[3] = {0.25f, -0.25f, 0.75f};
  float *table = table_of(&hashed3d, 0, 1);
  look_up(&hashed3d, table, x, 0, 1);
  expect_within("dtable of none", look.dtable, 0, 0);
  look_up(&hashed3d, table, x, 1, 1);
  expect_within("f of one", look.f, -1, 1);
  free(table);
}

/* case: boxes of 1e-30 and 1e30 | plain code: x + b leaves float | here: u is 0 and 1 at the ends | bound: 8 x 2^-23 */
/* Boxes so small or large that 2 b or x + b are at the ends of float. */
static void test_tiny_and_huge_box(void **state) {
  (void)state;
  static const float bounds[] = {1e-30f, 1e-5f, 3, 1e30f};
  for (size_t k = 0; k < COUNT_OF(bounds); k++) {
    struct ern_grid box;
    enum { N = 33 };
    float x[2 * N];
    make(&box, 2, 14, 1, 64, 512, 1 << 14, true, bounds[k]);
    for (size_t i = 0; i < 2 * N; i++) x[i] = machines_random(2, i, 1) * bounds[k];
    x[0] = bounds[k], x[1] = -bounds[k], x[2] = nextafterf(bounds[k], INFINITY);
    float *table = table_of(&box, 1, 0);
    look_up(&box, table, x, N, 1e-5f);
    for (size_t l = 0; l < 14; l++) {
      expect_at("at the end", look.f, l * N, 1, 8 * 0x1p-23);
      expect_at("at the begin", look.f, l * N + 1, 1, 8 * 0x1p-23);
      expect_at("outside", look.f, l * N + 2, 0, 0);
    }
    free(table);
  }
}

static int open_grids(void **state) {
  make(&hashed2d, 2, 14, 1, 64, 512, 1 << 14, true, 1);
  make(&hashed3d, 3, 16, 2, 64, 512, 1 << 14, true, 1);
  make(&torso2d, 2, 16, 2, 16, 2048, 1 << 16, false, 1);
  return open_hosts(state);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_coordinates_at_the_ends_long),
      cmocka_unit_test(test_coordinate_one_ulp_outside),
      cmocka_unit_test(test_coordinate_that_is_no_number),
      cmocka_unit_test(test_coordinate_minus_zero),
      cmocka_unit_test(test_level_positions_lose_the_cell),
      cmocka_unit_test(test_coordinates_on_cell_borders),
      cmocka_unit_test(test_tables_of_huge_and_denormal_values),
      cmocka_unit_test(test_million_gradients_into_one_cell),
      cmocka_unit_test(test_no_point_and_one_point),
      cmocka_unit_test(test_tiny_and_huge_box),
  };
  return cmocka_run_group_tests(tests, open_grids, close_machines);
}
