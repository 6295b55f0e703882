/* SPDX-License-Identifier: MIT
 * Helpers of the CPU's slots: they convert spans to pointers and distribute the work over threads. The slots' files are
 * compiled once for each scalar type.
 *
 * Results are the same for any number of threads. Sums over samples are computed in ERN_SHARDS blocks (shards), whose
 * bounds depend only on the number of samples, and added in the order of the shards. One thread adds to each level of a
 * grid, in sample order. */
#ifndef ERN_CPU_SLOTS_H
#define ERN_CPU_SLOTS_H

#include <string.h>

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/cpu_state.h"

#define ERN_CPU_SLOT(name) ern_status ERN_REF(ern_cpu_##name)(struct ern_stream *, struct ern_##name##_args *);
ERN_SLOTS(ERN_CPU_SLOT)
#undef ERN_CPU_SLOT

static inline ern_real *reals(ern_span span) {
  return span.buffer != NULL ? (ern_real *)span.buffer->memory + span.at : NULL;
}
static inline int32_t *int32s(ern_span span) {
  return span.buffer != NULL ? (int32_t *)span.buffer->memory + span.at : NULL;
}
static inline uint8_t *bytes(ern_span span) {
  return span.buffer != NULL ? (uint8_t *)span.buffer->memory + span.at : NULL;
}
static inline ern_real *after(ern_real *pointer, size_t count) { return pointer != NULL ? pointer + count : NULL; }

static inline const struct ern_cpu_kernels *kernels_of(const struct ern_stream *stream) {
  return ((const struct ern_cpu_backend *)stream->backend)->kernels;
}
static inline struct ern_pool *pool_of(struct ern_stream *stream) { return ((struct ern_cpu_stream *)stream)->pool; }

struct range {
  size_t begin, end;
};

/* Shard k of n items, in units of `unit` items. */
static inline struct range shard(size_t n, size_t unit, size_t k) {
  const size_t units = (n + unit - 1) / unit;
  const size_t begin = units * k / ERN_SHARDS * unit, end = units * (k + 1) / ERN_SHARDS * unit;
  return (struct range){begin < n ? begin : n, end < n ? end : n};
}

/* The shared arguments of a slot's tasks. */
struct job {
  struct ern_stream *stream;
  const struct ern_cpu_kernels *kernels;
  void *args;
  ern_real *block; /* per-shard sums */
  size_t block_stride;
  ern_status status[ERN_SHARDS];
};

static inline void run(struct ern_stream *stream, void *args, size_t tasks, void (*task)(void *, size_t, int)) {
  struct job job = {.stream = stream, .kernels = kernels_of(stream), .args = args};
  ern_pool_run(pool_of(stream), tasks, task, &job);
}

/* Defines a slot whose items are divided into shards in units of `unit`; the function body after the macro processes
 * the items of `r`. */
#define ERN_SHARDED_SLOT(name, items, unit)                                                                 \
  static void name##_shard(const struct ern_cpu_kernels *, const struct ern_##name##_args *, struct range); \
  static void name##_task(void *user, size_t k, int worker) {                                               \
    (void)worker;                                                                                           \
    const struct job *job = user;                                                                           \
    const struct ern_##name##_args *a = job->args;                                                          \
    name##_shard(job->kernels, a, shard(items, unit, k));                                                   \
  }                                                                                                         \
  ern_status ERN_REF(ern_cpu_##name)(struct ern_stream * stream, struct ern_##name##_args * a) {            \
    run(stream, a, ERN_SHARDS, name##_task);                                                                \
    return ERN_OK;                                                                                          \
  }                                                                                                         \
  static void name##_shard(const struct ern_cpu_kernels *kernels, const struct ern_##name##_args *a, struct range r)

/* Allocates a block of `each` reals for each shard, so that no two tasks write the same block. */
static inline ern_status take_blocks(struct ern_stream *stream, size_t each, ern_real **block) {
  ern_span span;
  const ern_status status = ern_scratch_take(stream, ERN_ELEMENT_REAL, each * ERN_SHARDS, &span);
  *block = reals(span);
  return status;
}

/* A slot that sums one number of each shard. */
struct figure_job {
  const struct ern_cpu_kernels *kernels;
  const void *args;
  double part[ERN_SHARDS];
};

static inline double sum_of_parts(struct ern_stream *stream, const void *args, void (*task)(void *, size_t, int)) {
  struct figure_job job = {.kernels = kernels_of(stream), .args = args};
  double sum = 0;
  ern_pool_run(pool_of(stream), ERN_SHARDS, task, &job);
  for (int k = 0; k < ERN_SHARDS; k++) sum += job.part[k];
  return sum;
}

#endif
