/* SPDX-License-Identifier: MIT
 * Slots between the caller's pictures and rows. */
#include "backend_cpu/slots.h"

static void backdrop_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_backdrop_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  const uint8_t *background = bytes(a->background), *torso = bytes(a->torso);
  job->kernels->backdrop(reals(a->pixel.span) + r.begin, a->pixel.stride, reals(a->opacity) + r.begin,
                         background != NULL ? background + 3 * r.begin : NULL,
                         torso != NULL ? torso + 4 * r.begin : NULL, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_backdrop)(struct ern_stream *stream, struct ern_backdrop_args *a) {
  run(stream, a, ERN_SHARDS, backdrop_task);
  return ERN_OK;
}

static void picture_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_picture_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  uint8_t *rgba = bytes(a->rgba);
  const struct ern_picture_view view = {.rgba = rgba != NULL ? rgba + 4 * r.begin : NULL,
                                        .rgb = after(reals(a->rgb), 3 * r.begin),
                                        .alpha = after(reals(a->alpha), r.begin),
                                        .pixel = reals(a->pixel.span) + r.begin,
                                        .head = after(reals(a->head), r.begin),
                                        .torso = after(reals(a->torso), r.begin),
                                        .stride = a->pixel.stride};
  job->kernels->picture(&view, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_picture)(struct ern_stream *stream, struct ern_picture_args *a) {
  run(stream, a, ERN_SHARDS, picture_task);
  return ERN_OK;
}

static void pick_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_pick_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->pick(reals(a->to.span) + r.begin, a->to.stride, reals(a->from.span), a->from.stride, a->from.rows,
                     int32s(a->pixel) + r.begin, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_pick)(struct ern_stream *stream, struct ern_pick_args *a) {
  run(stream, a, ERN_SHARDS, pick_task);
  return ERN_OK;
}

static void place_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_pick_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->place(reals(a->to.span), a->to.stride, reals(a->from.span) + r.begin, a->from.stride, a->from.rows,
                      int32s(a->pixel) + r.begin, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_place)(struct ern_stream *stream, struct ern_place_args *a) {
  run(stream, a, ERN_SHARDS, place_task);
  return ERN_OK;
}

static void blend_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_blend_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->blend(reals(a->to), reals(a->from.span) + r.begin, a->from.stride, reals(a->weight), a->weight.count,
                      int32s(a->pixel) + r.begin, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_blend)(struct ern_stream *stream, struct ern_blend_args *a) {
  run(stream, a, ERN_SHARDS, blend_task);
  return ERN_OK;
}

static void overlay_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_overlay_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->overlay(reals(a->pixel.span) + r.begin, a->pixel.stride, reals(a->colour.span) + r.begin,
                        a->colour.stride, reals(a->opacity) + r.begin, reals(a->background.span) + r.begin,
                        a->background.stride, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_overlay)(struct ern_stream *stream, struct ern_overlay_args *a) {
  run(stream, a, ERN_SHARDS, overlay_task);
  return ERN_OK;
}
