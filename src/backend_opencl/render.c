/* SPDX-License-Identifier: MIT
 * The slots of the fused passes: choose between one fused kernel and the stages. */
#include "backend_opencl/render.h"

#include "backend_opencl/opencl.h"
#include "backend_opencl/portrait.h"
#include "backend_opencl/render_head.h"
#include "backend_opencl/render_torso.h"
#include "core/memory.h"
#include "model/torso_ops.h"
#include "render/render_ops.h"
#include "render/stages.h"

void ern_cl_portrait_free(struct ern_cl_stream *stream) {
  struct ern_cl_portrait *portrait = stream->portrait;
  if (portrait == NULL) return;
  ern_cl_head_free(stream, portrait->head);
  ern_cl_torso_free(stream, portrait->torso);
  ern_release(stream->owner->table.context, portrait);
  stream->portrait = NULL;
}

ern_status ern_cl_render_prepare(struct ern_stream *stream, struct ern_render_prepare_args *a) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  ern_context *context = own->owner->table.context;
  char last_error[ERN_ERROR_BYTES];
  ern_status status = ERN_OK;
  ern_error_keep(context, last_error);
  ern_cl_portrait_free(own);
  ERN_TRY(ERN_NEW(context, 1, &own->portrait));
  status = ern_cl_clean_up(stream, ern_cl_head_make(stream, a, &own->portrait->head));
  if (status == ERN_OK) status = ern_cl_clean_up(stream, ern_cl_torso_make(stream, a, &own->portrait->torso));
  if (status == ERN_E_NO_MEMORY) {
    ern_log(context, ERN_LOG_INFO,
            "OpenCL: too little memory to prepare a model; rendering by stages, which is slower");
    ern_error_restore(context, last_error);
    status = ERN_OK;
  }
  ERN_TRY(status);
  own->portrait->of = a->parameters;
  return ERN_OK;
fail:
  ern_cl_portrait_free(own);
  return status;
}

/* NULL: nothing was prepared for these. */
static struct ern_cl_portrait *prepared_for(struct ern_stream *stream, ern_span parameters) {
  struct ern_cl_portrait *portrait = ern_cl_stream_of(stream)->portrait;
  const bool same = portrait != NULL && portrait->of.buffer == parameters.buffer && portrait->of.at == parameters.at;
  return same ? portrait : NULL;
}

/* ---- a frame ----------------------------------------------------------------------------------------------------- */

static ern_rows rows_from(ern_rows rows, size_t first) {
  if (rows.span.buffer != NULL) rows.span = ern_cl_from(rows.span, first);
  return rows;
}
static ern_span span_part(ern_span span, size_t first, size_t count) {
  return span.buffer != NULL ? ern_span_part(span, first, count) : span;
}

/* Rays are independent: where memory is too small for all of them at once, renders them in parts. */
static ern_status by_stages(struct ern_stream *stream, const struct ern_render_rays_args *all) {
  ern_context *context = stream->backend->context;
  char last_error[ERN_ERROR_BYTES];
  size_t most = all->n;
  ern_error_keep(context, last_error);
  for (size_t first = 0; first < all->n;) {
    const size_t n = all->n - first < most ? all->n - first : most;
    struct ern_render_rays_args part = *all;
    part.n = n;
    part.pixel = rows_from(all->pixel, first);
    part.colour = rows_from(all->colour, first);
    part.background = rows_from(all->background, first);
    part.opacity = span_part(all->opacity, first, n);
    part.depth = span_part(all->depth, first, n);
    part.attention = span_part(all->attention, first, n);
    part.eye = span_part(all->eye, first, n);
    part.pixel_number = span_part(all->pixel_number, first, n);
    const ern_status status = ern_cl_clean_up(stream, ern_render_rays_stages(stream, &part));
    if (status == ERN_OK) {
      first += n;
    } else if (status == ERN_E_NO_MEMORY && n > 1) {
      most = (n + 1) / 2;
    } else {
      return status;
    }
  }
  ern_error_restore(context, last_error);
  return ERN_OK;
}

ern_status ern_cl_render_rays(struct ern_stream *stream, struct ern_render_rays_args *a) {
  const struct ern_cl_portrait *portrait = prepared_for(stream, a->parameters);
  const bool fused = portrait != NULL && portrait->head != NULL && a->settings.bound == a->field->config.bound &&
                     a->n <= INT32_MAX / 2;
  char last_error[ERN_ERROR_BYTES];
  if (!fused || a->n == 0) return by_stages(stream, a);
  ern_error_keep(stream->backend->context, last_error);
  ern_status status = ern_cl_clean_up(stream, ern_cl_head_render(stream, portrait->head, a));
  if (status != ERN_E_NO_MEMORY) return status;
  status = by_stages(stream, a);
  if (status == ERN_OK) ern_error_restore(stream->backend->context, last_error);
  return status;
}

ern_status ern_cl_render_torso(struct ern_stream *stream, struct ern_render_torso_args *a) {
  const struct ern_cl_portrait *portrait = prepared_for(stream, a->parameters);
  const bool fused = portrait != NULL && portrait->torso != NULL;
  const struct ern_torso_place at = ern_torso_place_of(a); /* the kernel needs the frame to be the picture */
  const bool whole = at.top == 0 && at.left == 0 && at.width == a->width && at.height == a->height;
  return fused && whole ? ern_cl_torso_render(stream, portrait->torso, a) : ern_render_torso_stages(stream, a);
}
