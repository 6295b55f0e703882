/* SPDX-License-Identifier: MIT
 * Slots of the encodings. */
#include "backend_opencl/opencl.h"
#include "mlp/encoding_ops.h"

ern_status ern_cl_sh_fwd(struct ern_stream *stream, struct ern_sh_fwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_encoding, "sh_fwd", "");
  ERN_CL_ARGS(&call, a->y, a->d, a->n);
  return ern_cl_run(&call, shape.count, shape.group);
}

ern_status ern_cl_sh_bwd(struct ern_stream *stream, struct ern_sh_bwd_args *a) {
  if (a->n == 0) return ERN_OK;
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_encoding, "sh_bwd", "");
  ERN_CL_ARGS(&call, a->dd, a->dy, a->d, a->n);
  return ern_cl_run(&call, shape.count, shape.group);
}

ern_status ern_cl_freq_fwd(struct ern_stream *stream, struct ern_freq_fwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_encoding, "freq_fwd", "");
  ERN_CL_ARGS(&call, a->y, a->x, a->x.rows, (int)shape.count, a->n);
  return ern_cl_run(&call, shape.count * (size_t)a->x.rows * (1 + (size_t)a->octaves), shape.group);
}

ern_status ern_cl_freq_bwd(struct ern_stream *stream, struct ern_freq_bwd_args *a) {
  const struct ern_cl_blocks shape = ern_cl_blocks_of(stream, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_encoding, "freq_bwd", "");
  ERN_CL_ARGS(&call, a->dx, a->dy, a->x, a->x.rows, a->octaves, (int)shape.count, a->n);
  return ern_cl_run(&call, shape.count * (size_t)a->x.rows, shape.group);
}
