/* SPDX-License-Identifier: MIT
 * The reference kernels of render_ops.h. */
#ifndef ERN_RENDER_KERNELS_H
#define ERN_RENDER_KERNELS_H

#include "render/picture_ops.h"
#include "render/render_ops.h"

ern_rays_kernel ERN_REF(ern_rays);
ern_march_kernel ERN_REF(ern_march);
ern_march_from_kernel ERN_REF(ern_march_from);
ern_samples_kernel ERN_REF(ern_samples);
ern_composite_fwd_kernel ERN_REF(ern_composite_fwd);
ern_composite_bwd_kernel ERN_REF(ern_composite_bwd);
ern_occupancy_mark_kernel ERN_REF(ern_occupancy_mark);
ern_occupancy_list_kernel ERN_REF(ern_occupancy_list);
ern_occupancy_points_kernel ERN_REF(ern_occupancy_points);
ern_occupancy_update_kernel ERN_REF(ern_occupancy_update);
ern_occupancy_pack_kernel ERN_REF(ern_occupancy_pack);
ern_backdrop_kernel ERN_REF(ern_backdrop);
ern_picture_kernel ERN_REF(ern_picture);
ern_enlarge_kernel ERN_REF(ern_enlarge);
ern_pick_kernel ERN_REF(ern_pick);
ern_pick_kernel ERN_REF(ern_place);
ern_blend_kernel ERN_REF(ern_blend);
ern_overlay_kernel ERN_REF(ern_overlay);

#endif
