/* SPDX-License-Identifier: MIT */
#include "backend_cpu/fused/step.h"
#include "backend_cpu/fused/step_pass.h"
#include "core/memory.h"

void ern_train_workspace_free(ern_context *context, struct ern_train_workspace *workspace) {
  if (workspace == NULL) return;
  for (int use = 0; use < ERN_TRAIN_USES; use++) ern_release(context, workspace->block[use].memory);
  ern_release(context, workspace);
}

ern_status ern_train_workspace_take(struct ern_cpu_stream *stream, ern_train_use use, size_t count, float **memory) {
  ern_context *context = stream->base.backend->context;
  ern_status status = ERN_OK;
  *memory = NULL;
  if (stream->train_workspace == NULL) ERN_TRY(ERN_NEW(context, 1, &stream->train_workspace));
  struct ern_train_block *block = &stream->train_workspace->block[use];
  if (block->count < count) {
    ern_release(context, block->memory);
    *block = (struct ern_train_block){0};
    const size_t ample = count + count / 8; /* the number of samples changes from step to step */
    ERN_TRY(ERN_NEW(context, ample, &block->memory));
    block->count = ample;
  }
  *memory = block->memory;
fail:
  return status;
}
