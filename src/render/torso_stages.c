/* SPDX-License-Identifier: MIT */
#include "core/memory.h"
#include "core/status.h"
#include "model/torso.h"
#include "render/stages.h"

/* All pixels of the picture in order, int32. */
static ern_status take_numbers(struct ern_stream *stream, size_t pixels, ern_span *number) {
  ern_context *context = stream->backend->context;
  void *room = NULL;
  ern_status status = ern_take(stream, ERN_ELEMENT_INT32, pixels, number);
  if (status != ERN_OK) return status;
  status = ern_allocate(context, pixels, sizeof(int32_t), &room);
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < pixels; i++) ((int32_t *)room)[i] = (int32_t)i;
  status = stream->backend->upload_int32(stream, *number, room, pixels);
  ern_release(context, room);
  return status;
}

ern_status ern_render_torso_stages(struct ern_stream *stream, struct ern_render_torso_args *args) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const size_t pixels = (size_t)args->width * (size_t)args->height;
  const struct ern_torso_inputs in = {args->field, args->parameters, args->pose, args->individual};
  struct ern_torso_batch batch;
  ern_status status = ERN_OK;
  struct ern_torso_select_args select = {
      .grid = args->grid, .threshold = args->threshold, .width = args->width, .height = args->height, .n = pixels};
  ERN_TRY(take_numbers(stream, pixels, &select.pixel));
  ERN_TRY(ern_take(stream, ERN_ELEMENT_INT32, pixels, &select.index));
  ERN_TRY(ern_take(stream, ERN_ELEMENT_INT32, pixels, &select.selected));
  ERN_TRY(stream->backend->torso_select(stream, &select));
  ERN_TRY(ern_torso_batch_take(stream, args->field, select.count, &batch));
  ERN_TRY(ern_torso_q(stream, select.selected, args->width, args->height, args->shrink, select.count, batch.q));
  ERN_TRY(ern_torso_fwd(stream, &in, &batch));
  struct ern_torso_composite_args composite = {.pixel = args->pixel,
                                               .opacity = args->opacity,
                                               .layer = batch.layer,
                                               .index = select.index,
                                               .background = args->pixel,
                                               .rays = pixels,
                                               .n = select.count};
  ERN_TRY(stream->backend->torso_composite_fwd(stream, &composite));
fail:
  ern_arena_release(stream, mark);
  return status;
}
