/* SPDX-License-Identifier: MIT
 * The list of operations, by noun. NOUN_ops.h declares the arguments of a noun's operations and the types of their
 * kernels; their names stand here, apart, so that what needs the names alone does not depend on every argument.
 * Everything else about an operation is derived from its row: the slots of a backend (core/backend.h), the kernels of
 * the CPU and their table (NOUN_ops.h, backend_cpu/cpu_kernels.h), the functions behind the slots of a CPU
 * (backend_cpu/slots.h) and of an OpenCL device (backend_opencl/opencl.h).
 *
 * A row is OP(X, NAME, slot, kernel).
 * slot: SLOT where a backend has one: ern_status f(struct ern_stream *, struct ern_NAME_args *); else NONE.
 * kernel, of the type ern_NAME_kernel: REF: only the reference has one; FAST: each instruction set has its own; NONE:
 * the CPU's slot does all the work. */
#ifndef ERN_CORE_OPERATIONS_H
#define ERN_CORE_OPERATIONS_H

#include "core/types.h"

#define ERN_HASHGRID_OPERATIONS(OP, X) \
  OP(X, grid_fwd, SLOT, FAST)          \
  OP(X, grid_bwd, SLOT, FAST)

#define ERN_ACTIVATION_OPERATIONS(OP, X) \
  OP(X, activate_fwd, SLOT, FAST)        \
  OP(X, activate_bwd, SLOT, FAST)

#define ERN_AUDIO_OPERATIONS(OP, X) \
  OP(X, audio_fwd, SLOT, FAST)      \
  OP(X, audio_bwd, SLOT, FAST)      \
  OP(X, audio_frame, SLOT, NONE)    \
  OP(X, audio_window, NONE, REF)    \
  OP(X, audio_mix, NONE, REF)       \
  OP(X, audio_mix_bwd, NONE, REF)

#define ERN_ENCODING_OPERATIONS(OP, X) \
  OP(X, sh_fwd, SLOT, FAST)            \
  OP(X, sh_bwd, SLOT, REF)             \
  OP(X, freq_fwd, SLOT, FAST)          \
  OP(X, freq_bwd, SLOT, FAST)

#define ERN_MLP_OPERATIONS(OP, X) \
  OP(X, mlp_fwd, SLOT, FAST)      \
  OP(X, mlp_bwd, SLOT, FAST)

#define ERN_ATTENTION_OPERATIONS(OP, X) \
  OP(X, attention_fwd, SLOT, FAST)      \
  OP(X, attention_bwd, SLOT, FAST)      \
  OP(X, attention_fade, SLOT, REF)

#define ERN_TORSO_OPERATIONS(OP, X)     \
  OP(X, torso_pose_fwd, SLOT, REF)      \
  OP(X, torso_pose_bwd, SLOT, REF)      \
  OP(X, torso_coords, SLOT, REF)        \
  OP(X, torso_select, SLOT, REF)        \
  OP(X, torso_move, SLOT, REF)          \
  OP(X, torso_deform_fwd, SLOT, REF)    \
  OP(X, torso_deform_bwd, SLOT, REF)    \
  OP(X, torso_composite_fwd, SLOT, REF) \
  OP(X, torso_composite_bwd, SLOT, REF) \
  OP(X, torso_points, SLOT, REF)        \
  OP(X, torso_update, SLOT, REF)        \
  OP(X, render_torso, SLOT, NONE)

#define ERN_COMPOSITE_OPERATIONS(OP, X) \
  OP(X, composite_fwd, SLOT, FAST)      \
  OP(X, composite_bwd, SLOT, FAST)

#define ERN_MARCH_OPERATIONS(OP, X) \
  OP(X, rays, SLOT, FAST)           \
  OP(X, march, SLOT, FAST)          \
  OP(X, march_from, NONE, FAST)     \
  OP(X, scan, SLOT, NONE)           \
  OP(X, samples, SLOT, FAST)        \
  OP(X, spread_rays, SLOT, REF)

#define ERN_OCCUPANCY_OPERATIONS(OP, X) \
  OP(X, occupancy_mark, SLOT, REF)      \
  OP(X, occupancy_list, SLOT, REF)      \
  OP(X, occupancy_points, SLOT, FAST)   \
  OP(X, occupancy_scatter, SLOT, NONE)  \
  OP(X, occupancy_update, SLOT, FAST)   \
  OP(X, occupancy_pack, NONE, FAST)

#define ERN_PICTURE_OPERATIONS(OP, X) \
  OP(X, background, SLOT, FAST)       \
  OP(X, picture, SLOT, FAST)          \
  OP(X, gather, SLOT, REF)            \
  OP(X, scatter, SLOT, REF)           \
  OP(X, blend, SLOT, REF)             \
  OP(X, overlay, SLOT, REF)           \
  OP(X, finite, SLOT, FAST)

#define ERN_RENDER_OPERATIONS(OP, X) \
  OP(X, render_prepare, SLOT, NONE)  \
  OP(X, render_rays, SLOT, NONE)     \
  OP(X, head_density, SLOT, NONE)

#define ERN_UPSAMPLE_OPERATIONS(OP, X) OP(X, upsample, SLOT, REF)

#define ERN_LOSSES_OPERATIONS(OP, X) \
  OP(X, head_loss, SLOT, FAST)       \
  OP(X, head_softmax, NONE, FAST)    \
  OP(X, smooth_loss, SLOT, FAST)     \
  OP(X, smooth_points, SLOT, FAST)   \
  OP(X, mse, SLOT, FAST)             \
  OP(X, key_points_loss, SLOT, REF)  \
  OP(X, pose_bwd, SLOT, REF)

#define ERN_OPTIMIZER_OPERATIONS(OP, X) \
  OP(X, adamw, SLOT, FAST)              \
  OP(X, ema, SLOT, FAST)

#define ERN_PATCHES_OPERATIONS(OP, X) \
  OP(X, patch_loss, SLOT, NONE)       \
  OP(X, patch_scale, NONE, FAST)

#define ERN_STEP_OPERATIONS(OP, X) \
  OP(X, head_step, SLOT, NONE)     \
  OP(X, torso_step, SLOT, NONE)

#define ERN_OPERATIONS(OP, X)      \
  ERN_HASHGRID_OPERATIONS(OP, X)   \
  ERN_MLP_OPERATIONS(OP, X)        \
  ERN_ACTIVATION_OPERATIONS(OP, X) \
  ERN_ENCODING_OPERATIONS(OP, X)   \
  ERN_AUDIO_OPERATIONS(OP, X)      \
  ERN_ATTENTION_OPERATIONS(OP, X)  \
  ERN_TORSO_OPERATIONS(OP, X)      \
  ERN_MARCH_OPERATIONS(OP, X)      \
  ERN_COMPOSITE_OPERATIONS(OP, X)  \
  ERN_OCCUPANCY_OPERATIONS(OP, X)  \
  ERN_PICTURE_OPERATIONS(OP, X)    \
  ERN_UPSAMPLE_OPERATIONS(OP, X)   \
  ERN_RENDER_OPERATIONS(OP, X)     \
  ERN_LOSSES_OPERATIONS(OP, X)     \
  ERN_PATCHES_OPERATIONS(OP, X)    \
  ERN_OPTIMIZER_OPERATIONS(OP, X)  \
  ERN_STEP_OPERATIONS(OP, X)

/* X(NAME) for each operation that has a slot, a kernel, a kernel of each instruction set. */
#define ERN_SLOTS(X) ERN_OPERATIONS(ERN_OF_SLOT, X)
#define ERN_KERNELS(X) ERN_OPERATIONS(ERN_OF_KERNEL, X)
#define ERN_FAST_KERNELS(X) ERN_OPERATIONS(ERN_OF_FAST_KERNEL, X)

#define ERN_OF_SLOT(X, name, slot, kernel) ERN_SLOT_##slot(X(name))
#define ERN_OF_KERNEL(X, name, slot, kernel) ERN_KERNEL_##kernel(X(name))
#define ERN_OF_FAST_KERNEL(X, name, slot, kernel) ERN_FAST_KERNEL_##kernel(X(name))
#define ERN_SLOT_SLOT(...) __VA_ARGS__
#define ERN_SLOT_NONE(...)
#define ERN_KERNEL_FAST(...) __VA_ARGS__
#define ERN_KERNEL_REF(...) __VA_ARGS__
#define ERN_KERNEL_NONE(...)
#define ERN_FAST_KERNEL_FAST(...) __VA_ARGS__
#define ERN_FAST_KERNEL_REF(...)
#define ERN_FAST_KERNEL_NONE(...)

/* The arguments of each slot, which NOUN_ops.h defines. */
#define ERN_SLOT_ARGS(name) struct ern_##name##_args;
ERN_SLOTS(ERN_SLOT_ARGS)
#undef ERN_SLOT_ARGS

/* What a call of a slot costs, for the benchmark. NOUN_ops.h defines ERN_COST_NAME(args) for each slot, exact for
 * compute-bound kernels, approximate for memory-bound ones, by the equations in docs/maths.md. All but the first two
 * are for an item. */
struct ern_cost {
  const char *item;                        /* "sample"; NULL: not here */
  double items, flops, reals, ints, reads; /* reals, ints: read and written; reads: gathered reads of a table */
};
static inline struct ern_cost ern_cost(const char *item, size_t items, double flops, double reals, double ints,
                                       double reads) {
  return (struct ern_cost){item, (double)items, flops, reals, ints, reads};
}
#define ERN_COST_ELSEWHERE ern_cost(NULL, 0, 0, 0, 0, 0) /* lab/bench/bench_calls.c counts it, or nobody does */

/* Declares a noun's kernels: the reference in the scalar type of this build, and float kernels for each instruction
 * set. The suffix names the instruction set: avx2: AVX2 and FMA; avx512: AVX-512 F, DQ, BW, VL (both built where
 * ERN_X86_KERNELS is defined); neon: any aarch64 (where ERN_ARM_KERNELS is). */
#define ERN_DECLARE_KERNELS(OPERATIONS)                \
  OPERATIONS(ERN_OF_KERNEL, ERN_KERNEL_OF_REF)         \
  OPERATIONS(ERN_OF_FAST_KERNEL, ERN_KERNEL_OF_AVX2)   \
  OPERATIONS(ERN_OF_FAST_KERNEL, ERN_KERNEL_OF_AVX512) \
  OPERATIONS(ERN_OF_FAST_KERNEL, ERN_KERNEL_OF_NEON)
#define ERN_KERNEL_OF_REF(name) ern_##name##_kernel ERN_REF(ern_##name);
#define ERN_KERNEL_OF_AVX2(name) ern_##name##_kernel ern_##name##_avx2;
#define ERN_KERNEL_OF_AVX512(name) ern_##name##_kernel ern_##name##_avx512;
#define ERN_KERNEL_OF_NEON(name) ern_##name##_kernel ern_##name##_neon;

#endif
