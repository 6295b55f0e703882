/* SPDX-License-Identifier: MIT
 * Slots of the fully connected stacks. */
#include "backend_cpu/slots.h"
#include "mlp/mlp_tile.h"

static struct ern_rows_view view_of(ern_rows rows, size_t begin) {
  return (struct ern_rows_view){after(reals(rows.span), rows.per == ERN_PER_SAMPLE ? begin : 0), rows.stride, rows.rows,
                                rows.per};
}

static void mlp_fwd_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct job *job = user;
  const struct ern_mlp_fwd_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  struct ern_rows_view x[ERN_MAX_PIECES];
  for (int p = 0; p < a->pieces; p++) x[p] = view_of(a->x[p], r.begin);
  const int32_t *ray = int32s(a->ray);
  if (r.begin < r.end)
    job->kernels->mlp_fwd(reals(a->y.span) + r.begin, a->y.stride, x, a->pieces, ray != NULL ? ray + r.begin : NULL,
                          reals(a->parameters), &a->mlp, r.end - r.begin, job->block + k * job->block_stride);
}
ern_status ERN_REF(ern_cpu_mlp_fwd)(struct ern_stream *stream, struct ern_mlp_fwd_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct job job = {.stream = stream, .kernels = kernels_of(stream), .args = a};
  job.block_stride = (ern_mlp_scratch(&a->mlp) + 15) / 16 * 16;
  const ern_status status = take_blocks(stream, job.block_stride, &job.block);
  if (status == ERN_OK) ern_pool_run(pool_of(stream), ERN_SHARDS, mlp_fwd_task, &job);
  ern_arena_release(stream, mark);
  return status;
}

/* A shard's block: the weights' gradient, then that of each PER_BATCH piece, then the kernel's scratch. */
struct mlp_block {
  struct ern_mlp mlp; /* weight offsets from the start of the block */
  size_t first, weights, piece[ERN_MAX_PIECES], sums, stride;
};

static struct mlp_block mlp_block(const struct ern_mlp_bwd_args *a) {
  const struct ern_mlp *mlp = &a->forward.mlp;
  struct mlp_block block = {.mlp = *mlp, .first = mlp->weight[0]};
  const int last = mlp->layers - 1;
  block.weights = mlp->weight[last] + (size_t)mlp->width[last] * (size_t)mlp->width[last + 1] - block.first;
  for (int l = 0; l < mlp->layers; l++) block.mlp.weight[l] -= block.first;
  block.sums = block.weights;
  for (int p = 0; p < a->forward.pieces; p++) {
    block.piece[p] = block.sums;
    if (a->forward.x[p].per == ERN_PER_BATCH) block.sums += (size_t)a->forward.x[p].rows;
  }
  block.stride = (block.sums + 15) / 16 * 16 + (ern_mlp_scratch(mlp) + 15) / 16 * 16;
  return block;
}

static void mlp_bwd_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct job *job = user;
  const struct ern_mlp_bwd_args *a = job->args;
  const struct mlp_block block = mlp_block(a);
  const struct range r = shard(a->forward.n, 64, k);
  ern_real *sums = job->block + k * job->block_stride;
  memset(sums, 0, block.sums * sizeof *sums);
  if (r.begin == r.end) return;
  struct ern_rows_view x[ERN_MAX_PIECES], dx[ERN_MAX_PIECES];
  for (int p = 0; p < a->forward.pieces; p++) {
    x[p] = view_of(a->forward.x[p], r.begin);
    dx[p] = view_of(a->dx[p], r.begin);
    dx[p].per = x[p].per;
    if (x[p].per == ERN_PER_BATCH && dx[p].data != NULL) {
      dx[p].data = sums + block.piece[p];
      dx[p].stride = 1;
    }
  }
  const int32_t *ray = int32s(a->forward.ray);
  job->kernels->mlp_bwd(dx, sums, reals(a->dy.span) + r.begin, a->dy.stride, x, a->forward.pieces,
                        ray != NULL ? ray + r.begin : NULL, reals(a->forward.parameters) + block.first, &block.mlp,
                        r.end - r.begin, sums + (block.sums + 15) / 16 * 16);
}
ern_status ERN_REF(ern_cpu_mlp_bwd)(struct ern_stream *stream, struct ern_mlp_bwd_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const struct mlp_block block = mlp_block(a);
  struct job job = {.stream = stream, .kernels = kernels_of(stream), .args = a, .block_stride = block.stride};
  const ern_status status = take_blocks(stream, block.stride, &job.block);
  if (status == ERN_OK) {
    ern_pool_run(pool_of(stream), ERN_SHARDS, mlp_bwd_task, &job);
    ern_real *dweights = reals(a->dparameters) + block.first;
    for (size_t k = 0; k < ERN_SHARDS; k++) {
      const ern_real *sums = job.block + k * block.stride;
      for (size_t i = 0; i < block.weights; i++) dweights[i] += sums[i];
      for (int p = 0; p < a->forward.pieces; p++) {
        ern_real *dx = reals(a->dx[p].span);
        if (a->forward.x[p].per != ERN_PER_BATCH || dx == NULL) continue;
        for (size_t i = 0; i < (size_t)a->forward.x[p].rows; i++) dx[i * a->dx[p].stride] += sums[block.piece[p] + i];
      }
    }
  }
  ern_arena_release(stream, mark);
  return status;
}
