/* SPDX-License-Identifier: MIT
 * Backward of the grids, by table and by position, against central differences in double. */
#define ERN_DOUBLE
#include "difference.h"

#include "hashgrid/hashgrid.h"

enum { N = 40, STRIDE = N + 3, MAX_ROWS = 32, MAX_ENTRIES = 4000, MAX_FEATURES = 2 };

struct encoding {
  struct ern_grid grid;
  int begin, end; /* levels that are looked at */
  double table[MAX_ENTRIES * MAX_FEATURES], dtable[MAX_ENTRIES * MAX_FEATURES];
  double x[ERN_GRID_MAX_DIMS][N], dx[ERN_GRID_MAX_DIMS][N];
  double f[MAX_ROWS * STRIDE], df[MAX_ROWS * STRIDE];
};

static double encoding_loss(void *user) {
  struct encoding *enc = user;
  const double *const x[ERN_GRID_MAX_DIMS] = {enc->x[0], enc->x[1], enc->x[2]};
  ern_grid_fwd_ref64(enc->f, STRIDE, x, enc->table, &enc->grid, enc->begin, enc->end, N);
  double loss = 0;
  for (int r = enc->begin * enc->grid.features; r < enc->end * enc->grid.features; r++) {
    for (int i = 0; i < N; i++) loss += enc->f[r * STRIDE + i] * enc->df[r * STRIDE + i];
  }
  return loss;
}

/* The cells that the samples are in, and whether they are inside. */
static uint64_t encoding_piece(void *user) {
  const struct encoding *enc = user;
  uint64_t hash = 0xcbf29ce484222325u;
  for (int l = enc->begin; l < enc->end; l++) {
    for (int d = 0; d < enc->grid.dims; d++) {
      for (int i = 0; i < N; i++) {
        const double u = (enc->x[d][i] + enc->grid.bound) / (2.0 * enc->grid.bound);
        const bool inside = u >= 0 && u <= 1;
        hash = difference_hash(hash, inside ? (uint64_t)(u * enc->grid.level[l].scale + 0.5) : UINT64_MAX);
      }
    }
  }
  return hash;
}

static void check_levels(struct encoding *enc, int begin, int end) {
  const size_t values = (size_t)enc->grid.entries * (size_t)enc->grid.features;
  enc->begin = begin;
  enc->end = end;
  for (size_t i = 0; i < values; i++) enc->dtable[i] = 1;
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) {
    for (int i = 0; i < N; i++) enc->dx[d][i] = 1;
  }
  double *const dx[ERN_GRID_MAX_DIMS] = {enc->dx[0], enc->dx[1], enc->dx[2]};
  const double *const x[ERN_GRID_MAX_DIMS] = {enc->x[0], enc->x[1], enc->x[2]};
  ern_grid_bwd_ref64(enc->dtable, dx, enc->df, STRIDE, x, enc->table, &enc->grid, begin, end, N);
  for (size_t i = 0; i < values; i++) enc->dtable[i] -= 1;
  for (int d = 0; d < enc->grid.dims; d++) {
    for (int i = 0; i < N; i++) enc->dx[d][i] -= 1;
  }
  const struct difference of = {encoding_loss, encoding_piece, enc}, linear = {encoding_loss, NULL, enc};
  difference_check(&linear, "dtable", enc->table, enc->dtable, values, 1);
  for (int d = 0; d < enc->grid.dims; d++) difference_check(&of, "dx", enc->x[d], enc->dx[d], N, 1);
}

static void check_grid(const struct ern_grid_shape *shape) {
  static struct encoding enc;
  memset(&enc, 0, sizeof enc);
  assert_int_equal(ern_grid_build(&enc.grid, shape), ERN_OK);
  assert_true(enc.grid.entries <= MAX_ENTRIES && shape->levels * shape->features <= MAX_ROWS);
  difference_fill(enc.table, (size_t)enc.grid.entries * (size_t)shape->features, 1, 1);
  difference_fill(enc.df, sizeof enc.df / sizeof *enc.df, 1, 2);
  for (int d = 0; d < shape->dims; d++) difference_fill(enc.x[d], N, 1.05 * shape->bound, 10 + (uint64_t)d);
  enc.x[0][3] = NAN; /* no gradient from here, and none to here */
  enc.x[shape->dims - 1][5] = HUGE_VAL;
  check_levels(&enc, 0, shape->levels);
  for (int l = 0; l < shape->levels; l += 2) check_levels(&enc, l, l + 1);
}

static void test_hashed_plane(void **state) {
  (void)state;
  const struct ern_grid_shape shape = {
      .dims = 2, .levels = 6, .features = 1, .base = 4, .finest = 64, .table_limit = 256, .hashed = true, .bound = 1};
  check_grid(&shape);
}

static void test_hashed_space(void **state) {
  (void)state;
  const struct ern_grid_shape shape = {.dims = 3,
                                       .levels = 4,
                                       .features = 2,
                                       .base = 3,
                                       .finest = 40,
                                       .table_limit = 512,
                                       .hashed = true,
                                       .bound = 2.5f};
  check_grid(&shape);
}

static void test_tiled_plane(void **state) {
  (void)state;
  const struct ern_grid_shape shape = {
      .dims = 2, .levels = 7, .features = 2, .base = 4, .finest = 128, .table_limit = 512, .hashed = false, .bound = 1};
  check_grid(&shape);
}

static void test_line(void **state) {
  (void)state;
  const struct ern_grid_shape shape = {
      .dims = 1, .levels = 3, .features = 2, .base = 5, .finest = 90, .table_limit = 64, .hashed = true, .bound = 0.5f};
  check_grid(&shape);
}

/* Either gradient alone is the same as both together; a sample outside leaves no trace. */
static void test_alone(void **state) {
  (void)state;
  const struct ern_grid_shape shape = {
      .dims = 2, .levels = 3, .features = 2, .base = 4, .finest = 16, .table_limit = 64, .hashed = true, .bound = 1};
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, &shape), ERN_OK);
  double table[2 * 192], dtable[3][2 * 192] = {{0}}, dx[3][2][N] = {{{0}}}, x[2][N], df[6 * N];
  assert_true(grid.entries <= 192);
  difference_fill(table, 2 * 192, 1, 1);
  difference_fill(df, 6 * N, 1, 2);
  difference_fill(x[0], N, 1, 3);
  difference_fill(x[1], N, 1, 4);
  const double *const at[ERN_GRID_MAX_DIMS] = {x[0], x[1]};
  double *const none[ERN_GRID_MAX_DIMS] = {NULL};
  double *const both[ERN_GRID_MAX_DIMS] = {dx[0][0], dx[0][1]}, *const only[ERN_GRID_MAX_DIMS] = {dx[1][0], dx[1][1]};
  ern_grid_bwd_ref64(dtable[0], both, df, N, at, table, &grid, 0, 3, N);
  ern_grid_bwd_ref64(dtable[1], none, df, N, at, table, &grid, 0, 3, N);
  ern_grid_bwd_ref64(NULL, only, df, N, at, table, &grid, 0, 3, N);
  assert_memory_equal(dtable[0], dtable[1], sizeof dtable[0]);
  assert_memory_equal(dx[0], dx[1], sizeof dx[0]);
  for (int i = 0; i < N; i++) x[i % 2][i] = i % 3 == 0 ? NAN : i % 3 == 1 ? nextafter(1, 2) : -1 - 1e-9;
  double *const still[ERN_GRID_MAX_DIMS] = {dx[2][0], dx[2][1]};
  ern_grid_bwd_ref64(dtable[2], still, df, N, at, table, &grid, 0, 3, N);
  for (size_t i = 0; i < 2 * 192; i++) assert_true(dtable[2][i] == 0);
  for (int i = 0; i < N; i++) assert_true(dx[2][0][i] == 0 && dx[2][1][i] == 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_hashed_plane), cmocka_unit_test(test_hashed_space), cmocka_unit_test(test_tiled_plane),
      cmocka_unit_test(test_line),         cmocka_unit_test(test_alone),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
