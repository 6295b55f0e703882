/* SPDX-License-Identifier: MIT
 * The fused passes of rendering. */
#include "backend_opencl/opencl.h"
#include "render/stages.h"

static ern_status render_prepare(struct ern_stream *stream, struct ern_render_prepare_args *args) {
  (void)stream, (void)args;
  return ERN_OK;
}

void ern_cl_fill_render(struct ern_backend *table) {
  table->render_prepare = render_prepare;
  table->render_rays = ern_render_rays_stages;
  table->render_torso = ern_render_torso_stages;
}

void ern_cl_portrait_free(struct ern_cl_stream *stream) { (void)stream; }
