/* SPDX-License-Identifier: MIT
 * Slots of the activations. */
#include "backend_cpu/slots.h"

static void activate_fwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_activate_fwd_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  for (size_t c = 0; c < (size_t)a->y.rows; c++)
    job->kernels->activate_fwd(reals(a->y.span) + c * a->y.stride + r.begin,
                               reals(a->x.span) + c * a->x.stride + r.begin, a->kind, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_activate_fwd)(struct ern_stream *stream, struct ern_activate_fwd_args *a) {
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
ern_status ERN_REF(ern_cpu_activate_bwd)(struct ern_stream *stream, struct ern_activate_bwd_args *a) {
  run(stream, a, ERN_SHARDS, activate_bwd_task);
  return ERN_OK;
}
