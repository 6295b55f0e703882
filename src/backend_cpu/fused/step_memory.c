/* SPDX-License-Identifier: MIT */
#include "backend_cpu/fused/step.h"
#include "backend_cpu/fused/step_pass.h"
#include "core/memory.h"

void ern_train_room_free(ern_context *context, struct ern_train_room *room) {
  if (room == NULL) return;
  for (int use = 0; use < ERN_TRAIN_USES; use++) ern_release(context, room->block[use].memory);
  ern_release(context, room);
}

ern_status ern_train_room_take(struct ern_cpu_stream *stream, ern_train_use use, size_t count, float **memory) {
  ern_context *context = stream->base.backend->context;
  ern_status status = ERN_OK;
  *memory = NULL;
  if (stream->train_room == NULL) ERN_TRY(ERN_NEW(context, 1, &stream->train_room));
  struct ern_train_block *block = &stream->train_room->block[use];
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
