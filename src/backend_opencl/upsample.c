/* SPDX-License-Identifier: MIT
 * The slot that upsamples a layer. */
#include "backend_opencl/opencl.h"
#include "render/upsample_ops.h"

ern_status ern_cl_upsample(struct ern_stream *stream, struct ern_upsample_args *a) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_upsample, "upsample_picture", "");
  ERN_CL_ARGS(&call, a->large, a->small, a->background, a->large.rows, a->width, a->height, a->small_width,
              a->small_height, a->ratio);
  return ern_cl_each(&call, (size_t)a->width * (size_t)a->height);
}
