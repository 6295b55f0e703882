/* SPDX-License-Identifier: MIT
 * Slots from pixels to samples. */
#include "backend_cpu/slots.h"
#include "render/march_ops.h"

ERN_SHARDED_SLOT(rays, a->n, 64) {
  kernels->rays(reals(a->dir.span) + r.begin, a->dir.stride, int32s(a->pixel) + r.begin, &a->view, r.end - r.begin);
}

ERN_SHARDED_SLOT(march, a->n, 64) {
  kernels->march(reals(a->t) + r.begin * (size_t)a->settings.max_steps, int32s(a->count) + r.begin,
                 reals(a->dir.span) + r.begin, a->dir.stride, after(reals(a->jitter), r.begin), bytes(a->bits),
                 a->origin, &a->settings, r.end - r.begin);
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

ERN_SHARDED_SLOT(samples, a->n, 64) {
  kernels->samples(reals(a->x.span), a->x.stride, reals(a->dt), reals(a->depth), int32s(a->ray),
                   reals(a->t) + r.begin * (size_t)a->settings.max_steps, int32s(a->first) + r.begin,
                   reals(a->dir.span) + r.begin, a->dir.stride, a->origin, &a->settings, r.begin, r.end - r.begin);
}

ERN_SHARDED_SLOT(spread_rays, a->n, 64) {
  kernels->spread_rays(reals(a->y.span) + r.begin, a->y.stride, reals(a->x.span), a->x.stride, int32s(a->ray) + r.begin,
                       a->y.rows, r.end - r.begin);
}
