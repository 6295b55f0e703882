/* SPDX-License-Identifier: MIT
 * Slots of the occupancy grid. */
#include "backend_cpu/slots.h"
#include "render/occupancy_ops.h"

ERN_SHARDED_SLOT(occupancy_mark, ERN_OCCUPANCY_CELLS, 64) {
  kernels->occupancy_mark(reals(a->grid), a->views, a->view_count, a->bound, (uint32_t)r.begin, (uint32_t)r.end);
}
ern_status ERN_REF(ern_cpu_occupancy_list)(struct ern_stream *stream, struct ern_occupancy_list_args *a) {
  a->count = kernels_of(stream)->occupancy_list(int32s(a->cells), reals(a->grid), bytes(a->bits), a->turn);
  return ERN_OK;
}
ERN_SHARDED_SLOT(occupancy_points, a->n, 64) {
  kernels->occupancy_points(reals(a->x.span) + r.begin, a->x.stride, int32s(a->cells) + r.begin, a->bound, a->seed,
                            a->step, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_occupancy_scatter)(struct ern_stream *stream, struct ern_occupancy_scatter_args *a) {
  (void)stream;
  ern_real *fresh = reals(a->fresh);
  const int32_t *cells = int32s(a->cells);
  const ern_real *sigma = reals(a->sigma);
  for (size_t i = 0; i < a->n; i++) fresh[cells[i]] = sigma[i];
  return ERN_OK;
}

struct occupancy_job {
  const struct ern_cpu_kernels *kernels;
  const struct ern_occupancy_update_args *args;
  double sum[ERN_SHARDS];
  float threshold;
};
static void occupancy_update_task(void *user, size_t k, int worker) {
  (void)worker;
  struct occupancy_job *job = user;
  const struct range r = shard(ERN_OCCUPANCY_CELLS, 64, k);
  job->kernels->occupancy_update(reals(job->args->grid), &job->sum[k], reals(job->args->fresh), bytes(job->args->bits),
                                 &job->args->decay, (uint32_t)r.begin, (uint32_t)r.end);
}
static void occupancy_pack_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct occupancy_job *job = user;
  const struct range r = shard(ERN_OCCUPANCY_BYTES, 64, k);
  job->kernels->occupancy_pack(bytes(job->args->bits), reals(job->args->grid), job->threshold, (uint32_t)r.begin,
                               (uint32_t)r.end);
}
ern_status ERN_REF(ern_cpu_occupancy_update)(struct ern_stream *stream, struct ern_occupancy_update_args *a) {
  struct occupancy_job job = {.kernels = kernels_of(stream), .args = a};
  ern_pool_run(pool_of(stream), ERN_SHARDS, occupancy_update_task, &job);
  double sum = 0;
  for (int k = 0; k < ERN_SHARDS; k++) sum += job.sum[k];
  a->mean = sum / ERN_OCCUPANCY_CELLS;
  job.threshold = a->mean < (double)a->limit ? (float)a->mean : a->limit;
  ern_pool_run(pool_of(stream), ERN_SHARDS, occupancy_pack_task, &job);
  return ERN_OK;
}
