/* SPDX-License-Identifier: MIT
 * The kernels that are compiled for instruction sets of x86: signatures and semantics are those of the ops headers,
 * float only; there where ERN_X86_KERNELS is defined. Each needs the instruction sets its suffix names: avx2: AVX2 and
 * FMA; avx512: AVX-512 F, DQ, BW, VL. */
#ifndef ERN_KERNELS_X86_H
#define ERN_KERNELS_X86_H

#include "hashgrid/hashgrid_ops.h"
#include "mlp/mlp_ops.h"

ern_grid_fwd_kernel ern_grid_fwd_avx2, ern_grid_fwd_avx512;
ern_grid_bwd_kernel ern_grid_bwd_avx2, ern_grid_bwd_avx512;
ern_mlp_fwd_kernel ern_mlp_fwd_avx2, ern_mlp_fwd_avx512;
ern_mlp_bwd_kernel ern_mlp_bwd_avx2, ern_mlp_bwd_avx512;
ern_activate_fwd_kernel ern_activate_fwd_avx2, ern_activate_fwd_avx512;
ern_activate_bwd_kernel ern_activate_bwd_avx2, ern_activate_bwd_avx512;

#endif
