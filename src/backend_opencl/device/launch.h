/* SPDX-License-Identifier: MIT
 * Launching a kernel. */
#ifndef ERN_OPENCL_LAUNCH_H
#define ERN_OPENCL_LAUNCH_H

#include "backend_opencl/device/backend.h"

/* ---- a launch: arguments in order, then run; the first error sticks and comes out of run ---- */

struct ern_cl_call {
  struct ern_cl_stream *stream;
  const char *name;
  cl_kernel kernel;
  cl_uint at; /* number of the next argument */
  ern_status status;
};

struct ern_cl_call ern_cl_begin(struct ern_stream *stream, ern_cl_source source, const char *kernel,
                                const char *options);
void ern_cl_span(struct ern_cl_call *call, ern_span span); /* a zeroed span is a null pointer in the kernel */
void ern_cl_rows(struct ern_cl_call *call, ern_rows rows); /* likewise */
void ern_cl_int(struct ern_cl_call *call, int value);
void ern_cl_size(struct ern_cl_call *call, size_t value); /* ulong */
void ern_cl_float(struct ern_cl_call *call, float value);
void ern_cl_value(struct ern_cl_call *call, const void *value, size_t bytes); /* a struct */
void ern_cl_local(struct ern_cl_call *call, size_t bytes);
/* `groups` work-groups of `group` items; 0 groups: nothing is run. */
ERN_NODISCARD ern_status ern_cl_run(struct ern_cl_call *call, size_t groups, size_t group);
/* At least `items` work-items, in groups that suit the device; a kernel checks its number. */
ERN_NODISCARD ern_status ern_cl_each(struct ern_cl_call *call, size_t items);

/* How n samples of a row are dealt to groups: an item that carries vectors, or neighbouring ones of a sample each, as
 * in kernels/activation.cl, encoding.cl and attention.cl. */
struct ern_cl_blocks {
  size_t count, group;
};
struct ern_cl_blocks ern_cl_blocks_of(struct ern_stream *stream, size_t n);

/* Groups of a reduction, whatever the device: so that sums are the same everywhere. Each writes one figure. */
enum { ERN_CL_SUMS = 64, ERN_CL_SUM_GROUP = 64 };
/* Runs them side by side, as many of them an item as the device's vectors have lanes. */
ERN_NODISCARD ern_status ern_cl_run_sums(struct ern_cl_call *call);

/* Room for `count` figures, which `synchronize` will hand to the function together with `args` (alive until then). The
 * values may be added up in double by the host: a float for each of a fixed number of groups. */
ERN_NODISCARD ern_status ern_cl_figures(struct ern_stream *stream, size_t count,
                                        void (*deliver)(void *args, const float *values, size_t count), void *args,
                                        ern_span *span);

/* After a call that may have failed: what it left for `synchronize` would be written to arguments that are gone, and
 * scratch above what is in use is given back, as the next try may need it to be of other sizes. Returns `status`. */
ern_status ern_cl_clean_up(struct ern_stream *stream, ern_status status);

#endif
