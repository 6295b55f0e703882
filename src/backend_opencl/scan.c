/* SPDX-License-Identifier: MIT
 * Exclusive prefix sum on the device: sums of blocks of values, the scan of these sums, then the scan of each block
 * from there. One group scans few values alone. */
#include "backend_opencl/device/limits.h"
#include "backend_opencl/opencl.h"
#include "render/march_ops.h"

enum {
  GPU_ITEMS = ERN_CL_LIMIT_group_items, /* a group; on a CPU one item scans the whole block */
  GPU_EACH = 32,                        /* values an item */
  CPU_EACH = 1 << 16
};

/* first[0..n] of count[0..n) by `groups` groups; a zeroed base or total: none. */
static ern_status scan_from(struct ern_stream *stream, ern_span first, ern_span total, ern_span count, ern_span base,
                            size_t items, size_t each, size_t n, size_t groups) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_scan, "scan", "");
  ERN_CL_ARGS(&call, first, total, count, base, each, n);
  ern_cl_local(&call, items * sizeof(cl_ulong));
  return ern_cl_run(&call, groups, items);
}

ern_status ern_cl_scan(struct ern_stream *stream, struct ern_scan_args *a) {
  const ern_span first = a->first, count = a->count;
  const size_t n = a->n;
  const bool cpu = ern_cl_backend_of(stream)->device.cpu;
  const size_t items = cpu ? 1 : GPU_ITEMS, each = cpu ? CPU_EACH : GPU_EACH, tile = items * each;
  const size_t groups = n / tile + (n % tile != 0);
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const ern_span none = {0};
  ern_status status = ERN_OK;
  ern_span halves, sum, base;
  uint32_t half[2];
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, 2, &halves));
  if (groups <= 1) {
    ERN_TRY(scan_from(stream, first, halves, count, none, items, each, n, 1));
  } else {
    ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, groups, &sum));
    ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, groups + 1, &base));
    struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_scan, "scan_sums", "");
    ERN_CL_ARGS(&call, sum, count, each, n);
    ern_cl_local(&call, items * sizeof(cl_ulong));
    ERN_TRY(ern_cl_run(&call, groups, items));
    ERN_TRY(scan_from(stream, base, halves, sum, none, items, groups / items + (groups % items != 0), groups, 1));
    ERN_TRY(scan_from(stream, first, none, count, base, items, each, n, groups));
  }
  ERN_TRY(ern_cl_read(stream, half, halves, 2));
  const uint64_t sum_of_all = (uint64_t)half[1] << 32 | half[0];
  if (sum_of_all > INT32_MAX)
    ERN_TRY(ern_fail(stream->backend->context, ERN_E_NO_MEMORY, "march: more than %d samples in one batch", INT32_MAX));
  a->total = (size_t)sum_of_all;
fail:
  ern_arena_release(stream, mark);
  return status;
}
