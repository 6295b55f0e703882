/* SPDX-License-Identifier: MIT
 * Lays weights out for the fused passes. */
#include "backend_opencl/portrait.h"

static void say_place(struct ern_cl_call *call, const struct ern_cl_place *place, size_t rows, size_t columns) {
  ERN_CL_ARGS(call, (int)rows, (int)columns, (int)rows < place->outputs ? (int)rows : place->outputs, (int)place->width,
              (int)place->column);
}

ern_status ern_cl_pack(struct ern_stream *stream, const struct ern_cl_place *place, ern_span a, size_t row_step,
                       size_t rows, size_t columns) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_portrait, "pack", "");
  ERN_CL_ARGS(&call, place->matrix, a, row_step);
  say_place(&call, place, rows, columns);
  return ern_cl_each(&call, rows * columns);
}

ern_status ern_cl_multiply(struct ern_stream *stream, const struct ern_cl_place *place, ern_span a, size_t row_step,
                           ern_span scale, ern_span b, size_t rows, size_t count, size_t columns) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_portrait, "multiply", "");
  ERN_CL_ARGS(&call, place->matrix, a, scale, b, row_step, (int)count);
  say_place(&call, place, rows, columns);
  return ern_cl_each(&call, rows * columns);
}

struct ern_cl_form ern_cl_form_for(const struct ern_cl_backend *backend, ern_cl_tunable tunable, int outputs,
                                   size_t rows) {
  const struct ern_cl_device *device = &backend->device;
  const size_t column = rows * (size_t)device->width * sizeof(float);
  const bool vectors = device->width > 1;
  size_t size = (size_t)backend->size[tunable];
  while (size > 1 && (size * column > device->local_bytes || (!vectors && size > device->group_most))) size /= 2;
  return vectors ? (struct ern_cl_form){(int)size, outputs, 1, false}
                 : (struct ern_cl_form){1, outputs, (int)size, false};
}
