/* SPDX-License-Identifier: MIT
 * Shared code of kernelcheck: the tests and benchmark of each subject ("noun"), test sizes, and timing. */
#ifndef ERN_TESTS_HARNESS_H
#define ERN_TESTS_HARNESS_H

#include "machines.h"
#include "mlp/mlp_ops.h"

struct noun {
  const char *name;
  const struct CMUnitTest *tests;
  size_t count;
  void (*bench)(void);
  struct machines_wish wish;
};
/* noun_WHICH of the tests of a file; ...: members of its wish */
#define NOUN(which, speed, ...)      \
  const struct noun noun_##which = { \
      .name = #which, .tests = tests, .count = COUNT_OF(tests), .bench = speed, .wish = {__VA_ARGS__}};

/* Sizes around the edges of registers, vectors of a device and work-groups. */
static const size_t test_sizes[] = {1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 63, 64, 65, 127, 129, 255, 257, 1000};
enum { MOST_SIZE = 1000, SMALL_SIZES = 16 };

/* ERNERF_TEST_SMALL is set, for simulators: sizes up to 65. */
static inline bool is_set(const char *variable) {
  const char *value = getenv(variable);
  return value != NULL && value[0] != 0;
}
static inline bool is_small(void) { return is_set("ERNERF_TEST_SMALL"); }
static inline bool is_long(void) { return is_set("ERNERF_TEST_LONG"); }
static inline size_t size_count(void) { return is_small() ? SMALL_SIZES : COUNT_OF(test_sizes); }

/* Under emulation the reference takes about fifty times as long: checks of whole pictures then use smaller ones. */
static inline bool is_emulated(void) { return getenv("ERNERF_EMULATED") != NULL; }
/* Whether a sample of the models is enough: also on a device, which builds kernels for each; PoCL does for seconds. */
static inline bool is_sampled(void) { return is_emulated() || (is_device(machines.count - 1) && !is_long()); }
/* Of many shapes at many sizes, one combination of so many is enough. */
static inline size_t one_of(void) { return is_emulated() ? (is_long() ? 3 : 40) : is_long() ? 1 : 3; }
static inline int emulated_side(int side) { return is_emulated() ? (side + 2) / 3 : side; }

static inline float random_at(uint64_t seed, size_t at, float scale) { return machines_random(seed, at, scale); }
static inline void fill_random(float *values, size_t count, uint64_t seed, float scale) {
  for (size_t i = 0; i < count; i++) values[i] = random_at(seed, i, scale);
}
static inline float *floats(size_t count) { return held_memory(count, sizeof(float)); }

/* ---- OpenCL devices ---- */

bool divides_exactly(int k); /* quotients and roots are correctly rounded; true of a CPU's kernels */
bool compiles_for_cpus(int k);
bool is_gpu(int k); /* a real one, which computes few samples without tensor cores */
/* Changes a setting of the device for a test; 0: no change. Returns the previous value. */
size_t set_local_bytes(int k, size_t bytes);
int set_vector_width(int k, int width);

/* ---- threads: machines have one ---- */

/* Gives machine k a stream with so many threads; returns its previous stream, for stream_restore. */
struct ern_stream *stream_replace(int k, int threads);
void stream_restore(int k, struct ern_stream *own);

/* ---- speed: the least time of a call on each machine in turn, until it is done ---- */

struct bench_line {
  const char *what;
  double items, products, began, least, total, reference;
  int k, calls;
};
bool bench_again(struct bench_line *line);

/* Nanoseconds for each item, and the ratio to machine 0. products: multiply-adds of a call, 0: not counted; a CPU's
 * rate is compared with the peak of its instruction set on one core. */
#define BENCH_PRODUCTS(what, items, products, slot, args)                                                             \
  for (struct bench_line line_ = {what, (double)(items), (double)(products), 0, 0, 0, 0, 0, 0}; bench_again(&line_);) \
  support_ok(machines.context, machines.backend[line_.k]->slot(machines.stream[line_.k], &(args)[line_.k]))
#define BENCH(what, items, slot, args) BENCH_PRODUCTS(what, items, 0, slot, args)

/* Multiply-adds of a sample: forward 1 a weight; backward 2, and 1 for those of the hidden layers again. */
double products_of(const struct ern_mlp *mlp, bool backward);

#endif
