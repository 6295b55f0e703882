/* SPDX-License-Identifier: MIT
 * The fused pass of render_rays. */
#ifndef ERN_OPENCL_RENDER_HEAD_H
#define ERN_OPENCL_RENDER_HEAD_H

#include "backend_opencl/device/backend.h"

struct ern_cl_head;
/* *head: NULL for a shape that the kernels cannot be built for. */
ERN_NODISCARD ern_status ern_cl_head_make(struct ern_stream *stream, const struct ern_render_prepare_args *args,
                                          struct ern_cl_head **head);
void ern_cl_head_free(struct ern_cl_stream *stream, struct ern_cl_head *head); /* accepts NULL */
ERN_NODISCARD ern_status ern_cl_head_render(struct ern_stream *stream, struct ern_cl_head *head,
                                            const struct ern_render_rays_args *args);

#endif
