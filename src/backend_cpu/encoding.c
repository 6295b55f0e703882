/* SPDX-License-Identifier: MIT
 * Slots of the encodings. */
#include "backend_cpu/slots.h"

static void sh_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_sh_fwd_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->sh_fwd(reals(a->y.span) + r.begin, a->y.stride, reals(a->d.span) + r.begin, a->d.stride,
                       r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_sh_fwd)(struct ern_stream *stream, struct ern_sh_fwd_args *a) {
  run(stream, a, ERN_SHARDS, sh_task);
  return ERN_OK;
}

static void freq_fwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_freq_fwd_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->freq_fwd(reals(a->y.span) + r.begin, a->y.stride, reals(a->x.span) + r.begin, a->x.stride, a->x.rows,
                         a->octaves, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_freq_fwd)(struct ern_stream *stream, struct ern_freq_fwd_args *a) {
  run(stream, a, ERN_SHARDS, freq_fwd_task);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_freq_bwd)(struct ern_stream *stream, struct ern_freq_bwd_args *a) {
  kernels_of(stream)->freq_bwd(reals(a->dx.span), a->dx.stride, reals(a->dy.span), a->dy.stride, reals(a->x.span),
                               a->x.stride, a->x.rows, a->octaves, a->n);
  return ERN_OK;
}
