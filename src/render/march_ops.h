/* SPDX-License-Identifier: MIT
 * From pixels to samples: rays, and marching through the occupancy grid (docs/maths.md, Rays and samples). */
#ifndef ERN_MARCH_OPS_H
#define ERN_MARCH_OPS_H

#include "core/operations.h"
#include "core/types.h"

/* A pinhole camera in the renderer's frame: x up, y out of the face toward the camera, z right. */
struct ern_view {
  float pose[16];      /* camera to world, row-major */
  float focal, cx, cy; /* pixels */
  int width, height;
};

struct ern_rays_args {
  ern_rows dir;   /* out: [3] per ray, unit length */
  ern_span pixel; /* int32 [n], row-major pixel numbers j*width + i, whose centre is (i + 0.5, j + 0.5) */
  struct ern_view view;
  size_t n;
};
#define ERN_COST_rays(a) ern_cost("ray", (a)->n, 31, 3, 1, 0)
typedef void ern_rays_kernel(ern_real *dir, size_t stride, const int32_t *pixel, const struct ern_view *view, size_t n);

#define ERN_NEAR_PLANE 0.05f /* where marching may begin, scene units */

struct ern_march_settings {
  float bound;    /* the box is x in [-b, b], y in [-b/2, b/2], z in [-b, b] */
  int max_steps;  /* samples a ray, 1..ERN_MAX_STEPS */
  float dt_gamma; /* step = clamp(t*dt_gamma, dt_min, dt_max), docs/maths.md, Rays and samples */
  float near;     /* smallest distance of a sample, ERN_NEAR_PLANE */
};

/* Marching always computes in float, so that every build and backend samples the same points. */
struct ern_march_args {
  ern_span t;      /* out: real [n][max_steps], distance of each sample (before its step) */
  ern_span count;  /* out: int32 [n], samples of each ray */
  ern_rows dir;    /* [3] per ray */
  ern_span jitter; /* real [n] in [0, 1): the start moves by jitter*step; zeroed span: none */
  ern_span bits;   /* byte [ERN_OCCUPANCY_BYTES] */
  float origin[3];
  struct ern_march_settings settings;
  size_t n;
};
#define ERN_COST_march(a) ern_cost("ray", (a)->n, 0, 0, 0, 0) /* its steps are not known */
typedef void ern_march_kernel(ern_real *t, int32_t *count, const ern_real *dir, size_t stride, const ern_real *jitter,
                              const uint8_t *bits, const float origin[3], const struct ern_march_settings *settings,
                              size_t n);

/* The same for rays that are known to meet no occupied cell before distance not_before[r] [n] (NULL: unknown). Up to
 * that distance a ray follows the sequence t_{k+1} = t_k + dt(t_k) without testing cells, so the samples are the same.
 * (Where steps are shorter than a cell, rounding may assign a distance at a cell's border to the other cell.) */
typedef void ern_march_from_kernel(ern_real *t, int32_t *count, const ern_real *dir, size_t stride,
                                   const ern_real *jitter, const float *not_before, const uint8_t *bits,
                                   const float origin[3], const struct ern_march_settings *settings, size_t n);

/* first[r] = sum of count[0..r), first[n] = the total, also returned in `total`. */
struct ern_scan_args {
  ern_span first; /* out: int32 [n+1] */
  ern_span count; /* int32 [n] */
  size_t n;
  size_t total; /* out, on the host: the one figure that is read back */
};
#define ERN_COST_scan(a) ERN_COST_ELSEWHERE

/* The marched samples, packed ray by ray. */
struct ern_samples_args {
  ern_rows x;         /* out: [3] per sample, clamped to the cube */
  ern_span dt, depth; /* out: real [total]: step, and distance at its end */
  ern_span ray;       /* out: int32 [total] */
  ern_span t, first;  /* of the march and the scan */
  ern_rows dir;
  float origin[3];
  struct ern_march_settings settings;
  size_t n; /* rays */
};
#define ERN_COST_samples(a) ern_cost("sample", (a)->dt.count, 8, 6, 1, 0)
/* ray_begin: number of the first of these n rays; first points at its entry; x, dt, depth, ray are whole-batch. */
typedef void ern_samples_kernel(ern_real *x, size_t x_stride, ern_real *dt, ern_real *depth, int32_t *ray,
                                const ern_real *t, const int32_t *first, const ern_real *dir, size_t dir_stride,
                                const float origin[3], const struct ern_march_settings *settings, size_t ray_begin,
                                size_t n);

/* Copies the values of each ray to its samples. */
struct ern_spread_rays_args {
  ern_rows y;   /* out: per sample */
  ern_rows x;   /* as many rows, per ray */
  ern_span ray; /* int32 [n] */
  size_t n;     /* samples */
};
#define ERN_COST_spread_rays(a) ERN_COST_ELSEWHERE
typedef void ern_spread_rays_kernel(ern_real *y, size_t y_stride, const ern_real *x, size_t x_stride,
                                    const int32_t *ray, int rows, size_t n);

ERN_DECLARE_KERNELS(ERN_MARCH_OPERATIONS)

#endif
