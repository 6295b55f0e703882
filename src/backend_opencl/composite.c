/* SPDX-License-Identifier: MIT
 * Slots from samples to pixels. */
#include "backend_opencl/opencl.h"
#include "render/composite_ops.h"

/* An item processes RAYS rays, as in kernels/composite.cl. */
static ern_status run_rays(struct ern_cl_call *call, size_t n) {
  enum { RAYS = 64, GROUP = 4 };
  if (call->stream->owner->device.width == 1) return ern_cl_each(call, n);
  return ern_cl_run(call, n / (RAYS * GROUP) + (n % (RAYS * GROUP) != 0), GROUP);
}

ern_status ern_cl_composite_fwd(struct ern_stream *stream, struct ern_composite_fwd_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_composite, "composite_fwd", "");
  ERN_CL_ARGS(&call, a->pixel, a->colour, a->opacity, a->depth, a->attention, a->eye, a->uncertainty, a->first,
              a->sigma, a->dt, a->sample_depth, a->sample_attention, a->sample_eye, a->sample_uncertainty, a->rgb,
              a->background);
  ERN_CL_ARGS(&call, a->transmittance_stop, a->n);
  return run_rays(&call, a->n);
}

ern_status ern_cl_composite_bwd(struct ern_stream *stream, struct ern_composite_bwd_args *a) {
  const struct ern_composite_fwd_args *f = &a->forward;
  if (f->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_composite, "composite_bwd", "");
  ERN_CL_ARGS(&call, a->dsigma, a->drgb, a->dsample_attention, a->dsample_eye, a->dsample_uncertainty, a->dpixel,
              a->dopacity, a->dattention, a->deye, a->duncertainty, f->colour, f->opacity, f->first, f->sigma, f->dt,
              f->sample_uncertainty);
  ERN_CL_ARGS(&call, f->rgb, f->background, f->transmittance_stop, f->n);
  return run_rays(&call, f->n);
}
