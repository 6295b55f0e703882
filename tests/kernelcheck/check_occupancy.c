/* SPDX-License-Identifier: MIT
 * Points, refresh and bits of the head's occupancy of each instruction set against the reference: nothing but the same
 * bits is accepted. */
#include "kernelcheck.h"

#include <float.h>

#include "core/kernels.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_occupancy_points_kernel *points;
  ern_occupancy_update_kernel *update;
  ern_occupancy_pack_kernel *pack;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_occupancy_points_ref, ern_occupancy_update_ref, ern_occupancy_pack_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_occupancy_points_avx2, ern_occupancy_update_avx2, ern_occupancy_pack_avx2},
    {"avx512", MACHINE_AVX512, ern_occupancy_points_avx512, ern_occupancy_update_avx512, ern_occupancy_pack_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_occupancy_points_neon, ern_occupancy_update_neon, ern_occupancy_pack_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels, CELLS = ERN_OCCUPANCY_CELLS, BYTES = ERN_OCCUPANCY_BYTES };

static uint32_t word_at(uint64_t seed, size_t i) { return ern_random_at(seed, 0, (uint32_t)i, ERN_RNG_INIT).word[0]; }

static void test_points(void **state) {
  (void)state;
  static const size_t sizes[] = {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 33, 100, 5000};
  static const float bounds[] = {1, 2, 0.7f, 16};
  if (KERNELS == 1) skip(); /* built without instruction sets */
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) {
      print_message("%s: not on this machine\n", kernels[k].name);
      continue;
    }
    for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
      const size_t n = sizes[s], stride = n + 5;
      int32_t *cells = calloc(n, sizeof *cells);
      struct guarded x[2];
      assert_non_null(cells);
      for (size_t i = 0; i < n; i++) cells[i] = (int32_t)(i == 0 ? 0 : i == 1 ? CELLS - 1 : word_at(s, i) % CELLS);
      for (int with = 0; with < 2; with++) {
        x[with] = guarded_make(3 * stride);
        (with == 0 ? &kernels[0] : &kernels[k])
            ->points(x[with].data, stride, cells, bounds[s % 4], 0xabcdef0123456789u * s, s << 30, n);
      }
      assert_memory_equal(x[0].data, x[1].data, x[0].count * sizeof(float));
      guarded_check(&x[1], 3, stride, n, "points");
      for (int with = 0; with < 2; with++) guarded_free(&x[with]);
      free(cells);
    }
  }
}

/* Densities of all sizes, none, and no numbers; marked cells, alone and by the block. */
static void fill(struct guarded *grid, struct guarded *fresh) {
  for (size_t i = 0; i < CELLS; i++) {
    const uint32_t word = word_at(1, i), block = word_at(2, i / 64);
    grid->data[i] = block % 3 == 0 || word % 5 == 0 ? -1 : word % 7 == 0 ? 0 : (float)(word % 1000) * 0.01f;
    if (word % 1009 == 3) grid->data[i] = NAN;
    if (word % 1009 == 4) grid->data[i] = -0.0f;
    const uint32_t other = word_at(3, i);
    fresh->data[i] = other % 3 == 0 ? 0 : (float)(other % 4096) * 0.004f;
    if (other % 101 == 3) fresh->data[i] = NAN;
    if (other % 1009 == 4) fresh->data[i] = INFINITY;
    if (other % 1009 == 5) fresh->data[i] = -3;
    if (other % 1009 == 6) fresh->data[i] = -0.0f;
  }
}

/* The sums are of the same doubles in another order: a rounding of 2^-53 for each of them. */
static void expect_sum(const char *kernel, double found, double expected) {
  if (found == expected || fabs(found - expected) <= CELLS * 0x1p-53 * expected) return;
  fail_msg("%s: sum %.17g, reference %.17g", kernel, found, expected);
}

static void check_update(const struct kernel *kernel, const uint32_t *cut, size_t parts) {
  struct guarded grid[2] = {guarded_make(CELLS), guarded_make(CELLS)}, fresh = guarded_make(CELLS);
  fill(&grid[0], &fresh);
  memcpy(grid[1].data, grid[0].data, CELLS * sizeof(float));
  for (size_t p = 0; p < parts; p++) {
    double sum[2] = {-1, -1};
    for (int with = 0; with < 2; with++)
      (with == 0 ? &kernels[0] : kernel)->update(grid[with].data, &sum[with], fresh.data, 0.95f, cut[p], cut[p + 1]);
    expect_sum(kernel->name, sum[1], sum[0]);
  }
  for (size_t i = 0; i < CELLS; i++) {
    if (memcmp(&grid[0].data[i], &grid[1].data[i], sizeof(float)) != 0)
      fail_msg("%s: cell %zu: %.9g, reference %.9g", kernel->name, i, grid[1].data[i], grid[0].data[i]);
  }
  guarded_check(&grid[1], 1, CELLS, CELLS, "grid");
  for (int with = 0; with < 2; with++) guarded_free(&grid[with]);
  guarded_free(&fresh);
}

static void test_update(void **state) {
  (void)state;
  static const uint32_t whole[] = {0, CELLS},
                        odd[] = {0, 1, 1, 7, 9, 17, 31, 40, 999, 1000, 1024, 1600, 1 << 20, CELLS - 9, CELLS - 1};
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    check_update(&kernels[k], whole, 1);
    check_update(&kernels[k], odd, sizeof odd / sizeof *odd - 1);
  }
}

static void test_pack(void **state) {
  (void)state;
  static const float thresholds[] = {0, 5, -2, INFINITY, 0.01f};
  static const uint32_t cut[] = {0, 1, 3, 3, 8, 15, 16, 33, 1000, BYTES};
  struct guarded grid = guarded_make(CELLS), fresh = guarded_make(CELLS);
  uint8_t *bits[2] = {calloc(BYTES + 8, 1), calloc(BYTES + 8, 1)};
  assert_true(bits[0] != NULL && bits[1] != NULL);
  fill(&grid, &fresh);
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    for (size_t t = 0; t < sizeof thresholds / sizeof *thresholds; t++) {
      for (size_t p = 0; p + 1 < sizeof cut / sizeof *cut; p++) {
        for (int with = 0; with < 2; with++) {
          memset(bits[with], 0x5a, BYTES + 8);
          (with == 0 ? &kernels[0] : &kernels[k])->pack(bits[with], grid.data, thresholds[t], cut[p], cut[p + 1]);
        }
        assert_memory_equal(bits[0], bits[1], BYTES + 8);
      }
    }
  }
  guarded_free(&grid);
  guarded_free(&fresh);
  for (int with = 0; with < 2; with++) free(bits[with]);
}

/* ---- measure ---- */

enum { POINTS = 1 << 14 };

struct bench {
  const struct kernel *kernel;
  int what;
  struct guarded grid, fresh, x;
  int32_t cells[POINTS];
  uint8_t bits[BYTES];
};

static void bench_run(void *user) {
  struct bench *b = user;
  double sum;
  switch (b->what) {
    case 0: b->kernel->points(b->x.data, POINTS, b->cells, 1, 1, 2, POINTS); break;
    case 1: b->kernel->update(b->grid.data, &sum, b->fresh.data, 1, 0, CELLS); break;
    default: b->kernel->pack(b->bits, b->grid.data, 1, 0, BYTES); break;
  }
}

static void measure(void) {
  static const char *const name[] = {"points", "update", "pack"};
  static struct bench bench;
  bench.grid = guarded_make(CELLS);
  bench.fresh = guarded_make(CELLS);
  bench.x = guarded_make(3 * POINTS);
  for (int32_t i = 0; i < POINTS; i++) bench.cells[i] = 17 * i;
  fill(&bench.grid, &bench.fresh);
  for (bench.what = 0; bench.what < 3; bench.what++) {
    double first = 0;
    for (size_t k = 0; k < KERNELS; k++) {
      if (!machine_has(kernels[k].isa)) continue;
      bench.kernel = &kernels[k];
      const double seconds = seconds_of(bench_run, &bench);
      if (k == 0) first = seconds;
      printf("%-6s %-6s: %7.3f ns a cell, %7.3f ms, %.1f times ref\n", name[bench.what], kernels[k].name,
             seconds * 1e9 / (bench.what == 0 ? POINTS : CELLS), seconds * 1e3, first / seconds);
    }
  }
  guarded_free(&bench.grid);
  guarded_free(&bench.fresh);
  guarded_free(&bench.x);
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    measure();
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_points),
      cmocka_unit_test(test_update),
      cmocka_unit_test(test_pack),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
