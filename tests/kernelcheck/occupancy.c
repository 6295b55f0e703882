/* SPDX-License-Identifier: MIT
 * Marks, lists, points, refresh and bits of the head's occupancy: nothing but the same bits is accepted, but of the
 * mean. */
#include "harness.h"

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/cpu_state.h"

#include "render/occupancy_ops.h"
#include "render/render_ops.h"

/* The grid has one size: simulators, for which that is much, look at one of each kind of its contents. */
enum { CELLS = ERN_OCCUPANCY_CELLS, BYTES = ERN_OCCUPANCY_BYTES };

static float grid[CELLS], fresh[CELLS]; /* too large for a stack */
static uint8_t occupied[BYTES];

static uint32_t word_at(uint64_t seed, size_t i) { return words_at(seed, 0, i).word[0]; }

/* Bits of one cell in a third of the blocks, none in the others. */
static void occupy(uint64_t seed) {
  memset(occupied, 0, sizeof occupied);
  for (size_t block = 0; block < CELLS / 64; block++) {
    const uint32_t word = word_at(seed, block);
    if (word % 3 == 0) occupied[8 * block + word / 3 % 8] = (uint8_t)(1u << word / 24 % 8);
  }
}
static const struct ern_occupancy_turn all_blocks = {0, 0}, some_turn[] = {{0, 0}, {2, 3}, {5, 7}, {15, 15}, {1, 1}};
static struct ern_occupancy_decay same_decay(float decay) {
  return (struct ern_occupancy_decay){decay, decay, all_blocks};
}

/* ---- mark ---- */

/* Cameras around the head that look at it from afar and from within, turned about their axis. */
static void aim(struct ern_view *view, uint64_t seed) {
  float z[3], x[3], y[3], length = 0, along = 0;
  const float far = seed % 5 == 0 ? 0.5f : 2.5f;
  for (int a = 0; a < 3; a++) z[a] = random_at(seed, (size_t)a, 1), length += z[a] * z[a];
  for (int a = 0; a < 3; a++) z[a] /= sqrtf(length);
  for (int a = 0; a < 3; a++) x[a] = random_at(seed, (size_t)a + 3, 1), along += x[a] * z[a];
  length = 0;
  for (int a = 0; a < 3; a++) x[a] -= along * z[a], length += x[a] * x[a];
  for (int a = 0; a < 3; a++) x[a] /= sqrtf(length);
  for (int a = 0; a < 3; a++) y[a] = z[(a + 1) % 3] * x[(a + 2) % 3] - z[(a + 2) % 3] * x[(a + 1) % 3];
  *view = (struct ern_view){.focal = 900 + random_at(seed, 6, 500), .cx = 225, .cy = 200, .width = 450, .height = 400};
  for (int k = 0; k < 3; k++) {
    view->pose[4 * k] = x[k], view->pose[4 * k + 1] = y[k], view->pose[4 * k + 2] = z[k];
    view->pose[4 * k + 3] = -far * z[k] + random_at(seed, 7 + (size_t)k, 0.3f);
  }
  view->pose[15] = 1;
}

/* Returns how many cells are seen. */
static size_t check_mark(const struct ern_view *views, size_t count, float bound) {
  const struct many marked = many_empty(CELLS);
  struct ern_occupancy_mark_args args[MACHINES];
  size_t seen = 0;
  EACH_MACHINE (k) args[k] = (struct ern_occupancy_mark_args){marked.on[k], views, count, bound};
  RUN(occupancy_mark, args);
  expect_bits("marks", marked);
  const float *values = floats_of(0, marked);
  for (size_t i = 0; i < CELLS; i++) seen += values[i] == 0;
  machines_clear();
  return seen;
}

static void test_mark(void **state) {
  (void)state;
  static const float bounds[] = {1, 2, 0.7f}, odd[] = {0, -0.0f, 1e-40f, 1e30f, -1e30f, INFINITY, NAN, 3};
  static struct ern_view views[300];
  for (size_t v = 0; v < 300; v++) aim(&views[v], v);
  if (is_small()) {
    check_mark(views, 2, 1);
    return;
  }
  assert_int_equal(check_mark(NULL, 0, 1), 0);
  for (size_t count = 1; count <= (is_long() ? 300 : 20); count = count < 4 ? count + 1 : 5 * count) {
    const size_t seen = check_mark(views, count, bounds[count % 3]);
    assert_true(seen > 1000 && (count > 2 || seen < CELLS));
  }
  /* few of them see anything, and not all are rotations */
  for (uint64_t seed = 0; seed < (is_long() ? 40 : 5); seed++) {
    struct ern_view some[3];
    for (size_t v = 0; v < 3; v++) {
      aim(&some[v], 1000 + 3 * seed + v);
      if (seed % 4 == 0) some[v].pose[word_at(seed, v) % 12] = odd[word_at(seed, 8 + v) % 8];
      if (seed % 4 == 1) some[v].focal = odd[word_at(seed, v) % 8];
      if (seed % 4 == 2) some[v].cx = odd[word_at(seed, v) % 8], some[v].cy = odd[word_at(seed, 8 + v) % 8];
      if (seed % 4 == 3)
        for (size_t i = 0; i < 12; i++) some[v].pose[i] *= random_at(seed + 77, 12 * v + i, 2);
    }
    check_mark(some, 1 + seed % 3, seed % 7 == 6 ? odd[seed % 8] : bounds[seed % 3]);
  }
}

/* ---- list ---- */

static size_t check_list(struct ern_occupancy_turn turn) {
  const struct many cells = many_of(ERN_ELEMENT_INT32, NULL, CELLS), values = many_reals(grid, CELLS),
                    bits = many_of(ERN_ELEMENT_BYTE, occupied, BYTES);
  struct ern_occupancy_list_args args[MACHINES];
  EACH_MACHINE (k) args[k] = (struct ern_occupancy_list_args){cells.on[k], values.on[k], bits.on[k], turn, 0};
  RUN(occupancy_list, args);
  EACH_OTHER (k) assert_int_equal(args[k].count, args[0].count);
  expect_same_int32s("cells", cells); /* past the list: poison in both */
  expect_bits("grid", values);
  machines_clear();
  return args[0].count;
}

static void test_list(void **state) {
  (void)state;
  static const float odd[] = {0, -0.0f, 1e-45f, -1e-45f, INFINITY, -INFINITY, NAN, FLT_MAX};
  if (is_small()) {
    for (size_t i = 0; i < CELLS; i++) grid[i] = word_at(1, i) % 12 == 0 ? odd[word_at(2, i) % 8] : -1;
    check_list(all_blocks);
    return;
  }
  for (size_t i = 0; i < CELLS; i++) grid[i] = -1;
  assert_int_equal(check_list(all_blocks), 0);
  for (size_t i = 0; i < CELLS; i++) grid[i] = 0;
  assert_int_equal(check_list(all_blocks), CELLS);
  /* one cell: corners, edges and faces of the grid and of blocks, and anywhere */
  for (size_t i = 0; i < CELLS; i++) grid[i] = -1;
  for (size_t k = 0; k < 40; k += is_long() ? 1 : 13) {
    const uint32_t corner = (k & 1 ? 0x049249u : 0) | (k & 2 ? 0x092492u : 0) | (k & 4 ? 0x124924u : 0),
                   cell = k < 8    ? corner
                          : k < 24 ? corner ^ (1u << (word_at(k, 0) % 21))
                                   : word_at(k, 1) % CELLS;
    grid[cell] = 0;
    const size_t found = check_list(all_blocks);
    assert_in_range(found, 4, 7);
    grid[cell] = -1;
  }
  for (uint32_t share = 2; share < 5000; share *= 6) {
    if (!is_long() && share != 12) continue;
    for (size_t i = 0; i < CELLS; i++) {
      grid[i] = word_at(share, i) % share == 0 ? 0.5f : -1;
      if (word_at(share + 1, i / 64) % share == 0) grid[i] = 1;
      if (share == 12) grid[i] = odd[word_at(share, i) % 8];
    }
    const size_t all = check_list(all_blocks);
    for (size_t k = 1; k < COUNT_OF(some_turn); k += is_long() ? 1 : 3) {
      occupy(share);
      const size_t some = check_list(some_turn[k]);
      memset(occupied, 0, sizeof occupied);
      const size_t fewer = check_list(some_turn[k]);
      assert_true(fewer < some && some < all);
    }
  }
  /* each cell in one of the turns, where none is occupied */
  size_t sum = 0;
  for (uint32_t k = 0; k < 8; k++) sum += check_list((struct ern_occupancy_turn){k, 7});
  assert_int_equal(sum, check_list(all_blocks));
}

/* ---- points, scatter ---- */

static void test_points(void **state) {
  (void)state;
  static const float bounds[] = {1, 2, 0.7f, 16};
  static int32_t cells[5000];
  for (size_t s = 0; s < size_count() + 2; s++) {
    const size_t n = s < size_count() ? test_sizes[s] : s == size_count() ? 0 : 5000;
    for (size_t i = 0; i < n; i++) cells[i] = (int32_t)(i == 0 ? 0 : i == 1 ? CELLS - 1 : word_at(s, i) % CELLS);
    const struct many list = many_int32s(cells, n);
    const struct many_rows x = many_strided(NULL, 3, n, ERN_PER_SAMPLE);
    struct ern_occupancy_points_args args[MACHINES];
    EACH_MACHINE (k)
      args[k] = (struct ern_occupancy_points_args){.x = x.on[k],
                                                   .cells = list.on[k],
                                                   .bound = bounds[s % 4],
                                                   .seed = 0xabcdef0123456789u * s,
                                                   .step = s << 30,
                                                   .n = n};
    RUN(occupancy_points, args);
    expect_bits("points", of_rows(x));
    machines_clear();
  }
}

static void test_scatter(void **state) {
  (void)state;
  static int32_t cells[MOST_SIZE];
  static float sigma[MOST_SIZE];
  for (size_t s = 0; s < size_count() + 1; s += is_long() ? 1 : 3) {
    const size_t n = s < size_count() ? test_sizes[s] : 0;
    for (size_t i = 0; i < n; i++) {
      cells[i] = (int32_t)(i + 1 == n ? CELLS - 1 : 2003 * i);
      sigma[i] = i % 9 == 8 ? NAN : random_at(s, i, 100);
    }
    const struct many list = many_int32s(cells, n), value = many_reals(sigma, n), to = many_empty(CELLS);
    struct ern_occupancy_scatter_args args[MACHINES];
    EACH_MACHINE (k) args[k] = (struct ern_occupancy_scatter_args){to.on[k], list.on[k], value.on[k], n};
    RUN(occupancy_scatter, args);
    expect_bits("fresh", to);
    machines_clear();
  }
}

/* ---- refresh ---- */

/* The reference's sum has a rounding of 2^-53 for each cell. The device's, of non-negative numbers, lacks what adding
 * up its own roundings loses: at most 64 additions one after the other, 8 and 6 more, each of a relative 2^-24 and of
 * what is 2^-24 a step itself: below (78*2^-24)^2 = 2.2e-11. */
static const double mean_tolerance = CELLS * 0x1p-53 + 2.2e-11;
/* A group of the device adds up a 64th of the cells in float; a sum past its end is infinite. */
static const double most_mean = (double)FLT_MAX / (CELLS / 64);

static void check_update(struct ern_occupancy_decay decay, float limit) {
  const struct many cells = many_reals(grid, CELLS), now = many_reals(fresh, CELLS),
                    bits = many_of(ERN_ELEMENT_BYTE, occupied, BYTES);
  struct ern_occupancy_update_args args[MACHINES];
  EACH_MACHINE (k)
    args[k] = (struct ern_occupancy_update_args){
        .grid = cells.on[k], .bits = bits.on[k], .fresh = now.on[k], .decay = decay, .limit = limit, .mean = -7};
  RUN(occupancy_update, args);
  expect_bits("grid", cells);
  expect_bits("fresh", now);
  const double expected = args[0].mean;
  EACH_OTHER (k) {
    const double found = args[k].mean;
    const bool too_large = is_device(k) && isinf(found) && expected > most_mean;
    if (!(found == expected || (isnan(found) && isnan(expected)) || too_large ||
          fabs(found - expected) <= (is_device(k) ? mean_tolerance : CELLS * 0x1p-53) * fabs(expected)))
      fail_msg("%s: mean %.17g, reference %.17g", machines.name[k], found, expected);
  }
  expect_same_bytes("bits", bits);
  machines_clear();
}

/* Densities of all sizes, none, and, where `odd`, no numbers; marked cells, alone and by the block. */
static void fill(uint64_t seed, float scale, bool odd) {
  uint32_t block = 0;
  for (size_t i = 0; i < CELLS; i++) {
    const struct ern_random words = words_at(seed, 0, i);
    const uint32_t word = words.word[0], other = words.word[1];
    if (i % 64 == 0) block = words.word[2];
    grid[i] = block % 3 == 0 || word % 5 == 0 ? -1 : word % 7 == 0 ? 0 : (float)(word % 1000) * 0.01f * scale;
    fresh[i] = other % 3 == 0 ? 0 : (float)(other % 4096) * 0.004f * scale;
    if (word % 1009 == 4) grid[i] = -0.0f;
    if (other % 1009 == 6) fresh[i] = -0.0f;
    if (other % 1009 == 5) fresh[i] = -3;
    if (!odd) continue;
    if (word % 1009 == 3) grid[i] = NAN;
    if (other % 101 == 3) fresh[i] = NAN;
    if (other % 1009 == 4) fresh[i] = INFINITY;
  }
}

static void test_update(void **state) {
  (void)state;
  if (is_small()) {
    fill(1, 1, true);
    check_update(same_decay(0.95f), 10);
    return;
  }
  for (uint64_t seed = 0; seed < 6; seed += is_long() ? 1 : 4) {
    fill(10 * seed, seed % 2 ? 1 : 0.01f, false);
    check_update(same_decay(0.95f), seed == 4 ? 0.001f : 10);
  }
  for (uint64_t seed = 0; seed < 5; seed += is_long() ? 1 : 3) {
    static const float decays[] = {0.95f, 1, 0, NAN, INFINITY};
    fill(10 * seed + 5, 1, true);
    check_update(same_decay(decays[seed]), 10);
  }
  for (uint64_t seed = 0; seed < COUNT_OF(some_turn); seed += is_long() ? 1 : 2) {
    fill(10 * seed + 7, 1, seed % 2 == 0);
    occupy(seed);
    check_update((struct ern_occupancy_decay){0.9f, 0.2f, some_turn[seed]}, 10);
  }
  memset(occupied, 0, sizeof occupied);
  fill(1, 1e-41f, false);
  check_update(same_decay(0.95f), 10);
  fill(1, 1e-41f, false);
  check_update(same_decay(-2), 10); /* zeros of both signs are larger than these */
}

/* No cell is above the mean where all are the same, however the sum is rounded. */
static void test_same_everywhere(void **state) {
  (void)state;
  if (is_small()) skip();
  static const float value[] = {0, 0.1f, 7.3f, 1.0f / 3, 1e-40f, 3e30f, FLT_MAX};
  for (size_t v = 0; v < COUNT_OF(value); v += is_long() ? 1 : 3) {
    for (size_t i = 0; i < CELLS; i++) grid[i] = 0, fresh[i] = value[v];
    check_update(same_decay(0.95f), 10);
    for (size_t i = 0; i < CELLS; i++) grid[i] = i % 128 == 77 ? value[v] : -1, fresh[i] = 0;
    check_update(same_decay(1), 10);
  }
  for (size_t i = 0; i < CELLS; i++) grid[i] = -1, fresh[i] = 1;
  check_update(same_decay(1), 10);
}

/* The same sums on every run. */
static void test_repeated(void **state) {
  (void)state;
  if (is_small()) skip();
  fill(3, 1, false);
  double mean[MACHINES];
  for (int run = 0; run < 3; run++) {
    const struct many cells = many_reals(grid, CELLS), now = many_reals(fresh, CELLS),
                      bits = many_of(ERN_ELEMENT_BYTE, NULL, BYTES);
    EACH_MACHINE (k) {
      struct ern_occupancy_update_args args = {
          .grid = cells.on[k], .bits = bits.on[k], .fresh = now.on[k], .decay = same_decay(0.95f), .limit = 10};
      RUN_ON(k, occupancy_update, &args);
      if (run == 0) mean[k] = args.mean;
      assert_true(args.mean == mean[k]);
    }
    machines_clear();
  }
}

/* ---- the kernels of the CPU on parts of the grid, as the slot never cuts them ---- */

static void test_parts(void **state) {
  (void)state;
  static const uint32_t cut[] = {0, 1, 1, 7, 9, 17, 31, 40, 999, 1000, 1024, 1600, 1 << 20, CELLS - 9, CELLS - 1};
  const struct ern_occupancy_decay decay = {0.9f, 0.2f, some_turn[1]};
  fill(1, 1, true);
  occupy(1);
  const struct many cells = many_reals(grid, CELLS), now = many_reals(fresh, CELLS),
                    bits = many_of(ERN_ELEMENT_BYTE, occupied, BYTES);
  for (size_t p = 0; p + 1 < COUNT_OF(cut); p++) {
    double sum[MACHINES];
    EACH_MACHINE (k) {
      if (kernels_of(k) == NULL) continue;
      kernels_of(k)->occupancy_update(host_reals(k, cells.on[k]), &sum[k], host_reals(k, now.on[k]),
                                      host_memory(k, bits.on[k]), &decay, cut[p], cut[p + 1]);
      /* of the same doubles in another order: a rounding of 2^-53 for each of them */
      if (sum[k] != sum[0] && !(fabs(sum[k] - sum[0]) <= CELLS * 0x1p-53 * sum[0]))
        fail_msg("%s: sum %.17g, reference %.17g", machines.name[k], sum[k], sum[0]);
    }
  }
  EACH_OTHER (k)
    if (!is_device(k)) expect_near_on(k, "grid", cells, 0, 0);
  machines_clear();
}

static void test_pack(void **state) {
  (void)state;
  static const float thresholds[] = {0, 5, -2, INFINITY, 0.01f};
  static const uint32_t cut[] = {0, 1, 3, 3, 8, 15, 16, 33, 1000, BYTES};
  fill(1, 1, true);
  const struct many cells = many_reals(grid, CELLS);
  for (size_t t = 0; t < COUNT_OF(thresholds); t++) {
    for (size_t p = 0; p + 1 < COUNT_OF(cut); p++) {
      const struct machines_mark kept = machines_mark();
      const struct many bits = many_of(ERN_ELEMENT_BYTE, NULL, BYTES);
      EACH_MACHINE (k) {
        if (kernels_of(k) == NULL) continue;
        kernels_of(k)->occupancy_pack(host_memory(k, bits.on[k]), host_reals(k, cells.on[k]), thresholds[t], cut[p],
                                      cut[p + 1]);
        assert_memory_equal(bytes_of(k, bits), bytes_of(0, bits), BYTES);
      }
      machines_clear_to(kept);
    }
  }
  machines_clear();
}

/* The list first: others read it. */
static void bench(void) {
  enum { POINTS = 1 << 18, VIEWS = 1000 };
  static struct ern_view views[VIEWS];
  for (size_t v = 0; v < VIEWS; v++) aim(&views[v], 7), views[v].pose[3] += random_at(v, 0, 0.05f);
  fill(1, 1, false);
  const struct many cells = many_of(ERN_ELEMENT_INT32, NULL, CELLS), marked = many_reals(grid, CELLS),
                    values = many_reals(grid, CELLS), now = many_reals(fresh, CELLS), sigma = many_reals(fresh, POINTS),
                    bits = many_of(ERN_ELEMENT_BYTE, NULL, BYTES);
  const struct many_rows x = many_strided(NULL, 3, POINTS, ERN_PER_SAMPLE);
  struct ern_occupancy_mark_args mark[MACHINES];
  struct ern_occupancy_list_args listed[MACHINES];
  struct ern_occupancy_points_args points[MACHINES];
  struct ern_occupancy_scatter_args scatter[MACHINES];
  struct ern_occupancy_update_args update[MACHINES];
  EACH_MACHINE (k) {
    mark[k] = (struct ern_occupancy_mark_args){marked.on[k], views, VIEWS, 1};
    listed[k] = (struct ern_occupancy_list_args){cells.on[k], values.on[k], bits.on[k], all_blocks, 0};
    points[k] = (struct ern_occupancy_points_args){x.on[k], cells.on[k], 1, 1, 2, POINTS};
    scatter[k] = (struct ern_occupancy_scatter_args){now.on[k], cells.on[k], sigma.on[k], POINTS};
    update[k] = (struct ern_occupancy_update_args){values.on[k], bits.on[k], now.on[k], same_decay(1), 10, 0};
  }
  BENCH("list", CELLS, occupancy_list, listed);
  BENCH("points", POINTS, occupancy_points, points);
  BENCH("scatter", POINTS, occupancy_scatter, scatter);
  BENCH("update", CELLS, occupancy_update, update);
  BENCH("mark by 1000 views", CELLS, occupancy_mark, mark);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_mark),     cmocka_unit_test(test_list),   cmocka_unit_test(test_points),
    cmocka_unit_test(test_scatter),  cmocka_unit_test(test_update), cmocka_unit_test(test_same_everywhere),
    cmocka_unit_test(test_repeated), cmocka_unit_test(test_parts),  cmocka_unit_test(test_pack),
};
NOUN(occupancy, bench, .isa = NULL)
