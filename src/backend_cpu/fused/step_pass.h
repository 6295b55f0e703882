/* SPDX-License-Identifier: MIT
 * The state of a running fused training step of the head, shared by its parts. Float only. */
#ifndef ERN_STEP_PASS_H
#define ERN_STEP_PASS_H

#include "backend_cpu/fused/step_kernels.h"
#include "backend_cpu/slots.h"
#include "core/profile.h"
#include "render/stages.h"

/* ---- memory that a stream keeps from step to step ---- */

/* Grows without copying: unlike scratch, the old memory is freed before the larger is allocated. */
struct ern_train_block {
  float *memory;
  size_t count;
};
typedef enum ern_train_use {
  ERN_TRAIN_NET,       /* the weights and the shards' gradients */
  ERN_TRAIN_GRIDS,     /* the unhashed levels */
  ERN_TRAIN_WORKERS,   /* one struct ern_train_worker for each thread */
  ERN_TRAIN_MARCHED,   /* by marched sample */
  ERN_TRAIN_LIVE,      /* by live sample: one that contributes to its ray */
  ERN_TRAIN_DFEATURES, /* the features' gradient */
  ERN_TRAIN_USES
} ern_train_use;
struct ern_train_workspace {
  struct ern_train_block block[ERN_TRAIN_USES];
};

/* *memory = room for `count` floats; the former content is lost. */
ERN_NODISCARD ern_status ern_train_workspace_take(struct ern_cpu_stream *stream, ern_train_use use, size_t count,
                                                  float **memory);

/* Cuts the next `count` floats off a block. ern_train_padded: the floats that an array of n samples takes up. */
static inline float *ern_train_cut(float **block, size_t count) {
  float *at = *block;
  *block += count;
  return at;
}
static inline size_t ern_train_padded(size_t n) { return (n + 2 * ERN_MLP_TILE - 1) / 64 * 64 + 64; }

/* ---- memory of one thread ---- */

enum { ERN_TRAIN_BATCH = 1920 /* samples evaluated together */ };

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
  int32_t live[ERN_TRAIN_BATCH], place[ERN_TRAIN_BATCH]; /* the live samples of the batch: number, index in the batch */
  struct ern_train_group group[ERN_TRAIN_BATCH];
  float hidden[ERN_TRAIN_BATCH * ERN_NET_DENSITY];
  struct ern_profile profile;
  float by_ray[]; /* by ray for the shard's rays: queue, samples evaluated, transmittance */
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
  float stop;      /* a ray ends where its transmittance is below this */
  bool everything; /* attention and uncertainty of all samples, not only of the live ones */

  /* by marched sample, channels at `stride` */
  size_t stride;
  float *feature_rows, *sigma, *norm, *eye, *unc, *rgb;
  int32_t *live; /* by ray: number of live samples, which are the first of the ray */

  /* by live sample, channels at live_stride */
  size_t count, live_stride;
  struct ern_buffer reals, ints; /* the block that these are cut from, as a buffer of either type */
  ern_span first;                /* int32 [rays + 1] */
  float *live_x, *live_dt, *live_depth, *live_sigma, *live_norm, *live_eye, *live_unc, *live_rgb;
  float *dsigma, *drgb, *dnorm, *deye, *dunc;
  int32_t *live_ray, *live_sample;

  float *gradient; /* [ERN_SHARDS][net.forward] */
  float *df;       /* [features][live_stride], for the moved points [features][stride] */
  float *dsh;      /* [16][live_stride], of the harmonics; NULL: not wanted */
};

static inline struct ern_train_worker *ern_train_worker_of(const struct ern_train_step *s, int worker) {
  return (struct ern_train_worker *)(void *)(s->workers + (size_t)worker * s->worker_bytes);
}

/* Unhashes the grids' levels for all encoding in the step. */
ERN_NODISCARD ern_status ern_train_unhash(struct ern_train_step *s);

/* Evaluates the field for the losses at all live samples, and stores those samples contiguously. */
ERN_NODISCARD ern_status ern_train_forward(struct ern_train_step *s);

#endif
