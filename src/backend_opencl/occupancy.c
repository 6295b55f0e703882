/* SPDX-License-Identifier: MIT
 * The head's occupancy grid: occupancy.cl. */
#include <math.h>

#include "backend_opencl/opencl.h"
#include "core/memory.h"
#include "core/rng.h"
#include "render/march_ops.h"
#include "render/occupancy_ops.h"

enum { CUBES = ERN_OCCUPANCY_CELLS / 8, BLOCKS = ERN_OCCUPANCY_CELLS / 64 };

/* ---- cells that a camera sees ------------------------------------------------------------------------------------ */

enum { FRUSTUM = 14 }; /* floats of a camera, see occupancy.cl */

static void frustum_of(float frustum[FRUSTUM], const struct ern_view *view) {
  for (int k = 0; k < 3; k++) {
    for (int axis = 0; axis < 3; axis++) frustum[3 * axis + k] = view->pose[4 * k + axis];
    frustum[9 + k] = view->pose[4 * k + 3];
  }
  frustum[12] = view->cx / view->focal;
  frustum[13] = view->cy / view->focal;
}

ern_status ern_cl_occupancy_mark(struct ern_stream *stream, struct ern_occupancy_mark_args *a) {
  ern_context *context = stream->backend->context;
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const bool cpu = ern_cl_backend_of(stream)->device.cpu;
  ern_status status = ERN_OK;
  float *frustum = NULL;
  size_t floats = 0;
  ern_span frusta = {0};
  if (!ern_size_multiply(a->view_count, FRUSTUM, &floats))
    ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "occupancy: %zu views are too many", a->view_count));
  if (floats > 0) {
    ERN_TRY(ERN_NEW(context, floats, &frustum));
    for (size_t k = 0; k < a->view_count; k++) frustum_of(frustum + k * FRUSTUM, &a->views[k]);
    ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, floats, &frusta));
    ERN_TRY(stream->backend->upload_reals(stream, frusta, frustum, floats));
  }
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_occupancy, "occupancy_mark", "");
  ERN_CL_ARGS(&call, a->grid, frusta, a->bound * (127.0f / 128.0f), 2.0f / ERN_OCCUPANCY_SIDE * a->bound,
              2.0f / ERN_OCCUPANCY_SIDE * 4 * a->bound, a->view_count);
  ERN_TRY(ern_cl_each(&call, cpu ? BLOCKS : ERN_OCCUPANCY_CELLS));
fail:
  ern_release(context, frustum);
  ern_arena_release(stream, mark);
  return status;
}

/* ---- cells to refresh -------------------------------------------------------------------------------------------- */

ern_status ern_cl_occupancy_list(struct ern_stream *stream, struct ern_occupancy_list_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  struct ern_scan_args scan = {.n = BLOCKS};
  ern_span open;
  struct ern_cl_call call;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_BYTE, CUBES, &open));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, BLOCKS, &scan.count));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, BLOCKS + 1, &scan.first));
  call = ern_cl_begin(stream, ERN_CL_occupancy, "occupancy_open", "");
  ERN_CL_ARGS(&call, open, a->grid);
  ERN_TRY(ern_cl_each(&call, CUBES));
  call = ern_cl_begin(stream, ERN_CL_occupancy, "occupancy_count", "");
  ERN_CL_ARGS(&call, scan.count, open, a->bits, (int32_t)a->turn.turn, (int32_t)a->turn.mask);
  ERN_TRY(ern_cl_each(&call, BLOCKS));
  ERN_TRY(ern_cl_scan(stream, &scan));
  a->count = scan.total;
  call = ern_cl_begin(stream, ERN_CL_occupancy, "occupancy_list", "");
  ERN_CL_ARGS(&call, a->cells, scan.first, open, a->bits, (int32_t)a->turn.turn, (int32_t)a->turn.mask);
  ERN_TRY(ern_cl_each(&call, BLOCKS));
fail:
  ern_arena_release(stream, mark);
  return status;
}

ern_status ern_cl_occupancy_points(struct ern_stream *stream, struct ern_occupancy_points_args *a) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_occupancy, "occupancy_points", "");
  ERN_CL_ARGS(&call, a->x, a->cells, a->bound * (127.0f / 128.0f), a->bound / ERN_OCCUPANCY_SIDE, a->seed, a->step,
              ERN_RNG_REFRESH_CELL, a->n);
  return ern_cl_each(&call, a->n);
}

ern_status ern_cl_occupancy_scatter(struct ern_stream *stream, struct ern_occupancy_scatter_args *a) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_occupancy, "occupancy_scatter", "");
  ERN_CL_ARGS(&call, a->fresh, a->cells, a->sigma, a->n);
  return ern_cl_each(&call, a->n);
}

/* ---- refresh ----------------------------------------------------------------------------------------------------- */

/* Adds the groups' sums and their rounding errors; an error is NaN where its sum is not finite. */
static double sum_of(const float part[2 * ERN_CL_SUMS]) {
  double sum = 0;
  for (int g = 0; g < ERN_CL_SUMS; g++) {
    sum += (double)part[2 * g];
    if (isfinite(part[2 * g])) sum += (double)part[2 * g + 1];
  }
  return sum;
}

ern_status ern_cl_occupancy_update(struct ern_stream *stream, struct ern_occupancy_update_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  float part[2 * ERN_CL_SUMS];
  ern_span parts;
  struct ern_cl_call call;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, 2 * ERN_CL_SUMS, &parts));
  call = ern_cl_begin(stream, ERN_CL_occupancy, "occupancy_update", "");
  ERN_CL_ARGS(&call, parts, a->grid, a->fresh, a->bits, a->decay.near, a->decay.far, (int32_t)a->decay.turn.turn,
              (int32_t)a->decay.turn.mask, CUBES / (ERN_CL_SUMS * ERN_CL_SUM_GROUP));
  ERN_TRY(ern_cl_run(&call, ERN_CL_SUMS, ERN_CL_SUM_GROUP));
  ERN_TRY(ern_cl_read(stream, part, parts, 2 * ERN_CL_SUMS));
  a->mean = sum_of(part) / ERN_OCCUPANCY_CELLS;
  ern_cl_touch(ern_cl_backend_of(stream), a->bits.buffer);
  call = ern_cl_begin(stream, ERN_CL_occupancy, "occupancy_bits", "");
  ERN_CL_ARGS(&call, a->bits, a->grid, a->mean < (double)a->limit ? (float)a->mean : a->limit);
  ERN_TRY(ern_cl_each(&call, CUBES));
fail:
  ern_arena_release(stream, mark);
  return status;
}
