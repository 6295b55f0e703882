/* SPDX-License-Identifier: MIT
 * Visible blocks: every ray that the reference march finds samples for lies in one, and its first sample is not before
 * the block's distance; and what is called visible is not much more than what is. */
#include "../support.h"

#include <math.h>

#include "core/rng.h"
#include "render/march_ops.h"
#include "render/morton.h"
#include "render/tile_culling_ops.h"

enum { MOST_STEPS = 200, SIDE = ERN_OCCUPANCY_SIDE };

static uint32_t word_of(uint64_t seed, uint32_t at) { return ern_random_at(seed, 0, at, ERN_RNG_INIT).word[0]; }
static float around(uint64_t seed, uint32_t at) { return 2 * ern_uniform(word_of(seed, at)) - 1; }

static uint8_t bits[ERN_OCCUPANCY_BYTES];

static void occupy(uint32_t x, uint32_t y, uint32_t z) {
  const uint32_t number = ern_morton(x, y, z);
  bits[number >> 3] |= (uint8_t)(1u << (number & 7));
}

/* Single cells, anywhere and at the edges of the box in y. */
static void fill_cells(int count, uint64_t seed) {
  memset(bits, 0, sizeof bits);
  for (int i = 0; i < count; i++) {
    const uint32_t any = word_of(seed, (uint32_t)i), y = i % 4 == 0 ? 31 + 65 * (any >> 30 & 1) : any >> 7 & 127;
    occupy(any & 127, y, any >> 14 & 127);
  }
}
static void fill_ball(const double centre[3], double radius) {
  memset(bits, 0, sizeof bits);
  for (uint32_t x = 0; x < SIDE; x++) {
    for (uint32_t y = 0; y < SIDE; y++) {
      for (uint32_t z = 0; z < SIDE; z++) {
        const double p[3] = {(x + 0.5) / 64 - 1, (y + 0.5) / 64 - 1, (z + 0.5) / 64 - 1};
        if (hypot(hypot(p[0] - centre[0], p[1] - centre[1]), p[2] - centre[2]) < radius) occupy(x, y, z);
      }
    }
  }
}

/* Gram-Schmidt of random columns, the third one looking from `origin` to about `target`; then, by `kind`, as it is,
 * longer or shorter, or sheared. */
static struct ern_view view_of(const float origin[3], const float target[3], int kind, uint64_t seed) {
  struct ern_view view = {.focal = 60 * powf(10, around(seed, 1)),
                          .width = 1 + (int)(word_of(seed, 2) % 64),
                          .height = 1 + (int)(word_of(seed, 3) % 64)};
  double column[3][3];
  view.cx = (float)view.width * (0.5f + 0.3f * around(seed, 4));
  view.cy = (float)view.height * (0.5f + 0.3f * around(seed, 5));
  for (int c = 2; c >= 0; c--) {
    for (uint32_t a = 0; a < 3; a++) {
      column[c][a] = c == 2 ? (double)(target[a] - origin[a]) : (double)around(seed, 10 + 3 * (uint32_t)c + a);
    }
    for (int k = 2; k > c; k--) {
      double dot = 0;
      for (int a = 0; a < 3; a++) dot += column[c][a] * column[k][a];
      for (int a = 0; a < 3; a++) column[c][a] -= dot * column[k][a];
    }
    const double length = hypot(hypot(column[c][0], column[c][1]), column[c][2]);
    for (int a = 0; a < 3; a++) column[c][a] /= length;
  }
  const double scale = kind == 1 ? 0.3 : kind == 2 ? 5 : 1;
  for (int a = 0; a < 3; a++) {
    for (int c = 0; c < 3; c++) view.pose[4 * a + c] = (float)(scale * column[c][a]);
    if (kind == 3) view.pose[4 * a] += 0.7f * view.pose[4 * a + 1];
    view.pose[4 * a + 3] = origin[a];
  }
  view.pose[15] = 1;
  if (word_of(seed, 6) % 8 == 0) view.focal = word_of(seed, 7) % 2 ? 1e-3f : 1e5f;
  return view;
}

struct tally {
  size_t rays, blocks, seen; /* rays with samples; blocks called visible, and those that see something */
  double early;              /* sum over the seen blocks of the distance from not_before to the first sample */
};

static void check_view(const struct ern_view *view, const struct ern_march_settings *settings, struct tally *tally) {
  const size_t columns = ern_tile_count(view->width), rows = ern_tile_count(view->height);
  const size_t n = (size_t)view->width * (size_t)view->height, row = (size_t)settings->max_steps;
  float *not_before = malloc((columns * rows + 1) * sizeof(float)), *first = malloc(columns * rows * sizeof(float));
  float *dir = malloc(3 * n * sizeof(float)), *t = malloc(row * n * sizeof(float));
  int32_t *pixel = malloc(n * sizeof *pixel), *count = malloc(n * sizeof *count);
  assert_true(not_before && first && dir && t && pixel && count);
  for (size_t i = 0; i < n; i++) pixel[i] = (int32_t)i;
  for (size_t i = 0; i <= columns * rows; i++) not_before[i] = -7;
  ern_tile_culling(not_before, bits, view, settings->bound);
  assert_true(not_before[columns * rows] == -7);
  const float origin[3] = {view->pose[3], view->pose[7], view->pose[11]};
  ern_rays_ref(dir, n, pixel, view, n);
  ern_march_ref(t, count, dir, n, NULL, bits, origin, settings, n);
  for (size_t b = 0; b < columns * rows; b++) first[b] = INFINITY;
  for (size_t i = 0; i < n; i++) {
    const size_t block = i / (size_t)view->width / 8 * columns + i % (size_t)view->width / 8;
    if (count[i] == 0) continue;
    tally->rays++;
    first[block] = fminf(first[block], t[i * row]);
    if (!(not_before[block] <= t[i * row])) {
      fail_msg("pixel %zu of %d x %d, focal %g: first sample at %.9g, not before %.9g", i, view->width, view->height,
               (double)view->focal, (double)t[i * row], (double)not_before[block]);
    }
  }
  for (size_t b = 0; b < columns * rows; b++) {
    assert_true(not_before[b] >= 0);
    tally->blocks += not_before[b] < INFINITY;
    tally->seen += first[b] < INFINITY;
    if (first[b] < INFINITY) tally->early += (double)(first[b] - not_before[b]);
  }
  free(not_before), free(first), free(dir), free(t), free(pixel), free(count);
}

/* From outside, from inside the box, from within what is occupied; at it, past it, away from it. */
static void check_views(uint64_t seed_begin, size_t least_rays) {
  static const struct ern_march_settings settings[] = {
      {1, 16, 1 / 256.0f, 0.05f}, {1, MOST_STEPS, 1 / 256.0f, 0}, {2, 100, 0, 0.05f}, {0.7f, 64, 1 / 256.0f, 0.05f}};
  struct tally tally = {0};
  for (uint64_t seed = seed_begin; seed < seed_begin + 120; seed++) {
    const float reach = seed % 3 == 0 ? 5 : seed % 3 == 1 ? 1 : 0.3f;
    float origin[3], target[3];
    for (uint32_t a = 0; a < 3; a++) {
      origin[a] = reach * around(seed, 50 + a), target[a] = (seed % 5 == 0 ? 3 : 0.4f) * around(seed, 60 + a);
    }
    if (seed % 7 == 0) memset(origin, 0, sizeof origin);
    const struct ern_view view = view_of(origin, target, (int)(seed % 4), seed);
    check_view(&view, &settings[seed / 4 % 4], &tally);
  }
  assert_true(tally.rays >= least_rays);
}

static void test_cells(void **state) {
  (void)state;
  for (uint64_t k = 0; k < 4; k++) {
    fill_cells(k == 0 ? 1 : k == 1 ? 30 : 3000, k);
    check_views(1000 * k, k == 0 ? 0 : 20);
  }
}
static void test_balls(void **state) {
  (void)state;
  fill_ball((const double[]){0.1, 0.05, -0.2}, 0.3);
  check_views(5000, 2000);
  fill_ball((const double[]){-0.9, 0.45, 0.9}, 0.15);
  check_views(6000, 100);
}
static void test_full_and_empty(void **state) {
  (void)state;
  memset(bits, 0xff, sizeof bits);
  check_views(7000, 5000);
  memset(bits, 0, sizeof bits);
  const float origin[3] = {0.3f, 3, 0.1f}, target[3] = {0};
  const struct ern_view view = view_of(origin, target, 0, 1);
  float not_before[64];
  ern_tile_culling(not_before, bits, &view, 1);
  for (size_t b = 0; b < ern_tile_count(view.width) * ern_tile_count(view.height); b++)
    assert_true(not_before[b] == INFINITY);
}

/* From so far away that float is off by a good part of a pixel. (The margin for that is argued in tile_culling.c; it is
 * so seldom needed that this test passes without it too.) */
static void test_far(void **state) {
  (void)state;
  static const struct ern_march_settings settings = {1, 16, 1 / 256.0f, 0.05f};
  struct tally tally = {0};
  fill_cells(6000, 9);
  for (uint64_t seed = 0; seed < 60; seed++) {
    float origin[3], target[3];
    for (uint32_t a = 0; a < 3; a++) {
      origin[a] = 2000 * around(seed, 70 + a), target[a] = (a == 1 ? 0.4f : 0.8f) * around(seed, 80 + a);
    }
    struct ern_view view = view_of(origin, target, 0, seed);
    view.width = view.height = 64, view.cx = view.cy = 32, view.focal = 1e6f;
    check_view(&view, &settings, &tally);
  }
  assert_true(tally.rays > 2000);
}

/* A camera that is none: everything may be seen from 0 on. */
static void test_no_camera(void **state) {
  (void)state;
  fill_cells(100, 1);
  const float origin[3] = {0.3f, 3, 0.1f}, target[3] = {0};
  const struct ern_view good = view_of(origin, target, 0, 1);
  for (int k = 0; k < 19; k++) {
    struct ern_view view = good;
    if (k < 12) view.pose[k] = k % 2 ? NAN : INFINITY;
    if (k == 12) memset(view.pose, 0, sizeof view.pose);
    if (k == 13) view.focal = NAN;
    if (k == 14) view.focal = 0;
    if (k == 15) view.focal = -100;
    if (k == 16) view.cx = NAN;
    if (k == 17) view.cy = -INFINITY;
    if (k == 18) view.pose[2] = view.pose[1], view.pose[6] = view.pose[5], view.pose[10] = view.pose[9];
    float not_before[64];
    ern_tile_culling(not_before, bits, &view, 1);
    for (size_t b = 0; b < ern_tile_count(view.width) * ern_tile_count(view.height); b++)
      assert_true(not_before[b] == 0);
  }
}

/* A ball of radius 0.2 at 3.5, 450 x 450 pixels, focal length 1080: 15 blocks across. Boxes of 4 cells (19 pixels) add
 * less than half a block all around: (16/15)^2; a third more is allowed for blocks that are only just touched, as a
 * circle of 15 blocks has 47 on its rim. Distances are early by less than the 4 cells and the 8 pixels' slope: 0.15 on
 * average, of 3.5. */
static void test_not_useless(void **state) {
  (void)state;
  const double most_share = 1.42, most_early = 0.15;
  static const struct ern_march_settings settings = {1, 16, 1 / 256.0f, 0.05f};
  fill_ball((const double[]){0.1, 0.05, -0.2}, 0.2);
  const float origins[3][3] = {{0, 3.6f, 0}, {1, 3.3f, -0.8f}, {-1, 3, 1}}, target[3] = {0.1f, 0, -0.15f};
  for (uint64_t k = 0; k < 3; k++) {
    struct ern_view view = view_of(origins[k], target, 0, 3);
    struct tally tally = {0};
    view.width = view.height = 450, view.focal = 1080, view.cx = view.cy = 225;
    check_view(&view, &settings, &tally);
    assert_true(tally.seen > 100);
    if ((double)tally.blocks > most_share * (double)tally.seen || tally.early > most_early * (double)tally.seen) {
      fail_msg("%zu blocks visible, %zu see something; %.3f early", tally.blocks, tally.seen,
               tally.early / (double)tally.seen);
    }
    print_message("%zu blocks visible, %zu see something; %.3f early\n", tally.blocks, tally.seen,
                  tally.early / (double)tally.seen);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_cells), cmocka_unit_test(test_balls),     cmocka_unit_test(test_full_and_empty),
      cmocka_unit_test(test_far),   cmocka_unit_test(test_no_camera), cmocka_unit_test(test_not_useless),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
