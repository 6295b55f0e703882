/* SPDX-License-Identifier: MIT
 * Torso coordinates, the choice of pixels by the 2D occupancy, and its refresh. */
#include "../support.h"

#include <math.h>

#include "core/rng.h"
#include "model/torso_ops.h"

enum { SIDE = ERN_TORSO_SIDE, CELLS = ERN_TORSO_CELLS };

static float uniform(uint64_t seed, uint32_t at) {
  return ern_uniform(ern_random_at(seed, 0, at, ERN_RNG_INIT).word[0]);
}

static void test_coords(void **state) {
  (void)state;
  /* 5 wide, 3 high: corners, centre, and the middle of the last row */
  static const int32_t pixel[] = {0, 4, 10, 14, 7, 12};
  static const float expected[][2] = {{-1, -1}, {-1, 1}, {1, -1}, {1, 1}, {0, 0}, {1, 0}};
  enum { COUNT = sizeof pixel / sizeof *pixel, STRIDE = 9 };
  float q[2 * STRIDE];
  ern_torso_coords_ref(q, STRIDE, pixel, 5, 3, 0.8f, COUNT);
  for (int i = 0; i < COUNT; i++) {
    assert_true(q[i] == 0.8f * expected[i][0] && q[STRIDE + i] == 0.8f * expected[i][1]);
  }
  /* a side of one pixel is at 0 */
  const int32_t only[2] = {0, 1};
  ern_torso_coords_ref(q, STRIDE, only, 1, 2, 1, 2);
  assert_true(q[0] == -1 && q[1] == 1 && q[STRIDE] == 0 && q[STRIDE + 1] == 0);
  ern_torso_coords_ref(q, STRIDE, only, 2, 1, 1, 2);
  assert_true(q[0] == 0 && q[1] == 0 && q[STRIDE] == -1 && q[STRIDE + 1] == 1);
}

/* Bilinear in double over the cells (r, c) at c*128 + r, the corners of the picture on the centres of the corner cells.
 */
static double grid_at(const float *grid, double row, double column) {
  double sum = 0;
  for (int c = 0; c < SIDE; c++) {
    for (int r = 0; r < SIDE; r++) {
      const double wr = 1 - fabs((row + 1) / 2 * (SIDE - 1) - r), wc = 1 - fabs((column + 1) / 2 * (SIDE - 1) - c);
      if (wr > 0 && wc > 0) sum += wr * wc * (double)grid[c * SIDE + r];
    }
  }
  return sum;
}

static void check_select(const float *grid, int width, int height, float threshold) {
  enum { COUNT = 400 };
  int32_t pixel[COUNT], index[COUNT], selected[COUNT];
  for (uint32_t i = 0; i < COUNT; i++) pixel[i] = (int32_t)((uint32_t)(width * height - 1) * (uint64_t)i / (COUNT - 1));
  const size_t count = ern_torso_select_ref(index, selected, pixel, grid, threshold, width, height, COUNT);
  size_t at = 0;
  for (int i = 0; i < COUNT; i++) {
    const double row = height > 1 ? 2.0 * (pixel[i] / width) / (height - 1) - 1 : 0;
    const double column = width > 1 ? 2.0 * (pixel[i] % width) / (width - 1) - 1 : 0;
    const double value = grid_at(grid, row, column);
    const bool chosen = at < count && index[at] == i;
    if (fabs(value - (double)threshold) > 1e-4) assert_true(chosen == (value > (double)threshold));
    if (chosen) assert_int_equal(selected[at], pixel[i]);
    at += chosen;
  }
  assert_int_equal(at, count);
  assert_true(count > COUNT / 20 && count < COUNT);
}

static void test_select(void **state) {
  (void)state;
  static float grid[CELLS];
  for (uint32_t k = 0; k < CELLS; k++) grid[k] = uniform(1, k);
  check_select(grid, 128, 128, 0.5f); /* a pixel a cell */
  check_select(grid, 450, 300, 0.5f);
  check_select(grid, 31, 77, 0.4f);
  check_select(grid, 1, 400, 0.5f);
  /* a row of the picture is a row of cells: c*128 + r */
  memset(grid, 0, sizeof grid);
  grid[3 * SIDE + 90] = 1;
  int32_t pixel[SIDE * SIDE], index[SIDE * SIDE], selected[SIDE * SIDE];
  for (int32_t i = 0; i < SIDE * SIDE; i++) pixel[i] = i;
  assert_int_equal(ern_torso_select_ref(index, selected, pixel, grid, 0.5f, SIDE, SIDE, SIDE * SIDE), 1);
  assert_int_equal(selected[0], 90 * SIDE + 3);
  assert_int_equal(ern_torso_select_ref(index, selected, pixel, grid, 0.5f, SIDE, SIDE, 0), 0);
}

static void test_points(void **state) {
  (void)state;
  static float q[2 * CELLS], again[2 * CELLS];
  ern_torso_points_ref(q, CELLS, 0.8f, 3, 48);
  ern_torso_points_ref(again, CELLS, 0.8f, 3, 64);
  for (int cell = 0; cell < CELLS; cell++) {
    const int of[2] = {cell % SIDE, cell / SIDE}; /* row, column */
    for (int k = 0; k < 2; k++) {
      const double found = (double)q[k * CELLS + cell] / 0.8, centre = (2.0 * of[k] / 127 - 1) * 127 / 128;
      assert_true(fabs(found - centre) <= 1.0 / 128 + 1e-6);
      assert_true(q[k * CELLS + cell] != again[k * CELLS + cell]);
    }
  }
}

static void test_update(void **state) {
  (void)state;
  static float grid[CELLS], before[CELLS], alpha[CELLS];
  for (uint32_t k = 0; k < CELLS; k++) {
    before[k] = grid[k] = uniform(5, k);
    alpha[k] = uniform(6, k) < 0.02f ? uniform(7, k) : -0.001f; /* alphas may be a little below 0 */
  }
  const double mean = ern_torso_update_ref(grid, alpha, 0.95f);
  double sum = 0;
  size_t raised = 0;
  for (int c = 0; c < SIDE; c++) {
    for (int r = 0; r < SIDE; r++) {
      float most = before[c * SIDE + r] * 0.95f;
      for (int other = 0; other < 25; other++) {
        const int cc = c + other / 5 - 2, rr = r + other % 5 - 2;
        if (cc >= 0 && cc < SIDE && rr >= 0 && rr < SIDE) most = fmaxf(most, alpha[cc * SIDE + rr]);
      }
      assert_true(grid[c * SIDE + r] == most);
      raised += most > before[c * SIDE + r] * 0.95f;
      sum += (double)most;
    }
  }
  assert_true(raised > CELLS / 20 && raised < CELLS / 2);
  assert_true(fabs(mean - sum / CELLS) < 1e-12);
}

/* From a camera that looks at the face along y, key points are the projections of the anchors. */
static void test_pose(void **state) {
  (void)state;
  const float pose[16] = {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1};
  const float anchors[12] = {0.1f, 0, 0.2f, 1, 0, 0.5f, 0, 1, 0.1f, 1, -0.3f, 2};
  float k[6];
  /* x_cam = z, y_cam = -x, z_cam = 3 - y */
  const double expected[6] = {0.2 / 3, -0.1 / 3, 0, 0, -0.3 / 2 / 5, -0.1 / 2 / 5};
  ern_torso_pose_fwd_ref(k, anchors, NULL, pose);
  for (int i = 0; i < 6; i++) assert_true(fabs((double)k[i] - expected[i]) < 1e-7);
  const float gamma = 2.5f;
  ern_torso_pose_fwd_ref(k, anchors, &gamma, pose);
  for (int i = 0; i < 6; i++) assert_true(fabs((double)k[i] - 2.5 * expected[i]) < 3e-7);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_coords), cmocka_unit_test(test_select), cmocka_unit_test(test_points),
      cmocka_unit_test(test_update), cmocka_unit_test(test_pose),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
