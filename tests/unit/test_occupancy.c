/* SPDX-License-Identifier: MIT
 * The occupancy grid against plain loops over x, y, z. */
#include "../support.h"

#include <math.h>

#include "core/rng.h"
#include "render/march_ops.h"
#include "render/morton.h"
#include "render/occupancy_ops.h"

enum { SIDE = ERN_OCCUPANCY_SIDE, CELLS = ERN_OCCUPANCY_CELLS };

static float uniform(uint64_t seed, uint32_t at) {
  return ern_uniform(ern_random_at(seed, 0, at, ERN_RNG_INIT).word[0]);
}

static float *values(void) {
  float *memory = calloc(CELLS, sizeof *memory);
  assert_non_null(memory);
  return memory;
}

/* Bit by bit. */
static uint32_t number_of(uint32_t x, uint32_t y, uint32_t z) {
  uint32_t number = 0;
  for (uint32_t bit = 0; bit < 10; bit++) {
    number |= (x >> bit & 1) << 3 * bit | (y >> bit & 1) << (3 * bit + 1) | (z >> bit & 1) << (3 * bit + 2);
  }
  return number;
}

static void test_morton(void **state) {
  (void)state;
  assert_int_equal(ern_morton(1, 0, 0), 1);
  assert_int_equal(ern_morton(0, 1, 0), 2);
  assert_int_equal(ern_morton(0, 0, 1), 4);
  assert_int_equal(ern_morton(127, 127, 127), CELLS - 1);
  for (uint32_t v = 0; v < 1024; v++) {
    assert_int_equal(ern_morton_spread(v), number_of(v, 0, 0));
    assert_int_equal(ern_morton_gather(ern_morton_spread(v)), v);
  }
  for (uint32_t k = 0; k < CELLS; k++) {
    const uint32_t x = ern_morton_gather(k), y = ern_morton_gather(k >> 1), z = ern_morton_gather(k >> 2);
    if (ern_morton(x, y, z) != k || x >= SIDE || y >= SIDE || z >= SIDE) fail_msg("cell %u", k);
  }
  for (uint32_t k = 0; k < 1000; k++) {
    const struct ern_random r = ern_random_at(1, 2, k, ERN_RNG_INIT);
    const uint32_t x = r.word[0] % SIDE, y = r.word[1] % SIDE, z = r.word[2] % SIDE;
    assert_int_equal(ern_morton(x, y, z), number_of(x, y, z));
  }
}

/* ---- marking ---- */

/* -1 unseen, 0 seen, 1 too near the edge of a view to tell */
static int seen_by(const struct ern_view *views, size_t count, uint32_t x, uint32_t y, uint32_t z, double bound) {
  const double p[3] = {(2 * x / 127.0 - 1) * bound * 127 / 128, (2 * y / 127.0 - 1) * bound * 127 / 128,
                       (2 * z / 127.0 - 1) * bound * 127 / 128};
  int said = -1;
  for (size_t k = 0; k < count; k++) {
    const struct ern_view *view = &views[k];
    double q[3] = {0, 0, 0};
    for (size_t row = 0; row < 3; row++) {
      for (size_t axis = 0; axis < 3; axis++) {
        q[axis] += (double)view->pose[4 * row + axis] * (p[row] - (double)view->pose[4 * row + 3]);
      }
    }
    const double room_x = (double)(view->cx / view->focal) * q[2] + 2.0 / 128 * bound - fabs(q[0]);
    const double room_y = (double)(view->cy / view->focal) * q[2] + 2.0 / 128 * bound - fabs(q[1]);
    const double margin = fmin(fmin(room_x, room_y), q[2]);
    if (margin > 1e-5) return 0;
    if (margin > -1e-5) said = 1;
  }
  return said;
}

static size_t check_mark(const struct ern_view *views, size_t count, float bound) {
  float *grid = values();
  for (uint32_t k = 0; k < CELLS; k++) grid[k] = 3;
  ern_occupancy_mark_ref(grid, views, count, bound, 0, CELLS);
  size_t marked = 0, doubtful = 0;
  for (uint32_t k = 0; k < CELLS; k++) {
    const int said = seen_by(views, count, ern_morton_gather(k), ern_morton_gather(k >> 1), ern_morton_gather(k >> 2),
                             (double)bound);
    assert_true(grid[k] == 0 || grid[k] == -1);
    marked += grid[k] == -1;
    doubtful += said == 1;
    if (said != 1 && grid[k] != (float)said) fail_msg("cell %u is %g, expected %d", k, (double)grid[k], said);
  }
  assert_true(doubtful < 2000);
  /* in parts that cut blocks */
  float *parts = values();
  static const uint32_t cut[] = {0, 1, 777, 100001, 1 << 20, (1 << 20) + 63, CELLS - 5, CELLS};
  for (size_t k = 0; k + 1 < sizeof cut / sizeof *cut; k++) {
    ern_occupancy_mark_ref(parts, views, count, bound, cut[k], cut[k + 1]);
  }
  assert_memory_equal(grid, parts, CELLS * sizeof *grid);
  free(grid), free(parts);
  return marked;
}

/* Cameras at a distance, turned and inside the cube. */
static void test_mark(void **state) {
  (void)state;
  static const struct ern_view views[3] = {
      {{0.0967f, -0.9948f, -0.0315f, 0.187f, 0.0634f, 0.0378f, -0.9973f, 3.036f, 0.9933f, 0.0945f, 0.0667f, -0.2f, 0, 0,
        0, 1},
       626,
       128,
       100,
       256,
       200},
      {{0, -0.6f, -0.8f, 2.2f, 0, 0.8f, -0.6f, 1.5f, 1, 0, 0, 0.1f, 0, 0, 0, 1}, 900, 128, 128, 256, 256},
      {{1, 0, 0, 0.1f, 0, 1, 0, 0.2f, 0, 0, 1, -0.3f, 0, 0, 0, 1}, 200, 64, 64, 128, 128}};
  size_t marked[3];
  for (size_t k = 0; k < 3; k++) {
    marked[k] = check_mark(&views[k], 1, k == 1 ? 2 : 1);
    assert_true(marked[k] > CELLS / 20 && marked[k] < CELLS - CELLS / 100);
  }
  const size_t all = check_mark(views, 3, 1);
  assert_true(all < marked[0] && all < marked[2]);
  assert_int_equal(check_mark(views, 0, 1), CELLS);
}

/* ---- refresh ---- */

/* Grids by x, y, z with a border, so that neighbours need no test. */
typedef float volume[SIDE + 2][SIDE + 2][SIDE + 2];

static volume *unpack(const float *grid, float outside) {
  volume *v = malloc(sizeof *v);
  assert_non_null(v);
  for (size_t i = 0; i < sizeof *v / sizeof(float); i++) ((float *)*v)[i] = outside;
  for (uint32_t k = 0; k < CELLS; k++) {
    (*v)[ern_morton_gather(k) + 1][ern_morton_gather(k >> 1) + 1][ern_morton_gather(k >> 2) + 1] = grid[k];
  }
  return v;
}

/* The largest of the 6 neighbours. */
static float around(const volume *v, uint32_t k) {
  const uint32_t x = ern_morton_gather(k) + 1, y = ern_morton_gather(k >> 1) + 1, z = ern_morton_gather(k >> 2) + 1;
  return fmaxf(fmaxf(fmaxf((*v)[x - 1][y][z], (*v)[x + 1][y][z]), fmaxf((*v)[x][y - 1][z], (*v)[x][y + 1][z])),
               fmaxf((*v)[x][y][z - 1], (*v)[x][y][z + 1]));
}

static uint8_t no_bits[ERN_OCCUPANCY_BYTES];
static const struct ern_occupancy_turn all_blocks = {0, 0};

static void fill_grid(float *grid, float marked, uint64_t seed) {
  for (uint32_t k = 0; k < CELLS; k++) grid[k] = uniform(seed, k) < marked ? -1 : 4 * uniform(seed + 1, k);
}

static void test_list(void **state) {
  (void)state;
  float *grid = values();
  int32_t *cells = malloc(CELLS * sizeof *cells);
  assert_non_null(cells);
  fill_grid(grid, 0.97f, 1);
  grid[0] = 0, grid[CELLS - 1] = -1;
  volume *v = unpack(grid, -1);
  const size_t count = ern_occupancy_list_ref(cells, grid, no_bits, all_blocks);
  size_t at = 0;
  for (uint32_t k = 0; k < CELLS; k++) {
    if (grid[k] < 0 && around(v, k) < 0) continue;
    if (at >= count || cells[at] != (int32_t)k) fail_msg("cell %u is not where it should be", k);
    at++;
  }
  assert_int_equal(at, count);
  assert_true(count > CELLS / 100 && count < CELLS / 2);
  fill_grid(grid, 0, 2);
  assert_int_equal(ern_occupancy_list_ref(cells, grid, no_bits, all_blocks), CELLS);
  fill_grid(grid, 2, 2);
  assert_int_equal(ern_occupancy_list_ref(cells, grid, no_bits, all_blocks), 0);
  free(v), free(cells), free(grid);
}

static void test_update_and_pack(void **state) {
  (void)state;
  float *grid = values(), *before = values(), *fresh = values();
  uint8_t *bits = malloc(ERN_OCCUPANCY_BYTES);
  assert_non_null(bits);
  fill_grid(before, 0.3f, 5);
  for (uint32_t k = 0; k < CELLS; k++) fresh[k] = uniform(7, k) < 0.1f ? 8 * uniform(8, k) : 0;
  before[5] = 0, before[6] = 1e30f, before[7] = 1e-30f;
  fresh[100] = 1e38f;
  memcpy(grid, before, CELLS * sizeof *grid);
  volume *v = unpack(fresh, 0);
  const struct ern_occupancy_decay decay = {0.95f, 0.95f, all_blocks};
  double sum[3], total = 0;
  ern_occupancy_update_ref(grid, &sum[0], fresh, no_bits, &decay, 0, 999);
  ern_occupancy_update_ref(grid, &sum[1], fresh, no_bits, &decay, 999, 1 << 20);
  ern_occupancy_update_ref(grid, &sum[2], fresh, no_bits, &decay, 1 << 20, CELLS);
  for (uint32_t k = 0; k < CELLS; k++) {
    const float expected = before[k] < 0 ? before[k] : fmaxf(before[k] * 0.95f, fmaxf(fresh[k], around(v, k)));
    if (grid[k] != expected) fail_msg("cell %u is %g, expected %g", k, (double)grid[k], (double)expected);
    total += expected > 0 ? expected : 0.0;
  }
  assert_true(fabs(sum[0] + sum[1] + sum[2] - total) <= 1e-12 * total);

  const float threshold = 3.7f;
  grid[64] = threshold;
  ern_occupancy_pack_ref(bits, grid, threshold, 0, 1000);
  ern_occupancy_pack_ref(bits, grid, threshold, 1000, ERN_OCCUPANCY_BYTES);
  size_t set = 0;
  for (uint32_t k = 0; k < CELLS; k++) {
    assert_true((bits[k / 8] >> k % 8 & 1) == (grid[k] > threshold));
    set += grid[k] > threshold;
  }
  assert_true(set > CELLS / 20 && set < CELLS - CELLS / 20);
  free(v), free(bits), free(grid), free(before), free(fresh);
}

/* Blocks with an occupied cell in each refresh, the others in turn, with a decay of their own; no other cell changes.
 */
static void test_turns(void **state) {
  (void)state;
  const struct ern_occupancy_decay decay = {0.5f, 0.25f, {.turn = 5, .mask = 7}};
  float *grid = values(), *fresh = values();
  uint8_t *bits = calloc(1, ERN_OCCUPANCY_BYTES);
  int32_t *cells = malloc(CELLS * sizeof *cells);
  assert_true(bits != NULL && cells != NULL);
  for (uint32_t k = 0; k < CELLS; k++) grid[k] = 1, fresh[k] = 0;
  bits[8 * 3 + 7] = 0x80, bits[8 * 13] = 1; /* 13 is due anyway */
  const size_t count = ern_occupancy_list_ref(cells, grid, bits, decay.turn);
  assert_int_equal(count, CELLS / 8 + 64);
  for (size_t i = 0; i < count; i++) {
    const int32_t block = cells[i] / 64;
    assert_true((block % 8 == 5 || block == 3) && (i == 0 || cells[i] > cells[i - 1]));
  }
  double sum;
  ern_occupancy_update_ref(grid, &sum, fresh, bits, &decay, 0, CELLS);
  for (uint32_t k = 0; k < CELLS; k++) {
    const uint32_t block = k / 64;
    const float expected = block == 3 || block == 13 ? 0.5f : block % 8 == 5 ? 0.25f : 1;
    if (grid[k] != expected) fail_msg("cell %u is %g, expected %g", k, (double)grid[k], (double)expected);
  }
  free(grid), free(fresh), free(bits), free(cells);
}

/* A density that is not a number changes nothing. */
static void test_update_nan(void **state) {
  (void)state;
  float *grid = values(), *fresh = values();
  for (uint32_t k = 0; k < CELLS; k++) {
    grid[k] = 1;
    fresh[k] = NAN;
  }
  const struct ern_occupancy_decay decay = {0.5f, 0.5f, all_blocks};
  double sum;
  ern_occupancy_update_ref(grid, &sum, fresh, no_bits, &decay, 0, CELLS);
  for (uint32_t k = 0; k < CELLS; k++) assert_true(grid[k] == 0.5f);
  assert_true(sum == CELLS / 2.0);
  free(grid), free(fresh);
}

/* Each point in its own cell, whatever the order and number of cells asked for; another one at another step. */
static void test_points(void **state) {
  (void)state;
  enum { COUNT = 5000, STRIDE = COUNT + 1 };
  static int32_t cells[COUNT];
  static float x[3 * STRIDE], again[3 * STRIDE], later[3 * STRIDE];
  const float bound = 2;
  double mean = 0, square = 0;
  for (uint32_t i = 0; i < COUNT; i++) cells[i] = (int32_t)(i * 419u % CELLS);
  cells[0] = 0, cells[1] = CELLS - 1;
  ern_occupancy_points_ref(x, STRIDE, cells, bound, 11, 16, COUNT);
  ern_occupancy_points_ref(again, STRIDE, cells + 1000, bound, 11, 16, COUNT - 1000);
  ern_occupancy_points_ref(later, STRIDE, cells, bound, 11, 32, COUNT);
  for (size_t i = 0; i < COUNT; i++) {
    for (size_t axis = 0; axis < 3; axis++) {
      const double c = ern_morton_gather((uint32_t)cells[i] >> axis), centre = (2 * c / 127 - 1) * 2 * 127 / 128;
      const double offset = ((double)x[axis * STRIDE + i] - centre) / 2 * 128;
      assert_true(fabs(offset) <= 1 + 1e-4 && fabsf(x[axis * STRIDE + i]) <= bound);
      assert_true(x[axis * STRIDE + i] != later[axis * STRIDE + i]);
      if (i >= 1000) assert_true(x[axis * STRIDE + i] == again[axis * STRIDE + i - 1000]);
      mean += offset / (3 * COUNT);
      square += offset * offset / (3 * COUNT);
    }
  }
  /* uniform in [-1, 1): mean 0, variance 1/3; five standard errors */
  assert_true(fabs(mean) < 5 * sqrt(1.0 / 3 / (3 * COUNT)));
  assert_true(fabs(square - 1.0 / 3) < 5 * sqrt(4.0 / 45 / (3 * COUNT)));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_morton),          cmocka_unit_test(test_mark),       cmocka_unit_test(test_list),
      cmocka_unit_test(test_update_and_pack), cmocka_unit_test(test_update_nan), cmocka_unit_test(test_turns),
      cmocka_unit_test(test_points),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
