/* SPDX-License-Identifier: MIT */
#include <string.h>

#include "core/memory.h"
#include "core/status.h"
#include "model/torso.h"
#include "model/torso_ops.h"
#include "render/stages.h"

static int32_t held(int32_t i, int first, int count) {
  const int32_t at = i - first;
  return at < 0 ? 0 : at < count ? at : count - 1;
}

/* *number: int32, for each pixel of the picture in order the number of the frame's pixel there, or of the nearest
 * one. */
static ern_status take_numbers(struct ern_stream *stream, int width, int height, const struct ern_torso_place *frame,
                               ern_span *number) {
  ern_context *context = stream->backend->context;
  const size_t pixels = (size_t)width * (size_t)height;
  int32_t *pixel = NULL;
  ern_status status = ern_scratch_take(stream, ERN_ELEMENT_INT32, pixels, number);
  if (status != ERN_OK) return status;
  status = ERN_NEW(context, pixels, &pixel);
  if (status != ERN_OK) return status;
  int32_t *to = pixel;
  for (int32_t row = 0; row < height; row++)
    for (int32_t column = 0; column < width; column++)
      *to++ = held(row, frame->top, frame->height) * frame->width + held(column, frame->left, frame->width);
  status = stream->backend->upload_int32(stream, *number, pixel, pixels);
  ern_release(context, pixel);
  return status;
}

ern_status ern_render_torso_stages(struct ern_stream *stream, struct ern_render_torso_args *args) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const size_t pixels = (size_t)args->width * (size_t)args->height;
  struct ern_torso_inputs in = {args->field,      args->parameters, args->pose,
                                args->individual, args->motion,     args->shrink};
  struct ern_torso_batch batch;
  ern_status status = ERN_OK;
  const struct ern_torso_place frame = ern_torso_place_of(args);
  struct ern_torso_select_args select = {
      .grid = args->grid, .threshold = args->threshold, .width = frame.width, .height = frame.height, .n = pixels};
  ERN_TRY(take_numbers(stream, args->width, args->height, &frame, &select.pixel));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, pixels, &select.index));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, pixels, &select.selected));
  ERN_TRY(stream->backend->torso_select(stream, &select));
  ERN_TRY(ern_torso_batch_take(stream, args->field, select.count, &batch));
  ERN_TRY(ern_torso_q(stream, select.selected, frame.width, frame.height, args->shrink, select.count, batch.q));
  ERN_TRY(ern_torso_fwd(stream, &in, &batch));
  struct ern_torso_composite_fwd_args composite = {.pixel = args->pixel,
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
