/* SPDX-License-Identifier: MIT
 * Launching a kernel. */
#ifndef ERN_OPENCL_LAUNCH_H
#define ERN_OPENCL_LAUNCH_H

#include "backend_opencl/device/backend.h"

/* ---- a launch: arguments in order, then run; run returns the first error of all calls ---- */

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
/* ERN_CL_ARGS(call, a, b, ...): the next arguments, 16 at most, each by its type: ern_span, ern_rows, int, size_t or
 * float. */
/* clang-format off */
#define ERN_CL_ARG(call, value)                                                                                      \
  _Generic((value), ern_span: ern_cl_span, ern_rows: ern_cl_rows, int: ern_cl_int, size_t: ern_cl_size,              \
           float: ern_cl_float)(call, value)
/* clang-format on */
#define ERN_CL_ARGS_1(call, a) ERN_CL_ARG(call, a)
#define ERN_CL_ARGS_2(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_1(call, __VA_ARGS__)
#define ERN_CL_ARGS_3(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_2(call, __VA_ARGS__)
#define ERN_CL_ARGS_4(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_3(call, __VA_ARGS__)
#define ERN_CL_ARGS_5(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_4(call, __VA_ARGS__)
#define ERN_CL_ARGS_6(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_5(call, __VA_ARGS__)
#define ERN_CL_ARGS_7(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_6(call, __VA_ARGS__)
#define ERN_CL_ARGS_8(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_7(call, __VA_ARGS__)
#define ERN_CL_ARGS_9(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_8(call, __VA_ARGS__)
#define ERN_CL_ARGS_10(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_9(call, __VA_ARGS__)
#define ERN_CL_ARGS_11(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_10(call, __VA_ARGS__)
#define ERN_CL_ARGS_12(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_11(call, __VA_ARGS__)
#define ERN_CL_ARGS_13(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_12(call, __VA_ARGS__)
#define ERN_CL_ARGS_14(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_13(call, __VA_ARGS__)
#define ERN_CL_ARGS_15(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_14(call, __VA_ARGS__)
#define ERN_CL_ARGS_16(call, a, ...) ERN_CL_ARG(call, a), ERN_CL_ARGS_15(call, __VA_ARGS__)
#define ERN_CL_ARGS_OF(_1, _2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13, _14, _15, _16, count, ...) \
  ERN_CL_ARGS_##count
#define ERN_CL_ARGS(call, ...) \
  (ERN_CL_ARGS_OF(__VA_ARGS__, 16, 15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0)(call, __VA_ARGS__))

/* `groups` work-groups of `group` items; 0 groups: nothing is run. */
ERN_NODISCARD ern_status ern_cl_run(struct ern_cl_call *call, size_t groups, size_t group);
/* At least `items` work-items, in groups that suit the device; the kernel must check its global id. */
ERN_NODISCARD ern_status ern_cl_each(struct ern_cl_call *call, size_t items);

/* How n samples of a row are divided into work-groups: one item with several vectors, or neighbouring items with one
 * sample each, as in kernels/activation.cl, encoding.cl and attention.cl. */
struct ern_cl_blocks {
  size_t count, group;
};
struct ern_cl_blocks ern_cl_blocks_of(struct ern_stream *stream, size_t n);

/* Groups of a reduction, the same number on every device, so that sums are the same. Each group writes one partial
 * sum. */
enum { ERN_CL_SUMS = 64, ERN_CL_SUM_GROUP = 64 };
/* Runs these groups; an item processes as many values at a time as the device's vectors have lanes. */
ERN_NODISCARD ern_status ern_cl_run_sums(struct ern_cl_call *call);

/* Takes memory for `count` results, which `synchronize` passes to `deliver` together with `args` (alive until then).
 * They may be partial sums, one float for each of a fixed number of groups, which the host adds up in double. */
ERN_NODISCARD ern_status ern_cl_figures(struct ern_stream *stream, size_t count,
                                        void (*deliver)(void *args, const float *values, size_t count), void *args,
                                        ern_span *span);

/* The table's functions of these names (core/backend.h). */
ern_status ern_cl_mark(struct ern_stream *stream, int index);
ern_status ern_cl_marks_read(struct ern_stream *stream, double *ms, int count);

/* Cleans up where `status` is an error: discards results pending for `synchronize`, as their args are gone, and frees
 * unused scratch, as the next try may need other sizes. Returns `status`. */
ern_status ern_cl_clean_up(struct ern_stream *stream, ern_status status);

#endif
