/* SPDX-License-Identifier: MIT
 * The fused pass of render_torso. */
#ifndef ERN_OPENCL_RENDER_TORSO_H
#define ERN_OPENCL_RENDER_TORSO_H

#include "backend_opencl/device/backend.h"

struct ern_cl_torso;
ERN_NODISCARD ern_status ern_cl_torso_make(struct ern_stream *stream, const struct ern_render_prepare_args *args,
                                           struct ern_cl_torso **torso);
void ern_cl_torso_free(struct ern_cl_stream *stream, struct ern_cl_torso *torso); /* accepts NULL */
ERN_NODISCARD ern_status ern_cl_torso_render(struct ern_stream *stream, struct ern_cl_torso *torso,
                                             const struct ern_render_torso_args *args);

#endif
