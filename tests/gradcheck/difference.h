/* SPDX-License-Identifier: MIT
 * Compares the gradients of a backward kernel with central differences in double. */
#ifndef ERN_TESTS_DIFFERENCE_H
#define ERN_TESTS_DIFFERENCE_H

#include "../support.h"

#include <math.h>
#include <stdbool.h>

#include "core/rng.h"

/* A scalar function of values that the test owns, and a hash that differs if the function is not smooth between two
 * sets of values: it covers signs of ReLU units and cells of a grid. NULL: smooth everywhere. */
struct difference {
  double (*loss)(void *user);
  uint64_t (*piece)(void *user);
  void *user;
};

/* [-1, 1) */
static inline double difference_random(uint64_t seed, uint32_t at) {
  const struct ern_random random = ern_random_at(seed, 0, at, ERN_RNG_INIT);
  return ern_uniform(random.word[0]) * 2.0 - 1.0;
}

static inline void difference_fill(double *values, size_t count, double scale, uint64_t seed) {
  for (size_t i = 0; i < count; i++) values[i] = scale * difference_random(seed, (uint32_t)i);
}

/* FNV-1a over words. */
static inline uint64_t difference_hash(uint64_t hash, uint64_t word) { return (hash ^ word) * 0x100000001b3u; }

/* Whether the function has a kink within 10 h of the value. */
static inline bool difference_kink(const struct difference *of, double *value, double h) {
  if (of->piece == NULL) return false;
  const double kept = *value;
  const uint64_t here = of->piece(of->user);
  *value = kept + 10 * h;
  const uint64_t above = of->piece(of->user);
  *value = kept - 10 * h;
  const uint64_t below = of->piece(of->user);
  *value = kept;
  return above != here || below != here;
}

/* |g - g_fd| / |g_fd| over every `step`-th of a tensor's values <= 1e-6, with h = 1e-5 max(1, |x|): the truncation is
 * of the order h^2 = 1e-10 and the rounding of 1e-16/h = 1e-11. Values near a kink are skipped; they must be a
 * minority. */
static inline void difference_check(const struct difference *of, const char *name, double *values,
                                    const double *gradient, size_t count, size_t step) {
  double error = 0, norm = 0;
  size_t looked = 0, skipped = 0;
  for (size_t i = 0; i < count; i += step) {
    const double kept = values[i], h = 1e-5 * fmax(1, fabs(kept));
    looked++;
    if (difference_kink(of, &values[i], h)) {
      skipped++;
      continue;
    }
    values[i] = kept + h;
    const double above = of->loss(of->user);
    values[i] = kept - h;
    const double below = of->loss(of->user);
    values[i] = kept;
    const double found = (above - below) / (2 * h);
    error += (gradient[i] - found) * (gradient[i] - found);
    norm += found * found;
  }
  print_message("%-28s %6zu values, %4zu near a kink, error %.1e\n", name, looked, skipped, sqrt(error / norm));
  assert_true(norm > 0);
  assert_true(2 * skipped < looked);
  if (!(sqrt(error) <= 1e-6 * sqrt(norm))) fail_msg("%s: gradient is off by %.3e", name, sqrt(error / norm));
}

#endif
