/* SPDX-License-Identifier: MIT
 * Slots from samples to pixels. */
#include "backend_cpu/slots.h"
#include "render/composite_ops.h"

static struct ern_composite_view composite_view(const struct ern_composite_fwd_args *a, size_t begin) {
  return (struct ern_composite_view){.pixel = after(reals(a->pixel.span), begin),
                                     .colour = after(reals(a->colour.span), begin),
                                     .opacity = after(reals(a->opacity), begin),
                                     .depth = after(reals(a->depth), begin),
                                     .attention = after(reals(a->attention), begin),
                                     .eye = after(reals(a->eye), begin),
                                     .uncertainty = after(reals(a->uncertainty), begin),
                                     .first = int32s(a->first) + begin,
                                     .sigma = reals(a->sigma),
                                     .dt = reals(a->dt),
                                     .sample_depth = reals(a->sample_depth),
                                     .sample_attention = reals(a->sample_attention),
                                     .sample_eye = reals(a->sample_eye),
                                     .sample_uncertainty = reals(a->sample_uncertainty),
                                     .rgb = reals(a->rgb.span),
                                     .background = after(reals(a->background.span), begin),
                                     .ray_stride = a->background.stride,
                                     .rgb_stride = a->rgb.stride,
                                     .transmittance_stop = a->transmittance_stop};
}
ERN_SHARDED_SLOT(composite_fwd, a->n, 64) {
  const struct ern_composite_view view = composite_view(a, r.begin);
  kernels->composite_fwd(&view, r.end - r.begin);
}
ERN_SHARDED_SLOT(composite_bwd, a->forward.n, 64) {
  const struct ern_composite_bwd_view view = {.dsigma = reals(a->dsigma),
                                              .drgb = reals(a->drgb.span),
                                              .dsample_attention = reals(a->dsample_attention),
                                              .dsample_eye = reals(a->dsample_eye),
                                              .dsample_uncertainty = reals(a->dsample_uncertainty),
                                              .dpixel = after(reals(a->dpixel.span), r.begin),
                                              .dopacity = after(reals(a->dopacity), r.begin),
                                              .dattention = after(reals(a->dattention), r.begin),
                                              .deye = after(reals(a->deye), r.begin),
                                              .duncertainty = after(reals(a->duncertainty), r.begin),
                                              .forward = composite_view(&a->forward, r.begin)};
  kernels->composite_bwd(&view, r.end - r.begin);
}
