/* SPDX-License-Identifier: MIT
 * Slots of the grids. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "backend_opencl/opencl.h"
#include "hashgrid/hashgrid_ops.h"

enum { OWNERS = 512, OPTION_BYTES = 160 };

/* As kernels/hashgrid.cl has them. */
struct level {
  cl_float scale, dindex_dx;
  cl_uint mask, size, offset, multiplier[2], hashed;
};
struct grid {
  struct level level[ERN_GRID_MAX_LEVELS];
  cl_float bound, inverse;
  cl_uint levels, blocks;
};
_Static_assert(sizeof(struct level) == 32 && sizeof(struct grid) == 32 * 24 + 16 && ERN_GRID_MAX_LEVELS == 24,
               "layout of kernels/hashgrid.cl");

/* The dense index needs no modulo: u <= 1 makes cell + 1 <= resolution, so it is below (resolution + 1)^dims <= size.
 * *divide: set where the modulus is not a power of two. */
static struct level plan_level(const struct ern_grid *grid, int l, bool *divide) {
  static const uint32_t prime[ERN_GRID_MAX_DIMS] = {1, 2654435761u, 805459861u};
  const struct ern_grid_level *from = &grid->level[l];
  struct level level = {
      .scale = from->scale, .dindex_dx = from->scale / (2 * grid->bound), .mask = UINT32_MAX, .size = from->size};
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

/* A grid in the form of its kernels, their build options, and their work-groups. */
struct plan {
  struct grid grid;
  char options[OPTION_BYTES];
  size_t group, groups, table_groups;
};

static struct plan plan_grid(struct ern_stream *stream, ern_cl_tunable tunable, const struct ern_grid *grid, size_t n) {
  const struct ern_cl_backend *backend = ern_cl_backend_of(stream);
  const struct ern_cl_device *device = &backend->device;
  const size_t size = (size_t)backend->size[tunable];
  struct plan plan = {.group = device->cpu ? 1 : size};
  const size_t block = size * (size_t)device->width, blocks = n / block + (n % block != 0);
  bool divide = false;
  int exponent = 0;
  plan.grid = (struct grid){.bound = grid->bound,
                            .inverse = 1 / (2 * grid->bound),
                            .levels = (cl_uint)grid->levels,
                            .blocks = (cl_uint)blocks};
  for (int l = 0; l < grid->levels; l++) plan.grid.level[l] = plan_level(grid, l, &divide);
  /* The inverse of a power of two is exact, so the product equals the quotient. */
  const bool inverse = frexpf(grid->bound, &exponent) == 0.5f && abs(exponent) < 100;
  snprintf(
      plan.options, OPTION_BYTES,
      "-D DIMS=%d -D FEATURES=%d -D INVERSE=%d -D DIVIDE=%d -D OWNERS=%d -D GROUP=%zu -D VECTORS=%zu -D FLOAT_ADD=%d",
      grid->dims, grid->features, inverse, divide, OWNERS, plan.group, device->cpu ? size : 1, (int)device->float_add);
  plan.groups = blocks * (size_t)grid->levels;
  plan.table_groups = (size_t)grid->levels * (device->cpu ? 1 : OWNERS / size);
  return plan;
}

static void positions(struct ern_cl_call *call, const struct ern_grid_fwd_args *a) {
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) ern_cl_span(call, d < a->grid->dims ? a->x[d] : (ern_span){0});
}

ern_status ern_cl_grid_fwd(struct ern_stream *stream, struct ern_grid_fwd_args *a) {
  if (a->n == 0) return ERN_OK;
  const struct plan plan = plan_grid(stream, ERN_CL_SIZE_grid_fwd, a->grid, a->n);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_hashgrid, "grid_fwd", plan.options);
  ern_cl_rows(&call, a->f);
  positions(&call, a);
  ern_cl_span(&call, a->table);
  ern_cl_value(&call, &plan.grid, sizeof plan.grid);
  ern_cl_size(&call, a->n);
  return ern_cl_run(&call, plan.groups, plan.group);
}

static ern_status bwd_table(struct ern_stream *stream, const struct ern_grid_bwd_args *a, const struct plan *plan) {
  const bool atomics = !ern_cl_backend_of(stream)->table.deterministic;
  struct ern_cl_call call =
      ern_cl_begin(stream, ERN_CL_hashgrid, atomics ? "grid_bwd_table_atomic" : "grid_bwd_table", plan->options);
  ERN_CL_ARGS(&call, a->dtable, a->df);
  positions(&call, &a->forward);
  ern_cl_value(&call, &plan->grid, sizeof plan->grid);
  ern_cl_size(&call, a->forward.n);
  return ern_cl_run(&call, atomics ? plan->groups : plan->table_groups, plan->group);
}

static ern_status bwd_x(struct ern_stream *stream, const struct ern_grid_bwd_args *a, const struct plan *plan) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_hashgrid, "grid_bwd_x", plan->options);
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) ern_cl_span(&call, d < a->forward.grid->dims ? a->dx[d] : (ern_span){0});
  ern_cl_rows(&call, a->df);
  positions(&call, &a->forward);
  ern_cl_span(&call, a->forward.table);
  ern_cl_value(&call, &plan->grid, sizeof plan->grid);
  ern_cl_size(&call, a->forward.n);
  return ern_cl_run(&call, plan->grid.blocks, plan->group);
}

ern_status ern_cl_grid_bwd(struct ern_stream *stream, struct ern_grid_bwd_args *a) {
  ern_status status = ERN_OK;
  if (a->forward.n == 0) return ERN_OK;
  const struct plan plan = plan_grid(stream, ERN_CL_SIZE_grid_bwd, a->forward.grid, a->forward.n);
  if (a->dtable.buffer != NULL) ERN_TRY(bwd_table(stream, a, &plan));
  if (a->dx[0].buffer != NULL) ERN_TRY(bwd_x(stream, a, &plan));
fail:
  return status;
}
