/* SPDX-License-Identifier: MIT
 * From pixels to samples and back to pixels: rays, marching through the occupancy grid, compositing, and the grid
 * itself (model.md sections 1 and 5; paper eq. 1-2). */
#ifndef ERN_RENDER_OPS_H
#define ERN_RENDER_OPS_H

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
typedef void ern_rays_kernel(ern_real *dir, size_t stride, const int32_t *pixel, const struct ern_view *view, size_t n);

#define ERN_NEAR_PLANE 0.05f /* where marching may begin, scene units */

struct ern_march_settings {
  float bound;    /* the box is x in [-b, b], y in [-b/2, b/2], z in [-b, b] */
  int max_steps;  /* samples a ray, 1..ERN_MAX_STEPS */
  float dt_gamma; /* step = clamp(t*dt_gamma, dt_min, dt_max), model.md section 5 */
  float near;     /* smallest distance of a sample, ERN_NEAR_PLANE */
};

/* Marching always computes in float, so that every build and backend looks at the same points. */
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
typedef void ern_march_kernel(ern_real *t, int32_t *count, const ern_real *dir, size_t stride, const ern_real *jitter,
                              const uint8_t *bits, const float origin[3], const struct ern_march_settings *settings,
                              size_t n);

/* The same for rays that are known to meet no occupied cell before distance not_before[r] [n] (NULL: nothing is known):
 * they go up the ladder t_{k+1} = t_k + dt(t_k) without a look at the cells until there, so the samples are the same.
 * (Where steps are shorter than the way through a cell, a rung within rounding of a cell's border may be counted to
 * the other cell.) */
typedef void ern_march_from_kernel(ern_real *t, int32_t *count, const ern_real *dir, size_t stride,
                                   const ern_real *jitter, const float *not_before, const uint8_t *bits,
                                   const float origin[3], const struct ern_march_settings *settings, size_t n);

/* first[r] = sum of count[0..r), first[n] = the total, which is also handed back. */
struct ern_scan_args {
  ern_span first; /* out: int32 [n+1] */
  ern_span count; /* int32 [n] */
  size_t n;
  size_t total; /* out, on the host: the one figure that is read back */
};

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
/* ray_begin: number of the first of these n rays; first points at its entry; x, dt, depth, ray are whole-batch. */
typedef void ern_samples_kernel(ern_real *x, size_t x_stride, ern_real *dt, ern_real *depth, int32_t *ray,
                                const ern_real *t, const int32_t *first, const ern_real *dir, size_t dir_stride,
                                const float origin[3], const struct ern_march_settings *settings, size_t ray_begin,
                                size_t n);

/* alpha = 1 - exp(-sigma dt), w = alpha T, T *= 1 - alpha, no sample after T < transmittance_stop.
 * pixel = clamp(sum w rgb + (1 - sum w) background, 0, 1). */
struct ern_composite_args {
  ern_rows pixel;       /* out: [3] per ray, over the background and clamped; zeroed: not wanted */
  ern_rows colour;      /* out: [3] per ray, sum w rgb; zeroed: not wanted */
  ern_span opacity;     /* out: real [n], sum w */
  ern_span depth;       /* out: real [n], sum w depth */
  ern_span attention;   /* out: real [n], sum of |v|_2 over the counted samples, unweighted */
  ern_span eye;         /* out: real [n], sum of the eye attention, unweighted; zeroed: no eye branch */
  ern_span uncertainty; /* out: real [n], sum w u; zeroed: not wanted */
  ern_span first;       /* int32 [n+1] */
  ern_span sigma, dt, sample_depth, sample_attention, sample_eye, sample_uncertainty; /* real per sample */
  ern_rows rgb;                                                                       /* [3] per sample */
  ern_rows background;                                                                /* [3] per ray */
  float transmittance_stop;                                                           /* 1e-4 */
  size_t n;                                                                           /* rays */
};
/* The same with pointers; NULL where a span is zeroed. Per-ray pointers stand at the first of the n rays, `first` too;
 * per-sample pointers at sample 0 of the batch. */
struct ern_composite_view {
  ern_real *pixel, *colour, *opacity, *depth, *attention, *eye, *uncertainty;
  const int32_t *first;
  const ern_real *sigma, *dt, *sample_depth, *sample_attention, *sample_eye, *sample_uncertainty, *rgb, *background;
  size_t ray_stride, rgb_stride; /* of pixel, colour and background; of rgb */
  float transmittance_stop;
};
typedef void ern_composite_fwd_kernel(const struct ern_composite_view *view, size_t n);

struct ern_composite_bwd_args {
  ern_span dsigma; /* out (overwritten), real per sample; zeros past the stop */
  ern_rows drgb;   /* out, [3] per sample */
  ern_span dsample_attention, dsample_eye, dsample_uncertainty; /* out; zeroed where the forward one was */
  ern_rows
      dpixel; /* [3] per ray; no gradient through a clamped channel (torch.clamp: inside or at the ends it passes) */
  ern_span dopacity, dattention, deye, duncertainty; /* real [n] */
  struct ern_composite_args forward; /* with the values that the forward pass left in colour and opacity */
};
struct ern_composite_bwd_view {
  ern_real *dsigma, *drgb, *dsample_attention, *dsample_eye, *dsample_uncertainty;
  const ern_real *dpixel, *dopacity, *dattention, *deye, *duncertainty;
  struct ern_composite_view forward;
};
typedef void ern_composite_bwd_kernel(const struct ern_composite_bwd_view *view, size_t n);

/* ---- occupancy of the head ---- */

/* grid = -1 in cells that none of the views sees, 0 elsewhere: a cell is seen where z_cam > 0, |x_cam| < cx/f*z_cam +
 * 2/128*bound and the same for y, for its centre (2c/127 - 1)*bound*(127/128). */
struct ern_occupancy_mark_args {
  ern_span grid;                /* out: real [ERN_OCCUPANCY_CELLS], Morton order */
  const struct ern_view *views; /* on the host */
  size_t view_count;
  float bound;
};
typedef void ern_occupancy_mark_kernel(ern_real *grid, const struct ern_view *views, size_t view_count, float bound,
                                       uint32_t cell_begin, uint32_t cell_end);

/* Cells whose density a refresh must know: those not marked, and their 6 neighbours. */
struct ern_occupancy_list_args {
  ern_span cells; /* out: int32 [ERN_OCCUPANCY_CELLS], ascending Morton numbers, the first `count` of them */
  ern_span grid;
  size_t count; /* out, on the host */
};
typedef size_t ern_occupancy_list_kernel(int32_t *cells, const ern_real *grid);

/* Points to look at: (2c/127 - 1)*bound*(127/128) + uniform(-1, 1)*bound/128 an axis; the numbers are Philox's for
 * (seed, step, cell, ERN_RNG_REFRESH_CELL), words 0, 1, 2 for x, y, z. */
struct ern_occupancy_points_args {
  ern_rows x;     /* out: [3] per cell */
  ern_span cells; /* int32 [n] */
  float bound;
  uint64_t seed, step;
  size_t n;
};
typedef void ern_occupancy_points_kernel(ern_real *x, size_t stride, const int32_t *cells, float bound, uint64_t seed,
                                         uint64_t step, size_t n);

/* fresh[cells[i]] = sigma[i] */
struct ern_occupancy_scatter_args {
  ern_span fresh; /* out: real [ERN_OCCUPANCY_CELLS] */
  ern_span cells, sigma;
  size_t n;
};

/* new = maximum of fresh and its 6 neighbours (inside the cube); grid = max(decay*grid, new) where grid >= 0; then the
 * mean over all cells with marked ones as 0, and the bits: grid > min(mean, limit). */
struct ern_occupancy_update_args {
  ern_span grid;      /* in and out */
  ern_span bits;      /* out: byte [ERN_OCCUPANCY_BYTES] */
  ern_span fresh;     /* 0 in cells that are in no list */
  float decay, limit; /* 0.95, 10 */
  double mean;        /* out, on the host */
};
/* Cells [cell_begin, cell_end); *sum gets the sum of max(grid, 0) over them, in double. */
typedef void ern_occupancy_update_kernel(ern_real *grid, double *sum, const ern_real *fresh, float decay,
                                         uint32_t cell_begin, uint32_t cell_end);
/* Bytes [byte_begin, byte_end). */
typedef void ern_occupancy_pack_kernel(uint8_t *bits, const ern_real *grid, float threshold, uint32_t byte_begin,
                                       uint32_t byte_end);

/* ---- fused: a tile of rays from direction to pixel ---- */

struct ern_field;
struct ern_profile;

/* What a stream keeps of a model from frame to frame: a fast backend lays out weights and tables for its fused pass. To
 * be called before render_rays, and again when the parameters have changed. */
struct ern_render_prepare_args {
  ern_span parameters;
  const struct ern_field *field;
};

/* March, field and composite of n rays; nothing but the outputs is kept. Audio code, eye value and individual code are
 * the frame's. */
struct ern_render_rays_args {
  ern_rows pixel;                 /* out: [3] per ray, over the background, clamped */
  ern_rows colour;                /* out: [3] per ray, sum w rgb; zeroed: not wanted */
  ern_span opacity;               /* out: real [n] */
  ern_span depth, attention, eye; /* out: real [n] */
  ern_span pixel_number;          /* int32 [n] */
  struct ern_view view;
  ern_rows background; /* [3] per ray */
  ern_span bits;
  ern_span parameters;
  const struct ern_field *field;
  ern_span code; /* real [A], the audio code */
  float eye_value;
  size_t individual; /* row of the individual codes */
  struct ern_march_settings settings;
  float transmittance_stop;
  struct ern_profile *profile; /* added to; NULL: not wanted. Filled by fused passes alone */
  size_t n;
};

#endif
