/* SPDX-License-Identifier: MIT
 * Slots of the encodings. */
#include "backend_cpu/slots.h"
#include "mlp/encoding_ops.h"

ERN_SHARDED_SLOT(sh_fwd, a->n, 64) {
  kernels->sh_fwd(reals(a->y.span) + r.begin, a->y.stride, reals(a->d.span) + r.begin, a->d.stride, r.end - r.begin);
}

ERN_SHARDED_SLOT(sh_bwd, a->n, 64) {
  kernels->sh_bwd(reals(a->dd.span) + r.begin, a->dd.stride, reals(a->dy.span) + r.begin, a->dy.stride,
                  reals(a->d.span) + r.begin, a->d.stride, r.end - r.begin);
}

ERN_SHARDED_SLOT(freq_fwd, a->n, 64) {
  kernels->freq_fwd(reals(a->y.span) + r.begin, a->y.stride, reals(a->x.span) + r.begin, a->x.stride, a->x.rows,
                    a->octaves, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_freq_bwd)(struct ern_stream *stream, struct ern_freq_bwd_args *a) {
  kernels_of(stream)->freq_bwd(reals(a->dx.span), a->dx.stride, reals(a->dy.span), a->dy.stride, reals(a->x.span),
                               a->x.stride, a->x.rows, a->octaves, a->n);
  return ERN_OK;
}
