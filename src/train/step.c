/* SPDX-License-Identifier: MIT
 * A training step of the head: all stages forward, then mirrored. This page is the table of contents of the model. */
#include "train/step.h"

#include <string.h>

#include "core/memory.h"
#include "model/head.h"
#include "render/stages.h"

/* What the two halves of a step share. */
struct pass {
  struct ern_marched marched;
  struct ern_head_inputs in;
  struct ern_head_batch batch, d;
  struct ern_audio_args audio;
  ern_span dcode;                               /* real [A] */
  ern_rows pixel, colour, dpixel;               /* [3] per ray */
  ern_rows opacity, depth, attention, eye, unc; /* [1] per ray */
  ern_rows dopacity, dattention, deye, dunc;
  struct ern_mse_args plain; /* figures of these come with `settle` */
  struct ern_head_loss_args loss;
  struct ern_smooth_loss_args smooth[3];
};

enum { ALL_PARTS = ERN_BATCH_DENSITY | ERN_BATCH_COLOUR | ERN_BATCH_UNCERTAINTY };

static ern_status take_ray_rows(struct ern_stream *stream, size_t rays, struct pass *p) {
  ern_rows *const colours[] = {&p->pixel, &p->colour, &p->dpixel};
  ern_rows *const values[] = {&p->opacity,  &p->depth,      &p->attention, &p->eye, &p->unc,
                              &p->dopacity, &p->dattention, &p->deye,      &p->dunc};
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof colours / sizeof *colours && status == ERN_OK; i++)
    status = ern_take_rows(stream, 3, rays, colours[i]);
  for (size_t i = 0; i < sizeof values / sizeof *values && status == ERN_OK; i++)
    status = ern_take_rows(stream, 1, rays, values[i]);
  return status;
}

static struct ern_composite_args composite_args(const struct ern_head_step_args *a, const struct pass *p) {
  const bool eye = a->field->config.eye;
  return (struct ern_composite_args){.pixel = p->pixel,
                                     .colour = p->colour,
                                     .opacity = p->opacity.span,
                                     .depth = p->depth.span,
                                     .attention = p->attention.span,
                                     .eye = eye ? p->eye.span : (ern_span){0},
                                     .uncertainty = p->unc.span,
                                     .first = p->marched.first,
                                     .sigma = p->batch.sigma.span,
                                     .dt = p->marched.dt,
                                     .sample_depth = p->marched.depth,
                                     .sample_attention = p->batch.norm.span,
                                     .sample_eye = eye ? p->batch.eye.span : (ern_span){0},
                                     .sample_uncertainty = p->batch.unc.span,
                                     .rgb = p->batch.rgb,
                                     .background = a->background,
                                     .transmittance_stop = a->transmittance_stop,
                                     .n = a->n};
}

static ern_status forward(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p) {
  const struct ern_backend *backend = stream->backend;
  ern_status status = ERN_OK;
  ERN_TRY(ern_march_rays(stream, a->pixel_number, a->view, a->jitter, a->bits, a->settings, a->n, &p->marched));
  ERN_TRY(ern_take(stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &p->in.code));
  p->in.field = a->field;
  p->in.parameters = a->parameters;
  p->in.eye = a->eye_value;
  p->in.individual = a->individual;
  p->in.sh = p->marched.sh;
  p->in.ray = p->marched.ray;
  p->audio = (struct ern_audio_args){p->in.code, a->windows, a->parameters, a->field->audio};
  ERN_TRY(backend->audio_fwd(stream, &p->audio));
  ERN_TRY(ern_head_batch_take(stream, a->field, p->marched.total, ALL_PARTS, &p->batch));
  if (p->marched.total > 0) {
    ERN_TRY(ern_head_density_fwd(stream, &p->in, p->marched.x, &p->batch));
    ERN_TRY(ern_head_colour_fwd(stream, &p->in, &p->batch));
    ERN_TRY(ern_head_uncertainty_fwd(stream, &p->in, &p->batch));
  }
  ERN_TRY(take_ray_rows(stream, a->n, p));
  struct ern_composite_args composite = composite_args(a, p);
  ERN_TRY(backend->composite_fwd(stream, &composite));
fail:
  return status;
}

static ern_status loss(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p) {
  const bool eye = a->field->config.eye;
  p->plain = (struct ern_mse_args){.dpixel = p->dpixel, .pixel = p->pixel, .truth = a->truth, .n = a->n};
  p->loss = (struct ern_head_loss_args){.dpixel = p->dpixel,
                                        .dopacity = p->dopacity.span,
                                        .dattention = p->dattention.span,
                                        .deye = eye ? p->deye.span : (ern_span){0},
                                        .duncertainty = p->dunc.span,
                                        .pixel = p->pixel,
                                        .truth = a->truth,
                                        .opacity = p->opacity.span,
                                        .attention = p->attention.span,
                                        .eye = eye ? p->eye.span : (ern_span){0},
                                        .uncertainty = p->unc.span,
                                        .face = a->face,
                                        .weights = a->weights,
                                        .max_steps = a->settings->max_steps,
                                        .n = a->n};
  const ern_status status = stream->backend->mse(stream, &p->plain);
  return status != ERN_OK ? status : stream->backend->head_loss(stream, &p->loss);
}

static ern_status backward(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p) {
  const struct ern_backend *backend = stream->backend;
  const bool eye = a->field->config.eye;
  ern_status status = ERN_OK;
  ERN_TRY(ern_head_batch_take(stream, a->field, p->marched.total, ALL_PARTS, &p->d));
  struct ern_composite_bwd_args composite = {.dsigma = p->d.sigma.span,
                                             .drgb = p->d.rgb,
                                             .dsample_attention = p->d.norm.span,
                                             .dsample_eye = eye ? p->d.eye.span : (ern_span){0},
                                             .dsample_uncertainty = p->d.unc.span,
                                             .dpixel = p->dpixel,
                                             .dopacity = p->dopacity.span,
                                             .dattention = p->dattention.span,
                                             .deye = eye ? p->deye.span : (ern_span){0},
                                             .duncertainty = p->dunc.span,
                                             .forward = composite_args(a, p)};
  ERN_TRY(backend->composite_bwd(stream, &composite));
  ERN_TRY(backend->zero(stream, p->d.f.span));
  ERN_TRY(backend->zero(stream, p->d.h.span));
  if (p->marched.total > 0) {
    ERN_TRY(ern_head_uncertainty_bwd(stream, &p->in, &p->batch, &p->d, a->dparameters));
    ERN_TRY(ern_head_colour_bwd(stream, &p->in, &p->batch, &p->d, a->dparameters));
    ERN_TRY(ern_head_density_bwd(stream, &p->in, p->marched.x, &p->batch, &p->d, a->dparameters, p->dcode));
  }
  struct ern_audio_bwd_args audio = {a->dparameters, p->dcode, p->audio};
  ERN_TRY(backend->audio_bwd(stream, &audio));
fail:
  return status;
}

/* The moved points: Philox's offsets, or another program's recorded ones. */
static ern_status move_points(struct ern_stream *stream, const struct ern_head_step_args *a, const struct pass *p,
                              ern_rows moved) {
  const size_t n = p->marched.total;
  const struct ern_backend *backend = stream->backend;
  if (a->smooth_offsets == NULL) {
    struct ern_smooth_points_args points = {
        .moved = moved, .x = p->marched.x, .reach = 1e-3f, .seed = a->seed, .step = a->step, .n = n};
    return backend->smooth_points(stream, &points);
  }
  void *room = NULL;
  ern_status status = ern_allocate(backend->context, n, sizeof(float), &room);
  float *x = room;
  for (int axis = 0; axis < 3 && status == ERN_OK; axis++) {
    status = backend->download_reals(stream, x, ern_span_of_row(p->marched.x, axis, n), n);
    for (size_t i = 0; i < n; i++) x[i] += a->smooth_offsets[3 * i + (size_t)axis];
    if (status == ERN_OK) status = backend->upload_reals(stream, ern_span_of_row(moved, axis, n), x, n);
  }
  ern_release(backend->context, room);
  return status;
}

static ern_status smooth_term(struct ern_stream *stream, struct ern_smooth_loss_args *args, ern_rows dmoved,
                              ern_rows still, ern_rows moved, float weight, size_t n) {
  *args = (struct ern_smooth_loss_args){
      .dmoved = dmoved.span, .still = still.span, .moved = moved.span, .weight = weight, .n = n};
  return stream->backend->smooth_loss(stream, args);
}

/* Attention, eye attention and uncertainty should not change within 1e-3; gradient through the moved points alone. */
static ern_status smoothness(struct ern_stream *stream, struct ern_head_step_args *a, struct pass *p) {
  const float weight = a->weights.smoothness * a->weights.s;
  const size_t n = p->marched.total;
  const int parts = ERN_BATCH_ATTENTION | ERN_BATCH_UNCERTAINTY;
  struct ern_head_batch moved, d;
  ern_rows x;
  ern_status status = ERN_OK;
  if (n == 0 || weight == 0) return ERN_OK;
  ERN_TRY(ern_take_rows(stream, 3, n, &x));
  ERN_TRY(move_points(stream, a, p, x));
  ERN_TRY(ern_head_batch_take(stream, a->field, n, parts, &moved));
  ERN_TRY(ern_head_batch_take(stream, a->field, n, parts, &d));
  ERN_TRY(ern_head_density_fwd(stream, &p->in, x, &moved));
  ERN_TRY(ern_head_uncertainty_fwd(stream, &p->in, &moved));

  ERN_TRY(smooth_term(stream, &p->smooth[0], d.norm, p->batch.norm, moved.norm, weight, n));
  ERN_TRY(smooth_term(stream, &p->smooth[1], d.unc, p->batch.unc, moved.unc, weight, n));
  if (a->field->config.eye) ERN_TRY(smooth_term(stream, &p->smooth[2], d.eye, p->batch.eye, moved.eye, weight, n));

  ERN_TRY(stream->backend->zero(stream, d.f.span));
  ERN_TRY(ern_head_uncertainty_bwd(stream, &p->in, &moved, &d, a->dparameters));
  ERN_TRY(ern_head_density_bwd(stream, &p->in, x, &moved, &d, a->dparameters, (ern_span){0}));
fail:
  return status;
}

static void take_figures(struct ern_head_step_args *a, const struct pass *p) {
  memcpy(a->terms, p->loss.terms, sizeof a->terms);
  for (int i = 0; i < 3; i++) a->terms[ERN_LOSS_SMOOTHNESS] += p->smooth[i].term;
  a->squared_error = p->plain.term;
  a->samples = p->marched.total;
}

ern_status ern_head_step_stages(struct ern_stream *stream, struct ern_head_step_args *args) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct pass pass = {0};
  ern_status status = ERN_OK;
  memset(args->terms, 0, sizeof args->terms);
  ERN_TRY(ern_take(stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &pass.dcode));
  ERN_TRY(stream->backend->zero(stream, pass.dcode));
  ERN_TRY(forward(stream, args, &pass));
  ERN_TRY(loss(stream, args, &pass));
  ERN_TRY(backward(stream, args, &pass));
  if (args->smooth) ERN_TRY(smoothness(stream, args, &pass));
  ERN_TRY(stream->backend->settle(stream));
  take_figures(args, &pass);
fail:
  ern_arena_release(stream, mark);
  return status;
}
