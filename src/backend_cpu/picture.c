/* SPDX-License-Identifier: MIT
 * Slots that convert between the caller's pictures and rows. */
#include "backend_cpu/slots.h"
#include "render/picture_ops.h"

ERN_SHARDED_SLOT(background, a->n, 64) {
  const uint8_t *background = bytes(a->background), *torso = bytes(a->torso);
  kernels->background(reals(a->pixel.span) + r.begin, a->pixel.stride, reals(a->opacity) + r.begin,
                      background != NULL ? background + 3 * r.begin : NULL, torso != NULL ? torso + 4 * r.begin : NULL,
                      r.end - r.begin);
}

ERN_SHARDED_SLOT(picture, a->n, 64) {
  uint8_t *rgba = bytes(a->rgba);
  const struct ern_picture_view view = {.rgba = rgba != NULL ? rgba + 4 * r.begin : NULL,
                                        .rgb = after(reals(a->rgb), 3 * r.begin),
                                        .alpha = after(reals(a->alpha), r.begin),
                                        .pixel = reals(a->pixel.span) + r.begin,
                                        .head = after(reals(a->head), r.begin),
                                        .torso = after(reals(a->torso), r.begin),
                                        .stride = a->pixel.stride};
  kernels->picture(&view, r.end - r.begin);
}

ERN_SHARDED_SLOT(gather, a->n, 64) {
  kernels->gather(reals(a->to.span) + r.begin, a->to.stride, reals(a->from.span), a->from.stride, a->from.rows,
                  int32s(a->pixel) + r.begin, r.end - r.begin);
}

ERN_SHARDED_SLOT(scatter, a->n, 64) {
  kernels->scatter(reals(a->to.span), a->to.stride, reals(a->from.span) + r.begin, a->from.stride, a->from.rows,
                   int32s(a->pixel) + r.begin, r.end - r.begin);
}

ERN_SHARDED_SLOT(blend, a->n, 64) {
  kernels->blend(reals(a->to), reals(a->from.span) + r.begin, a->from.stride, reals(a->weight), a->weight.count,
                 int32s(a->pixel) + r.begin, r.end - r.begin);
}

ERN_SHARDED_SLOT(overlay, a->n, 64) {
  kernels->overlay(reals(a->pixel.span) + r.begin, a->pixel.stride, reals(a->colour.span) + r.begin, a->colour.stride,
                   reals(a->opacity) + r.begin, reals(a->background.span) + r.begin, a->background.stride,
                   r.end - r.begin);
}

/* A shard's result: 1 where a value is not finite. */
static void finite_task(void *user, size_t k, int worker) {
  (void)worker;
  struct figure_job *job = user;
  const struct ern_finite_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->part[k] = job->kernels->finite(reals(a->values) + r.begin, r.end - r.begin) ? 0 : 1;
}
ern_status ERN_REF(ern_cpu_finite)(struct ern_stream *stream, struct ern_finite_args *a) {
  a->finite = sum_of_parts(stream, a, finite_task) == 0;
  return ERN_OK;
}
