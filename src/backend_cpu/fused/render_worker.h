/* SPDX-License-Identifier: MIT
 * The fused rendering pass: one thread's part of a frame, from pixel numbers to pixels. */
#ifndef ERN_RENDER_WORKER_H
#define ERN_RENDER_WORKER_H

#include "backend_cpu/cpu_state.h"
#include "backend_cpu/fused/frame_net.h"
#include "core/profile.h"
#include "mlp/encoding_ops.h"
#include "render/march_ops.h"

/* Shared by all threads. A ray's number is its index in pixel_number; outputs are indexed by ray. */
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
  const int32_t *order;    /* [count]: the rays in marching order: neighbours in the picture are close together */
  const float *not_before; /* [count]: the ray meets no occupied cell at a smaller distance */
  size_t count;
  float *pixel, *colour, *opacity, *depth, *attention, *eye; /* all but pixel and opacity may be NULL */
  const float *background;
  size_t pixel_stride, colour_stride, background_stride;
};

/* Bytes of scratch that a thread needs. */
size_t ern_render_worker_scratch(const struct ern_render_work *work);

/* ern_render_worker_kernel: takes rays from `order` until none is left. *next: index of the first ray that no thread
 * has taken, shared by the threads. A ray's values do not depend on the other rays of its tile. scratch: aligned to a
 * cache line. profile may be NULL. */
ern_render_worker_kernel ern_render_worker_avx2, ern_render_worker_avx512, ern_render_worker_neon;
ern_render_worker_kernel ern_render_worker_avx512bf16; /* needs a net packed in pairs of bf16 */

#endif
