/* SPDX-License-Identifier: MIT
 * Data that a frame keeps for the next one (ern_renderer_reuse_rays): the layers behind the head, and the results of
 * its rays.
 *
 * A ray keeps its sum w rgb and its opacity, so it can be composited over another background; it keeps depth and
 * attention where they are wanted. While the view does not change, rays are of three kinds (ray_reuse_classify.c): rays
 * without samples; steady rays, whose colour depends so smoothly on speech and eyes that it is interpolated between
 * keyframes of the speech (keyframes.h); and rays that are rendered in every frame. */
#ifndef ERN_RENDER_RAY_REUSE_H
#define ERN_RENDER_RAY_REUSE_H

#include "render/renderer_state.h"

/* Channels that are kept of a ray, each a row of the picture. */
enum { ERN_RAY_REUSE_CHANNELS = 7 };
/* The rows of `args` that are not zeroed: colour (the pixel, where there is no background), opacity, depth, attention,
 * eye. Returns how many. */
size_t ern_ray_reuse_rows(ern_rows rows[ERN_RAY_REUSE_CHANNELS], const ern_renderer *r,
                          const struct ern_render_rays_args *args);

/* Sorts the rays of a view. */
ERN_NODISCARD ern_status ern_ray_reuse_classify(ern_renderer *r, const struct ern_render_rays_args *all);
void ern_reused_rays_free(ern_renderer *r);

/* Renders some of the rays of `all`, those of the pixels in `list` (int32), into scratch rows in the order of the list,
 * with the outputs that `all` wants. ray: their numbers in all->pixel_number. */
ERN_NODISCARD ern_status ern_ray_reuse_render(ern_renderer *r, const struct ern_render_rays_args *all, ern_span list,
                                              ern_span ray, struct ern_render_rays_args *some);

/* Renders all rays of a picture, or only those that have changed since the frame before. over: the frame has a
 * background, which may change in the next frame; else there is none. */
ERN_NODISCARD ern_status ern_ray_reuse_head(ern_renderer *r, const struct ern_render_rays_args *all, bool over);

/* Sets behind_changed: whether the background rows must be made again. Keeps a copy of the input; the code that makes
 * the rows then sets `known`. */
ERN_NODISCARD ern_status ern_ray_reuse_check_background(ern_renderer *r, const ern_frame_input *input);

/* Marks the kept rows as unknown, after they were lost or became out of date. */
void ern_ray_reuse_forget(ern_renderer *r);
void ern_ray_reuse_free(ern_renderer *r);

#endif
