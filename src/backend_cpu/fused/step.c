/* SPDX-License-Identifier: MIT
 * The fused training step of the head: forward (step_forward.c), compositing and losses by their slots, backward with
 * recomputed hidden values, and the tables' gradients level by level. train/step.c does the same in separate stages.
 *
 * Sums over samples are computed in ERN_SHARDS blocks, whose bounds depend only on the number of samples, and added in
 * order. */
#include "backend_cpu/fused/step.h"

#include "backend_cpu/fused/step_pass.h"
#include "core/memory.h"
#include "render/composite_ops.h"
#include "render/render_ops.h"
#include "train/losses_ops.h"
#include "train/step.h"
#include "train/step_ops.h"

/* By ray. */
struct rays {
  ern_rows pixel, colour, dpixel;               /* [3] */
  ern_rows opacity, depth, attention, eye, unc; /* [1] */
  ern_rows dopacity, dattention, deye, dunc;
};

static ern_status rays_take(struct ern_stream *stream, size_t n, struct rays *rays) {
  ern_rows *const colours[] = {&rays->pixel, &rays->colour, &rays->dpixel};
  ern_rows *const values[] = {&rays->opacity,  &rays->depth,      &rays->attention, &rays->eye, &rays->unc,
                              &rays->dopacity, &rays->dattention, &rays->deye,      &rays->dunc};
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof colours / sizeof *colours && status == ERN_OK; i++)
    status = ern_scratch_take_rows(stream, 3, n, colours[i]);
  for (size_t i = 0; i < sizeof values / sizeof *values && status == ERN_OK; i++)
    status = ern_scratch_take_rows(stream, 1, n, values[i]);
  return status;
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

static struct ern_train_step step_of(struct ern_stream *stream, const struct ern_field *field, ern_span parameters,
                                     bool bf16) {
  const struct ern_cpu_backend *backend = (const struct ern_cpu_backend *)stream->backend;
  return (struct ern_train_step){.stream = stream,
                                 .kernels = kernels_of(stream),
                                 .train = bf16 ? backend->train_pairs : backend->train,
                                 .field = field,
                                 .parameters = reals(parameters)};
}

/* Takes memory for the weights as floats and as pairs, the shards' gradients, and each thread's worker. */
static ern_status take_threads(struct ern_train_step *s, float **weights) {
  struct ern_cpu_stream *stream = (struct ern_cpu_stream *)s->stream;
  const size_t workers = (size_t)ern_pool_threads(stream->pool);
  float *next = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ern_train_workspace_take(stream, ERN_TRAIN_NET, 2 * s->net.count + ERN_SHARDS * s->net.forward, &next));
  *weights = ern_train_cut(&next, 2 * s->net.count);
  s->gradient = next;
  for (size_t k = 0; k < ERN_SHARDS; k++) {
    const struct range r = shard(s->rays, 64, k);
    if (r.end - r.begin > s->shard_rays) s->shard_rays = r.end - r.begin;
  }
  const size_t worker_floats = ern_train_worker_floats(s->shard_rays);
  ERN_TRY(ern_train_workspace_take(stream, ERN_TRAIN_WORKERS, workers * worker_floats, &next));
  s->workers = (char *)next;
  s->worker_bytes = worker_floats * sizeof(float);
  for (size_t worker = 0; worker < workers; worker++)
    ern_train_worker_of(s, (int)worker)->profile = (struct ern_profile){.timed = true};
fail:
  return status;
}

/* weights: [2*net.count] */
static void fill_net(struct ern_train_step *s, float *weights, const struct ern_train_fold *fold) {
  ern_train_net_fill(&s->net, weights, fold);
  if (s->train->pair_weights == NULL) return;
  float *factors = weights + s->net.count;
  s->train->pair_weights(&s->net, factors);
  s->net.factors = factors;
}

/* Takes memory for the values of each marched sample. */
static ern_status take_marched(struct ern_train_step *s) {
  float *next = NULL;
  s->stride = ern_train_padded(s->marched.total);
  const size_t rays = (s->rays + 63) / 64 * 64, floats = s->stride * (s->net.feature_row + 7) + rays;
  const ern_status status =
      ern_train_workspace_take((struct ern_cpu_stream *)s->stream, ERN_TRAIN_MARCHED, floats, &next);
  if (status != ERN_OK) return status;
  s->feature_rows = ern_train_cut(&next, s->stride * s->net.feature_row);
  s->rgb = ern_train_cut(&next, 3 * s->stride);
  float **const rows[] = {&s->sigma, &s->norm, &s->eye, &s->unc};
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) *rows[i] = ern_train_cut(&next, s->stride);
  s->live = (int32_t *)(void *)next;
  return ERN_OK;
}

static ern_status take_gradients(struct ern_train_step *s, size_t stride) {
  return ern_train_workspace_take((struct ern_cpu_stream *)s->stream, ERN_TRAIN_DFEATURES, s->net.features * stride,
                                  &s->df);
}

static ern_span span_of(const struct ern_train_step *s, const float *values, size_t count) {
  return (ern_span){(struct ern_buffer *)&s->reals, (size_t)(values - (const float *)s->reals.memory), count};
}
static ern_rows rows_of(const struct ern_train_step *s, const float *values) {
  return (ern_rows){span_of(s, values, 3 * s->live_stride), s->live_stride, 3, ERN_PER_SAMPLE};
}

/* ---- losses ------------------------------------------------------------------------------------------------------ */

static struct ern_composite_fwd_args composite_args(const struct ern_head_step_args *a, const struct ern_train_step *s,
                                                    const struct rays *rays) {
  const bool eye = s->net.eye;
  return (struct ern_composite_fwd_args){.pixel = rays->pixel,
                                         .colour = rays->colour,
                                         .opacity = rays->opacity.span,
                                         .depth = rays->depth.span,
                                         .attention = rays->attention.span,
                                         .eye = eye ? rays->eye.span : (ern_span){0},
                                         .uncertainty = rays->unc.span,
                                         .first = s->first,
                                         .sigma = span_of(s, s->live_sigma, s->count),
                                         .dt = span_of(s, s->live_dt, s->count),
                                         .sample_depth = span_of(s, s->live_depth, s->count),
                                         .sample_attention = span_of(s, s->live_norm, s->count),
                                         .sample_eye = eye ? span_of(s, s->live_eye, s->count) : (ern_span){0},
                                         .sample_uncertainty = span_of(s, s->live_unc, s->count),
                                         .rgb = rows_of(s, s->live_rgb),
                                         .background = a->background,
                                         .transmittance_stop = a->transmittance_stop,
                                         .n = a->n};
}

static ern_status losses(struct ern_head_step_args *a, const struct ern_train_step *s, const struct rays *rays) {
  const struct ern_backend *backend = s->stream->backend;
  const bool eye = s->net.eye;
  struct ern_composite_fwd_args forward = composite_args(a, s, rays);
  struct ern_mse_args plain = {.dpixel = rays->dpixel, .pixel = rays->pixel, .truth = a->truth, .n = a->n};
  struct ern_head_loss_args loss = {.dpixel = rays->dpixel,
                                    .dopacity = rays->dopacity.span,
                                    .dattention = rays->dattention.span,
                                    .deye = eye ? rays->deye.span : (ern_span){0},
                                    .duncertainty = rays->dunc.span,
                                    .pixel = rays->pixel,
                                    .truth = a->truth,
                                    .opacity = rays->opacity.span,
                                    .attention = rays->attention.span,
                                    .eye = eye ? rays->eye.span : (ern_span){0},
                                    .uncertainty = rays->unc.span,
                                    .face = a->face,
                                    .weights = a->weights,
                                    .max_steps = a->settings->max_steps,
                                    .n = a->n};
  struct ern_patch_loss_args patches = ern_patches_of_step(a, rays->dpixel, rays->pixel);
  struct ern_composite_bwd_args backward = {.dsigma = span_of(s, s->dsigma, s->count),
                                            .drgb = rows_of(s, s->drgb),
                                            .dsample_attention = span_of(s, s->dnorm, s->count),
                                            .dsample_eye = eye ? span_of(s, s->deye, s->count) : (ern_span){0},
                                            .dsample_uncertainty = span_of(s, s->dunc, s->count),
                                            .dpixel = rays->dpixel,
                                            .dopacity = rays->dopacity.span,
                                            .dattention = rays->dattention.span,
                                            .deye = eye ? rays->deye.span : (ern_span){0},
                                            .duncertainty = rays->dunc.span,
                                            .forward = forward};
  ern_status status = ERN_OK;
  ERN_TRY(backend->composite_fwd(s->stream, &forward));
  ERN_TRY(backend->mse(s->stream, &plain));
  ERN_TRY(backend->head_loss(s->stream, &loss));
  ERN_TRY(ern_step_patch_loss(s->stream, a->patches.loss, &patches));
  ERN_TRY(backend->composite_bwd(s->stream, &backward));
  a->squared_error = plain.term;
  memcpy(a->terms, loss.terms, sizeof a->terms);
  a->terms[ERN_LOSS_PATCHES] = patches.term;
fail:
  return status;
}

/* ---- backward ---------------------------------------------------------------------------------------------------- */

static void backward_task(void *user, size_t k, int number) {
  const struct ern_train_step *s = user;
  struct ern_train_worker *worker = ern_train_worker_of(s, number);
  const struct range r = shard(s->count, ERN_MLP_TILE, k);
  const double began = ern_profile_now();
  const struct ern_train_backward_args args = {.list = {s->live_sample + r.begin, r.end - r.begin},
                                               .ray = s->live_ray + r.begin,
                                               .x = s->live_x + r.begin,
                                               .feature_rows = s->feature_rows,
                                               .harmonics = s->net.harmonics > 0 ? reals(s->marched.sh.span) : NULL,
                                               .dsigma = s->dsigma + r.begin,
                                               .drgb = s->drgb + r.begin,
                                               .dnorm = s->dnorm + r.begin,
                                               .deye = s->deye + r.begin,
                                               .dunc = s->dunc + r.begin,
                                               .gradient = s->gradient + k * s->net.forward,
                                               .df = s->df + r.begin,
                                               .dsh = s->dsh != NULL ? s->dsh + r.begin : NULL,
                                               .sh_stride = s->marched.sh.stride,
                                               .rgb_stride = s->live_stride,
                                               .stride = s->live_stride};
  memset(args.gradient, 0, s->net.forward * sizeof *args.gradient);
  s->train->backward(&s->net, &worker->tile, &args);
  worker->profile.seconds[ERN_PROFILE_BACKWARD] += ern_profile_now() - began;
}

struct pose {
  const struct ern_train_step *step;
  const struct ern_head_step_args *args;
  ern_rows dx, d, dd, weight; /* [3], [1] per live sample */
  double part[ERN_SHARDS][ERN_POSE_PARAMETERS];
};

/* Gradients of a shard's samples: through the tables to positions, through the harmonics to directions, and from both
 * to the camera pose. */
static void pose_task(void *user, size_t k, int number) {
  struct pose *pose = user;
  const struct ern_train_step *s = pose->step;
  struct ern_train_worker *worker = ern_train_worker_of(s, number);
  const struct range r = shard(s->count, ERN_MLP_TILE, k);
  const size_t stride = s->live_stride, n = r.end - r.begin, levels = (size_t)s->field->config.levels;
  float *dx = reals(pose->dx.span) + r.begin, *d = after(reals(pose->d.span), r.begin),
        *dd = after(reals(pose->dd.span), r.begin), *weight = after(reals(pose->weight.span), r.begin);
  const double began = ern_profile_now();
  for (size_t axis = 0; axis < 3; axis++) memset(dx + axis * pose->dx.stride, 0, n * sizeof *dx);
  for (size_t p = 0; p < ERN_PLANES; p++) {
    const size_t first = (size_t)s->field->encoder.axis[p][0], second = (size_t)s->field->encoder.axis[p][1];
    const float *const x[ERN_GRID_MAX_DIMS] = {s->live_x + first * stride + r.begin,
                                               s->live_x + second * stride + r.begin, NULL};
    float *const to[ERN_GRID_MAX_DIMS] = {dx + first * pose->dx.stride, dx + second * pose->dx.stride, NULL};
    s->kernels->grid_bwd(NULL, to, s->df + p * levels * stride + r.begin, stride, x,
                         s->parameters + s->field->encoder.table[p], &s->field->encoder.grid[p], 0, (int)levels, n);
  }
  if (dd != NULL) {
    s->kernels->spread_rays(d, pose->d.stride, reals(s->marched.dir.span), s->marched.dir.stride, s->live_ray + r.begin,
                            3, n);
    s->kernels->sh_bwd(dd, pose->dd.stride, s->dsh + r.begin, stride, d, pose->d.stride, n);
  }
  if (weight != NULL)
    s->kernels->spread_rays(weight, 0, reals(pose->args->dpose_weight), 0, s->live_ray + r.begin, 1, n);
  s->kernels->pose_bwd(pose->part[k], dx, pose->dx.stride, s->live_x + r.begin, stride, dd, pose->dd.stride, d,
                       pose->d.stride, weight, n);
  worker->profile.seconds[ERN_PROFILE_TABLES] += ern_profile_now() - began;
}

static ern_status add_pose(const struct ern_head_step_args *a, const struct ern_train_step *s) {
  const struct ern_arena_mark mark = ern_arena_mark(s->stream);
  struct pose pose = {.step = s, .args = a};
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take_rows(s->stream, 3, s->count, &pose.dx));
  if (a->dpose_weight.buffer != NULL) ERN_TRY(ern_scratch_take_rows(s->stream, 1, s->count, &pose.weight));
  if (s->dsh != NULL) {
    ERN_TRY(ern_scratch_take_rows(s->stream, 3, s->count, &pose.d));
    ERN_TRY(ern_scratch_take_rows(s->stream, 3, s->count, &pose.dd));
  }
  ern_pool_run(pool_of(s->stream), ERN_SHARDS, pose_task, &pose);
  for (size_t i = 0; i < ERN_POSE_PARAMETERS; i++) {
    a->dpose[i] = 0;
    for (size_t k = 0; k < ERN_SHARDS; k++) a->dpose[i] += pose.part[k][i];
  }
fail:
  ern_arena_release(s->stream, mark);
  return status;
}

/* The tables' gradients: a task for each level and plane, samples in order. With `fold`, two more tasks run beside the
 * last tables: the audio network's gradient, and the unfolding of the colour's. They share no memory with the tables
 * and would otherwise occupy one thread alone. */
struct tables {
  const struct ern_train_step *step;
  const float *x[3];
  size_t stride, n; /* of df */
  float *dparameters;
  const struct ern_train_fold *fold; /* NULL: only the tables */
  const struct ern_audio_bwd_args *audio;
};
static void tables_task(void *user, size_t k, int number) {
  const struct tables *t = user;
  const struct ern_train_step *s = t->step;
  struct ern_train_worker *worker = ern_train_worker_of(s, number);
  const size_t levels = (size_t)s->field->config.levels, p = k / levels;
  const int level = (int)(k % levels), *axis = s->field->encoder.axis[p];
  const float *const x[ERN_GRID_MAX_DIMS] = {t->x[axis[0]], t->x[axis[1]], NULL};
  float *const none[ERN_GRID_MAX_DIMS] = {NULL};
  const size_t table = s->field->encoder.table[p];
  const double began = ern_profile_now();
  s->kernels->grid_bwd(t->dparameters + table, none, s->df + p * levels * t->stride, t->stride, x,
                       s->parameters + table, &s->field->encoder.grid[p], level, level + 1, t->n);
  worker->profile.seconds[ERN_PROFILE_TABLES] += ern_profile_now() - began;
}
static void last_task(void *user, size_t k, int number) {
  const struct tables *t = user;
  const struct ern_train_step *s = t->step;
  if (k == 0)
    s->kernels->audio_bwd(t->dparameters, reals(t->audio->dcode), reals(t->audio->forward.windows), s->parameters,
                          &t->audio->forward.net);
  else if (k == 1)
    ern_train_net_unfold_colour(t->dparameters, s->gradient, &s->net, t->fold);
  else
    tables_task(user, k - 2, number);
}
static void add_tables(const struct tables *t) {
  const size_t tasks = ERN_PLANES * (size_t)t->step->field->config.levels;
  ern_pool_run(pool_of(t->step->stream), t->fold != NULL ? tasks + 2 : tasks, t->fold != NULL ? last_task : tables_task,
               (void *)t);
}

/* The backward pass without the tables' gradients, which the caller adds. */
static ern_status backward(const struct ern_head_step_args *a, struct ern_train_step *s, struct tables *tables) {
  ern_span dsh;
  ern_status status = take_gradients(s, s->live_stride);
  if (status == ERN_OK && a->dpose != NULL && s->net.harmonics > 0) {
    status = ern_scratch_take(s->stream, ERN_ELEMENT_REAL, ERN_SH_ROWS * s->live_stride, &dsh);
    if (status == ERN_OK) s->dsh = reals(dsh);
  }
  if (status != ERN_OK) return status;
  ern_pool_run(pool_of(s->stream), ERN_SHARDS, backward_task, s);
  if (a->dpose != NULL) status = add_pose(a, s);
  const size_t stride = s->live_stride;
  *tables = (struct tables){.step = s,
                            .x = {s->live_x, s->live_x + stride, s->live_x + 2 * stride},
                            .stride = stride,
                            .n = s->count,
                            .dparameters = reals(a->dparameters)};
  return status;
}

/* ---- smoothness -------------------------------------------------------------------------------------------------- */

struct smoothness {
  struct ern_train_step *step;
  ern_rows x;
  float factor;
  double sum[ERN_SHARDS][3];
};

static void smooth_task(void *user, size_t k, int number) {
  struct smoothness *smooth = user;
  struct ern_train_step *s = smooth->step;
  struct ern_train_worker *worker = ern_train_worker_of(s, number);
  const struct range r = shard(s->marched.total, ERN_MLP_TILE, k);
  struct ern_train_smooth_args args = {.count = r.end - r.begin,
                                       .x = reals(smooth->x.span) + r.begin,
                                       .x_stride = smooth->x.stride,
                                       .norm = s->norm + r.begin,
                                       .eye = s->eye + r.begin,
                                       .unc = s->unc + r.begin,
                                       .factor = smooth->factor,
                                       .gradient = s->gradient + k * s->net.forward,
                                       .df = s->df + r.begin,
                                       .stride = s->stride};
  const double began = ern_profile_now();
  worker->tile.encoding = 0;
  s->train->smooth(&s->net, &worker->tile, &args);
  worker->profile.seconds[ERN_PROFILE_ENCODE] += worker->tile.encoding;
  worker->profile.seconds[ERN_PROFILE_BACKWARD] += ern_profile_now() - began - worker->tile.encoding;
  memcpy(smooth->sum[k], args.sum, sizeof args.sum);
}

static ern_status move_points(const struct ern_head_step_args *a, const struct ern_train_step *s, ern_rows moved) {
  const size_t n = s->marched.total, stride = s->marched.x.stride;
  if (a->smooth_offsets == NULL) {
    struct ern_smooth_points_args points = {
        .moved = moved, .x = s->marched.x, .reach = 1e-3f, .seed = a->seed, .step = a->step, .n = n};
    return s->stream->backend->smooth_points(s->stream, &points);
  }
  for (size_t axis = 0; axis < 3; axis++)
    for (size_t i = 0; i < n; i++)
      reals(moved.span)[axis * moved.stride + i] =
          reals(s->marched.x.span)[axis * stride + i] + a->smooth_offsets[3 * i + axis];
  return ERN_OK;
}

/* Smoothness loss: attention, eye attention and uncertainty should not change within 1e-3. The gradient flows through
 * the moved points alone. First adds the gradients of `tables`, whose memory then takes those of the moved points. */
static ern_status smoothness(struct ern_head_step_args *a, struct ern_train_step *s, struct tables *tables) {
  const size_t n = s->marched.total;
  const float weight = a->weights.smoothness * a->weights.s;
  struct smoothness smooth = {.step = s, .factor = (float)(2 * (double)weight / (double)n)};
  ern_status status = ERN_OK;
  add_tables(tables);
  ERN_TRY(ern_scratch_take_rows(s->stream, 3, n, &smooth.x));
  ERN_TRY(move_points(a, s, smooth.x));
  ERN_TRY(take_gradients(s, s->stride));
  ern_pool_run(pool_of(s->stream), ERN_SHARDS, smooth_task, &smooth);
  double term = 0;
  for (size_t q = 0; q < 3; q++) {
    double sum = 0;
    for (size_t k = 0; k < ERN_SHARDS; k++) sum += smooth.sum[k][q];
    term += (double)weight / (double)n * sum;
  }
  a->terms[ERN_LOSS_SMOOTHNESS] = term;
  const float *x = reals(smooth.x.span);
  *tables = (struct tables){.step = s,
                            .x = {x, x + smooth.x.stride, x + 2 * smooth.x.stride},
                            .stride = s->stride,
                            .n = n,
                            .dparameters = reals(a->dparameters)};
fail:
  return status;
}

/* ---- the step ---------------------------------------------------------------------------------------------------- */

static void sum_task(void *user, size_t part, int worker) {
  (void)worker;
  const struct ern_train_step *s = user;
  const struct range r = shard(s->net.forward, 64, part);
  for (size_t k = 1; k < ERN_SHARDS; k++) {
    const float *block = s->gradient + k * s->net.forward;
    for (size_t i = r.begin; i < r.end; i++) s->gradient[i] += block[i];
  }
}

static void add_profile(const struct ern_train_step *s, struct ern_profile *profile, const double when[4]) {
  if (profile == NULL) return;
  for (int worker = 0; worker < ern_pool_threads(pool_of(s->stream)); worker++)
    ern_profile_add(profile, &ern_train_worker_of(s, worker)->profile);
  profile->seconds[ERN_PROFILE_MARCH] += when[1] - when[0];
  profile->seconds[ERN_PROFILE_COMPOSITE] += when[3] - when[2];
  profile->count[ERN_PROFILE_PIXELS] += s->rays;
  profile->count[ERN_PROFILE_RAYS] += s->rays;
  profile->count[ERN_PROFILE_MARCHED] += s->marched.total;
  const int32_t *first = int32s(s->marched.first);
  for (size_t i = 0; i < s->rays; i++) profile->count[ERN_PROFILE_HITS] += first[i + 1] > first[i];
}

static ern_status head_step(struct ern_stream *stream, struct ern_head_step_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct ern_train_step s = step_of(stream, a->field, a->parameters, a->bf16 && !a->smooth);
  struct rays rays;
  struct tables tables;
  float *weights = NULL;
  ern_span code, dcode;
  double when[4];
  ern_status status = ERN_OK;
  if (!ern_train_net_plan(&s.net, a->field)) return ern_head_step_stages(stream, a);
  s.rays = a->n;
  s.stop = a->transmittance_stop;
  s.everything = a->smooth && a->weights.smoothness * a->weights.s != 0;
  memset(a->terms, 0, sizeof a->terms);
  when[0] = ern_profile_now();
  ERN_TRY(ern_march_rays(stream, a->pixel_number, a->view, a->jitter, a->bits, a->settings, a->n, &s.marched));
  ERN_TRY(ern_march_view(stream, a->field, a->n, &s.marched));
  when[1] = ern_profile_now();
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &code));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &dcode));
  struct ern_audio_fwd_args audio = {
      .code = code, .windows = a->windows, .parameters = a->parameters, .net = a->field->audio};
  ERN_TRY(stream->backend->audio_fwd(stream, &audio));
  ERN_TRY(stream->backend->zero(stream, dcode));
  ERN_TRY(take_threads(&s, &weights));
  ERN_TRY(take_marched(&s));
  const struct ern_train_fold fold = {a->field, s.parameters, reals(code), a->eye_value, a->individual};
  fill_net(&s, weights, &fold);
  ERN_TRY(ern_train_unhash(&s));

  ERN_TRY(ern_train_forward(&s));
  when[2] = ern_profile_now();
  ERN_TRY(rays_take(stream, a->n, &rays));
  ERN_TRY(losses(a, &s, &rays));
  when[3] = ern_profile_now();
  ERN_TRY(backward(a, &s, &tables));
  if (s.everything && s.marched.total > 0) ERN_TRY(smoothness(a, &s, &tables));
  ern_pool_run(pool_of(stream), ERN_SHARDS, sum_task, &s);
  ern_train_net_unfold(reals(a->dparameters), reals(dcode), s.gradient, &s.net, &fold);
  const struct ern_audio_bwd_args audio_bwd = {a->dparameters, dcode, audio};
  tables.fold = &fold;
  tables.audio = &audio_bwd;
  add_tables(&tables);
  a->samples = s.marched.total;
  add_profile(&s, a->profile, when);
fail:
  ern_arena_release(stream, mark);
  return status;
}

/* ---- densities alone --------------------------------------------------------------------------------------------- */

struct densities {
  const struct ern_train_step *step;
  const struct ern_head_density_args *args;
};

static void density_task(void *user, size_t k, int number) {
  const struct densities *job = user;
  const struct ern_train_step *s = job->step;
  const struct ern_head_density_args *a = job->args;
  struct ern_train_worker *worker = ern_train_worker_of(s, number);
  const size_t begin = k * ERN_TRAIN_BATCH, left = a->n - begin, n = left < ERN_TRAIN_BATCH ? left : ERN_TRAIN_BATCH;
  const struct ern_train_density_args density = {
      .list = {NULL, n}, .x = reals(a->x.span) + begin, .x_stride = a->x.stride, .sigma = reals(a->sigma) + begin};
  s->train->density(&s->net, &worker->tile, &density);
}

static ern_status head_density(struct ern_stream *stream, struct ern_head_density_args *a) {
  struct ern_train_step s = step_of(stream, a->field, a->parameters, a->bf16);
  float *weights = NULL;
  if (!ern_train_net_plan(&s.net, a->field)) return ern_head_density_stages(stream, a);
  ern_status status = ERN_OK;
  ERN_TRY(take_threads(&s, &weights));
  const struct ern_train_fold fold = {a->field, s.parameters, reals(a->code), a->eye_value, 0};
  fill_net(&s, weights, &fold);
  ERN_TRY(ern_train_unhash(&s));
  struct densities job = {&s, a};
  ern_pool_run(pool_of(stream), (a->n + ERN_TRAIN_BATCH - 1) / ERN_TRAIN_BATCH, density_task, &job);
fail:
  return status;
}

void ern_cpu_fuse_step(struct ern_backend *backend) {
  backend->head_density = head_density;
  backend->head_step = head_step;
}
