/* SPDX-License-Identifier: MIT
 * The slot that upsamples a layer. */
#include "backend_opencl/opencl.h"
#include "render/upsample_ops.h"

ern_status ern_cl_upsample(struct ern_stream *stream, struct ern_upsample_args *a) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_upsample, "upsample_picture", "");
  ern_cl_rows(&call, a->large);
  ern_cl_rows(&call, a->small);
  ern_cl_rows(&call, a->background);
  ern_cl_int(&call, a->large.rows);
  ern_cl_int(&call, a->width);
  ern_cl_int(&call, a->height);
  ern_cl_int(&call, a->small_width);
  ern_cl_int(&call, a->small_height);
  ern_cl_float(&call, a->ratio);
  return ern_cl_each(&call, (size_t)a->width * (size_t)a->height);
}
