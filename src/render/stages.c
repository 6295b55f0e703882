/* SPDX-License-Identifier: MIT */
#include "render/stages.h"

#include "core/profile.h"
#include "core/status.h"
#include "mlp/encoding_ops.h"
#include "model/head.h"
#include "render/composite_ops.h"
#include "render/march_ops.h"
#include "render/render_ops.h"

ern_status ern_march_rays(struct ern_stream *stream, ern_span pixel_number, const struct ern_view *view,
                          ern_span jitter, ern_span bits, const struct ern_march_settings *settings, size_t rays,
                          struct ern_marched *out) {
  const struct ern_backend *backend = stream->backend;
  const float origin[3] = {view->pose[3], view->pose[7], view->pose[11]};
  ern_status status = ERN_OK;
  ern_span t, count;
  *out = (struct ern_marched){0};
  ERN_TRY(ern_scratch_take_rows(stream, 3, rays, &out->dir));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, rays + 1, &out->first));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, rays, &count));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, rays * (size_t)settings->max_steps, &t));

  struct ern_rays_args ray_args = {.dir = out->dir, .pixel = pixel_number, .view = *view, .n = rays};
  ERN_TRY(backend->rays(stream, &ray_args));
  struct ern_march_args march = {.t = t,
                                 .count = count,
                                 .dir = out->dir,
                                 .jitter = jitter,
                                 .bits = bits,
                                 .origin = {origin[0], origin[1], origin[2]},
                                 .settings = *settings,
                                 .n = rays};
  ERN_TRY(backend->march(stream, &march));
  struct ern_scan_args scan = {.first = out->first, .count = count, .n = rays};
  ERN_TRY(backend->scan(stream, &scan));
  out->total = scan.total;
  ERN_TRY(ern_scratch_take_rows(stream, 3, out->total, &out->x));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, out->total, &out->dt));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, out->total, &out->depth));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, out->total, &out->ray));
  struct ern_samples_args samples = {.x = out->x,
                                     .dt = out->dt,
                                     .depth = out->depth,
                                     .ray = out->ray,
                                     .t = t,
                                     .first = out->first,
                                     .dir = out->dir,
                                     .origin = {origin[0], origin[1], origin[2]},
                                     .settings = *settings,
                                     .n = rays};
  ERN_TRY(backend->samples(stream, &samples));
fail:
  return status;
}

ern_status ern_march_view(struct ern_stream *stream, const struct ern_field *field, size_t rays,
                          struct ern_marched *marched) {
  if (field->config.no_view) return ERN_OK;
  const ern_status status = ern_scratch_take_rows(stream, ERN_SH_ROWS, rays, &marched->sh);
  if (status != ERN_OK) return status;
  marched->sh.per = ERN_PER_RAY;
  struct ern_sh_fwd_args sh = {.y = marched->sh, .d = marched->dir, .n = rays};
  return stream->backend->sh_fwd(stream, &sh);
}

ern_status ern_render_rays_stages(struct ern_stream *stream, struct ern_render_rays_args *args) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct ern_marched marched;
  struct ern_head_batch batch;
  ern_status status = ERN_OK;
  ERN_TRY(ern_march_rays(stream, args->pixel_number, &args->view, (ern_span){0}, args->bits, &args->settings, args->n,
                         &marched));
  ERN_TRY(ern_march_view(stream, args->field, args->n, &marched));
  const struct ern_head_inputs in = {.field = args->field,
                                     .parameters = args->parameters,
                                     .code = args->code,
                                     .eye = args->eye_value,
                                     .individual = args->individual,
                                     .sh = marched.sh,
                                     .ray = marched.ray};
  ERN_TRY(ern_head_batch_take(stream, args->field, marched.total, ERN_BATCH_DENSITY | ERN_BATCH_COLOUR, &batch));
  if (marched.total > 0) {
    ERN_TRY(ern_head_density_fwd(stream, &in, marched.x, &batch));
    ERN_TRY(ern_head_colour_fwd(stream, &in, &batch));
  }
  struct ern_composite_fwd_args composite = {.pixel = args->pixel,
                                             .colour = args->colour,
                                             .opacity = args->opacity,
                                             .depth = args->depth,
                                             .first = marched.first,
                                             .sigma = batch.sigma.span,
                                             .dt = marched.dt,
                                             .sample_depth = marched.depth,
                                             .rgb = batch.rgb,
                                             .background = args->background,
                                             .transmittance_stop = args->transmittance_stop,
                                             .n = args->n};
  if (ern_field_attends(args->field)) {
    composite.attention = args->attention;
    composite.sample_attention = batch.norm.span;
  }
  if (ern_field_attends_eye(args->field)) {
    composite.eye = args->eye;
    composite.sample_eye = batch.eye.span;
  }
  ERN_TRY(stream->backend->composite_fwd(stream, &composite));
  if (args->profile != NULL) {
    args->profile->count[ERN_PROFILE_PIXELS] += args->n;
    args->profile->count[ERN_PROFILE_SAMPLES] += marched.total;
  }
fail:
  ern_arena_release(stream, mark);
  return status;
}
