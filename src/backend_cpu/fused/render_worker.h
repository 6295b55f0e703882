/* SPDX-License-Identifier: MIT
 * The fused pass of rendering: one thread's share of a frame, from pixel numbers to pixels. */
#ifndef ERN_RENDER_WORKER_H
#define ERN_RENDER_WORKER_H

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/fused/frame_net.h"
#include "core/profile.h"

/* What all threads share. Rays are numbered by their place in pixel_number; outputs are by ray. */
struct ern_render_work {
  const struct ern_frame_net *net;
  ern_rays_kernel *rays;
  ern_march_from_kernel *march;
  ern_sh_fwd_kernel *sh;
  struct ern_view view;
  struct ern_march_settings settings;
  float transmittance_stop;
  const uint8_t *bits;
  const int32_t *pixel_number;
  const int32_t *order;    /* [count]: the rays to march, neighbours in the picture close together */
  const float *not_before; /* [count]: no occupied cell of that ray is nearer */
  size_t count;
  float *pixel, *colour, *opacity, *depth, *attention, *eye; /* all but pixel and opacity may be NULL */
  const float *background;
  size_t pixel_stride, colour_stride, background_stride;
};

/* Bytes of scratch that a thread needs. */
size_t ern_render_worker_scratch(const struct ern_render_work *work);

/* ern_render_worker_kernel: takes rays off the order until none is left. *next: the first that nobody has taken, shared
 * by the threads. A ray's values do not depend on which others share its tile. scratch: aligned to a cache line.
 * profile may be NULL. */
ern_render_worker_kernel ern_render_worker_avx2, ern_render_worker_avx512, ern_render_worker_neon;
ern_render_worker_kernel ern_render_worker_avx512bf16; /* takes a net in pairs of bf16 */

#endif
