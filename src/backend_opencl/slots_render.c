/* SPDX-License-Identifier: MIT */
#include "backend_opencl/opencl.h"

void ern_cl_fill_render(struct ern_backend *table) { (void)table; }

void ern_cl_portrait_free(struct ern_cl_stream *stream) { (void)stream; }
