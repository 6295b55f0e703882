/* SPDX-License-Identifier: MIT
 * The slots of rendering as the CPU's fast instruction sets fill them. */
#ifndef ERN_FUSED_RENDER_H
#define ERN_FUSED_RENDER_H

#include "backend_cpu/fused/render_worker.h"

/* Overwrites render_prepare and render_rays of a table of floats; a model whose layers the fused pass does not know
 * goes through the stages. */
void ern_cpu_fuse_render(struct ern_backend *backend);

#endif
