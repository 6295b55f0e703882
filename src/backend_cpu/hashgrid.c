/* SPDX-License-Identifier: MIT
 * Slots of the grids. */
#include "backend_cpu/slots.h"
#include "hashgrid/hashgrid_ops.h"

static void grid_pointers(const ern_real *out[ERN_GRID_MAX_DIMS], const ern_span *in, int dims, size_t begin) {
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) out[d] = d < dims ? after(reals(in[d]), begin) : NULL;
}

ERN_SHARDED_SLOT(grid_fwd, a->n, 64) {
  const ern_real *x[ERN_GRID_MAX_DIMS];
  grid_pointers(x, a->x, a->grid->dims, r.begin);
  kernels->grid_fwd(reals(a->f.span) + r.begin, a->f.stride, x, reals(a->table), a->grid, 0, a->grid->levels,
                    r.end - r.begin);
}

/* The table's gradient: one task for each level. */
static void grid_bwd_table_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct job *job = user;
  const struct ern_grid_bwd_args *a = job->args;
  const ern_real *x[ERN_GRID_MAX_DIMS];
  ern_real *none[ERN_GRID_MAX_DIMS] = {NULL};
  grid_pointers(x, a->forward.x, a->forward.grid->dims, 0);
  job->kernels->grid_bwd(reals(a->dtable), none, reals(a->df.span), a->df.stride, x, reals(a->forward.table),
                         a->forward.grid, (int)k, (int)k + 1, a->forward.n);
}
/* The coordinates' gradient: one task for each shard of samples. */
static void grid_bwd_x_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct job *job = user;
  const struct ern_grid_bwd_args *a = job->args;
  const struct range r = shard(a->forward.n, 64, k);
  const ern_real *x[ERN_GRID_MAX_DIMS];
  ern_real *dx[ERN_GRID_MAX_DIMS];
  grid_pointers(x, a->forward.x, a->forward.grid->dims, r.begin);
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) dx[d] = after(reals(a->dx[d]), r.begin);
  job->kernels->grid_bwd(NULL, dx, reals(a->df.span) + r.begin, a->df.stride, x, reals(a->forward.table),
                         a->forward.grid, 0, a->forward.grid->levels, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_grid_bwd)(struct ern_stream *stream, struct ern_grid_bwd_args *a) {
  if (a->dtable.buffer != NULL) run(stream, a, (size_t)a->forward.grid->levels, grid_bwd_table_task);
  if (a->dx[0].buffer != NULL) run(stream, a, ERN_SHARDS, grid_bwd_x_task);
  return ERN_OK;
}
