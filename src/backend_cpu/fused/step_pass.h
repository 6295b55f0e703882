/* SPDX-License-Identifier: MIT
 * A fused training step of the head in flight: what its parts share. Float only. */
#ifndef ERN_STEP_PASS_H
#define ERN_STEP_PASS_H

#include "backend_cpu/fused/step_kernels.h"
#include "backend_cpu/slots.h"
#include "core/profile.h"
#include "render/stages.h"

/* ---- memory that a stream keeps from step to step ---- */

/* Grown, never copied: unlike scratch, it is given back before more is taken. */
struct ern_train_block {
  float *memory;
  size_t count;
};
typedef enum ern_train_use {
  ERN_TRAIN_NET,     /* the weights and the shards' gradients */
  ERN_TRAIN_GRIDS,   /* the unhashed levels */
  ERN_TRAIN_WORKERS, /* a struct ern_train_worker a thread */
  ERN_TRAIN_MARCHED, /* by marched sample */
  ERN_TRAIN_LIVE,    /* by sample that counts */
  ERN_TRAIN_SLOPES,  /* the features' gradient */
  ERN_TRAIN_USES
} ern_train_use;
struct ern_train_workspace {
  struct ern_train_block block[ERN_TRAIN_USES];
};

/* *memory = room for `count` floats; what it held is lost. */
ERN_NODISCARD ern_status ern_train_workspace_take(struct ern_cpu_stream *stream, ern_train_use use, size_t count,
                                                  float **memory);

/* The next `count` floats of a block, and how many a quantity of n samples takes up. */
static inline float *ern_train_cut(float **block, size_t count) {
  float *at = *block;
  *block += count;
  return at;
}
static inline size_t ern_train_padded(size_t n) { return (n + 2 * ERN_MLP_TILE - 1) / 64 * 64 + 64; }

/* ---- a thread's own ---- */

enum { ERN_TRAIN_BATCH = 1920 /* samples looked at together */ };

/* The samples of one ray that are in the batch. */
struct ern_train_group {
  int32_t ray; /* of the shard */
  int32_t count;
};

struct ern_train_worker {
  struct ern_train_tile tile;
  float x[3][ERN_TRAIN_BATCH];
  float sigma[ERN_TRAIN_BATCH], norm[ERN_TRAIN_BATCH], eye[ERN_TRAIN_BATCH], unc[ERN_TRAIN_BATCH];
  float rgb[3 * ERN_TRAIN_BATCH];
  int32_t sample[ERN_TRAIN_BATCH];                       /* of the batch */
  int32_t live[ERN_TRAIN_BATCH], place[ERN_TRAIN_BATCH]; /* those that count: their number, their place in it */
  struct ern_train_group group[ERN_TRAIN_BATCH];
  float hidden[ERN_TRAIN_BATCH * ERN_NET_DENSITY];
  struct ern_profile profile;
  float by_ray[]; /* of the shard: queue, samples looked at, transmittance */
};

/* Floats of a worker, for shards of `rays`. */
static inline size_t ern_train_worker_floats(size_t rays) {
  const size_t bytes = sizeof(struct ern_train_worker);
  return (bytes / sizeof(float) + 3 * rays + 63) / 64 * 64;
}

/* ---- the step ---- */

struct ern_train_step {
  struct ern_stream *stream;
  const struct ern_cpu_kernels *kernels;
  const struct ern_train_kernels *train;
  const struct ern_field *field;
  const float *parameters;
  struct ern_train_net net;
  struct ern_frame_net grids;
  char *workers;
  size_t worker_bytes, shard_rays;

  size_t rays;
  struct ern_marched marched;
  float stop;      /* a ray is spent where less light than this is left */
  bool everything; /* attention and uncertainty of all samples, not only of those that count */

  /* by marched sample, channels at `stride` */
  size_t stride;
  float *feature_rows, *sigma, *norm, *eye, *unc, *rgb;
  int32_t *live; /* by ray: samples that count, the first ones of a ray */

  /* by sample that counts, channels at live_stride */
  size_t count, live_stride;
  struct ern_buffer reals, ints; /* the block that these are cut from, as numbers of either type */
  ern_span first;                /* int32 [rays + 1] */
  float *live_x, *live_dt, *live_depth, *live_sigma, *live_norm, *live_eye, *live_unc, *live_rgb;
  float *dsigma, *drgb, *dnorm, *deye, *dunc;
  int32_t *live_ray, *live_sample;

  float *gradient; /* [ERN_SHARDS][net.forward] */
  float *df;       /* [features][live_stride], of the moved points [features][stride] */
  float *dsh;      /* [16][live_stride], of the harmonics; NULL: not wanted */
};

static inline struct ern_train_worker *ern_train_worker_of(const struct ern_train_step *s, int worker) {
  return (struct ern_train_worker *)(void *)(s->workers + (size_t)worker * s->worker_bytes);
}

/* Unhashes the levels, for all encoding of the step. */
ERN_NODISCARD ern_status ern_train_unhash(struct ern_train_step *s);

/* All of the field that the losses need, of all samples that count; they are gathered behind each other. */
ERN_NODISCARD ern_status ern_train_forward(struct ern_train_step *s);

#endif
