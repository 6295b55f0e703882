/* SPDX-License-Identifier: MIT
 * What one frame leaves for the next (ern_renderer_reuse_rays): the layers behind the head, and what its rays gathered.
 *
 * A ray keeps its sum w rgb and its opacity, so it can go over another background; depth and attention likewise where
 * they are wanted. While a view stands still its rays are of three kinds (ray_reuse_sort.c): without samples; steady,
 * whose light follows speech and eyes so smoothly that it is interpolated between keyframes of the speech
 * (keyframes.h); and those that are rendered anew. */
#ifndef ERN_RENDER_RAY_REUSE_H
#define ERN_RENDER_RAY_REUSE_H

#include "render/renderer_state.h"

/* What a ray has beside its pixel, each a row of the picture. */
enum { ERN_RAY_REUSE_CHANNELS = 7 };
/* Rows of `args` that are there: colour (the pixel, where nothing is behind), opacity, depth, attention, eye. Returns
 * how many. */
size_t ern_ray_reuse_rows(ern_rows rows[ERN_RAY_REUSE_CHANNELS], const ern_renderer *r,
                          const struct ern_render_rays_args *args);

/* Sorts the rays of a view. */
ERN_NODISCARD ern_status ern_ray_reuse_sort(ern_renderer *r, const struct ern_render_rays_args *all);
void ern_reused_rays_free(ern_renderer *r);

/* Renders some of the rays of `all`, those of the pixels in `list` (int32), into rows in the order of the list, made in
 * scratch: what `all` wants of them. ray: their numbers in all->pixel_number. */
ERN_NODISCARD ern_status ern_ray_reuse_render(ern_renderer *r, const struct ern_render_rays_args *all, ern_span list,
                                              ern_span ray, struct ern_render_rays_args *some);

/* Renders all rays of a picture, or only those that have changed since the frame before. over: the background is the
 * frame's, and may be another one in the next; else there is none. */
ERN_NODISCARD ern_status ern_ray_reuse_head(ern_renderer *r, const struct ern_render_rays_args *all, bool over);

/* Whether the background rows have to be made again: behind_changed. Takes note of the input; `known` is then for who
 * makes them to set. */
ERN_NODISCARD ern_status ern_ray_reuse_check_background(ern_renderer *r, const ern_frame_input *input);

/* The rows were lost, or are no longer what they would be. */
void ern_ray_reuse_forget(ern_renderer *r);
void ern_ray_reuse_free(ern_renderer *r);

#endif
