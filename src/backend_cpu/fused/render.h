/* SPDX-License-Identifier: MIT
 * The fused implementation of the rendering slots, for the CPU's SIMD instruction sets. */
#ifndef ERN_FUSED_RENDER_H
#define ERN_FUSED_RENDER_H

#include "backend_cpu/fused/render_worker.h"

/* Overwrites render_prepare and render_rays of a float backend. A model whose layers the fused pass does not support
 * runs the separate stages. */
void ern_cpu_fuse_render(struct ern_backend *backend);

#endif
