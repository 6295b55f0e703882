/* SPDX-License-Identifier: MIT
 * A dubbed frame: what is handed over is checked, and what is not drawn on stays as recorded. */
#include "media/dub.h"

#include <math.h>

#include "core/sized.h"

static ern_status check(ern_context *context, const ern_dub_input *in) {
  const int *square = in->square;
  if (in->width < 1 || in->height < 1 || in->width > ERN_IMAGE_MAX_SIDE || in->height > ERN_IMAGE_MAX_SIDE)
    return ern_fail(context, ERN_E_SHAPE, "dub: the frame has %d x %d pixels, expected 1 to %d a side", in->width,
                    in->height, ERN_IMAGE_MAX_SIDE);
  if (in->head_side < 1 || in->head_side > ERN_IMAGE_MAX_SIDE)
    return ern_fail(context, ERN_E_SHAPE, "dub: the head has %d pixels a side, expected 1 to %d", in->head_side,
                    ERN_IMAGE_MAX_SIDE);
  if (square[0] < 0 || square[1] < 0 || square[2] < 1 || square[3] < 1 || square[2] > in->width - square[0] ||
      square[3] > in->height - square[1])
    return ern_fail(context, ERN_E_SHAPE,
                    "dub: the square is at %d, %d with %d x %d pixels, expected one within the frame of %d x %d",
                    square[0], square[1], square[2], square[3], in->width, in->height);
  if (in->recorded_head != NULL && (in->recorded_head->data == NULL || in->recorded_head->channels != 1 ||
                                    in->recorded_head->width < 1 || in->recorded_head->height < 1))
    return ern_fail(context, ERN_E_SHAPE, "dub: recorded_head has %d channels, expected a picture with one",
                    in->recorded_head->channels);
  for (int i = 0; i < 68; i++) {
    if (isfinite(in->landmarks[i][0]) && isfinite(in->landmarks[i][1])) continue;
    return ern_fail(context, ERN_E_NONFINITE, "dub: landmark %d is not finite", i);
  }
  return ERN_OK;
}

ern_status ern_dub_frame_sized(ern_context *context, const ern_dub_input *input, size_t bytes, uint8_t *rgba,
                               bool *drawn) {
  ern_dub_input own = {0};
  if (drawn != NULL) *drawn = false;
  if (context == NULL) return ERN_E_ARGUMENT;
  ERN_NEED(context, input);
  ERN_NEED(context, rgba);
  ERN_NEED(context, drawn);
  ern_status status = ERN_COPY_IN(context, ern_dub_input, &own, input, bytes);
  if (status != ERN_OK) return status;
  const uint8_t *recorded = own.recorded, *head = own.head;
  ERN_NEED(context, recorded);
  ERN_NEED(context, head);
  status = check(context, &own);
  if (status != ERN_OK) return status;
  const size_t pixels = (size_t)own.width * (size_t)own.height;
  for (size_t i = 0; i < pixels; i++) {
    for (size_t c = 0; c < 3; c++) rgba[4 * i + c] = recorded[3 * i + c];
    rgba[4 * i + 3] = 255;
  }
  return ern_dub_compose(context, &own, rgba, drawn);
}
