/* SPDX-License-Identifier: MIT
 * What the kernel checks share: guarded arrays, random numbers, the instruction sets of this machine, time, and the
 * rate of multiply-adds that it can reach. `check_x --bench` measures instead of checking. */
#ifndef ERN_TESTS_KERNELCHECK_H
#define ERN_TESTS_KERNELCHECK_H

#include "../support.h"

#include <math.h>
#include <stdbool.h>
#include <time.h>

#include "core/rng.h"

/* Values are filled with, and surrounded by, a NaN of our own, which must still be there afterwards. */
enum { GUARD = 32 };
#define POISON_BITS 0x7fa5a5a5u

struct guarded {
  float *room, *data; /* data is aligned to 64 bytes */
  size_t count;
};

static inline bool is_poison(float value) {
  uint32_t bits = 0;
  memcpy(&bits, &value, sizeof bits);
  return bits == POISON_BITS;
}

static inline void poison(float *values, size_t count) {
  const uint32_t bits = POISON_BITS;
  for (size_t i = 0; i < count; i++) memcpy(values + i, &bits, sizeof bits);
}

static inline struct guarded guarded_make(size_t count) {
  const size_t bytes = (count + 2 * GUARD) * sizeof(float);
  struct guarded array = {.room = aligned_alloc(64, (bytes + 63) / 64 * 64), .count = count};
  assert_non_null(array.room);
  array.data = array.room + GUARD;
  poison(array.room, count + 2 * GUARD);
  return array;
}

/* Rows of n values at `stride`: what is between and around them was not touched. */
static inline void guarded_check(const struct guarded *array, size_t rows, size_t stride, size_t n, const char *what) {
  for (size_t i = 0; i < GUARD; i++) {
    if (!is_poison(array->room[i])) fail_msg("%s: written %zu before its begin", what, GUARD - i);
    if (!is_poison(array->data[array->count + i])) fail_msg("%s: written %zu past its end", what, i);
  }
  for (size_t r = 0; r < rows; r++) {
    for (size_t i = n; i < stride && r * stride + i < array->count; i++) {
      if (!is_poison(array->data[r * stride + i])) fail_msg("%s: written past the end of row %zu", what, r);
    }
  }
}

static inline void guarded_free(struct guarded *array) { free(array->room); }

/* [-scale, scale) */
static inline float random_at(uint64_t seed, size_t at, float scale) {
  const struct ern_random random = ern_random_at(seed, 0, (uint32_t)at, ERN_RNG_INIT);
  return (ern_uniform(random.word[0]) * 2 - 1) * scale;
}

static inline void random_rows(struct guarded *array, size_t rows, size_t stride, size_t n, float scale,
                               uint64_t seed) {
  for (size_t r = 0; r < rows; r++) {
    for (size_t i = 0; i < n; i++) array->data[r * stride + i] = random_at(seed, r * stride + i, scale);
  }
}

typedef enum machine_isa { MACHINE_REF, MACHINE_AVX2, MACHINE_AVX512, MACHINE_AVX512BF16, MACHINE_NEON } machine_isa;

static inline bool machine_has(machine_isa isa) {
#if defined(__x86_64__)
  switch (isa) {
    case MACHINE_REF: return true;
    case MACHINE_AVX2: return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    case MACHINE_AVX512:
      return machine_has(MACHINE_AVX2) && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
             __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
    case MACHINE_AVX512BF16: return machine_has(MACHINE_AVX512) && __builtin_cpu_supports("avx512bf16");
    case MACHINE_NEON: return false;
  }
#elif defined(__aarch64__)
  if (isa == MACHINE_NEON) return true;
#endif
  return isa == MACHINE_REF;
}

/* Under emulation the reference takes some fifty times as long: checks of whole pictures then look at smaller ones. */
static inline bool is_emulated(void) { return getenv("ERNERF_EMULATED") != NULL; }
static inline int emulated_side(int side) { return is_emulated() ? (side + 2) / 3 : side; }

static inline double seconds_now(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* The shortest of several runs, each of at least 30 ms. */
static inline double seconds_of(void (*run)(void *user), void *user) {
  run(user);
  int times = 1;
  for (;; times *= 2) {
    const double begin = seconds_now();
    for (int k = 0; k < times; k++) run(user);
    if (seconds_now() - begin > 0.03) break;
  }
  double best = INFINITY;
  for (int repeat = 0; repeat < 7; repeat++) {
    const double begin = seconds_now();
    for (int k = 0; k < times; k++) run(user);
    best = fmin(best, (seconds_now() - begin) / times);
  }
  return best;
}

/* Multiply-adds of independent chains, enough of them to fill any pipeline: floating-point operations a second. */
enum { PEAK_CHAINS = 12, PEAK_TURNS = 20000 };
#define PEAK_BODY(vector)                                                                           \
  vector chain[PEAK_CHAINS], a = (vector){0} + 0.999f, b = (vector){0} + 1e-3f;                     \
  for (int k = 0; k < PEAK_CHAINS; k++) chain[k] = b * (float)k;                                    \
  for (int turn = 0; turn < PEAK_TURNS; turn++) {                                                   \
    _Pragma("GCC unroll 12") for (int k = 0; k < PEAK_CHAINS; k++) { chain[k] = chain[k] * a + b; } \
  }                                                                                                 \
  for (int k = 1; k < PEAK_CHAINS; k++) chain[0] += chain[k];                                       \
  *(float *)user = chain[0][0];

#if defined(__x86_64__)
typedef float peak_8 __attribute__((vector_size(32)));
typedef float peak_16 __attribute__((vector_size(64)));
__attribute__((target("avx2,fma"), optimize("O3,fp-contract=fast"))) static inline void peak_run_8(void *user) {
  PEAK_BODY(peak_8)
}
__attribute__((target("avx512f,fma"), optimize("O3,fp-contract=fast"))) static inline void peak_run_16(void *user) {
  PEAK_BODY(peak_16)
}
#elif defined(__aarch64__)
typedef float peak_4 __attribute__((vector_size(16)));
__attribute__((optimize("O3,fp-contract=fast"))) static inline void peak_run_4(void *user) { PEAK_BODY(peak_4) }
#endif

/* Of one core; of the reference, 0: it has no multiply-add to be measured by. */
static inline double peak_flops(machine_isa isa) {
#if defined(__x86_64__) || defined(__aarch64__)
  float sink = 0;
  const double operations = 2.0 * PEAK_CHAINS * PEAK_TURNS;
#endif
#if defined(__x86_64__)
  if (isa == MACHINE_AVX2) return 8 * operations / seconds_of(peak_run_8, &sink);
  if (isa == MACHINE_AVX512) return 16 * operations / seconds_of(peak_run_16, &sink);
#elif defined(__aarch64__)
  if (isa == MACHINE_NEON) return 4 * operations / seconds_of(peak_run_4, &sink);
#endif
  (void)isa;
  return 0;
}

#endif
