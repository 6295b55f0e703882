/* SPDX-License-Identifier: MIT
 * Slots from pixels to samples. */
#include "backend_cpu/slots.h"

static void rays_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_rays_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->rays(reals(a->dir.span) + r.begin, a->dir.stride, int32s(a->pixel) + r.begin, &a->view,
                     r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_rays)(struct ern_stream *stream, struct ern_rays_args *a) {
  run(stream, a, ERN_SHARDS, rays_task);
  return ERN_OK;
}

static void march_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_march_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->march(reals(a->t) + r.begin * (size_t)a->settings.max_steps, int32s(a->count) + r.begin,
                      reals(a->dir.span) + r.begin, a->dir.stride, after(reals(a->jitter), r.begin), bytes(a->bits),
                      a->origin, &a->settings, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_march)(struct ern_stream *stream, struct ern_march_args *a) {
  run(stream, a, ERN_SHARDS, march_task);
  return ERN_OK;
}

ern_status ERN_REF(ern_cpu_scan)(struct ern_stream *stream, struct ern_scan_args *a) {
  const int32_t *count = int32s(a->count);
  int32_t *first = int32s(a->first);
  int64_t total = 0;
  for (size_t i = 0; i < a->n; i++) {
    first[i] = (int32_t)total;
    total += count[i];
    if (total > INT32_MAX)
      return ern_fail(stream->backend->context, ERN_E_NO_MEMORY, "march: more than %d samples in one batch", INT32_MAX);
  }
  first[a->n] = (int32_t)total;
  a->total = (size_t)total;
  return ERN_OK;
}

static void samples_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_samples_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->samples(reals(a->x.span), a->x.stride, reals(a->dt), reals(a->depth), int32s(a->ray),
                        reals(a->t) + r.begin * (size_t)a->settings.max_steps, int32s(a->first) + r.begin,
                        reals(a->dir.span) + r.begin, a->dir.stride, a->origin, &a->settings, r.begin, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_samples)(struct ern_stream *stream, struct ern_samples_args *a) {
  run(stream, a, ERN_SHARDS, samples_task);
  return ERN_OK;
}
