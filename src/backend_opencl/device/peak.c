/* SPDX-License-Identifier: MIT
 * The loops of kernels/peak.cl, sized so that a call lasts about a millisecond and every unit has work. */
#include "backend_opencl/device/peak.h"

#include "backend_opencl/device/limits.h"
#include "backend_opencl/opencl.h"

enum {
  MULTIPLY_CHAINS = 12, /* as in peak.cl; so is the next */
  GATHER_CHAINS = 4,
  GROUP = 256,           /* work-items of a group of a GPU that takes so many */
  ITEMS_RESIDENT = 2048, /* of a unit: as many as the largest GPUs keep */
  ITEMS_A_UNIT = 8,      /* of a CPU, each a group: enough of them to balance the load */
  MULTIPLY_TURNS = 4096, /* of an item of a GPU */
  GATHER_TURNS = 512,
  CPU_TURNS = 1 << 17, /* multiply-adds: a quarter of a millisecond an item */
  CPU_GATHER_TURNS = 1 << 13,
};

static struct ern_cl_device *device_of(struct ern_stream *stream) { return &ern_cl_backend_of(stream)->device; }

static size_t group_of(const struct ern_cl_device *device) {
  return device->cpu ? 1 : device->group_most < GROUP ? ERN_CL_LIMIT_group_items : GROUP;
}

static size_t items_of(const struct ern_cl_device *device) {
  return (size_t)device->units * (device->cpu ? ITEMS_A_UNIT : ITEMS_RESIDENT);
}

void ern_opencl_describe(const struct ern_backend *backend, struct ern_opencl_about *about) {
  const struct ern_cl_device *device = &((const struct ern_cl_backend *)backend)->device;
  cl_ulong cache = 0;
  if (clGetDeviceInfo(device->id, CL_DEVICE_GLOBAL_MEM_CACHE_SIZE, sizeof cache, &cache, NULL) != CL_SUCCESS) cache = 0;
  *about = (struct ern_opencl_about){.units = device->units,
                                     .cpu = device->cpu,
                                     .cache_bytes = (size_t)cache,
                                     .memory_bytes = device->memory_bytes,
                                     .buffer_bytes = device->buffer_bytes,
                                     .sink = items_of(device)};
}

static ern_status run_arithmetic(struct ern_stream *stream, const struct ern_opencl_peak *peak, double *done) {
  const struct ern_cl_device *device = device_of(stream);
  const bool gather = peak->loop == ERN_OPENCL_GATHER;
  const int turns = gather ? device->cpu ? CPU_GATHER_TURNS : GATHER_TURNS : device->cpu ? CPU_TURNS : MULTIPLY_TURNS;
  const size_t items = items_of(device), group = group_of(device);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_peak, gather ? "peak_gather" : "peak_multiply", "");
  ern_cl_span(&call, peak->sink);
  if (gather) ern_cl_span(&call, peak->table);
  ern_cl_int(&call, turns);
  *done = (double)items * device->width * turns * (gather ? GATHER_CHAINS : 2 * MULTIPLY_CHAINS);
  return ern_cl_run(&call, items / group, group);
}

static ern_status run_stream(struct ern_stream *stream, const struct ern_opencl_peak *peak, double *done) {
  const struct ern_cl_device *device = device_of(stream);
  const bool copy = peak->loop == ERN_OPENCL_COPY;
  const size_t count = peak->to.count, floats = device->cpu ? ERN_OPENCL_PEAK_BLOCK : 4; /* an item's */
  const size_t group = group_of(device), items = (count + floats - 1) / floats;
  *done = 2.0 * (double)count * sizeof(float);
  if (peak->loop == ERN_OPENCL_MOVE) return stream->backend->copy(stream, peak->to, peak->from, count);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_peak, copy ? "peak_copy" : "peak_update", "");
  ern_cl_span(&call, peak->to);
  if (copy) ern_cl_span(&call, peak->from);
  ern_cl_size(&call, count);
  return ern_cl_run(&call, (items + group - 1) / group, group);
}

ern_status ern_opencl_peak_run(struct ern_stream *stream, const struct ern_opencl_peak *peak, double *done) {
  const bool arithmetic = peak->loop == ERN_OPENCL_MULTIPLY || peak->loop == ERN_OPENCL_GATHER;
  return arithmetic ? run_arithmetic(stream, peak, done) : run_stream(stream, peak, done);
}

ern_status ern_opencl_finish(struct ern_stream *stream) {
  return ern_cl_check(ern_cl_backend_of(stream), clFinish(ern_cl_stream_of(stream)->queue), "wait for the device");
}
