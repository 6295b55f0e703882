/* SPDX-License-Identifier: MIT
 * The kernels that are compiled once for each instruction set: signatures and semantics are those of the ops headers,
 * float only. Each needs what its suffix names: avx2: AVX2 and FMA; avx512: AVX-512 F, DQ, BW, VL (both there where
 * ERN_X86_KERNELS is defined); neon: any aarch64 (where ERN_ARM_KERNELS is). */
#ifndef ERN_KERNELS_ISA_H
#define ERN_KERNELS_ISA_H

#include "hashgrid/hashgrid_ops.h"
#include "mlp/mlp_ops.h"

#define ERN_KERNELS_OF(isa)                              \
  extern ern_grid_fwd_kernel ern_grid_fwd_##isa;         \
  extern ern_grid_bwd_kernel ern_grid_bwd_##isa;         \
  extern ern_mlp_fwd_kernel ern_mlp_fwd_##isa;           \
  extern ern_mlp_bwd_kernel ern_mlp_bwd_##isa;           \
  extern ern_activate_fwd_kernel ern_activate_fwd_##isa; \
  extern ern_activate_bwd_kernel ern_activate_bwd_##isa

ERN_KERNELS_OF(avx2);
ERN_KERNELS_OF(avx512);
ERN_KERNELS_OF(neon);

#endif
