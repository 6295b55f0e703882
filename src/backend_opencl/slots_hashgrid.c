/* SPDX-License-Identifier: MIT
 * Slots of the grids. */
#include <stdio.h>
#include <string.h>

#include "backend_opencl/opencl.h"

enum { GROUP = 64 /* as in kernels/hashgrid.cl */, OWNERS = 512, OPTION_BYTES = 96 };

/* As kernels/hashgrid.cl has them. */
struct level {
  cl_float scale, slope;
  cl_uint mask, size, offset, multiplier[2], hashed;
};
struct grid {
  struct level level[ERN_GRID_MAX_LEVELS];
  cl_float bound;
  cl_uint levels;
};
_Static_assert(sizeof(struct level) == 32 && sizeof(struct grid) == 32 * 24 + 8 && ERN_GRID_MAX_LEVELS == 24,
               "layout of kernels/hashgrid.cl");

/* The dense index needs no modulo: u <= 1 makes cell + 1 <= resolution, so it is below (resolution + 1)^dims <= size.
 * *divide: set where the modulo is no power of two. */
static struct level plan_level(const struct ern_grid *grid, int l, bool *divide) {
  static const uint32_t prime[ERN_GRID_MAX_DIMS] = {1, 2654435761u, 805459861u};
  const struct ern_grid_level *from = &grid->level[l];
  struct level level = {
      .scale = from->scale, .slope = from->scale / (2 * grid->bound), .mask = UINT32_MAX, .size = from->size};
  uint64_t stride = 1;
  level.offset = from->offset;
  for (int d = 0; d < grid->dims && stride <= from->size; d++) {
    if (d > 0) level.multiplier[d - 1] = (uint32_t)stride;
    stride *= from->resolution + 1;
  }
  if (stride <= from->size) return level;
  level.hashed = grid->hashed;
  if (grid->hashed) memcpy(level.multiplier, prime + 1, sizeof level.multiplier);
  level.mask = from->size - 1;
  *divide |= (from->size & level.mask) != 0;
  return level;
}

/* The grid as its kernels take it, and what they are built with. */
static struct grid plan(struct ern_stream *stream, const struct ern_grid *grid, char options[OPTION_BYTES]) {
  struct grid made = {.bound = grid->bound, .levels = (cl_uint)grid->levels};
  bool divide = false;
  for (int l = 0; l < grid->levels; l++) made.level[l] = plan_level(grid, l, &divide);
  snprintf(options, OPTION_BYTES, "-D DIMS=%d -D FEATURES=%d -D DIVIDE=%d -D OWNERS=%d", grid->dims, grid->features,
           divide, ern_cl_backend_of(stream)->device.cpu ? 1 : OWNERS);
  return made;
}

static void positions(struct ern_cl_call *call, const struct ern_grid_args *a) {
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) ern_cl_span(call, d < a->grid->dims ? a->x[d] : (ern_span){0});
}

static ern_status grid_fwd(struct ern_stream *stream, struct ern_grid_args *a) {
  char options[OPTION_BYTES];
  const struct grid grid = plan(stream, a->grid, options);
  const size_t blocks = a->n / GROUP + (a->n % GROUP != 0);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_hashgrid, "grid_fwd", options);
  ern_cl_rows(&call, a->f);
  positions(&call, a);
  ern_cl_span(&call, a->table);
  ern_cl_value(&call, &grid, sizeof grid);
  ern_cl_int(&call, (int)blocks);
  ern_cl_size(&call, a->n);
  return ern_cl_run(&call, blocks * grid.levels, GROUP);
}

static ern_status bwd_table(struct ern_stream *stream, const struct ern_grid_bwd_args *a, const struct grid *grid,
                            const char *options) {
  const bool atomics = !stream->backend->deterministic;
  const size_t blocks = a->forward.n / GROUP + (a->forward.n % GROUP != 0);
  struct ern_cl_call call =
      ern_cl_begin(stream, ERN_CL_hashgrid, atomics ? "grid_bwd_table_atomic" : "grid_bwd_table", options);
  ern_cl_span(&call, a->dtable);
  ern_cl_rows(&call, a->df);
  positions(&call, &a->forward);
  ern_cl_value(&call, grid, sizeof *grid);
  if (atomics) ern_cl_int(&call, (int)blocks);
  ern_cl_size(&call, a->forward.n);
  if (atomics) return ern_cl_run(&call, blocks * grid->levels, GROUP);
  return ern_cl_run(&call, grid->levels * (size_t)(ern_cl_backend_of(stream)->device.cpu ? 1 : OWNERS / GROUP), GROUP);
}

static ern_status bwd_x(struct ern_stream *stream, const struct ern_grid_bwd_args *a, const struct grid *grid,
                        const char *options) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_hashgrid, "grid_bwd_x", options);
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) ern_cl_span(&call, d < a->forward.grid->dims ? a->dx[d] : (ern_span){0});
  ern_cl_rows(&call, a->df);
  positions(&call, &a->forward);
  ern_cl_span(&call, a->forward.table);
  ern_cl_value(&call, grid, sizeof *grid);
  ern_cl_size(&call, a->forward.n);
  return ern_cl_run(&call, a->forward.n / GROUP + (a->forward.n % GROUP != 0), GROUP);
}

static ern_status grid_bwd(struct ern_stream *stream, struct ern_grid_bwd_args *a) {
  ern_status status = ERN_OK;
  char options[OPTION_BYTES];
  const struct grid grid = plan(stream, a->forward.grid, options);
  if (a->forward.n == 0) return ERN_OK;
  if (a->dtable.buffer != NULL) ERN_TRY(bwd_table(stream, a, &grid, options));
  if (a->dx[0].buffer != NULL) ERN_TRY(bwd_x(stream, a, &grid, options));
fail:
  return status;
}

void ern_cl_fill_hashgrid(struct ern_backend *table) {
  table->grid_fwd = grid_fwd;
  table->grid_bwd = grid_bwd;
}
