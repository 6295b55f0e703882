/* SPDX-License-Identifier: MIT
 * The fused rendering slots by calling the stages: what a backend without faster ones of its own puts there. */
#ifndef ERN_RENDER_STAGES_H
#define ERN_RENDER_STAGES_H

#include "core/backend.h"
#include "model/field.h"

ern_status ern_render_rays_stages(struct ern_stream *stream, struct ern_render_rays_args *args);
ern_status ern_render_torso_stages(struct ern_stream *stream, struct ern_render_torso_args *args);

/* Rays to packed samples: what rendering and training share. */
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
/* What the colour reads of the rays' directions, nothing where it reads none; behind ern_march_rays. */
ERN_NODISCARD ern_status ern_march_view(struct ern_stream *stream, const struct ern_field *field, size_t rays,
                                        struct ern_marched *marched);

#endif
