/* SPDX-License-Identifier: MIT
 * The slots of rendering as the CPU's fast instruction sets fill them. */
#ifndef ERN_RENDER_FAST_H
#define ERN_RENDER_FAST_H

#include "backend_cpu/fused/render_lane.h"

/* Overwrites render_prepare and render_rays of a table of floats; a model whose layers the fused pass does not know
 * goes through the stages. */
void ern_cpu_fill_render_fast(struct ern_backend *backend);

#endif
