/* SPDX-License-Identifier: MIT
 * The list of operations. NOUN_ops.h declares the arguments of a noun's operations and, at its end, lists their names;
 * ERN_OPERATIONS joins these lists. Everything else about an operation is derived from it: the slots of a backend
 * (core/backend.h), the kernels of the CPU and their table (core/kernels.h), the functions behind the slots of a CPU
 * (backend_cpu/slots.h) and of an OpenCL device (backend_opencl/opencl.h).
 *
 * A row is OP(X, NAME, slot, kernel).
 * slot: SLOT where a backend has one: ern_status f(struct ern_stream *, struct ern_NAME_args *); else NONE.
 * kernel, of the type ern_NAME_kernel: REF: only the reference has one; FAST: each instruction set has its own; NONE:
 * the CPU's slot does all the work. */
#ifndef ERN_CORE_OPERATIONS_H
#define ERN_CORE_OPERATIONS_H

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
#include "render/render_ops.h"
#include "render/upsample_ops.h"
#include "train/losses_ops.h"
#include "train/optimizer_ops.h"
#include "train/patches_ops.h"
#include "train/step_ops.h"

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

#endif
