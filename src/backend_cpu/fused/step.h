/* SPDX-License-Identifier: MIT
 * The fused implementation of the head's training slots, for the CPU's SIMD instruction sets. */
#ifndef ERN_FUSED_STEP_H
#define ERN_FUSED_STEP_H

#include "core/backend.h"

/* Overwrites head_step and head_density of a float backend whose ern_cpu_backend has train kernels. A model whose
 * layers these do not support runs the separate stages. */
void ern_cpu_fuse_step(struct ern_backend *backend);

/* Memory that a stream keeps from step to step. */
struct ern_train_workspace;
void ern_train_workspace_free(ern_context *context, struct ern_train_workspace *workspace); /* accepts NULL */

#endif
