/* SPDX-License-Identifier: MIT
 * Slots from samples to pixels, and between pixels and the caller's pictures. */
#include "backend_opencl/opencl.h"

/* Items that carry n elements, a device's vector each. */
static ern_status run_vectors(struct ern_cl_call *call, size_t n) {
  const size_t width = (size_t)call->stream->owner->device.width;
  return ern_cl_each(call, n / width + (n % width != 0));
}

/* An item carries RAYS rays of kernels/composite.cl. */
static ern_status run_rays(struct ern_cl_call *call, size_t n) {
  enum { RAYS = 64, GROUP = 4 };
  if (call->stream->owner->device.width == 1) return ern_cl_each(call, n);
  return ern_cl_run(call, n / (RAYS * GROUP) + (n % (RAYS * GROUP) != 0), GROUP);
}

static ern_status composite_fwd(struct ern_stream *stream, struct ern_composite_args *a) {
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

static ern_status composite_bwd(struct ern_stream *stream, struct ern_composite_bwd_args *a) {
  const struct ern_composite_args *f = &a->forward;
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

static ern_status backdrop(struct ern_stream *stream, struct ern_backdrop_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "backdrop", "");
  ern_cl_rows(&call, a->pixel);
  ern_cl_span(&call, a->opacity);
  ern_cl_span(&call, a->background);
  ern_cl_span(&call, a->torso);
  ern_cl_size(&call, a->n);
  return run_vectors(&call, a->n);
}

static ern_status picture(struct ern_stream *stream, struct ern_picture_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "picture", "");
  ern_cl_span(&call, a->rgba);
  ern_cl_span(&call, a->rgb);
  ern_cl_span(&call, a->alpha);
  ern_cl_rows(&call, a->pixel);
  ern_cl_span(&call, a->head);
  ern_cl_span(&call, a->torso);
  ern_cl_size(&call, a->n);
  return run_vectors(&call, a->n);
}

static ern_status enlarge(struct ern_stream *stream, struct ern_enlarge_args *a) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_enlarge, "enlarge", "");
  ern_cl_rows(&call, a->large);
  ern_cl_rows(&call, a->small);
  ern_cl_rows(&call, a->background);
  ern_cl_int(&call, a->large.rows);
  ern_cl_int(&call, a->width);
  ern_cl_int(&call, a->height);
  ern_cl_int(&call, a->small_width);
  ern_cl_int(&call, a->small_height);
  ern_cl_float(&call, a->ratio);
  return ern_cl_each(&call, (size_t)a->width * (size_t)a->height);
}

static ern_status pick_or_place(struct ern_stream *stream, const char *kernel, const struct ern_pick_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, kernel, "");
  ern_cl_rows(&call, a->to);
  ern_cl_rows(&call, a->from);
  ern_cl_span(&call, a->pixel);
  ern_cl_int(&call, a->from.rows);
  ern_cl_size(&call, a->n);
  return ern_cl_each(&call, a->n);
}
static ern_status pick(struct ern_stream *stream, struct ern_pick_args *a) { return pick_or_place(stream, "pick", a); }
static ern_status place(struct ern_stream *stream, struct ern_pick_args *a) {
  return pick_or_place(stream, "place", a);
}

static ern_status blend(struct ern_stream *stream, struct ern_blend_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "blend", "");
  ern_cl_span(&call, a->to);
  ern_cl_rows(&call, a->from);
  ern_cl_span(&call, a->weight);
  ern_cl_span(&call, a->pixel);
  ern_cl_size(&call, a->weight.count);
  ern_cl_size(&call, a->n);
  return ern_cl_each(&call, a->n);
}

static ern_status overlay(struct ern_stream *stream, struct ern_overlay_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_picture, "overlay", "");
  ern_cl_rows(&call, a->pixel);
  ern_cl_rows(&call, a->colour);
  ern_cl_span(&call, a->opacity);
  ern_cl_rows(&call, a->background);
  ern_cl_size(&call, a->n);
  return run_vectors(&call, a->n);
}

void ern_cl_fill_composite(struct ern_backend *table) {
  table->composite_fwd = composite_fwd;
  table->composite_bwd = composite_bwd;
  table->backdrop = backdrop;
  table->picture = picture;
  table->enlarge = enlarge;
  table->pick = pick;
  table->place = place;
  table->blend = blend;
  table->overlay = overlay;
}
