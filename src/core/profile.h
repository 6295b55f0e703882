/* SPDX-License-Identifier: MIT
 * Times and counts of a fused pass, for the benchmark. A pass adds them to the profile that its args point to. */
#ifndef ERN_CORE_PROFILE_H
#define ERN_CORE_PROFILE_H

#include <stdbool.h>
#include <stdint.h>
#include <time.h>

typedef enum ern_profile_stage {
  ERN_PROFILE_MARCH,     /* visible pixels, directions, sample distances, spherical harmonics */
  ERN_PROFILE_ENCODE,    /* grids forward */
  ERN_PROFILE_FORWARD,   /* MLPs and activations forward */
  ERN_PROFILE_COMPOSITE, /* compositing, losses and their gradients */
  ERN_PROFILE_BACKWARD,  /* MLPs backward, hidden values computed again */
  ERN_PROFILE_TABLES,    /* gradients of the grids' tables */
  ERN_PROFILE_STAGES
} ern_profile_stage;

typedef enum ern_profile_count {
  ERN_PROFILE_PIXELS,
  ERN_PROFILE_RAYS,    /* that were marched */
  ERN_PROFILE_HITS,    /* rays with a sample */
  ERN_PROFILE_MARCHED, /* samples in occupied cells, on rays that were marched */
  ERN_PROFILE_SAMPLES, /* whose density was computed */
  ERN_PROFILE_COLOURS, /* whose colour was computed */
  ERN_PROFILE_COUNTS
} ern_profile_count;

struct ern_profile {
  double seconds[ERN_PROFILE_STAGES]; /* of all threads together */
  uint64_t count[ERN_PROFILE_COUNTS];
  bool timed; /* set by the caller: seconds are wanted too; the pass then reads a clock several times a tile */
};

/* Seconds of a monotonic clock. */
static inline double ern_profile_now(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* profile += part; either may be NULL. */
static inline void ern_profile_add(struct ern_profile *profile, const struct ern_profile *part) {
  if (profile == NULL || part == NULL) return;
  for (int i = 0; i < ERN_PROFILE_STAGES; i++) profile->seconds[i] += part->seconds[i];
  for (int i = 0; i < ERN_PROFILE_COUNTS; i++) profile->count[i] += part->count[i];
}

#endif
