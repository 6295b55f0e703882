/* SPDX-License-Identifier: MIT
 * Slots of the activations. */
#include "backend_cpu/slots.h"

ERN_SHARDED_SLOT(activate_fwd, a->n, 64) {
  for (size_t c = 0; c < (size_t)a->y.rows; c++)
    kernels->activate_fwd(reals(a->y.span) + c * a->y.stride + r.begin, reals(a->x.span) + c * a->x.stride + r.begin,
                          a->kind, r.end - r.begin);
}
ERN_SHARDED_SLOT(activate_bwd, a->n, 64) {
  for (size_t c = 0; c < (size_t)a->dx.rows; c++)
    kernels->activate_bwd(reals(a->dx.span) + c * a->dx.stride + r.begin,
                          reals(a->dy.span) + c * a->dy.stride + r.begin, reals(a->x.span) + c * a->x.stride + r.begin,
                          a->kind, r.end - r.begin);
}
