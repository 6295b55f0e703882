/* SPDX-License-Identifier: MIT
 * The reference kernels of attention_ops.h and torso_ops.h. */
#ifndef ERN_MODEL_KERNELS_H
#define ERN_MODEL_KERNELS_H

#include "model/attention_ops.h"
#include "model/torso_ops.h"

ern_attention_fwd_kernel ERN_REF(ern_attention_fwd);
ern_attention_bwd_kernel ERN_REF(ern_attention_bwd);
ern_torso_pose_fwd_kernel ERN_REF(ern_torso_pose_fwd);
ern_torso_pose_bwd_kernel ERN_REF(ern_torso_pose_bwd);
ern_torso_coords_kernel ERN_REF(ern_torso_coords);
ern_torso_select_kernel ERN_REF(ern_torso_select);
ern_torso_deform_fwd_kernel ERN_REF(ern_torso_deform_fwd);
ern_torso_deform_bwd_kernel ERN_REF(ern_torso_deform_bwd);
ern_torso_composite_fwd_kernel ERN_REF(ern_torso_composite_fwd);
ern_torso_composite_bwd_kernel ERN_REF(ern_torso_composite_bwd);
ern_torso_points_kernel ERN_REF(ern_torso_points);
ern_torso_update_kernel ERN_REF(ern_torso_update);

#endif
