/* SPDX-License-Identifier: MIT
 * The fused rendering slots, implemented by calling the stages: for backends without faster ones of their own. */
#ifndef ERN_RENDER_STAGES_H
#define ERN_RENDER_STAGES_H

#include "core/backend.h"
#include "model/field.h"
#include "render/march_ops.h"

ern_status ern_render_rays_stages(struct ern_stream *stream, struct ern_render_rays_args *args);
ern_status ern_render_torso_stages(struct ern_stream *stream, struct ern_render_torso_args *args);

/* Marched rays and their packed samples, for rendering and training. */
struct ern_marched {
  ern_rows dir;       /* [3] per ray */
  ern_rows sh;        /* [16] per ray, of ern_march_view */
  ern_span first;     /* int32 [rays + 1] */
  size_t total;       /* samples */
  ern_rows x;         /* [3] per sample */
  ern_span dt, depth; /* real [total] */
  ern_span ray;       /* int32 [total] */
};
/* jitter zeroed: none. Takes its rows from the stream's scratch. */
ERN_NODISCARD ern_status ern_march_rays(struct ern_stream *stream, ern_span pixel_number, const struct ern_view *view,
                                        ern_span jitter, ern_span bits, const struct ern_march_settings *settings,
                                        size_t rays, struct ern_marched *marched);
/* Computes marched->sh, after ern_march_rays. Does nothing where the colour does not depend on the direction. */
ERN_NODISCARD ern_status ern_march_view(struct ern_stream *stream, const struct ern_field *field, size_t rays,
                                        struct ern_marched *marched);

#endif
