/* SPDX-License-Identifier: MIT
 * The forward pass of a fused training step, up to compositing.
 *
 * A ray's samples are evaluated one by one or a few at a time, and none after its transmittance falls below the stop:
 * they would contribute nothing and have no gradient. The contributing ("live") samples are stored contiguously, so
 * that later passes process only these. */
#include <math.h>

#include "backend_cpu/fused/step_pass.h"

enum {
  FULL = 2 * ERN_MLP_TILE, /* smaller batches waste much of a tile */
  MOST = 16                /* most samples of a ray in a batch */
};

/* ---- grids ------------------------------------------------------------------------------------------------------- */

static void unhash_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct ern_train_step *s = user;
  const size_t levels = (size_t)s->field->config.levels, p = k / levels;
  const struct ern_grid_level *level = &s->field->encoder.grid[p].level[k % levels];
  const struct ern_dense_level *to = &s->grids.level[p][k % levels];
  const float *entries = s->parameters + s->field->encoder.table[p] + level->offset;
  if (to->value != entries) s->train->unhash((float *)to->value, entries, level);
}

/* Levels that are dense already are read in place. */
ern_status ern_train_unhash(struct ern_train_step *s) {
  const struct ern_field *field = s->field;
  const int levels = field->config.levels;
  size_t floats = 64;
  float *next = NULL;
  for (int p = 0; p < ERN_PLANES; p++) {
    for (int l = 0; l < levels; l++) {
      const size_t side = (size_t)field->encoder.grid[p].level[l].resolution + 1;
      floats += side * side + ERN_NET_ALIGNED;
    }
  }
  const ern_status status =
      ern_train_workspace_take((struct ern_cpu_stream *)s->stream, ERN_TRAIN_GRIDS, floats, &next);
  if (status != ERN_OK) return status;
  s->grids.levels = levels;
  s->grids.bound = field->config.bound;
  for (int p = 0; p < ERN_PLANES; p++) {
    memcpy(s->grids.axis[p], field->encoder.axis[p], sizeof s->grids.axis[p]);
    for (int l = 0; l < levels; l++) {
      const struct ern_grid_level *level = &field->encoder.grid[p].level[l];
      const uint32_t side = level->resolution + 1;
      const bool dense = (uint64_t)side * side <= level->size;
      const float *value = s->parameters + field->encoder.table[p] + level->offset;
      if (!dense) value = ern_train_cut(&next, (size_t)side * side + ERN_NET_ALIGNED);
      s->grids.level[p][l] = (struct ern_dense_level){level->scale, side, value};
    }
  }
  s->net.grids = &s->grids;
  ern_pool_run(pool_of(s->stream), ERN_PLANES * (size_t)levels, unhash_task, s);
  return ERN_OK;
}

/* ---- samples in batches ------------------------------------------------------------------------------------------ */

/* The queue of a shard's unfinished rays, oldest first. */
struct waiting {
  const int32_t *first;  /* of the shard's first ray */
  int32_t *queue, *done; /* [rays] ring buffer; samples evaluated, by ray */
  int32_t *live;         /* live samples, by ray */
  float *light;          /* transmittance, by ray */
  size_t rays, head, length;
};

static struct waiting waiting_make(const struct ern_train_step *s, struct ern_train_worker *worker, struct range r) {
  int32_t *queues = (int32_t *)(void *)worker->by_ray;
  struct waiting w = {.first = int32s(s->marched.first) + r.begin,
                      .queue = queues,
                      .done = queues + s->shard_rays,
                      .live = s->live + r.begin,
                      .light = (float *)(void *)(queues + 2 * s->shard_rays),
                      .rays = r.end - r.begin};
  for (size_t i = 0; i < w.rays; i++) {
    w.done[i] = w.live[i] = 0;
    w.light[i] = 1;
    if (w.first[i + 1] > w.first[i]) w.queue[w.length++] = (int32_t)i;
  }
  return w;
}

/* The number of samples that a ray adds to the next batch: one, as the ray may end after it; more where few rays are
 * left. */
static int32_t share_of(const struct ern_train_step *s, const struct waiting *w) {
  const size_t share = w->length > 0 ? (FULL + w->length - 1) / w->length : 1;
  return share > MOST || s->everything ? MOST : (int32_t)share;
}

/* Collects the next samples of the rays that have waited longest; *groups: rays. Returns the number of samples. */
static size_t collect(const struct ern_train_step *s, struct ern_train_worker *worker, struct waiting *w,
                      size_t *groups) {
  const float *x = reals(s->marched.x.span);
  const size_t x_stride = s->marched.x.stride;
  const int32_t share = share_of(s, w);
  size_t count = 0;
  for (*groups = 0; w->length > 0 && count < ERN_TRAIN_BATCH; ++*groups) {
    const int32_t ray = w->queue[w->head], begin = w->first[ray] + w->done[ray];
    int32_t take = w->first[ray + 1] - begin;
    if (take > share) take = share;
    if ((size_t)take > ERN_TRAIN_BATCH - count) take = (int32_t)(ERN_TRAIN_BATCH - count);
    worker->group[*groups] = (struct ern_train_group){ray, take};
    w->head = w->head + 1 < w->rays ? w->head + 1 : 0;
    w->length--;
    for (int32_t sample = begin; sample < begin + take; sample++, count++) {
      worker->sample[count] = sample;
      for (size_t axis = 0; axis < 3; axis++) worker->x[axis][count] = x[axis * x_stride + (size_t)sample];
    }
  }
  return count;
}

/* Updates the transmittance by the samples of the batch; rays with transmittance and samples left are queued again.
 * Returns the number of live samples. The margin makes sure that compositing, which recomputes the sum, needs no sample
 * that was left out. */
static size_t update_transmittance(const struct ern_train_step *s, struct ern_train_worker *worker, struct waiting *w,
                                   size_t groups) {
  const float *dt = reals(s->marched.dt), spent = s->stop * 0.999f;
  size_t at = 0, live = 0;
  for (size_t g = 0; g < groups; g++) {
    const int32_t ray = worker->group[g].ray;
    float light = w->light[ray];
    for (int32_t i = 0; i < worker->group[g].count; i++, at++) {
      if (light < spent) continue;
      w->live[ray]++;
      worker->live[live] = worker->sample[at];
      worker->place[live++] = (int32_t)at;
      light *= expf(-worker->sigma[at] * dt[worker->sample[at]]);
    }
    w->light[ray] = light;
    w->done[ray] += worker->group[g].count;
    if (w->first[ray] + w->done[ray] == w->first[ray + 1] || (light < spent && !s->everything)) continue;
    const size_t end = w->head + w->length++;
    w->queue[end < w->rays ? end : end - w->rays] = ray;
  }
  return live;
}

static void put(float *values, const float *batch, const int32_t *sample, size_t count) {
  for (size_t i = 0; i < count; i++) values[sample[i]] = batch[i];
}

static void look_at(const struct ern_train_step *s, struct ern_train_worker *worker, struct waiting *w) {
  size_t groups;
  const size_t count = collect(s, worker, w, &groups);
  const struct ern_train_density_args density = {.list = {worker->sample, count},
                                                 .x = worker->x[0],
                                                 .x_stride = ERN_TRAIN_BATCH,
                                                 .feature_rows = s->feature_rows,
                                                 .sigma = worker->sigma,
                                                 .norm = worker->norm,
                                                 .eye = s->net.eye ? worker->eye : NULL,
                                                 .hidden = worker->hidden};
  s->train->density(&s->net, &worker->tile, &density);
  put(s->sigma, worker->sigma, worker->sample, count);
  put(s->norm, worker->norm, worker->sample, count);
  if (s->net.eye) put(s->eye, worker->eye, worker->sample, count);

  const size_t live = update_transmittance(s, worker, w, groups);
  const struct ern_train_colour_args colour = {.list = {worker->live, live},
                                               .place = worker->place,
                                               .ray = int32s(s->marched.ray),
                                               .hidden = worker->hidden,
                                               .harmonics = s->net.harmonics > 0 ? reals(s->marched.sh.span) : NULL,
                                               .sh_stride = s->marched.sh.stride,
                                               .rgb = worker->rgb,
                                               .stride = ERN_TRAIN_BATCH};
  s->train->colour(&s->net, &worker->tile, &colour);
  for (size_t c = 0; c < 3; c++) put(s->rgb + c * s->stride, worker->rgb + c * ERN_TRAIN_BATCH, worker->live, live);
  const struct ern_train_list looked_at = {s->everything ? worker->sample : worker->live, s->everything ? count : live};
  const struct ern_train_uncertainty_args uncertainty = {looked_at, s->feature_rows, worker->unc};
  s->train->uncertainty(&s->net, &worker->tile, &uncertainty);
  put(s->unc, worker->unc, looked_at.index, looked_at.count);

  worker->profile.count[ERN_PROFILE_SAMPLES] += count;
  worker->profile.count[ERN_PROFILE_COLOURS] += live;
}

static void forward_task(void *user, size_t k, int number) {
  const struct ern_train_step *s = user;
  struct ern_train_worker *worker = ern_train_worker_of(s, number);
  const struct range r = shard(s->rays, 64, k);
  struct waiting w = waiting_make(s, worker, r);
  const double began = ern_profile_now();
  worker->tile.encoding = 0;
  while (w.length > 0) look_at(s, worker, &w);
  worker->profile.seconds[ERN_PROFILE_ENCODE] += worker->tile.encoding;
  worker->profile.seconds[ERN_PROFILE_FORWARD] += ern_profile_now() - began - worker->tile.encoding;
}

/* ---- those that count -------------------------------------------------------------------------------------------- */

enum { LIVE_ROWS = 10 + 3 * 3 + 2 };

/* Numbers the live samples and takes memory for them. */
static ern_status take_live(struct ern_train_step *s) {
  size_t total = 0;
  float *next = NULL;
  for (size_t i = 0; i < s->rays; i++) total += (size_t)s->live[i];
  s->count = total;
  const size_t stride = s->live_stride = ern_train_padded(total), rays = (s->rays + 64) / 64 * 64;
  const size_t floats = LIVE_ROWS * stride + rays;
  const ern_status status = ern_train_workspace_take((struct ern_cpu_stream *)s->stream, ERN_TRAIN_LIVE, floats, &next);
  if (status != ERN_OK) return status;
  s->reals = (struct ern_buffer){ERN_ELEMENT_REAL, floats, next};
  s->ints = (struct ern_buffer){ERN_ELEMENT_INT32, floats, next};
  s->first = (ern_span){&s->ints, 0, s->rays + 1};
  int32_t *first = (int32_t *)(void *)ern_train_cut(&next, rays);
  float **const rows[] = {&s->live_dt,  &s->live_depth, &s->live_sigma, &s->live_norm, &s->live_eye,
                          &s->live_unc, &s->dsigma,     &s->dnorm,      &s->deye,      &s->dunc};
  float **const triples[] = {&s->live_x, &s->live_rgb, &s->drgb};
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) *rows[i] = ern_train_cut(&next, stride);
  for (size_t i = 0; i < sizeof triples / sizeof *triples; i++) *triples[i] = ern_train_cut(&next, 3 * stride);
  s->live_ray = (int32_t *)(void *)ern_train_cut(&next, stride);
  s->live_sample = (int32_t *)(void *)ern_train_cut(&next, stride);
  first[0] = 0;
  for (size_t i = 0; i < s->rays; i++) first[i + 1] = first[i] + s->live[i];
  return ERN_OK;
}

/* Copies the live samples of a shard's rays to their contiguous place. */
static void gather_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct ern_train_step *s = user;
  const struct range r = shard(s->rays, 64, k);
  const int32_t *marched = int32s(s->marched.first), *first = int32s(s->first);
  const float *x = reals(s->marched.x.span), *dt = reals(s->marched.dt), *depth = reals(s->marched.depth);
  const size_t x_stride = s->marched.x.stride;
  for (size_t ray = r.begin; ray < r.end; ray++) {
    size_t to = (size_t)first[ray];
    for (size_t from = (size_t)marched[ray]; to < (size_t)first[ray + 1]; from++, to++) {
      s->live_ray[to] = (int32_t)ray;
      s->live_sample[to] = (int32_t)from;
      s->live_dt[to] = dt[from];
      s->live_depth[to] = depth[from];
      s->live_sigma[to] = s->sigma[from];
      s->live_norm[to] = s->norm[from];
      if (s->net.eye) s->live_eye[to] = s->eye[from];
      s->live_unc[to] = s->unc[from];
      for (size_t c = 0; c < 3; c++) {
        s->live_x[c * s->live_stride + to] = x[c * x_stride + from];
        s->live_rgb[c * s->live_stride + to] = s->rgb[c * s->stride + from];
      }
    }
  }
}

ern_status ern_train_forward(struct ern_train_step *s) {
  ern_pool_run(pool_of(s->stream), ERN_SHARDS, forward_task, s);
  const ern_status status = take_live(s);
  if (status == ERN_OK) ern_pool_run(pool_of(s->stream), ERN_SHARDS, gather_task, s);
  return status;
}
