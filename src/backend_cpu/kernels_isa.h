/* SPDX-License-Identifier: MIT
 * The kernels that are compiled once for each instruction set: signatures and semantics are those of the ops headers,
 * float only. Each needs what its suffix names: avx2: AVX2 and FMA; avx512: AVX-512 F, DQ, BW, VL (both there where
 * ERN_X86_KERNELS is defined); neon: any aarch64 (where ERN_ARM_KERNELS is). */
#ifndef ERN_KERNELS_ISA_H
#define ERN_KERNELS_ISA_H

#include "hashgrid/hashgrid_ops.h"
#include "mlp/mlp_ops.h"
#include "model/attention_ops.h"
#include "render/picture_ops.h"
#include "render/render_ops.h"
#include "train/train_ops.h"

#define ERN_KERNELS_OF(isa)                                      \
  extern ern_rays_kernel ern_rays_##isa;                         \
  extern ern_march_kernel ern_march_##isa;                       \
  extern ern_march_from_kernel ern_march_from_##isa;             \
  extern ern_samples_kernel ern_samples_##isa;                   \
  extern ern_grid_fwd_kernel ern_grid_fwd_##isa;                 \
  extern ern_grid_bwd_kernel ern_grid_bwd_##isa;                 \
  extern ern_mlp_fwd_kernel ern_mlp_fwd_##isa;                   \
  extern ern_mlp_bwd_kernel ern_mlp_bwd_##isa;                   \
  extern ern_sh_kernel ern_sh_fwd_##isa;                         \
  extern ern_freq_fwd_kernel ern_freq_fwd_##isa;                 \
  extern ern_freq_bwd_kernel ern_freq_bwd_##isa;                 \
  extern ern_attention_fwd_kernel ern_attention_fwd_##isa;       \
  extern ern_attention_bwd_kernel ern_attention_bwd_##isa;       \
  extern ern_composite_fwd_kernel ern_composite_fwd_##isa;       \
  extern ern_composite_bwd_kernel ern_composite_bwd_##isa;       \
  extern ern_occupancy_points_kernel ern_occupancy_points_##isa; \
  extern ern_occupancy_update_kernel ern_occupancy_update_##isa; \
  extern ern_occupancy_pack_kernel ern_occupancy_pack_##isa;     \
  extern ern_head_softmax_kernel ern_head_softmax_##isa;         \
  extern ern_head_loss_kernel ern_head_loss_##isa;               \
  extern ern_smooth_loss_kernel ern_smooth_loss_##isa;           \
  extern ern_smooth_points_kernel ern_smooth_points_##isa;       \
  extern ern_mse_kernel ern_mse_##isa;                           \
  extern ern_adamw_kernel ern_adamw_##isa;                       \
  extern ern_ema_kernel ern_ema_##isa;                           \
  extern ern_finite_kernel ern_finite_##isa;                     \
  extern ern_activate_fwd_kernel ern_activate_fwd_##isa;         \
  extern ern_activate_bwd_kernel ern_activate_bwd_##isa;         \
  extern ern_backdrop_kernel ern_backdrop_##isa;                 \
  extern ern_picture_kernel ern_picture_##isa

ERN_KERNELS_OF(avx2);
ERN_KERNELS_OF(avx512);
ERN_KERNELS_OF(neon);

#endif
