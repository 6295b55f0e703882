/* SPDX-License-Identifier: MIT
 * Errors, buffers and transfers. */
#define _GNU_SOURCE /* MAP_ANONYMOUS */
#include "backend_opencl/device/buffer.h"

#include <string.h>
#include <sys/mman.h>

#include "backend_opencl/device/limits.h"
#include "core/memory.h"
#include "core/status.h"

static const size_t element_bytes[] = {
    [ERN_ELEMENT_REAL] = sizeof(float), [ERN_ELEMENT_INT32] = sizeof(int32_t), [ERN_ELEMENT_BYTE] = 1};

/* ---- errors ------------------------------------------------------------------------------------------------------ */

const char *ern_cl_error_name(cl_int code) {
  switch (code) {
#define NAME(name) \
  case name: return #name;
    NAME(CL_DEVICE_NOT_FOUND)
    NAME(CL_DEVICE_NOT_AVAILABLE)
    NAME(CL_COMPILER_NOT_AVAILABLE)
    NAME(CL_MEM_OBJECT_ALLOCATION_FAILURE)
    NAME(CL_OUT_OF_RESOURCES)
    NAME(CL_OUT_OF_HOST_MEMORY)
    NAME(CL_BUILD_PROGRAM_FAILURE)
    NAME(CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST)
    NAME(CL_INVALID_VALUE)
    NAME(CL_INVALID_CONTEXT)
    NAME(CL_INVALID_COMMAND_QUEUE)
    NAME(CL_INVALID_MEM_OBJECT)
    NAME(CL_INVALID_BINARY)
    NAME(CL_INVALID_BUILD_OPTIONS)
    NAME(CL_INVALID_PROGRAM_EXECUTABLE)
    NAME(CL_INVALID_KERNEL_NAME)
    NAME(CL_INVALID_ARG_INDEX)
    NAME(CL_INVALID_ARG_VALUE)
    NAME(CL_INVALID_ARG_SIZE)
    NAME(CL_INVALID_KERNEL_ARGS)
    NAME(CL_INVALID_WORK_GROUP_SIZE)
    NAME(CL_INVALID_WORK_ITEM_SIZE)
    NAME(CL_INVALID_GLOBAL_OFFSET)
    NAME(CL_INVALID_BUFFER_SIZE)
    NAME(CL_INVALID_GLOBAL_WORK_SIZE)
#undef NAME
    default: return "an error without a name";
  }
}

static bool is_memory(cl_int code) {
  return code == CL_MEM_OBJECT_ALLOCATION_FAILURE || code == CL_OUT_OF_HOST_MEMORY || code == CL_OUT_OF_RESOURCES;
}

/* Whether the device still responds to a small command. Drivers report a lost or faulted device with several codes,
 * even CL_OUT_OF_RESOURCES, so the code alone does not tell. */
static bool answers(struct ern_cl_backend *backend) {
  const cl_uint word = 0;
  if (backend->probe == NULL) return true; /* the backend is still being made */
  return clEnqueueFillBuffer(backend->queue, backend->probe, &word, sizeof word, 0, sizeof word, 0, NULL, NULL) ==
             CL_SUCCESS &&
         clFinish(backend->queue) == CL_SUCCESS;
}

ern_status ern_cl_check(struct ern_cl_backend *backend, cl_int code, const char *doing) {
  if (code == CL_SUCCESS) return ERN_OK;
  const bool lost = !answers(backend);
  return ern_fail(backend->table.context, is_memory(code) && !lost ? ERN_E_NO_MEMORY : ERN_E_DEVICE,
                  "OpenCL: %s: %s failed: %s (%d)%s", backend->device.name, doing, ern_cl_error_name(code), (int)code,
                  lost ? "; the device is lost, it no longer answers" : "");
}

/* ---- buffers ----------------------------------------------------------------------------------------------------- */

bool ern_cl_memory_is_free(size_t bytes) {
  void *room = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (room == MAP_FAILED) return false;
  (void)munmap(room, bytes);
  return true;
}

static size_t bytes_of(const struct ern_buffer *buffer) {
  return (buffer->count > 0 ? buffer->count : 1) * element_bytes[buffer->element];
}

static void buffer_free(struct ern_backend *table, struct ern_buffer *buffer) {
  if (buffer == NULL) return;
  if (buffer->memory != NULL) {
    clReleaseMemObject(buffer->memory);
    atomic_fetch_sub(&((struct ern_cl_backend *)table)->taken, bytes_of(buffer));
  }
  ern_release(table->context, buffer);
}

/* Clears `bytes` from byte `at` on, in pieces; `each` divides both. */
static cl_int clear(cl_command_queue queue, cl_mem memory, size_t each, size_t at, size_t bytes) {
  const size_t most = ERN_CL_LIMIT_fill_bytes;
  const cl_uint word = 0;
  cl_int code = CL_SUCCESS;
  for (size_t piece = 0; bytes > 0 && code == CL_SUCCESS; at += piece, bytes -= piece) {
    piece = bytes < most ? bytes : most;
    code = clEnqueueFillBuffer(queue, memory, &word, each, at, piece, 0, NULL, NULL);
  }
  return code;
}

static ern_status too_large(struct ern_cl_backend *backend, size_t bytes) {
  const struct ern_cl_device *device = &backend->device;
  return ern_fail(backend->table.context, ERN_E_NO_MEMORY,
                  "OpenCL: %s: too little memory: a buffer of %zu bytes is needed beside the %zu taken, but one may "
                  "have %llu and all memory is %llu",
                  device->name, bytes, atomic_load(&backend->taken), (unsigned long long)device->buffer_bytes,
                  (unsigned long long)device->memory_bytes);
}

enum { BESIDE = 1 << 20 /* bytes of the allocator and the driver for a buffer, a guess */ };

static ern_status buffer_make(struct ern_backend *table, ern_element element, size_t count,
                              struct ern_buffer **buffer) {
  struct ern_cl_backend *backend = (struct ern_cl_backend *)table;
  ern_status status = ERN_OK;
  struct ern_buffer *made = NULL;
  size_t bytes = 0;
  cl_int code = CL_SUCCESS;
  *buffer = NULL;
  if (!ern_size_multiply(count > 0 ? count : 1, element_bytes[element], &bytes)) return too_large(backend, SIZE_MAX);
  if (bytes > backend->device.buffer_bytes) return too_large(backend, bytes);
  if (backend->device.host && !ern_cl_memory_is_free(bytes + BESIDE))
    return ern_fail(
        table->context, ERN_E_NO_MEMORY,
        "OpenCL: %s: too little memory: a buffer of %zu bytes is needed beside the %zu taken, and the system "
        "refuses them (ulimit -v, -d)",
        backend->device.name, bytes, atomic_load(&backend->taken));
  ERN_TRY(ERN_NEW(table->context, 1, &made));
  made->element = element;
  made->count = count;
  ern_cl_touch(backend, made);
  made->memory = clCreateBuffer(backend->context, CL_MEM_READ_WRITE, bytes, NULL, &code);
  /* Devices allocate memory at its first use, so that a lack of memory shows here. */
  if (code == CL_SUCCESS) code = clear(backend->queue, made->memory, element_bytes[element], 0, bytes);
  if (code == CL_SUCCESS) code = clFinish(backend->queue);
  if (code != CL_SUCCESS && made->memory != NULL) {
    clReleaseMemObject(made->memory);
    made->memory = NULL;
  }
  if (is_memory(code) && answers(backend)) ERN_TRY(too_large(backend, bytes));
  ERN_TRY(ern_cl_check(backend, code, "make a buffer"));
  atomic_fetch_add(&backend->taken, bytes);
  *buffer = made;
  return ERN_OK;
fail:
  buffer_free(table, made);
  return status;
}

/* ---- moving bytes ------------------------------------------------------------------------------------------------ */

/* Waits for the transfers from the staging memory. */
static cl_int staging_wait(struct ern_cl_staging *staging) {
  const cl_int code = staging->last != NULL ? clWaitForEvents(1, &staging->last) : CL_SUCCESS;
  if (staging->last != NULL) clReleaseEvent(staging->last);
  staging->last = NULL;
  staging->used = 0;
  return code;
}

static void staging_make(struct ern_cl_stream *stream, struct ern_cl_staging *staging) {
  cl_int code = CL_SUCCESS;
  staging->memory =
      clCreateBuffer(stream->owner->context, CL_MEM_READ_WRITE | CL_MEM_ALLOC_HOST_PTR, ERN_CL_STAGING, NULL, &code);
  if (code != CL_SUCCESS) staging->memory = NULL;
  if (code == CL_SUCCESS)
    staging->bytes = clEnqueueMapBuffer(stream->queue, staging->memory, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0,
                                        ERN_CL_STAGING, 0, NULL, NULL, &code);
  if (code != CL_SUCCESS) staging->bytes = NULL;
}

void ern_cl_staging_free(struct ern_cl_stream *stream) {
  for (int i = 0; i < 2; i++) {
    struct ern_cl_staging *staging = &stream->staging[i];
    staging_wait(staging);
    if (staging->bytes != NULL) clEnqueueUnmapMemObject(stream->queue, staging->memory, staging->bytes, 0, NULL, NULL);
    if (staging->memory != NULL) clReleaseMemObject(staging->memory);
  }
}

/* *staging = the one with room for `bytes`; NULL where there is none: then the transfer is from or to the caller's
 * memory, and waited for. For a CPU as the device that is the faster way. */
static cl_int staging_with_room(struct ern_cl_stream *stream, size_t bytes, struct ern_cl_staging **staging) {
  cl_int code = CL_SUCCESS;
  *staging = NULL;
  if (bytes > ERN_CL_STAGING || stream->owner->device.cpu) return CL_SUCCESS;
  struct ern_cl_staging *at = &stream->staging[stream->staging_at];
  if (bytes > ERN_CL_STAGING - at->used) {
    stream->staging_at = 1 - stream->staging_at;
    at = &stream->staging[stream->staging_at];
    code = staging_wait(at);
  }
  if (at->memory == NULL) staging_make(stream, at);
  if (at->bytes != NULL) *staging = at;
  return code;
}

/* Through staging memory, so that neither the host waits for the device's earlier work, nor the device for the
 * transfer of pageable memory. */
static ern_status write_span(struct ern_stream *stream, ern_span to, const void *from, size_t count) {
  if (count == 0) return ERN_OK;
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  struct ern_cl_staging *staging = NULL;
  ern_cl_touch(own->owner, to.buffer);
  const size_t each = element_bytes[to.buffer->element], bytes = count * each;
  cl_int code = staging_with_room(own, bytes, &staging);
  if (code == CL_SUCCESS && staging == NULL)
    code = clEnqueueWriteBuffer(own->queue, to.buffer->memory, CL_TRUE, to.at * each, bytes, from, 0, NULL, NULL);
  if (code == CL_SUCCESS && staging != NULL) {
    uint8_t *copy = staging->bytes + staging->used;
    memcpy(copy, from, bytes);
    staging->used += (bytes + 63) / 64 * 64;
    if (staging->last != NULL) clReleaseEvent(staging->last);
    staging->last = NULL;
    code = clEnqueueWriteBuffer(own->queue, to.buffer->memory, CL_FALSE, to.at * each, bytes, copy, 0, NULL,
                                &staging->last);
  }
  return ern_cl_check(own->owner, code, "write to the device");
}

/* Through staging memory likewise: a transfer to pageable memory is slower than one to pinned memory and a copy. */
ern_status ern_cl_read(struct ern_stream *stream, void *to, ern_span from, size_t count) {
  if (count == 0) return ERN_OK;
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  struct ern_cl_staging *staging = NULL;
  const size_t each = element_bytes[from.buffer->element], bytes = count * each;
  cl_int code = staging_with_room(own, bytes, &staging);
  void *pinned = staging != NULL ? staging->bytes + staging->used : to;
  if (code == CL_SUCCESS)
    code = clEnqueueReadBuffer(own->queue, from.buffer->memory, CL_TRUE, from.at * each, bytes, pinned, 0, NULL, NULL);
  if (code == CL_SUCCESS && staging != NULL) memcpy(to, pinned, bytes);
  return ern_cl_check(own->owner, code, "read from the device");
}

static ern_status upload_reals(struct ern_stream *stream, ern_span to, const float *from, size_t count) {
  return write_span(stream, to, from, count);
}
static ern_status download_reals(struct ern_stream *stream, float *to, ern_span from, size_t count) {
  return ern_cl_read(stream, to, from, count);
}
static ern_status upload_int32(struct ern_stream *stream, ern_span to, const int32_t *from, size_t count) {
  return write_span(stream, to, from, count);
}
static ern_status download_int32(struct ern_stream *stream, int32_t *to, ern_span from, size_t count) {
  return ern_cl_read(stream, to, from, count);
}
static ern_status upload_bytes(struct ern_stream *stream, ern_span to, const uint8_t *from, size_t count) {
  return write_span(stream, to, from, count);
}
static ern_status download_bytes(struct ern_stream *stream, uint8_t *to, ern_span from, size_t count) {
  return ern_cl_read(stream, to, from, count);
}

static ern_status zero(struct ern_stream *stream, ern_span span) {
  if (span.buffer == NULL || span.count == 0) return ERN_OK;
  ern_cl_touch(ern_cl_backend_of(stream), span.buffer);
  const size_t each = element_bytes[span.buffer->element];
  const cl_int code =
      clear(ern_cl_stream_of(stream)->queue, span.buffer->memory, each, span.at * each, span.count * each);
  return ern_cl_check(ern_cl_backend_of(stream), code, "clear memory");
}

static ern_status copy(struct ern_stream *stream, ern_span to, ern_span from, size_t count) {
  if (count == 0) return ERN_OK;
  ern_cl_touch(ern_cl_backend_of(stream), to.buffer);
  const size_t each = element_bytes[to.buffer->element];
  const cl_int code = clEnqueueCopyBuffer(ern_cl_stream_of(stream)->queue, from.buffer->memory, to.buffer->memory,
                                          from.at * each, to.at * each, count * each, 0, NULL, NULL);
  return ern_cl_check(ern_cl_backend_of(stream), code, "copy on the device");
}

static ern_status synchronize(struct ern_stream *stream) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  const size_t pending = own->pending_count, used = own->figures_used;
  own->pending_count = 0;
  own->figures_used = 0;
  if (pending == 0) return ERN_OK;
  const ern_status status = ern_cl_read(stream, own->figures_host, (ern_span){own->figures, 0, used}, used);
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < pending; i++)
    own->pending[i].deliver(own->pending[i].args, own->figures_host + own->pending[i].at, own->pending[i].count);
  return ERN_OK;
}

void ern_cl_fill_memory(struct ern_backend *table) {
  table->buffer_make = buffer_make;
  table->buffer_free = buffer_free;
  table->upload_reals = upload_reals;
  table->download_reals = download_reals;
  table->upload_int32 = upload_int32;
  table->download_int32 = download_int32;
  table->upload_bytes = upload_bytes;
  table->download_bytes = download_bytes;
  table->zero = zero;
  table->copy = copy;
  table->synchronize = synchronize;
}
