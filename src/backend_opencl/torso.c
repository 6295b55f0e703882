/* SPDX-License-Identifier: MIT
 * Slots of the torso: pose encoding, coordinates, selection of pixels, deformation, compositing, 2D occupancy. */
#include <math.h>
#include <string.h>

#include "backend_opencl/opencl.h"
#include "core/memory.h"
#include "core/rng.h"
#include "model/torso_ops.h"
#include "render/march_ops.h"

static struct ern_cl_call begin(struct ern_stream *stream, const char *kernel) {
  return ern_cl_begin(stream, ERN_CL_torso, kernel, "");
}

/* ---- pose -------------------------------------------------------------------------------------------------------- */

/* The kernel's struct inverse: high + low is the inverse in double to 48 bits, 4 x 4 row by row. */
struct inverse {
  cl_float high[16], low[16];
};
_Static_assert(sizeof(struct inverse) == 32 * sizeof(float), "as the kernel has it");

/* Row `column` of a [4][8] becomes a unit row with a 1 in that column, which is cleared in the other rows. */
static void eliminate(double a[4][8], int column) {
  int pivot = column;
  for (int i = column + 1; i < 4; i++) {
    if (fabs(a[i][column]) > fabs(a[pivot][column])) pivot = i;
  }
  for (int j = 0; j < 8; j++) {
    const double swapped = a[pivot][j];
    a[pivot][j] = a[column][j];
    a[column][j] = swapped;
  }
  const double scale = 1 / a[column][column];
  for (int j = 0; j < 8; j++) a[column][j] *= scale;
  for (int i = 0; i < 4; i++) {
    const double factor = a[i][column];
    for (int j = 0; j < 8 && i != column; j++) a[i][j] -= factor * a[column][j];
  }
}

/* Gauss-Jordan with row pivoting in double on the host, in the reference's order of operations. */
static struct inverse inverse_of(const float pose[16]) {
  struct inverse inverse;
  double a[4][8];
  for (int i = 0; i < 4; i++) {
    for (int j = 0; j < 4; j++) {
      a[i][j] = (double)pose[4 * i + j];
      a[i][4 + j] = i == j;
    }
  }
  for (int column = 0; column < 4; column++) eliminate(a, column);
  for (int i = 0; i < 16; i++) {
    const double value = a[i / 4][4 + i % 4];
    inverse.high[i] = (float)value;
    inverse.low[i] = (float)(value - (double)inverse.high[i]);
  }
  return inverse;
}

ern_status ern_cl_torso_pose_fwd(struct ern_stream *stream, struct ern_torso_pose_fwd_args *a) {
  const struct inverse inverse = inverse_of(a->pose);
  struct ern_cl_call call = begin(stream, "torso_pose_fwd");
  ERN_CL_ARGS(&call, a->k, a->anchors, a->gamma);
  ern_cl_value(&call, &inverse, sizeof inverse);
  return ern_cl_run(&call, 1, 1);
}

ern_status ern_cl_torso_pose_bwd(struct ern_stream *stream, struct ern_torso_pose_bwd_args *a) {
  const struct inverse inverse = inverse_of(a->forward.pose);
  struct ern_cl_call call = begin(stream, "torso_pose_bwd");
  ERN_CL_ARGS(&call, a->danchors, a->dgamma, a->dk, a->forward.anchors, a->forward.gamma);
  ern_cl_value(&call, &inverse, sizeof inverse);
  return ern_cl_run(&call, 1, 1);
}

/* ---- pixels ------------------------------------------------------------------------------------------------------ */

ern_status ern_cl_torso_coords(struct ern_stream *stream, struct ern_torso_coords_args *a) {
  struct ern_cl_call call = begin(stream, "torso_coords");
  ERN_CL_ARGS(&call, a->q, a->pixel, a->width, a->height, a->shrink, a->n);
  return ern_cl_each(&call, a->n);
}

static ern_status find_reached(struct ern_stream *stream, const struct ern_torso_select_args *a, ern_span reached) {
  struct ern_cl_call call = begin(stream, "torso_reached");
  ERN_CL_ARGS(&call, reached, a->pixel, a->grid, a->threshold, a->width, a->height, a->n);
  return ern_cl_each(&call, a->n);
}

static ern_status gather(struct ern_stream *stream, const struct ern_torso_select_args *a, ern_span reached,
                         ern_span first) {
  struct ern_cl_call call = begin(stream, "torso_gather");
  ERN_CL_ARGS(&call, a->index, a->selected, reached, first, a->pixel, a->n);
  return ern_cl_each(&call, a->n);
}

ern_status ern_cl_torso_select(struct ern_stream *stream, struct ern_torso_select_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  struct ern_scan_args scan = {.n = a->n};
  a->count = 0;
  if (a->n == 0) return ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, a->n, &scan.count));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, a->n + 1, &scan.first));
  ERN_TRY(find_reached(stream, a, scan.count));
  ERN_TRY(stream->backend->scan(stream, &scan));
  if (scan.total > 0) ERN_TRY(gather(stream, a, scan.count, scan.first));
  a->count = scan.total;
fail:
  ern_arena_release(stream, mark);
  return status;
}

/* ---- deformation ------------------------------------------------------------------------------------------------- */

ern_status ern_cl_torso_move(struct ern_stream *stream, struct ern_torso_move_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_span motion;
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_MOTION_VALUES, &motion));
  ERN_TRY(stream->backend->upload_reals(stream, motion, a->motion, ERN_MOTION_VALUES));
  struct ern_cl_call call = begin(stream, "torso_move");
  ERN_CL_ARGS(&call, a->moved, a->q, motion, (float)(ERN_MOTION_SIDE - 1) / 2 / a->shrink, a->n);
  status = ern_cl_each(&call, a->n);
fail:
  ern_arena_release(stream, mark);
  return status;
}

ern_status ern_cl_torso_deform_fwd(struct ern_stream *stream, struct ern_torso_deform_fwd_args *a) {
  struct ern_cl_call call = begin(stream, "torso_deform_fwd");
  ERN_CL_ARGS(&call, a->x, a->q, a->d, a->n);
  return ern_cl_each(&call, a->n);
}

ern_status ern_cl_torso_deform_bwd(struct ern_stream *stream, struct ern_torso_deform_bwd_args *a) {
  struct ern_cl_call call = begin(stream, "torso_deform_bwd");
  ERN_CL_ARGS(&call, a->dd, a->dx, a->forward.q, a->forward.d, a->forward.n);
  return ern_cl_each(&call, a->forward.n);
}

/* ---- compositing ------------------------------------------------------------------------------------------------- */

static ern_status leave_untouched(struct ern_stream *stream, const struct ern_torso_composite_fwd_args *a) {
  const ern_span to = a->pixel.span, from = a->background.span;
  const bool in_place = to.buffer == from.buffer && to.at == from.at;
  if (in_place && a->opacity.buffer == NULL) return ERN_OK;
  struct ern_cl_call call = begin(stream, "torso_untouched");
  ERN_CL_ARGS(&call, a->pixel, a->opacity, in_place ? (ern_rows){0} : a->background, a->rays);
  return ern_cl_each(&call, a->rays);
}

ern_status ern_cl_torso_composite_fwd(struct ern_stream *stream, struct ern_torso_composite_fwd_args *a) {
  const ern_status status = leave_untouched(stream, a);
  if (status != ERN_OK) return status;
  struct ern_cl_call call = begin(stream, "torso_composite_fwd");
  ERN_CL_ARGS(&call, a->pixel, a->opacity, a->layer, a->index, a->background, a->n);
  return ern_cl_each(&call, a->n);
}

ern_status ern_cl_torso_composite_bwd(struct ern_stream *stream, struct ern_torso_composite_bwd_args *a) {
  struct ern_cl_call call = begin(stream, "torso_composite_bwd");
  ERN_CL_ARGS(&call, a->dlayer, a->dpixel, a->forward.layer, a->forward.index, a->forward.background, a->forward.n);
  return ern_cl_each(&call, a->forward.n);
}

/* ---- occupancy --------------------------------------------------------------------------------------------------- */

ern_status ern_cl_torso_points(struct ern_stream *stream, struct ern_torso_points_args *a) {
  struct ern_cl_call call = begin(stream, "torso_points");
  ERN_CL_ARGS(&call, a->q, a->shrink, a->seed, a->step, ERN_RNG_REFRESH_CELL);
  return ern_cl_each(&call, ERN_TORSO_CELLS);
}

/* Reads back the grid (64 KB) and sums it cell by cell in double, so that the mean has the reference's bits. */
static ern_status mean_of(struct ern_stream *stream, ern_span grid, double *mean) {
  ern_context *context = stream->backend->context;
  float *values = NULL;
  double sum = 0;
  ern_status status = ERN_NEW(context, ERN_TORSO_CELLS, &values);
  if (status != ERN_OK) return status;
  status = ern_cl_read(stream, values, grid, ERN_TORSO_CELLS);
  for (size_t i = 0; i < ERN_TORSO_CELLS && status == ERN_OK; i++) sum += (double)values[i];
  *mean = sum / ERN_TORSO_CELLS;
  ern_release(context, values);
  return status;
}

ern_status ern_cl_torso_update(struct ern_stream *stream, struct ern_torso_update_args *a) {
  struct ern_cl_call call = begin(stream, "torso_update");
  ERN_CL_ARGS(&call, a->grid, a->alpha, a->decay);
  const ern_status status = ern_cl_each(&call, ERN_TORSO_CELLS);
  return status == ERN_OK ? mean_of(stream, a->grid, &a->mean) : status;
}
