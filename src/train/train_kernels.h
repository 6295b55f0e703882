/* SPDX-License-Identifier: MIT
 * The reference kernels of train_ops.h. */
#ifndef ERN_TRAIN_KERNELS_H
#define ERN_TRAIN_KERNELS_H

#include "train/train_ops.h"

ern_head_softmax_kernel ERN_REF(ern_head_softmax);
ern_head_loss_kernel ERN_REF(ern_head_loss);
ern_smooth_loss_kernel ERN_REF(ern_smooth_loss);
ern_smooth_points_kernel ERN_REF(ern_smooth_points);
ern_mse_kernel ERN_REF(ern_mse);
ern_key_points_loss_kernel ERN_REF(ern_key_points_loss);
ern_adamw_kernel ERN_REF(ern_adamw);
ern_ema_kernel ERN_REF(ern_ema);
ern_finite_kernel ERN_REF(ern_finite);

#endif
