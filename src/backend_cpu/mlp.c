/* SPDX-License-Identifier: MIT
 * Slots of the field: grids, MLPs, encodings, audio, region attention. */
#include "backend_cpu/slots.h"
#include "mlp/mlp.h"

/* ---- grids ------------------------------------------------------------------------------------------------------- */

static void grid_pointers(const ern_real *out[ERN_GRID_MAX_DIMS], const ern_span *in, int dims, size_t begin) {
  for (int d = 0; d < ERN_GRID_MAX_DIMS; d++) out[d] = d < dims ? after(reals(in[d]), begin) : NULL;
}

static void grid_fwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_grid_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  const ern_real *x[ERN_GRID_MAX_DIMS];
  grid_pointers(x, a->x, a->grid->dims, r.begin);
  job->kernels->grid_fwd(reals(a->f.span) + r.begin, a->f.stride, x, reals(a->table), a->grid, 0, a->grid->levels,
                         r.end - r.begin);
}
static ern_status grid_fwd(struct ern_stream *stream, struct ern_grid_args *a) {
  run(stream, a, ERN_SHARDS, grid_fwd_task);
  return ERN_OK;
}

/* The table's gradient: a task a level. */
static void grid_bwd_table_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_grid_bwd_args *a = job->args;
  const ern_real *x[ERN_GRID_MAX_DIMS];
  ern_real *none[ERN_GRID_MAX_DIMS] = {NULL};
  grid_pointers(x, a->forward.x, a->forward.grid->dims, 0);
  job->kernels->grid_bwd(reals(a->dtable), none, reals(a->df.span), a->df.stride, x, reals(a->forward.table),
                         a->forward.grid, (int)k, (int)k + 1, a->forward.n);
}
/* The coordinates' gradient: a task a shard of samples. */
static void grid_bwd_x_task(void *user, size_t k, int lane) {
  (void)lane;
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
static ern_status grid_bwd(struct ern_stream *stream, struct ern_grid_bwd_args *a) {
  if (a->dtable.buffer != NULL) run(stream, a, (size_t)a->forward.grid->levels, grid_bwd_table_task);
  if (a->dx[0].buffer != NULL) run(stream, a, ERN_SHARDS, grid_bwd_x_task);
  return ERN_OK;
}

/* ---- MLPs -------------------------------------------------------------------------------------------------------- */

static struct ern_rows_view view_of(ern_rows rows, size_t begin) {
  return (struct ern_rows_view){after(reals(rows.span), rows.per == ERN_PER_SAMPLE ? begin : 0), rows.stride, rows.rows,
                                rows.per};
}

static void mlp_fwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_mlp_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  struct ern_rows_view x[ERN_MAX_PIECES];
  for (int p = 0; p < a->pieces; p++) x[p] = view_of(a->x[p], r.begin);
  const int32_t *ray = int32s(a->ray);
  if (r.begin < r.end)
    job->kernels->mlp_fwd(reals(a->y.span) + r.begin, a->y.stride, x, a->pieces, ray != NULL ? ray + r.begin : NULL,
                          reals(a->parameters), &a->mlp, r.end - r.begin, job->block + k * job->block_stride);
}
static ern_status mlp_fwd(struct ern_stream *stream, struct ern_mlp_args *a) {
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
  struct ern_mlp mlp; /* the weights counted from the start of the block */
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

static void mlp_bwd_task(void *user, size_t k, int lane) {
  (void)lane;
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
static ern_status mlp_bwd(struct ern_stream *stream, struct ern_mlp_bwd_args *a) {
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

static void activate_fwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_activate_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  for (size_t c = 0; c < (size_t)a->y.rows; c++)
    job->kernels->activate_fwd(reals(a->y.span) + c * a->y.stride + r.begin,
                               reals(a->x.span) + c * a->x.stride + r.begin, a->kind, r.end - r.begin);
}
static ern_status activate_fwd(struct ern_stream *stream, struct ern_activate_args *a) {
  run(stream, a, ERN_SHARDS, activate_fwd_task);
  return ERN_OK;
}
static void activate_bwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_activate_bwd_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  for (size_t c = 0; c < (size_t)a->dx.rows; c++)
    job->kernels->activate_bwd(reals(a->dx.span) + c * a->dx.stride + r.begin,
                               reals(a->dy.span) + c * a->dy.stride + r.begin,
                               reals(a->x.span) + c * a->x.stride + r.begin, a->kind, r.end - r.begin);
}
static ern_status activate_bwd(struct ern_stream *stream, struct ern_activate_bwd_args *a) {
  run(stream, a, ERN_SHARDS, activate_bwd_task);
  return ERN_OK;
}

static void sh_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_sh_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->sh_fwd(reals(a->y.span) + r.begin, a->y.stride, reals(a->d.span) + r.begin, a->d.stride,
                       r.end - r.begin);
}
static ern_status sh_fwd(struct ern_stream *stream, struct ern_sh_args *a) {
  run(stream, a, ERN_SHARDS, sh_task);
  return ERN_OK;
}

static void freq_fwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_freq_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->freq_fwd(reals(a->y.span) + r.begin, a->y.stride, reals(a->x.span) + r.begin, a->x.stride, a->x.rows,
                         a->octaves, r.end - r.begin);
}
static ern_status freq_fwd(struct ern_stream *stream, struct ern_freq_args *a) {
  run(stream, a, ERN_SHARDS, freq_fwd_task);
  return ERN_OK;
}
static ern_status freq_bwd(struct ern_stream *stream, struct ern_freq_bwd_args *a) {
  kernels_of(stream)->freq_bwd(reals(a->dx.span), a->dx.stride, reals(a->dy.span), a->dy.stride, reals(a->x.span),
                               a->x.stride, a->x.rows, a->octaves, a->n);
  return ERN_OK;
}

/* ---- audio and attention ----------------------------------------------------------------------------------------- */

static ern_status audio_fwd(struct ern_stream *stream, struct ern_audio_args *a) {
  kernels_of(stream)->audio_fwd(reals(a->code), reals(a->windows), reals(a->parameters), &a->net);
  return ERN_OK;
}
static ern_status audio_bwd(struct ern_stream *stream, struct ern_audio_bwd_args *a) {
  kernels_of(stream)->audio_bwd(reals(a->dparameters), reals(a->dcode), reals(a->forward.windows),
                                reals(a->forward.parameters), &a->forward.net);
  return ERN_OK;
}
static void audio_window_task(void *user, size_t t, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_audio_frame_args *a = job->args;
  const struct ern_audio_net *net = &a->audio.net;
  if ((a->known >> t & 1) != 0) return;
  job->kernels->audio_window(reals(a->codes) + t * (size_t)net->code,
                             reals(a->audio.windows) + t * (size_t)net->window_length * (size_t)net->width,
                             reals(a->audio.parameters), net);
}
static ern_status audio_frame(struct ern_stream *stream, struct ern_audio_frame_args *a) {
  run(stream, a, ERN_AUDIO_WINDOWS, audio_window_task);
  kernels_of(stream)->audio_mix(reals(a->audio.code), reals(a->codes), reals(a->audio.parameters), &a->audio.net);
  return ERN_OK;
}

static struct ern_attention_shape shape_of(const struct ern_attention_args *a) {
  return (struct ern_attention_shape){a->region.rows, a->v.rows};
}

static void attention_fwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_attention_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->attention_fwd(after(reals(a->region.span), r.begin), after(reals(a->norm), r.begin),
                              after(reals(a->region_eye), r.begin), after(reals(a->v.span), r.begin), reals(a->code),
                              after(reals(a->eye_attention), r.begin), a->eye, shape_of(a), a->v.stride,
                              r.end - r.begin);
}
static ern_status attention_fwd(struct ern_stream *stream, struct ern_attention_args *a) {
  run(stream, a, ERN_SHARDS, attention_fwd_task);
  return ERN_OK;
}
static void attention_bwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_attention_bwd_args *a = job->args;
  const struct range r = shard(a->forward.n, 64, k);
  ern_real *dcode = a->dcode.buffer != NULL ? job->block + k * job->block_stride : NULL;
  job->kernels->attention_bwd(after(reals(a->dv.span), r.begin), dcode, after(reals(a->deye_attention), r.begin),
                              after(reals(a->dregion.span), r.begin), after(reals(a->dnorm), r.begin),
                              after(reals(a->dregion_eye), r.begin), after(reals(a->forward.v.span), r.begin),
                              after(reals(a->forward.norm), r.begin), reals(a->forward.code), a->forward.eye,
                              shape_of(&a->forward), a->forward.v.stride, r.end - r.begin);
}
static ern_status attention_bwd(struct ern_stream *stream, struct ern_attention_bwd_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const size_t channels = (size_t)a->forward.region.rows;
  struct job job = {
      .stream = stream, .kernels = kernels_of(stream), .args = a, .block_stride = (channels + 15) / 16 * 16};
  const ern_status status = take_blocks(stream, job.block_stride, &job.block);
  if (status == ERN_OK) {
    memset(job.block, 0, job.block_stride * ERN_SHARDS * sizeof *job.block);
    ern_pool_run(pool_of(stream), ERN_SHARDS, attention_bwd_task, &job);
    ern_real *dcode = reals(a->dcode);
    for (size_t k = 0; dcode != NULL && k < ERN_SHARDS; k++)
      for (size_t c = 0; c < channels; c++) dcode[c] += job.block[k * job.block_stride + c];
  }
  ern_arena_release(stream, mark);
  return status;
}

void ERN_REF(ern_cpu_fill_field)(struct ern_backend *backend) {
  backend->grid_fwd = grid_fwd;
  backend->grid_bwd = grid_bwd;
  backend->mlp_fwd = mlp_fwd;
  backend->mlp_bwd = mlp_bwd;
  backend->activate_fwd = activate_fwd;
  backend->activate_bwd = activate_bwd;
  backend->sh_fwd = sh_fwd;
  backend->freq_fwd = freq_fwd;
  backend->freq_bwd = freq_bwd;
  backend->audio_fwd = audio_fwd;
  backend->audio_bwd = audio_bwd;
  backend->audio_frame = audio_frame;
  backend->attention_fwd = attention_fwd;
  backend->attention_bwd = attention_bwd;
}
