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
  ern_cl_rows(&call, a->pixel);
  ern_cl_rows(&call, a->colour);
  ern_cl_span(&call, a->opacity);
  ern_cl_span(&call, a->depth);
  ern_cl_span(&call, a->attention);
  ern_cl_span(&call, a->eye);
  ern_cl_span(&call, a->uncertainty);
  ern_cl_span(&call, a->first);
  ern_cl_span(&call, a->sigma);
  ern_cl_span(&call, a->dt);
  ern_cl_span(&call, a->sample_depth);
  ern_cl_span(&call, a->sample_attention);
  ern_cl_span(&call, a->sample_eye);
  ern_cl_span(&call, a->sample_uncertainty);
  ern_cl_rows(&call, a->rgb);
  ern_cl_rows(&call, a->background);
  ern_cl_float(&call, a->transmittance_stop);
  ern_cl_size(&call, a->n);
  return run_rays(&call, a->n);
}

ern_status ern_cl_composite_bwd(struct ern_stream *stream, struct ern_composite_bwd_args *a) {
  const struct ern_composite_fwd_args *f = &a->forward;
  if (f->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_composite, "composite_bwd", "");
  ern_cl_span(&call, a->dsigma);
  ern_cl_rows(&call, a->drgb);
  ern_cl_span(&call, a->dsample_attention);
  ern_cl_span(&call, a->dsample_eye);
  ern_cl_span(&call, a->dsample_uncertainty);
  ern_cl_rows(&call, a->dpixel);
  ern_cl_span(&call, a->dopacity);
  ern_cl_span(&call, a->dattention);
  ern_cl_span(&call, a->deye);
  ern_cl_span(&call, a->duncertainty);
  ern_cl_rows(&call, f->colour);
  ern_cl_span(&call, f->opacity);
  ern_cl_span(&call, f->first);
  ern_cl_span(&call, f->sigma);
  ern_cl_span(&call, f->dt);
  ern_cl_span(&call, f->sample_uncertainty);
  ern_cl_rows(&call, f->rgb);
  ern_cl_rows(&call, f->background);
  ern_cl_float(&call, f->transmittance_stop);
  ern_cl_size(&call, f->n);
  return run_rays(&call, f->n);
}
