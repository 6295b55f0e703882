/* SPDX-License-Identifier: MIT
 * From samples to pixels (docs/maths.md, Compositing; paper eq. 1-2). */
#ifndef ERN_COMPOSITE_OPS_H
#define ERN_COMPOSITE_OPS_H

#include "core/operations.h"
#include "core/types.h"

/* alpha = 1 - exp(-sigma dt), w = alpha T, T *= 1 - alpha, no sample after T < transmittance_stop.
 * pixel = clamp(sum w rgb + (1 - sum w) background, 0, 1). */
struct ern_composite_fwd_args {
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
#define ERN_COST_composite_fwd(a) ern_cost("sample", (a)->dt.count, 18, 9, 0, 0)
/* The same with pointers; NULL where a span is zeroed. Per-ray pointers point to the first of the n rays, `first` too;
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
  struct ern_composite_fwd_args forward; /* with the values that the forward pass left in colour and opacity */
};
#define ERN_COST_composite_bwd(a) ern_cost("sample", (a)->forward.dt.count, 32, 16, 0, 0)
struct ern_composite_bwd_view {
  ern_real *dsigma, *drgb, *dsample_attention, *dsample_eye, *dsample_uncertainty;
  const ern_real *dpixel, *dopacity, *dattention, *deye, *duncertainty;
  struct ern_composite_view forward;
};
typedef void ern_composite_bwd_kernel(const struct ern_composite_bwd_view *view, size_t n);

ERN_DECLARE_KERNELS(ERN_COMPOSITE_OPERATIONS)

#endif
