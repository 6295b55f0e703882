/* SPDX-License-Identifier: MIT
 * The table of the CPU's kernels: one a stage, in the scalar type of the build. backend_cpu.c fills it with the
 * reference kernels, then overwrites those that an instruction set has a faster one for. */
#ifndef ERN_CPU_KERNELS_H
#define ERN_CPU_KERNELS_H

#include "hashgrid/hashgrid_ops.h"
#include "mlp/activation_ops.h"
#include "mlp/audio_ops.h"
#include "mlp/encoding_ops.h"
#include "mlp/mlp_ops.h"
#include "model/attention_ops.h"
#include "model/torso_ops.h"
#include "render/composite_ops.h"
#include "render/march_ops.h"
#include "render/occupancy_ops.h"
#include "render/picture_ops.h"
#include "render/upsample_ops.h"
#include "train/losses_ops.h"
#include "train/optimizer_ops.h"
#include "train/patches_ops.h"

struct ern_cpu_kernels {
#define ERN_KERNEL_MEMBER(name) ern_##name##_kernel *name;
  ERN_KERNELS(ERN_KERNEL_MEMBER)
#undef ERN_KERNEL_MEMBER
};

#endif
