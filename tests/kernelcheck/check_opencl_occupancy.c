/* SPDX-License-Identifier: MIT
 * Marks, lists, points, refresh and bits of the head's occupancy on an OpenCL device against the reference: nothing but
 * the same bits is accepted, but of the mean. */
#include "twin.h"

#include <float.h>

#include "kernelcheck.h"
#include "render/render_ops.h"

/* The grid has one size: simulators, for which that is much, look at one of each kind of its contents. */
enum { CELLS = ERN_OCCUPANCY_CELLS, BYTES = ERN_OCCUPANCY_BYTES };

static ern_context *context;
static struct twin twin;
static float grid[CELLS], fresh[CELLS]; /* too large for a stack */

static uint32_t word_at(uint64_t seed, size_t i) { return ern_random_at(seed, 0, (uint32_t)i, ERN_RNG_INIT).word[0]; }

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
  const struct twin_span marked = twin_take(&twin, ERN_ELEMENT_REAL, CELLS);
  struct ern_occupancy_mark_args args[2];
  size_t seen = 0;
  for (int k = 0; k < 2; k++) args[k] = (struct ern_occupancy_mark_args){marked.on[k], views, count, bound};
  TWIN_RUN(&twin, occupancy_mark, args);
  twin_same_bits(&twin, "marks", marked);
  float *values = twin_down(&twin, 1, marked.on[1]);
  for (size_t i = 0; i < CELLS; i++) seen += values[TWIN_GUARD + i] == 0;
  free(values);
  twin_clear(&twin);
  return seen;
}

static void test_mark(void **state) {
  (void)state;
  static const float bounds[] = {1, 2, 0.7f}, odd[] = {0, -0.0f, 1e-40f, 1e30f, -1e30f, INFINITY, NAN, 3};
  static struct ern_view views[300];
  for (size_t v = 0; v < 300; v++) aim(&views[v], v);
  if (twin_is_small()) {
    check_mark(views, 2, 1);
    return;
  }
  assert_int_equal(check_mark(NULL, 0, 1), 0);
  for (size_t count = 1; count <= 300; count = count < 4 ? count + 1 : 5 * count) {
    const size_t seen = check_mark(views, count, bounds[count % 3]);
    assert_true(seen > 1000 && (count > 2 || seen < CELLS));
  }
  /* few of them see anything, and not all are rotations */
  for (uint64_t seed = 0; seed < 40; seed++) {
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

static size_t check_list(void) {
  const struct twin_span cells = twin_take(&twin, ERN_ELEMENT_INT32, CELLS), values = twin_reals(&twin, grid, CELLS);
  struct ern_occupancy_list_args args[2];
  for (int k = 0; k < 2; k++) args[k] = (struct ern_occupancy_list_args){cells.on[k], values.on[k], 0};
  TWIN_RUN(&twin, occupancy_list, args);
  assert_int_equal(args[1].count, args[0].count);
  twin_same_int32(&twin, "cells", cells); /* past the list: poison in both */
  twin_same_bits(&twin, "grid", values);
  twin_clear(&twin);
  return args[0].count;
}

static void test_list(void **state) {
  (void)state;
  static const float odd[] = {0, -0.0f, 1e-45f, -1e-45f, INFINITY, -INFINITY, NAN, FLT_MAX};
  if (twin_is_small()) {
    for (size_t i = 0; i < CELLS; i++) grid[i] = word_at(1, i) % 12 == 0 ? odd[word_at(2, i) % 8] : -1;
    check_list();
    return;
  }
  for (size_t i = 0; i < CELLS; i++) grid[i] = -1;
  assert_int_equal(check_list(), 0);
  for (size_t i = 0; i < CELLS; i++) grid[i] = 0;
  assert_int_equal(check_list(), CELLS);
  /* one cell: corners, edges and faces of the grid and of blocks, and anywhere */
  for (size_t i = 0; i < CELLS; i++) grid[i] = -1;
  for (size_t k = 0; k < 40; k++) {
    const uint32_t corner = (k & 1 ? 0x049249u : 0) | (k & 2 ? 0x092492u : 0) | (k & 4 ? 0x124924u : 0),
                   cell = k < 8    ? corner
                          : k < 24 ? corner ^ (1u << (word_at(k, 0) % 21))
                                   : word_at(k, 1) % CELLS;
    grid[cell] = 0;
    const size_t found = check_list();
    assert_in_range(found, 4, 7);
    grid[cell] = -1;
  }
  for (uint32_t share = 2; share < 5000; share *= 6) {
    for (size_t i = 0; i < CELLS; i++) {
      grid[i] = word_at(share, i) % share == 0 ? 0.5f : -1;
      if (word_at(share + 1, i / 64) % share == 0) grid[i] = 1;
      if (share == 12) grid[i] = odd[word_at(share, i) % 8];
    }
    check_list();
  }
}

/* ---- points, scatter ---- */

static void test_points(void **state) {
  (void)state;
  static const float bounds[] = {1, 2, 0.7f, 16};
  static int32_t cells[5000];
  for (size_t s = 0; s < TWIN_SIZES + 2; s++) {
    const size_t n = s < TWIN_SIZES ? twin_sizes[s] : s == TWIN_SIZES ? 0 : 5000;
    for (size_t i = 0; i < n; i++) cells[i] = (int32_t)(i == 0 ? 0 : i == 1 ? CELLS - 1 : word_at(s, i) % CELLS);
    const struct twin_span list = twin_int32s(&twin, cells, n);
    const struct twin_rows x = twin_rows_of(&twin, NULL, 3, n, ERN_PER_SAMPLE);
    struct ern_occupancy_points_args args[2];
    for (int k = 0; k < 2; k++)
      args[k] = (struct ern_occupancy_points_args){.x = x.on[k],
                                                   .cells = list.on[k],
                                                   .bound = bounds[s % 4],
                                                   .seed = 0xabcdef0123456789u * s,
                                                   .step = s << 30,
                                                   .n = n};
    TWIN_RUN(&twin, occupancy_points, args);
    twin_same_bits(&twin, "points", (struct twin_span){{x.on[0].span, x.on[1].span}});
    twin_clear(&twin);
  }
}

static void test_scatter(void **state) {
  (void)state;
  static int32_t cells[TWIN_MOST];
  static float sigma[TWIN_MOST];
  for (size_t s = 0; s < TWIN_SIZES + 1; s++) {
    const size_t n = s < TWIN_SIZES ? twin_sizes[s] : 0;
    for (size_t i = 0; i < n; i++) {
      cells[i] = (int32_t)(i + 1 == n ? CELLS - 1 : 2003 * i);
      sigma[i] = i % 9 == 8 ? NAN : random_at(s, i, 100);
    }
    const struct twin_span list = twin_int32s(&twin, cells, n), value = twin_reals(&twin, sigma, n),
                           to = twin_take(&twin, ERN_ELEMENT_REAL, CELLS);
    struct ern_occupancy_scatter_args args[2];
    for (int k = 0; k < 2; k++) args[k] = (struct ern_occupancy_scatter_args){to.on[k], list.on[k], value.on[k], n};
    TWIN_RUN(&twin, occupancy_scatter, args);
    twin_same_bits(&twin, "fresh", to);
    twin_clear(&twin);
  }
}

/* ---- refresh ---- */

/* The reference's sum has a rounding of 2^-53 for each cell. The device's, of non-negative numbers, lacks what adding
 * up its own roundings loses: at most 64 additions one after the other, 8 and 6 more, each of a relative 2^-24 and of
 * what is 2^-24 a step itself: below (78*2^-24)^2 = 2.2e-11. */
static const double mean_tolerance = CELLS * 0x1p-53 + 2.2e-11;
/* A group of the device adds up a 64th of the cells in float; a sum past its end is infinite. */
static const double most_mean = (double)FLT_MAX / (CELLS / 64);

static void check_update(float decay, float limit) {
  const struct twin_span cells = twin_reals(&twin, grid, CELLS), now = twin_reals(&twin, fresh, CELLS),
                         bits = twin_take(&twin, ERN_ELEMENT_BYTE, BYTES);
  struct ern_occupancy_update_args args[2];
  for (int k = 0; k < 2; k++)
    args[k] = (struct ern_occupancy_update_args){
        .grid = cells.on[k], .bits = bits.on[k], .fresh = now.on[k], .decay = decay, .limit = limit, .mean = -7};
  TWIN_RUN(&twin, occupancy_update, args);
  twin_same_bits(&twin, "grid", cells);
  twin_same_bits(&twin, "fresh", now);
  const double found = args[1].mean, expected = args[0].mean;
  const bool too_large = isinf(found) && expected > most_mean;
  if (!(found == expected || (isnan(found) && isnan(expected)) || too_large ||
        fabs(found - expected) <= mean_tolerance * fabs(expected)))
    fail_msg("mean %.17g, reference %.17g", found, expected);
  static uint8_t packed[2][BYTES + 2 * TWIN_GUARD];
  for (int k = 0; k < 2; k++)
    support_ok(context,
               twin.backend[k]->download_bytes(twin.stream[k], packed[k],
                                               (ern_span){bits.on[k].buffer, 0, sizeof packed[k]}, sizeof packed[k]));
  assert_memory_equal(packed[1], packed[0], sizeof packed[0]);
  twin_clear(&twin);
}

/* Densities of all sizes, none, and, where `odd`, no numbers; marked cells, alone and by the block. */
static void fill(uint64_t seed, float scale, bool odd) {
  for (size_t i = 0; i < CELLS; i++) {
    const uint32_t word = word_at(seed, i), block = word_at(seed + 2, i / 64), other = word_at(seed + 3, i);
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
  if (twin_is_small()) {
    fill(1, 1, true);
    check_update(0.95f, 10);
    return;
  }
  for (uint64_t seed = 0; seed < 6; seed++) {
    fill(10 * seed, seed % 2 ? 1 : 0.01f, false);
    check_update(0.95f, seed == 4 ? 0.001f : 10);
  }
  for (uint64_t seed = 0; seed < 5; seed++) {
    static const float decays[] = {0.95f, 1, 0, NAN, INFINITY};
    fill(10 * seed + 5, 1, true);
    check_update(decays[seed], 10);
  }
  fill(1, 1e-41f, false);
  check_update(0.95f, 10);
  fill(1, 1e-41f, false);
  check_update(-2, 10); /* zeros of both signs are larger than these */
}

/* No cell is above the mean where all are the same, however the sum is rounded. */
static void test_same_everywhere(void **state) {
  (void)state;
  if (twin_is_small()) skip();
  static const float value[] = {0, 0.1f, 7.3f, 1.0f / 3, 1e-40f, 3e30f, FLT_MAX};
  for (size_t v = 0; v < sizeof value / sizeof *value; v++) {
    for (size_t i = 0; i < CELLS; i++) grid[i] = 0, fresh[i] = value[v];
    check_update(0.95f, 10);
    for (size_t i = 0; i < CELLS; i++) grid[i] = i % 128 == 77 ? value[v] : -1, fresh[i] = 0;
    check_update(1, 10);
  }
  for (size_t i = 0; i < CELLS; i++) grid[i] = -1, fresh[i] = 1;
  check_update(1, 10);
}

/* The same sums on every run. */
static void test_repeated(void **state) {
  (void)state;
  double mean[3];
  if (twin_is_small()) skip();
  fill(3, 1, false);
  for (int run = 0; run < 3; run++) {
    const struct twin_span cells = twin_reals(&twin, grid, CELLS), now = twin_reals(&twin, fresh, CELLS),
                           bits = twin_take(&twin, ERN_ELEMENT_BYTE, BYTES);
    struct ern_occupancy_update_args args = {
        .grid = cells.on[1], .bits = bits.on[1], .fresh = now.on[1], .decay = 0.95f, .limit = 10};
    support_ok(context, twin.backend[1]->occupancy_update(twin.stream[1], &args));
    mean[run] = args.mean;
    assert_true(mean[run] == mean[0]);
    twin_clear(&twin);
  }
}

/* ---- speed ---- */

enum { POINTS = 1 << 18, VIEWS = 1000 };

struct bench {
  int with, slot;
  struct ern_occupancy_mark_args mark[2];
  struct ern_occupancy_list_args list[2];
  struct ern_occupancy_points_args points[2];
  struct ern_occupancy_scatter_args scatter[2];
  struct ern_occupancy_update_args update[2];
};

static void bench_run(void *user) {
  struct bench *b = user;
  const int k = b->with;
  struct ern_backend *backend = twin.backend[k];
  struct ern_stream *stream = twin.stream[k];
  int32_t last;
  switch (b->slot) {
    case 0: support_ok(context, backend->occupancy_mark(stream, &b->mark[k])); break;
    case 1: support_ok(context, backend->occupancy_list(stream, &b->list[k])); break;
    case 2: support_ok(context, backend->occupancy_points(stream, &b->points[k])); break;
    case 3: support_ok(context, backend->occupancy_scatter(stream, &b->scatter[k])); break;
    default: support_ok(context, backend->occupancy_update(stream, &b->update[k])); break;
  }
  /* a small blocking read: the time is of work that is done */
  support_ok(context, backend->download_int32(stream, &last, b->list[k].cells, 1));
}

static void measure(void) {
  static const char *const name[] = {"mark", "list", "points", "scatter", "update"};
  static struct ern_view views[VIEWS];
  struct bench bench;
  for (size_t v = 0; v < VIEWS; v++) aim(&views[v], 7), views[v].pose[3] += random_at(v, 0, 0.05f);
  fill(1, 1, false);
  const struct twin_span cells = twin_take(&twin, ERN_ELEMENT_INT32, CELLS), marked = twin_reals(&twin, grid, CELLS),
                         values = twin_reals(&twin, grid, CELLS), now = twin_reals(&twin, fresh, CELLS),
                         sigma = twin_reals(&twin, fresh, POINTS), bits = twin_take(&twin, ERN_ELEMENT_BYTE, BYTES);
  const struct twin_rows x = twin_rows_of(&twin, NULL, 3, POINTS, ERN_PER_SAMPLE);
  for (int k = 0; k < 2; k++) {
    bench.mark[k] = (struct ern_occupancy_mark_args){marked.on[k], views, VIEWS, 1};
    bench.list[k] = (struct ern_occupancy_list_args){cells.on[k], values.on[k], 0};
    bench.points[k] = (struct ern_occupancy_points_args){x.on[k], cells.on[k], 1, 1, 2, POINTS};
    bench.scatter[k] = (struct ern_occupancy_scatter_args){now.on[k], cells.on[k], sigma.on[k], POINTS};
    bench.update[k] = (struct ern_occupancy_update_args){values.on[k], bits.on[k], now.on[k], 1, 10, 0};
  }
  for (int slot = 4; slot >= 0; slot--) {
    double seconds[2];
    bench.slot = slot == 4 ? 1 : slot == 1 ? 4 : slot; /* the list first: others read it */
    for (bench.with = 0; bench.with < 2; bench.with++) seconds[bench.with] = seconds_of(bench_run, &bench);
    printf("%-8s reference %8.3f ms, device %8.3f ms: %.2f times\n", name[bench.slot], 1e3 * seconds[0],
           1e3 * seconds[1], seconds[0] / seconds[1]);
  }
  printf("%d cells, %zu in the list, %d points, %d views\n", CELLS, bench.list[1].count, POINTS, VIEWS);
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
    set_up(NULL);
    measure();
    tear_down(NULL);
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_mark),     cmocka_unit_test(test_list),   cmocka_unit_test(test_points),
      cmocka_unit_test(test_scatter),  cmocka_unit_test(test_update), cmocka_unit_test(test_same_everywhere),
      cmocka_unit_test(test_repeated),
  };
  return cmocka_run_group_tests_name("opencl occupancy", tests, set_up, tear_down);
}
