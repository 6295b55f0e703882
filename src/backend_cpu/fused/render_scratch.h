/* SPDX-License-Identifier: MIT
 * What a thread of the fused renderer works in. Rows are a tile wide: (c, slot) at c*ERN_MLP_TILE + slot. */
#ifndef ERN_RENDER_SCRATCH_H
#define ERN_RENDER_SCRATCH_H

#include "backend_cpu/fused/render_worker.h"
#include "mlp/mlp_tile.h"

/* The rays of a tile in flight, by slot, and the sample that each of them is at. */
struct flight {
  int32_t ray[ERN_MLP_TILE];  /* -1: the slot is empty */
  int32_t left[ERN_MLP_TILE]; /* samples */
  int32_t at[ERN_MLP_TILE];   /* of the next one, in `distance` */
  float d[3][ERN_MLP_TILE], transmittance[ERN_MLP_TILE], colour[3][ERN_MLP_TILE];
  float opacity[ERN_MLP_TILE], depth[ERN_MLP_TILE], attention[ERN_MLP_TILE], eye[ERN_MLP_TILE];
  float x[3][ERN_MLP_TILE], dt[ERN_MLP_TILE], end[ERN_MLP_TILE];
  float *distance;  /* [tile][max_steps] */
  float *ray_share; /* [colour][tile]: what direction and code give to the colour's first layer */
  float *features;  /* [features, attention, eye 1][tile]: the density's input, unless that is in pairs */
  size_t flying;    /* slots that are not empty */
};

/* Tiles whose samples are encoded together, level by level: a level's entries are found where the tile before has just
 * left them. */
enum { ERN_FLIGHTS = 4 };

struct render_scratch {
  struct flight flight[ERN_FLIGHTS];
  /* the samples of a tile */
  float sigma[ERN_MLP_TILE], rgb[3 * ERN_MLP_TILE], norm[ERN_MLP_TILE], eye[ERN_MLP_TILE];
  float harmonics[ERN_SH_ROWS * ERN_MLP_TILE];
  float shortest, longest; /* step */
  bool ended;              /* no ray is left to be taken */
  size_t batch;            /* rays that are marched together */
  size_t hits, taken;      /* of the batch: rays with samples, and how many of them have a slot or had one */
  size_t shared;           /* of the hits, those whose share of the colour has been worked out */
  float *input;      /* pairs of bf16 (gemm_tile_bf16.h) of features, attention, eye: the density's input; else NULL */
  float *hidden[2];  /* [widest][tile] */
  float *next_share; /* [colour][tile]: of hits shared-tile .. shared */
  float *distance;   /* [batch][max_steps] */
  float *direction;  /* [3][batch] */
  int32_t *number, *count; /* [batch]: pixel, samples */
  int32_t *hit, *ray;      /* [hits]: place in the batch, number of the ray */
};

/* scratch of ern_render_worker_scratch bytes, laid out, with no ray in flight */
struct render_scratch *ern_render_scratch_make(void *scratch, const struct ern_render_work *work);

#endif
