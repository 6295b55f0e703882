/* SPDX-License-Identifier: MIT
 * Level tables of the grids, and which entries of the table a sample reads. */
#include "../support.h"

#include <math.h>

#include "hashgrid/hashgrid.h"

static const struct ern_grid_shape triplane = {2, 14, 1, 64, 512, 1 << 14, true, 1};
static const struct ern_grid_shape space = {3, 16, 2, 64, 512, 1 << 14, true, 1};
static const struct ern_grid_shape torso = {2, 16, 2, 16, 2048, 1 << 16, false, 1};

static void build(struct ern_grid *grid, struct ern_grid_shape shape) {
  assert_int_equal(ern_grid_build(grid, &shape), ERN_OK);
}

static void test_totals(void **state) {
  (void)state;
  struct ern_grid grid;
  build(&grid, triplane);
  assert_int_equal(grid.entries, 191896);
  struct ern_grid_shape public_code = triplane;
  public_code.levels = 12;
  build(&grid, public_code);
  assert_int_equal(grid.entries, 163584);
  build(&grid, torso);
  assert_int_equal(grid.entries, 555520);
  build(&grid, space);
  assert_int_equal(grid.entries, 16 << 14);
  for (int l = 0; l < 16; l++) assert_int_equal(grid.level[l].offset, l << 14);
}

/* The scales are part of the model: base 64 and 512 exactly, growth between, float32 at every step. */
static void test_levels(void **state) {
  (void)state;
  struct ern_grid grid;
  build(&grid, triplane);
  assert_true(grid.level[0].scale == 63 && grid.level[0].resolution == 64 && grid.level[0].size == 4232);
  assert_true(fabsf(grid.level[13].scale - 511) < 1e-3f);
  for (int l = 0; l < 14; l++) {
    const double scale = 64 * pow(8, l / 13.0) - 1;
    assert_true(fabs(grid.level[l].scale - scale) <= 1e-6 * scale);
    assert_int_equal(grid.level[l].resolution, (int)ceilf(grid.level[l].scale) + 1);
    assert_true(grid.level[l].size % 8 == 0 && grid.level[l].size <= 1 << 14);
    if (l > 0) assert_int_equal(grid.level[l].offset, grid.level[l - 1].offset + grid.level[l - 1].size);
  }
  struct ern_grid_shape one = triplane; /* a single level: the base alone */
  one.levels = 1;
  build(&grid, one);
  assert_true(grid.level[0].scale == 63 && grid.entries == 4232);
}

static void test_refused(void **state) {
  (void)state;
  struct ern_grid_shape bad[12];
  for (int k = 0; k < 12; k++) bad[k] = triplane;
  bad[0].dims = 0;
  bad[1].dims = 4;
  bad[2].levels = 0;
  bad[3].levels = ERN_GRID_MAX_LEVELS + 1;
  bad[4].features = 0;
  bad[5].base = 0;
  bad[6].finest = 63;
  bad[7].finest = 1 << 21;
  bad[8].table_limit = 1000;
  bad[9].table_limit = 0;
  bad[10].bound = 0;
  bad[11].bound = NAN;
  struct ern_grid grid;
  for (int k = 0; k < 12; k++) assert_int_equal(ern_grid_build(&grid, &bad[k]), ERN_E_ARGUMENT);
}

/* The rule in 64-bit integers, as the PyTorch program states it. */
static uint32_t rule(const struct ern_grid *grid, const struct ern_grid_level *level, const uint64_t *cell) {
  static const uint64_t prime[3] = {1, 2654435761u, 805459861u};
  uint64_t stride = 1, index = 0;
  int d = 0;
  while (d < grid->dims && stride <= level->size) {
    index += cell[d] * stride;
    stride *= level->resolution + 1;
    d++;
  }
  if (grid->hashed && stride > level->size) {
    index = 0;
    for (d = 0; d < grid->dims; d++) index ^= cell[d] * prime[d] & 0xffffffffu;
  }
  return level->offset + (uint32_t)((index & 0xffffffffu) % level->size);
}

/* With a single 1 in the table, at each corner's entry in turn, a level answers with the weights that belong there. */
static void check_entries(const struct ern_grid_shape *shape) {
  struct ern_grid grid;
  build(&grid, *shape);
  const size_t features = (size_t)grid.features, rows = (size_t)grid.levels * features;
  float *table = calloc(grid.entries * features, sizeof *table), f[64];
  assert_non_null(table);
  assert_true(rows <= 64);
  for (int l = 0; l < grid.levels; l++) {
    const struct ern_grid_level *level = &grid.level[l];
    for (uint32_t k = 0; k < 40; k++) {
      float x[ERN_GRID_MAX_DIMS];
      const float *const at[ERN_GRID_MAX_DIMS] = {&x[0], &x[1], &x[2]};
      uint64_t cell[ERN_GRID_MAX_DIMS];
      double t[ERN_GRID_MAX_DIMS];
      for (uint32_t d = 0; d < (uint32_t)grid.dims; d++) {
        const float wish = (float)((k * 7919 + d * 104729) % 1000) / 1000; /* anywhere in [0, 1) */
        x[d] = (wish * 2 - 1) * grid.bound;
        const float p = (x[d] + grid.bound) / (2 * grid.bound) * level->scale + 0.5f;
        cell[d] = (uint64_t)p;
        t[d] = (double)p - (double)cell[d];
      }
      for (int b = 0; b < 1 << grid.dims; b++) {
        uint64_t corner[ERN_GRID_MAX_DIMS];
        for (int d = 0; d < grid.dims; d++) corner[d] = cell[d] + (uint64_t)(b >> d & 1);
        const uint32_t entry = rule(&grid, level, corner);
        double expected = 0; /* corners may share an entry */
        for (int other = 0; other < 1 << grid.dims; other++) {
          double weight = 1;
          for (int d = 0; d < grid.dims; d++) {
            corner[d] = cell[d] + (uint64_t)(other >> d & 1);
            weight *= (other >> d & 1) != 0 ? t[d] : 1 - t[d];
          }
          if (rule(&grid, level, corner) == entry) expected += weight;
        }
        const size_t feature = k % features;
        table[entry * features + feature] = 1;
        ern_grid_fwd_ref(f, 1, at, table, &grid, l, l + 1, 1);
        table[entry * features + feature] = 0;
        for (size_t c = 0; c < features; c++) {
          const double found = f[(size_t)l * features + c];
          assert_true(fabs(found - (c == feature ? expected : 0)) <= 1e-6);
        }
      }
    }
  }
  free(table);
}

static void test_entries(void **state) {
  (void)state;
  check_entries(&triplane);
  check_entries(&space);
  check_entries(&torso);
  const struct ern_grid_shape tiled_space = {3, 4, 2, 3, 60, 512, false, 2};
  check_entries(&tiled_space);
}

/* Outside, by one step of a float, and no number: zeros. At the very ends: not. */
static void test_outside(void **state) {
  (void)state;
  struct ern_grid grid;
  build(&grid, triplane);
  float *table = malloc(grid.entries * sizeof *table), f[14];
  assert_non_null(table);
  for (uint32_t i = 0; i < grid.entries; i++) table[i] = 1;
  const float inside[] = {-1, -0.5f, 0, 1},
              outside[] = {nextafterf(1, 2), nextafterf(-1, -2), NAN, INFINITY, -INFINITY};
  const float middle = 0.3f;
  for (size_t k = 0; k < 5; k++) {
    for (int second = 0; second < 2; second++) {
      const float *const at[ERN_GRID_MAX_DIMS] = {second ? &middle : &outside[k], second ? &outside[k] : &middle};
      ern_grid_fwd_ref(f, 1, at, table, &grid, 0, 14, 1);
      for (int l = 0; l < 14; l++) assert_true(f[l] == 0);
    }
  }
  for (size_t k = 0; k < 4; k++) {
    const float *const at[ERN_GRID_MAX_DIMS] = {&inside[k], &inside[3 - k]};
    ern_grid_fwd_ref(f, 1, at, table, &grid, 0, 14, 1);
    for (int l = 0; l < 14; l++) assert_true(fabsf(f[l] - 1) <= 1e-6f); /* the weights of the corners sum to 1 */
  }
  free(table);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_totals),  cmocka_unit_test(test_levels),  cmocka_unit_test(test_refused),
      cmocka_unit_test(test_entries), cmocka_unit_test(test_outside),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
