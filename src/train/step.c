/* SPDX-License-Identifier: MIT
 * A training step of the head: all stages forward, then mirrored. This page is the table of contents of the model. */
#include "train/step.h"

#include <string.h>

#include "core/memory.h"
#include "mlp/encoding_ops.h"
#include "model/head.h"
#include "render/composite_ops.h"
#include "render/march_ops.h"
#include "render/stages.h"
#include "train/losses_ops.h"
#include "train/step_ops.h"

/* Data shared by the forward and backward halves of a step. */
struct pass {
  struct ern_audio_fwd_args audio;
  struct ern_head_inputs in;
  ern_span dcode;                               /* real [A] */
  ern_rows pixel, colour, dpixel;               /* [3] per ray */
  ern_rows opacity, depth, attention, eye, unc; /* [1] per ray */
  ern_rows dopacity, dattention, deye, dunc;
  size_t total;              /* samples of all rays */
  struct ern_mse_args plain; /* results of these are valid after `synchronize` */
  struct ern_head_loss_args loss;
  struct ern_patch_loss_args patches;
  struct ern_smooth_loss_args smooth[3];
  struct ern_pose_bwd_args pose;
};

/* Some of the rays, and their samples. */
struct part {
  size_t begin, rays;  /* rays [begin, begin + rays) */
  size_t first_sample; /* samples of the rays before */
  struct ern_marched marched;
  struct ern_head_inputs in; /* the pass's, with these rays */
  struct ern_head_batch batch, d;
};

enum { ALL_PARTS = ERN_BATCH_DENSITY | ERN_BATCH_COLOUR | ERN_BATCH_UNCERTAINTY };

static ern_status take_ray_rows(struct ern_stream *stream, size_t rays, struct pass *p) {
  ern_rows *const colours[] = {&p->pixel, &p->colour, &p->dpixel};
  ern_rows *const values[] = {&p->opacity,  &p->depth,      &p->attention, &p->eye, &p->unc,
                              &p->dopacity, &p->dattention, &p->deye,      &p->dunc};
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof colours / sizeof *colours && status == ERN_OK; i++)
    status = ern_scratch_take_rows(stream, 3, rays, colours[i]);
  for (size_t i = 0; i < sizeof values / sizeof *values && status == ERN_OK; i++)
    status = ern_scratch_take_rows(stream, 1, rays, values[i]);
  return status;
}

static ern_rows rows_at(ern_rows rows, const struct part *part) {
  rows.span = ern_span_part(rows.span, part->begin, rows.span.count - part->begin);
  return rows;
}
/* The part's section of a span with one value per ray; a zeroed span stays zeroed. */
static ern_span span_at(ern_span span, const struct part *part) {
  return span.buffer != NULL ? ern_span_part(span, part->begin, part->rays) : span;
}

static struct ern_composite_fwd_args composite_args(const struct ern_head_step_args *a, const struct pass *p,
                                                    const struct part *part) {
  const bool attends = ern_field_attends(a->field), eye = ern_field_attends_eye(a->field);
  return (struct ern_composite_fwd_args){.pixel = rows_at(p->pixel, part),
                                         .colour = rows_at(p->colour, part),
                                         .opacity = span_at(p->opacity.span, part),
                                         .depth = span_at(p->depth.span, part),
                                         .attention = attends ? span_at(p->attention.span, part) : (ern_span){0},
                                         .eye = eye ? span_at(p->eye.span, part) : (ern_span){0},
                                         .uncertainty = span_at(p->unc.span, part),
                                         .first = part->marched.first,
                                         .sigma = part->batch.sigma.span,
                                         .dt = part->marched.dt,
                                         .sample_depth = part->marched.depth,
                                         .sample_attention = part->batch.norm.span,
                                         .sample_eye = part->batch.eye.span,
                                         .sample_uncertainty = part->batch.unc.span,
                                         .rgb = part->batch.rgb,
                                         .background = rows_at(a->background, part),
                                         .transmittance_stop = a->transmittance_stop,
                                         .n = part->rays};
}

/* Computes and allocates what all rays of the frame share. */
static ern_status begin(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &p->dcode));
  ERN_TRY(stream->backend->zero(stream, p->dcode));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &p->in.code));
  p->in.field = a->field;
  p->in.parameters = a->parameters;
  p->in.eye = a->eye_value;
  p->in.individual = a->individual;
  p->audio = (struct ern_audio_fwd_args){
      .code = p->in.code, .windows = a->windows, .parameters = a->parameters, .net = a->field->audio, .keep = true};
  ERN_TRY(take_ray_rows(stream, a->n, p));
  ERN_TRY(stream->backend->audio_fwd(stream, &p->audio));
fail:
  return status;
}

static ern_status forward(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p, struct part *part) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_march_rays(stream, ern_span_part(a->pixel_number, part->begin, part->rays), a->view,
                         span_at(a->jitter, part), a->bits, a->settings, part->rays, &part->marched));
  ERN_TRY(ern_march_view(stream, a->field, part->rays, &part->marched));
  part->in = p->in;
  part->in.sh = part->marched.sh;
  part->in.ray = part->marched.ray;
  ERN_TRY(ern_head_batch_take(stream, a->field, part->marched.total, ALL_PARTS, &part->batch));
  if (part->marched.total > 0) {
    ERN_TRY(ern_head_density_fwd(stream, &part->in, part->marched.x, &part->batch));
    ERN_TRY(ern_head_colour_fwd(stream, &part->in, &part->batch));
    ERN_TRY(ern_head_uncertainty_fwd(stream, &part->in, &part->batch));
  }
  struct ern_composite_fwd_args composite = composite_args(a, p, part);
  ERN_TRY(stream->backend->composite_fwd(stream, &composite));
fail:
  return status;
}

static ern_status loss(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p) {
  const bool attends = ern_field_attends(a->field), eye = ern_field_attends_eye(a->field);
  p->plain = (struct ern_mse_args){.dpixel = p->dpixel, .pixel = p->pixel, .truth = a->truth, .n = a->n};
  p->loss = (struct ern_head_loss_args){.dpixel = p->dpixel,
                                        .dopacity = p->dopacity.span,
                                        .dattention = attends ? p->dattention.span : (ern_span){0},
                                        .deye = eye ? p->deye.span : (ern_span){0},
                                        .duncertainty = p->dunc.span,
                                        .pixel = p->pixel,
                                        .truth = a->truth,
                                        .opacity = p->opacity.span,
                                        .attention = attends ? p->attention.span : (ern_span){0},
                                        .eye = eye ? p->eye.span : (ern_span){0},
                                        .uncertainty = p->unc.span,
                                        .face = a->face,
                                        .weights = a->weights,
                                        .max_steps = a->settings->max_steps,
                                        .n = a->n};
  p->patches = ern_patches_of_step(a, p->dpixel, p->pixel);
  ern_status status = stream->backend->mse(stream, &p->plain);
  if (status == ERN_OK) status = stream->backend->head_loss(stream, &p->loss);
  return status != ERN_OK ? status : ern_step_patch_loss(stream, a->patches.loss, &p->patches);
}

/* Memory of the gradients of a part's positions and directions, and its harmonics by sample. */
static ern_status take_pose(struct ern_stream *stream, const struct ern_head_step_args *a, struct pass *p,
                            struct part *part) {
  const struct ern_backend *backend = stream->backend;
  const size_t n = part->marched.total;
  struct ern_pose_bwd_args *pose = &p->pose;
  ern_status status = ERN_OK;
  *pose = (struct ern_pose_bwd_args){.x = part->marched.x, .n = n};
  ERN_TRY(ern_scratch_take_rows(stream, 3, n, &part->d.x));
  ERN_TRY(backend->zero(stream, part->d.x.span));
  pose->dx = part->d.x;
  if (a->dpose_weight.buffer != NULL) {
    const ern_span own = span_at(a->dpose_weight, part);
    ern_rows weight;
    ERN_TRY(ern_scratch_take_rows(stream, 1, n, &weight));
    struct ern_spread_rays_args spread = {weight, {own, own.count, 1, ERN_PER_RAY}, part->marched.ray, n};
    ERN_TRY(backend->spread_rays(stream, &spread));
    pose->weight = weight.span;
  }
  if (a->field->config.no_view) return ERN_OK;
  ERN_TRY(ern_scratch_take_rows(stream, ERN_SH_ROWS, n, &part->in.sh));
  ERN_TRY(ern_scratch_take_rows(stream, ERN_SH_ROWS, n, &part->d.sh));
  ERN_TRY(backend->zero(stream, part->d.sh.span));
  ERN_TRY(ern_scratch_take_rows(stream, 3, n, &pose->d));
  ERN_TRY(ern_scratch_take_rows(stream, 3, n, &pose->dd));
  struct ern_spread_rays_args dirs = {pose->d, part->marched.dir, part->marched.ray, n};
  ERN_TRY(backend->spread_rays(stream, &dirs));
  struct ern_sh_fwd_args sh = {part->in.sh, pose->d, n};
  ERN_TRY(backend->sh_fwd(stream, &sh));
fail:
  return status;
}

/* Gradient by the camera from the gradients by a part's positions and directions. */
static ern_status pose_bwd(struct ern_stream *stream, struct pass *p, const struct part *part) {
  if (p->pose.dd.span.buffer != NULL) {
    struct ern_sh_bwd_args sh = {p->pose.dd, part->d.sh, p->pose.d, p->pose.n};
    const ern_status status = stream->backend->sh_bwd(stream, &sh);
    if (status != ERN_OK) return status;
  }
  return stream->backend->pose_bwd(stream, &p->pose);
}

static ern_status backward(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p, struct part *part) {
  const struct ern_backend *backend = stream->backend;
  const bool attends = ern_field_attends(a->field), eye = ern_field_attends_eye(a->field);
  ern_status status = ERN_OK;
  ERN_TRY(ern_head_batch_take(stream, a->field, part->marched.total, ALL_PARTS, &part->d));
  struct ern_head_batch *d = &part->d;
  struct ern_composite_bwd_args composite = {.dsigma = d->sigma.span,
                                             .drgb = d->rgb,
                                             .dsample_attention = d->norm.span,
                                             .dsample_eye = d->eye.span,
                                             .dsample_uncertainty = d->unc.span,
                                             .dpixel = rows_at(p->dpixel, part),
                                             .dopacity = span_at(p->dopacity.span, part),
                                             .dattention = attends ? span_at(p->dattention.span, part) : (ern_span){0},
                                             .deye = eye ? span_at(p->deye.span, part) : (ern_span){0},
                                             .duncertainty = span_at(p->dunc.span, part),
                                             .forward = composite_args(a, p, part)};
  ERN_TRY(backend->composite_bwd(stream, &composite));
  ERN_TRY(backend->zero(stream, d->f.span));
  ERN_TRY(backend->zero(stream, d->h.span));
  const bool pose = a->dpose != NULL && part->marched.total > 0;
  if (pose) ERN_TRY(take_pose(stream, a, p, part));
  if (part->marched.total > 0) {
    ERN_TRY(ern_head_uncertainty_bwd(stream, &part->in, &part->batch, d, a->dparameters));
    ERN_TRY(ern_head_colour_bwd(stream, &part->in, &part->batch, d, a->dparameters));
    ERN_TRY(ern_head_density_bwd(stream, &part->in, part->marched.x, &part->batch, d, a->dparameters, p->dcode));
  }
  if (pose) ERN_TRY(pose_bwd(stream, p, part));
fail:
  return status;
}

/* The moved points: Philox's offsets, or another program's recorded ones. */
static ern_status move_points(struct ern_stream *stream, const struct ern_head_step_args *a, const struct part *part,
                              ern_rows moved) {
  const size_t n = part->marched.total;
  const struct ern_backend *backend = stream->backend;
  if (a->smooth_offsets == NULL) {
    struct ern_smooth_points_args points = {.moved = moved,
                                            .x = part->marched.x,
                                            .reach = 1e-3f,
                                            .seed = a->seed,
                                            .step = a->step,
                                            .first = part->first_sample,
                                            .n = n};
    return backend->smooth_points(stream, &points);
  }
  const float *offsets = a->smooth_offsets + 3 * part->first_sample;
  float *x = NULL;
  ern_status status = ERN_NEW(backend->context, n, &x);
  for (int axis = 0; axis < 3 && status == ERN_OK; axis++) {
    status = backend->download_reals(stream, x, ern_span_of_row(part->marched.x, axis, n), n);
    for (size_t i = 0; i < n; i++) x[i] += offsets[3 * i + (size_t)axis];
    if (status == ERN_OK) status = backend->upload_reals(stream, ern_span_of_row(moved, axis, n), x, n);
  }
  ern_release(backend->context, x);
  return status;
}

static ern_status smooth_term(struct ern_stream *stream, const struct ern_head_step_args *a, struct pass *p, int which,
                              ern_rows dmoved, ern_rows still, ern_rows moved, size_t n) {
  p->smooth[which] = (struct ern_smooth_loss_args){.dmoved = dmoved.span,
                                                   .still = still.span,
                                                   .moved = moved.span,
                                                   .weight = a->weights.smoothness * a->weights.s,
                                                   .batch = p->total,
                                                   .n = n};
  return stream->backend->smooth_loss(stream, &p->smooth[which]);
}

/* Attention, eye attention and uncertainty should not change within 1e-3; gradient through the moved points alone. */
static ern_status smoothness(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p,
                             struct part *part) {
  const size_t n = part->marched.total;
  const int parts = ERN_BATCH_ATTENTION | ERN_BATCH_UNCERTAINTY;
  const bool attends = ern_field_attends(a->field), eye = ern_field_attends_eye(a->field);
  struct ern_head_batch moved, d;
  ern_rows x;
  ern_status status = ERN_OK;
  if (n == 0 || a->weights.smoothness * a->weights.s == 0) return ERN_OK;
  ERN_TRY(ern_scratch_take_rows(stream, 3, n, &x));
  ERN_TRY(move_points(stream, a, part, x));
  ERN_TRY(ern_head_batch_take(stream, a->field, n, parts, &moved));
  ERN_TRY(ern_head_batch_take(stream, a->field, n, parts, &d));
  ERN_TRY(ern_head_density_fwd(stream, &part->in, x, &moved));
  ERN_TRY(ern_head_uncertainty_fwd(stream, &part->in, &moved));

  if (attends) ERN_TRY(smooth_term(stream, a, p, 0, d.norm, part->batch.norm, moved.norm, n));
  ERN_TRY(smooth_term(stream, a, p, 1, d.unc, part->batch.unc, moved.unc, n));
  if (eye) ERN_TRY(smooth_term(stream, a, p, 2, d.eye, part->batch.eye, moved.eye, n));

  ERN_TRY(stream->backend->zero(stream, d.f.span));
  ERN_TRY(ern_head_uncertainty_bwd(stream, &part->in, &moved, &d, a->dparameters));
  if (attends || eye) ERN_TRY(ern_head_density_bwd(stream, &part->in, x, &moved, &d, a->dparameters, (ern_span){0}));
fail:
  return status;
}

static ern_status backward_pass(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p,
                                struct part *part) {
  const ern_status status = backward(stream, a, p, part);
  return status == ERN_OK && a->smooth ? smoothness(stream, a, p, part) : status;
}

/* Adds a part's contribution to the camera's gradient, after it is synchronized. */
static void add_pose(struct ern_head_step_args *a, struct pass *p) {
  for (size_t k = 0; a->dpose != NULL && k < ERN_POSE_PARAMETERS; k++) {
    a->dpose[k] += p->pose.dpose[k];
    p->pose.dpose[k] = 0;
  }
}

/* Backward pass of the audio net; then collects the results. */
static ern_status end(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p) {
  struct ern_audio_bwd_args audio = {a->dparameters, p->dcode, p->audio};
  ern_status status = stream->backend->audio_bwd(stream, &audio);
  if (status == ERN_OK && a->meanwhile != NULL) a->meanwhile(a->user);
  if (status == ERN_OK) status = stream->backend->synchronize(stream);
  if (status != ERN_OK) return status;
  const double smooth = a->terms[ERN_LOSS_SMOOTHNESS];
  add_pose(a, p);
  memcpy(a->terms, p->loss.terms, sizeof a->terms);
  a->terms[ERN_LOSS_SMOOTHNESS] = smooth;
  a->terms[ERN_LOSS_PATCHES] = p->patches.term;
  for (int i = 0; i < 3; i++) a->terms[ERN_LOSS_SMOOTHNESS] += p->smooth[i].term;
  a->squared_error = p->plain.term;
  a->samples = p->total;
  return ERN_OK;
}

/* Rays `at_once` at a time: the losses need all pixels, so the samples are thrown away and computed again. */
static ern_status in_parts(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p, size_t at_once) {
  ern_status status = ERN_OK;
  for (int back = 0; back < 2; back++) {
    size_t samples = 0;
    for (size_t from = 0; from < a->n; from += at_once) {
      const struct ern_arena_mark mark = ern_arena_mark(stream);
      struct part part = {
          .begin = from, .rays = a->n - from < at_once ? a->n - from : at_once, .first_sample = samples};
      status = forward(stream, a, p, &part);
      if (status == ERN_OK && back == 1) status = backward_pass(stream, a, p, &part);
      if (status == ERN_OK && back == 1) status = stream->backend->synchronize(stream);
      samples += part.marched.total;
      ern_arena_release(stream, mark);
      if (status != ERN_OK) return status;
      add_pose(a, p);
      for (int i = 0; i < 3; i++) {
        a->terms[ERN_LOSS_SMOOTHNESS] += p->smooth[i].term;
        p->smooth[i].term = 0;
      }
    }
    p->total = samples;
    if (back == 0) ERN_TRY(loss(stream, a, p));
  }
fail:
  return status;
}

ern_status ern_head_step_parts(struct ern_stream *stream, struct ern_head_step_args *args, size_t at_once) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct pass pass = {0};
  struct part all = {.rays = args->n};
  ern_status status = ERN_OK;
  memset(args->terms, 0, sizeof args->terms);
  for (size_t k = 0; args->dpose != NULL && k < ERN_POSE_PARAMETERS; k++) args->dpose[k] = 0;
  ERN_TRY(begin(stream, args, &pass));
  if (at_once < args->n) {
    ERN_TRY(in_parts(stream, args, &pass, at_once > 0 ? at_once : 1));
  } else {
    ERN_TRY(forward(stream, args, &pass, &all));
    pass.total = all.marched.total;
    ERN_TRY(loss(stream, args, &pass));
    ERN_TRY(backward_pass(stream, args, &pass, &all));
  }
  ERN_TRY(end(stream, args, &pass));
fail:
  ern_arena_release(stream, mark);
  return status;
}

ern_status ern_head_step_stages(struct ern_stream *stream, struct ern_head_step_args *args) {
  return ern_head_step_parts(stream, args, args->n);
}
