/* SPDX-License-Identifier: MIT
 * The work memory of a thread of the fused renderer. Rows are a tile wide: (c, slot) at c*ERN_MLP_TILE + slot. */
#ifndef ERN_RENDER_SCRATCH_H
#define ERN_RENDER_SCRATCH_H

#include "backend_cpu/fused/render_worker.h"
#include "mlp/mlp_tile.h"

/* The rays of a tile that are being marched, by slot, and the current sample of each. */
struct flight {
  int32_t ray[ERN_MLP_TILE];  /* -1: the slot is empty */
  int32_t left[ERN_MLP_TILE]; /* samples */
  int32_t at[ERN_MLP_TILE];   /* index of the next sample in `distance` */
  float d[3][ERN_MLP_TILE], transmittance[ERN_MLP_TILE], colour[3][ERN_MLP_TILE];
  float opacity[ERN_MLP_TILE], depth[ERN_MLP_TILE], attention[ERN_MLP_TILE], eye[ERN_MLP_TILE];
  float x[3][ERN_MLP_TILE], dt[ERN_MLP_TILE], end[ERN_MLP_TILE];
  float *distance; /* [tile][max_steps] */
  float *ray_term; /* [colour][tile]: the contribution of direction and individual code to the colour's first layer */
  float *features; /* [features, attention, eye 1][tile]: the density's input, unless that is in pairs of bf16 */
  size_t flying;   /* slots that are not empty */
};

/* Tiles whose samples are encoded together, level by level: the entries of a level are then still in the cache from the
 * tile before. */
enum { ERN_FLIGHTS = 4 };

struct render_scratch {
  struct flight flight[ERN_FLIGHTS];
  /* the samples of a tile */
  float sigma[ERN_MLP_TILE], rgb[3 * ERN_MLP_TILE], norm[ERN_MLP_TILE], eye[ERN_MLP_TILE];
  float harmonics[ERN_SH_ROWS * ERN_MLP_TILE];
  float shortest, longest; /* step */
  bool ended;              /* no ray is left to be taken */
  size_t batch;            /* most rays that are marched together */
  size_t hits, taken;      /* of the batch: rays with samples, and how many of them have been given a slot */
  size_t shared;           /* hits whose ray_term has been computed */
  float *input;     /* pairs of bf16 (gemm_tile_bf16.h) of features, attention, eye: the density's input; else NULL */
  float *hidden[2]; /* [widest][tile] */
  float *next_term; /* [colour][tile]: of hits shared-tile .. shared */
  float *distance;  /* [batch][max_steps] */
  float *direction; /* [3][batch] */
  int32_t *number, *count; /* [batch]: pixel, samples */
  int32_t *hit, *ray;      /* [hits]: index in the batch, number of the ray */
};

/* scratch of ern_render_worker_scratch bytes, laid out, with no ray in flight */
struct render_scratch *ern_render_scratch_make(void *scratch, const struct ern_render_work *work);

#endif
