/* SPDX-License-Identifier: MIT
 * How weights are laid out for the fused passes (kernels/tile.cl). */
#ifndef ERN_OPENCL_PORTRAIT_H
#define ERN_OPENCL_PORTRAIT_H

#include "backend_opencl/device/launch.h"

/* Sizes of tiles for a device: vectors an item, outputs of a layer that are summed at once, items a group. */
struct ern_cl_form {
  int vectors, outputs, group;
  bool tensor; /* wide layers by tensor cores */
};

enum { ERN_CL_ALIGN = 16 /* reals that a packed matrix begins at a multiple of */ };

/* Columns from `column` on of a packed matrix that has `width` of them. */
struct ern_cl_place {
  ern_span matrix;
  size_t width, column;
  int outputs; /* of the form; 0: for tensor cores */
};
/* The place gets A [rows][columns], its rows row_step apart. */
ERN_NODISCARD ern_status ern_cl_pack(struct ern_stream *stream, const struct ern_cl_place *place, ern_span a,
                                     size_t row_step, size_t rows, size_t columns);
/* The place gets A [rows][count] diag(scale) B [count][columns]; scale zeroed: ones. */
ERN_NODISCARD ern_status ern_cl_multiply(struct ern_stream *stream, const struct ern_cl_place *place, ern_span a,
                                         size_t row_step, ern_span scale, ern_span b, size_t rows, size_t count,
                                         size_t columns);

static inline ern_span ern_cl_whole(struct ern_buffer *buffer) {
  return buffer != NULL ? (ern_span){buffer, 0, buffer->count} : (ern_span){0};
}
static inline ern_span ern_cl_from(ern_span span, size_t at) { return ern_span_part(span, at, span.count - at); }

/* Outputs of a layer of at most `widest` that are summed at once: with three vectors they fill a CPU's registers. */
static inline int ern_cl_outputs(const struct ern_cl_device *device, int widest) {
  return device->width == 1 ? widest : device->width == 8 ? 4 : 8;
}
/* The form for tiles of `rows`, with the tunable's vectors or items where local memory has room for them. */
struct ern_cl_form ern_cl_form_for(const struct ern_cl_backend *backend, ern_cl_tunable tunable, int outputs,
                                   size_t rows);
/* Work-groups that keep a device busy, for kernels whose items take work from a counter until none is left. */
static inline size_t ern_cl_groups(const struct ern_cl_backend *backend, ern_cl_tunable tunable) {
  return backend->device.units * (size_t)backend->size[tunable];
}

#endif
