/* SPDX-License-Identifier: MIT
 * Counter-based random numbers: Philox 4x32-10 (Salmon, Moraes, Dror, Shaw 2011). The same key and counter give the
 * same numbers on every machine, thread and backend, so a checkpoint stores a step and no generator. */
#ifndef ERN_CORE_RNG_H
#define ERN_CORE_RNG_H

#include <stdint.h>

/* What a number is drawn for: the fourth word of the counter, so that purposes never share a stream. */
typedef enum ern_purpose {
  ERN_RNG_INIT = 0,
  ERN_RNG_FRAME,
  ERN_RNG_PIXEL,
  ERN_RNG_MARCH,
  ERN_RNG_EYE,
  ERN_RNG_SMOOTH,
  ERN_RNG_REFRESH_FRAME,
  ERN_RNG_REFRESH_CELL,
  ERN_RNG_SPEECH,
  ERN_RNG_PATCH,
  ERN_RNG_BACKGROUND,
  ERN_RNG_PRUNE,
  ERN_RNG_SPEECH_NOISE
} ern_purpose;

struct ern_random {
  uint32_t word[4];
};

static inline struct ern_random ern_random_at(uint64_t seed, uint64_t step, uint32_t index, ern_purpose purpose) {
  uint32_t c0 = (uint32_t)step, c1 = (uint32_t)(step >> 32), c2 = index, c3 = (uint32_t)purpose;
  uint32_t k0 = (uint32_t)seed, k1 = (uint32_t)(seed >> 32);
  for (int round = 0; round < 10; round++) {
    const uint64_t p0 = (uint64_t)0xD2511F53u * c0, p1 = (uint64_t)0xCD9E8D57u * c2;
    c0 = (uint32_t)(p1 >> 32) ^ c1 ^ k0;
    c2 = (uint32_t)(p0 >> 32) ^ c3 ^ k1;
    c1 = (uint32_t)p1;
    c3 = (uint32_t)p0;
    k0 += 0x9E3779B9u;
    k1 += 0xBB67AE85u;
  }
  return (struct ern_random){{c0, c1, c2, c3}};
}

/* [0, 1), 24 bits: exact in float. */
static inline float ern_uniform(uint32_t word) { return (float)(word >> 8) * 0x1p-24f; }

/* 0 .. bound-1, bound >= 1; the bias is below bound/2^32. */
static inline uint32_t ern_below(uint32_t word, uint32_t bound) { return (uint32_t)(((uint64_t)word * bound) >> 32); }

#endif
