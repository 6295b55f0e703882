/* SPDX-License-Identifier: MIT
 * The slots of the head's training as the CPU's fast instruction sets fill them. */
#ifndef ERN_FUSED_STEP_H
#define ERN_FUSED_STEP_H

#include "core/backend.h"

/* Overwrites head_step and head_density of a table of floats whose ern_cpu_backend has train kernels; a model whose
 * layers these do not know goes through the stages. */
void ern_cpu_fuse_step(struct ern_backend *backend);

/* What a stream keeps from step to step. */
struct ern_train_workspace;
void ern_train_workspace_free(ern_context *context, struct ern_train_workspace *workspace); /* accepts NULL */

#endif
