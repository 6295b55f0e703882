/* SPDX-License-Identifier: MIT
 * The torso: adaptive pose encoding, deformation, compositing, and its 2D occupancy (docs/maths.md, Torso; paper eq.
 * 9-11). */
#ifndef ERN_TORSO_OPS_H
#define ERN_TORSO_OPS_H

#include "core/operations.h"
#include "core/types.h"

enum { ERN_TORSO_POINTS = 3, ERN_TORSO_SIDE = 128, ERN_TORSO_CELLS = 128 * 128 };

/* k[2p], k[2p+1] = gamma * X0/X3/X2, gamma * X1/X3/X2, where X = anchor_p (row vector) times transpose(inverse(pose)).
 */
struct ern_torso_pose_fwd_args {
  ern_span k;       /* out: real [6] */
  ern_span anchors; /* real [3][4] */
  ern_span gamma;   /* real [1]; zeroed: 1 */
  float pose[16];   /* camera to world, renderer's frame; the caller has checked that it can be inverted */
};
#define ERN_COST_torso_pose_fwd(a) ERN_COST_ELSEWHERE
struct ern_torso_pose_bwd_args {
  ern_span danchors, dgamma; /* accumulate; dgamma zeroed where gamma is */
  ern_span dk;               /* real [6] */
  struct ern_torso_pose_fwd_args forward;
};
#define ERN_COST_torso_pose_bwd(a) ERN_COST_ELSEWHERE
typedef void ern_torso_pose_fwd_kernel(ern_real *k, const ern_real *anchors, const ern_real *gamma,
                                       const float pose[16]);
typedef void ern_torso_pose_bwd_kernel(ern_real *danchors, ern_real *dgamma, const ern_real *dk,
                                       const ern_real *anchors, const ern_real *gamma, const float pose[16]);

/* Torso coordinates of pixels, times shrink: row 0 = shrink*(2j/(H-1) - 1), row 1 = shrink*(2i/(W-1) - 1); a side of
 * one pixel is at 0. */
struct ern_torso_coords_args {
  ern_rows q;     /* out: [2] per pixel */
  ern_span pixel; /* int32 [n], row-major */
  int width, height;
  float shrink; /* 0.8 */
  size_t n;
};
#define ERN_COST_torso_coords(a) ern_cost("pixel", (a)->n, 6, 2, 1, 0)
typedef void ern_torso_coords_kernel(ern_real *q, size_t stride, const int32_t *pixel, int width, int height,
                                     float shrink, size_t n);

/* Selects the pixels where the torso's occupancy, sampled bilinearly (aligned corners), is above the threshold. */
struct ern_torso_select_args {
  ern_span index;    /* out: int32 [n], positions in `pixel` of those selected, ascending */
  ern_span selected; /* out: int32 [n], the pixel numbers of those selected */
  ern_span pixel;    /* int32 [n] */
  ern_span grid;     /* real [ERN_TORSO_CELLS], cell (r, c) at c*128 + r */
  float threshold;   /* min(mean of grid, 0.01) */
  int width, height;
  size_t n;
  size_t count; /* out, on the host */
};
#define ERN_COST_torso_select(a) ern_cost("pixel", (a)->n, 14, 0, 3, 4)
typedef size_t ern_torso_select_kernel(int32_t *index, int32_t *selected, const int32_t *pixel, const ern_real *grid,
                                       float threshold, int width, int height, size_t n);

/* q' = q + m(q): the place in the body of a point of the picture. m is given at ERN_MOTION_SIDE x ERN_MOTION_SIDE
 * control points, evenly over the picture, bilinear between them. */
struct ern_torso_move_args {
  ern_rows moved; /* out: [2] */
  ern_rows q;
  const float *motion; /* [ERN_MOTION_VALUES], on the host, of ern_torso_motion_of; zeros: q' = q */
  float shrink;        /* the picture's corners have the coordinates -shrink and shrink, above 0 */
  size_t n;
};
#define ERN_COST_torso_move(a) ern_cost("pixel", (a)->n, 32, 4, 0, 0)
typedef void ern_torso_move_kernel(ern_real *moved, const ern_real *q, const float *motion, float shrink, size_t stride,
                                   size_t n);

/* x = clamp(q + d, -1, 1), q being q' */
struct ern_torso_deform_fwd_args {
  ern_rows x; /* out: [2] */
  ern_rows q, d;
  size_t n;
};
#define ERN_COST_torso_deform_fwd(a) ern_cost("pixel", (a)->n, 2, 6, 0, 0)
struct ern_torso_deform_bwd_args {
  ern_rows dd; /* out, overwritten; 0 where x was clamped (passes at the ends themselves, as in torch.clamp) */
  ern_rows dx;
  struct ern_torso_deform_fwd_args forward;
};
#define ERN_COST_torso_deform_bwd(a) ern_cost("pixel", (a)->forward.n, 2, 8, 0, 0)
typedef void ern_torso_deform_fwd_kernel(ern_real *x, const ern_real *q, const ern_real *d, size_t stride, size_t n);
typedef void ern_torso_deform_bwd_kernel(ern_real *dd, const ern_real *dx, const ern_real *q, const ern_real *d,
                                         size_t stride, size_t n);

/* pixel[index[i]] = a rgb + (1 - a) background; pixels not in the list keep the background, and opacity 0. */
struct ern_torso_composite_fwd_args {
  ern_rows pixel;      /* out: [3] per ray */
  ern_span opacity;    /* out: real [rays]; zeroed: not wanted */
  ern_rows layer;      /* [4] per sample: alpha, r, g, b */
  ern_span index;      /* int32 [n] */
  ern_rows background; /* [3] per ray */
  size_t rays, n;
};
#define ERN_COST_torso_composite_fwd(a) ern_cost("pixel", (a)->n, 12, 10, 1, 0)
struct ern_torso_composite_bwd_args {
  ern_rows dlayer; /* out, overwritten */
  ern_rows dpixel; /* [3] per ray */
  struct ern_torso_composite_fwd_args forward;
};
#define ERN_COST_torso_composite_bwd(a) ern_cost("pixel", (a)->forward.n, 12, 14, 1, 0)
/* Over the n listed samples; the caller has copied the background to all rays and zeroed the opacity. */
typedef void ern_torso_composite_fwd_kernel(ern_real *pixel, ern_real *opacity, const ern_real *layer,
                                            size_t layer_stride, const int32_t *index, const ern_real *background,
                                            size_t ray_stride, size_t n);
typedef void ern_torso_composite_bwd_kernel(ern_real *dlayer, size_t layer_stride, const ern_real *dpixel,
                                            const ern_real *layer, const int32_t *index, const ern_real *background,
                                            size_t ray_stride, size_t n);

/* Refresh of the 2D occupancy. Points: cell (r, c): (2r/127 - 1)(127/128) + uniform(-1,1)/128 for the row coordinate,
 * the same of c for the column, times shrink; Philox (seed, step, cell, ERN_RNG_REFRESH_CELL), words 0 and 1. */
struct ern_torso_points_args {
  ern_rows q; /* out: [2] per cell, ERN_TORSO_CELLS of them, in cell order */
  float shrink;
  uint64_t seed, step;
};
#define ERN_COST_torso_points(a) ern_cost("cell", ERN_TORSO_CELLS, 0, 0, 0, 0)
typedef void ern_torso_points_kernel(ern_real *q, size_t stride, float shrink, uint64_t seed, uint64_t step);

/* grid = max(decay*grid, 5 x 5 maximum of alpha); the mean of grid is handed back. */
struct ern_torso_update_args {
  ern_span grid;  /* in and out */
  ern_span alpha; /* real [ERN_TORSO_CELLS] */
  float decay;
  double mean; /* out, on the host */
};
#define ERN_COST_torso_update(a) ern_cost("cell", ERN_TORSO_CELLS, 1, 3, 0, 0)
typedef double ern_torso_update_kernel(ern_real *grid, const ern_real *alpha, float decay);

/* ---- fused: the torso over a whole picture ---- */

struct ern_field;

/* Where the frame that a torso was trained on lies in a picture, in pixels; it may extend beyond the picture. Pixels
 * outside the frame have the coordinates of its nearest pixel. Zeros: the frame is the picture. */
struct ern_torso_place {
  int top, left, width, height;
};

/* Selects pixels, evaluates the field and composites, in place, for a width x height picture. */
struct ern_render_torso_args {
  ern_rows pixel;   /* [3] per pixel, row by row; in: the background, out: the torso over it */
  ern_span opacity; /* out: real [width*height], 0 where the occupancy is not above the threshold */
  ern_span grid;    /* the 2D occupancy: real [ERN_TORSO_CELLS] */
  float threshold;
  int width, height;
  struct ern_torso_place frame;
  float shrink;        /* of coordinates: 0.8 */
  float pose[16];      /* camera to world, renderer's frame; the caller has checked that it can be inverted */
  size_t individual;   /* row of the individual codes */
  const float *motion; /* [ERN_MOTION_VALUES] of torso_move */
  ern_span parameters;
  const struct ern_field *field;
};
#define ERN_COST_render_torso(a) ERN_COST_ELSEWHERE

/* The frame's place, which is the picture where none is given. */
static inline struct ern_torso_place ern_torso_place_of(const struct ern_render_torso_args *args) {
  return args->frame.width > 0 ? args->frame : (struct ern_torso_place){0, 0, args->width, args->height};
}

ERN_DECLARE_KERNELS(ERN_TORSO_OPERATIONS)

#endif
