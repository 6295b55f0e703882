/* SPDX-License-Identifier: MIT
 * Launching a kernel: its arguments in order, then its work-groups. */
#include <stdlib.h>
#include <string.h>

#include "backend_opencl/device/launch.h"

#include "backend_opencl/device/buffer.h"
#include "backend_opencl/device/limits.h"
#include "backend_opencl/device/program.h"
#include "core/memory.h"

enum { GROUP = ERN_CL_LIMIT_group_items };

static ern_status kernel_get(struct ern_cl_stream *stream, cl_program program, const char *name, cl_kernel *kernel) {
  struct ern_cl_backend *backend = stream->owner;
  for (size_t i = 0; i < stream->kernel_count; i++) {
    const struct ern_cl_kernel *known = &stream->kernels[i];
    if (known->program != program || strcmp(known->name, name) != 0) continue;
    *kernel = known->kernel;
    return ERN_OK;
  }
  if (stream->kernel_count == stream->kernel_capacity) {
    const size_t capacity = stream->kernel_capacity > 0 ? 2 * stream->kernel_capacity : 64;
    struct ern_cl_kernel *grown = NULL;
    const ern_status status = ERN_NEW(backend->table.context, capacity, &grown);
    if (status != ERN_OK) return status;
    if (stream->kernel_count > 0) memcpy(grown, stream->kernels, stream->kernel_count * sizeof *stream->kernels);
    ern_release(backend->table.context, stream->kernels);
    stream->kernels = grown;
    stream->kernel_capacity = capacity;
  }
  cl_int code = CL_SUCCESS;
  *kernel = clCreateKernel(program, name, &code);
  if (code != CL_SUCCESS) return ern_cl_check(backend, code, name);
  stream->kernels[stream->kernel_count++] = (struct ern_cl_kernel){program, name, *kernel};
  return ERN_OK;
}

struct ern_cl_call ern_cl_begin(struct ern_stream *stream, ern_cl_source source, const char *kernel,
                                const char *options) {
  struct ern_cl_call call = {.stream = ern_cl_stream_of(stream), .name = kernel};
  cl_program program = NULL;
  call.status = ern_cl_program_get(ern_cl_backend_of(stream), source, options, &program);
  if (call.status == ERN_OK) call.status = kernel_get(call.stream, program, kernel, &call.kernel);
  return call;
}

void ern_cl_value(struct ern_cl_call *call, const void *value, size_t bytes) {
  if (call->status != ERN_OK) return;
  const cl_int code = clSetKernelArg(call->kernel, call->at, bytes, value);
  struct ern_cl_backend *backend = call->stream->owner;
  if (code != CL_SUCCESS)
    call->status = ern_fail(backend->table.context, ERN_E_DEVICE, "OpenCL: %s: argument %u of kernel %s: %s",
                            backend->device.name, call->at, call->name, ern_cl_error_name(code));
  call->at++;
}

void ern_cl_local(struct ern_cl_call *call, size_t bytes) { ern_cl_value(call, NULL, bytes); }

void ern_cl_int(struct ern_cl_call *call, int value) {
  const cl_int argument = value;
  ern_cl_value(call, &argument, sizeof argument);
}

void ern_cl_size(struct ern_cl_call *call, size_t value) {
  const cl_ulong argument = value;
  ern_cl_value(call, &argument, sizeof argument);
}

void ern_cl_float(struct ern_cl_call *call, float value) {
  const cl_float argument = value;
  ern_cl_value(call, &argument, sizeof argument);
}

void ern_cl_span(struct ern_cl_call *call, ern_span span) {
  const cl_mem memory = span.buffer != NULL ? span.buffer->memory : NULL;
  ern_cl_value(call, span.buffer != NULL ? &memory : NULL, sizeof memory);
  ern_cl_size(call, span.at);
}

void ern_cl_rows(struct ern_cl_call *call, ern_rows rows) {
  ern_cl_span(call, rows.span);
  ern_cl_size(call, rows.stride);
}

ern_status ern_cl_run(struct ern_cl_call *call, size_t groups, size_t group) {
  if (call->status != ERN_OK || groups == 0) return call->status;
  struct ern_cl_backend *backend = call->stream->owner;
  size_t items = 0;
  if (!ern_size_multiply(groups, group, &items))
    return ern_fail(backend->table.context, ERN_E_NO_MEMORY, "OpenCL: %zu groups of %zu items are too many", groups,
                    group);
  const cl_int code = clEnqueueNDRangeKernel(call->stream->queue, call->kernel, 1, NULL, &items, &group, 0, NULL, NULL);
  return ern_cl_check(backend, code, call->name);
}

ern_status ern_cl_each(struct ern_cl_call *call, size_t items) {
  return ern_cl_run(call, items / GROUP + (items % GROUP != 0), GROUP);
}

/* ---- figures ----------------------------------------------------------------------------------------------------- */

enum { FIGURES = 1 << 14 };

ern_status ern_cl_figures(struct ern_stream *stream, size_t count,
                          void (*deliver)(void *args, const float *values, size_t count), void *args, ern_span *span) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  struct ern_backend *backend = &own->owner->table;
  ern_status status = ERN_OK;
  if (own->figures_host == NULL) ERN_TRY(ERN_NEW(backend->context, FIGURES, &own->figures_host));
  if (own->figures == NULL) ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, FIGURES, &own->figures));
  if (own->pending_count == ERN_CL_PENDING || count > FIGURES - own->figures_used)
    ERN_TRY(backend->synchronize(stream));
  if (count > FIGURES)
    ERN_TRY(ern_fail(backend->context, ERN_E_ARGUMENT, "OpenCL: %zu figures, expected %d at most", count, FIGURES));
  *span = (ern_span){own->figures, own->figures_used, count};
  own->pending[own->pending_count++] = (struct ern_cl_pending){deliver, args, own->figures_used, count};
  own->figures_used += count;
fail:
  return status;
}

struct ern_cl_blocks ern_cl_blocks_of(struct ern_stream *stream, size_t n) {
  enum { VECTORS = 32 };
  const struct ern_cl_device *device = &ern_cl_backend_of(stream)->device;
  const size_t block = device->cpu ? VECTORS * (size_t)device->width : GROUP;
  return (struct ern_cl_blocks){n / block + (n % block != 0), device->cpu ? 1 : GROUP};
}

ern_status ern_cl_run_sums(struct ern_cl_call *call) {
  return ern_cl_run(call, ERN_CL_SUMS, ERN_CL_SUM_GROUP / (size_t)call->stream->owner->device.width);
}

ern_status ern_cl_clean_up(struct ern_stream *stream, ern_status status) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  if (status == ERN_OK) return ERN_OK;
  own->pending_count = own->figures_used = 0;
  clFinish(own->queue); /* its result is ignored: `status` is returned */
  ern_arena_trim(stream);
  return status;
}

/* ---- times ------------------------------------------------------------------------------------------------------- */

ern_status ern_cl_mark(struct ern_stream *stream, int index) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  if (own->mark[index] != NULL) clReleaseEvent(own->mark[index]);
  own->mark[index] = NULL;
  const cl_int code = clEnqueueMarkerWithWaitList(own->queue, 0, NULL, &own->mark[index]);
  return ern_cl_check(own->owner, code, "note a time");
}

ern_status ern_cl_marks_read(struct ern_stream *stream, double *ms, int count) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  cl_ulong at[ERN_MARKS];
  cl_int code = clWaitForEvents((cl_uint)count, own->mark);
  if (code != CL_SUCCESS) return ern_cl_check(own->owner, code, "wait for times");
  for (int i = 0; i < count && code == CL_SUCCESS; i++)
    code = clGetEventProfilingInfo(own->mark[i], CL_PROFILING_COMMAND_END, sizeof at[i], &at[i], NULL);
  for (int i = 0; i < count && code == CL_SUCCESS; i++) ms[i] = 1e-6 * (double)(cl_long)(at[i] - at[0]);
  return ERN_OK; /* a driver that gives no times leaves the host's */
}
