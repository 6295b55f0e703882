/* SPDX-License-Identifier: MIT
 * A dubbed frame: what is handed over is checked, and what is not drawn on stays as recorded. */
#include "media/dub.h"

#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/sized.h"

/* Shares of the square. A face that leaves the square has landmarks beyond 0..1, up to this. In pixels, a face that is
 * large enough to be drawn (16 pixels) has some beyond it. */
#define LANDMARK_MOST 8.0F

/* The frame, the square and the landmarks. */
static ern_status check_face(ern_context *context, const ern_dub_input *in) {
  const int *square = in->square;
  if (in->width < 1 || in->height < 1 || in->width > ERN_IMAGE_MAX_SIDE || in->height > ERN_IMAGE_MAX_SIDE)
    return ern_fail(context, ERN_E_SHAPE, "dub: the frame has %d x %d pixels, expected 1 to %d a side", in->width,
                    in->height, ERN_IMAGE_MAX_SIDE);
  for (int c = 0; c < 2; c++)
    if (square[c] < -ERN_IMAGE_MAX_SIDE || square[c] > ERN_IMAGE_MAX_SIDE || square[c + 2] < 1 ||
        square[c + 2] > ERN_IMAGE_MAX_SIDE)
      return ern_fail(context, ERN_E_SHAPE,
                      "dub: the square is at %d, %d with %d x %d pixels, expected -%d to %d and 1 to %d a side",
                      square[0], square[1], square[2], square[3], ERN_IMAGE_MAX_SIDE, ERN_IMAGE_MAX_SIDE,
                      ERN_IMAGE_MAX_SIDE);
  for (int i = 0; i < 68; i++) {
    const float x = in->landmarks[i][0], y = in->landmarks[i][1];
    if (!isfinite(x) || !isfinite(y)) return ern_fail(context, ERN_E_NONFINITE, "dub: landmark %d is not finite", i);
    if (fabsf(x) > LANDMARK_MOST || fabsf(y) > LANDMARK_MOST)
      return ern_fail(context, ERN_E_ARGUMENT,
                      "dub: landmark %d is at %g, %g, expected shares of the square (0..1), not pixels", i, (double)x,
                      (double)y);
  }
  return ERN_OK;
}

/* x, y, width, height. */
static bool is_within(const int inner[4], const int outer[4]) {
  for (int c = 0; c < 2; c++) {
    const int from = inner[c] - outer[c];
    if (inner[c] < outer[c] || inner[c + 2] < 0 || from > outer[c + 2] || inner[c + 2] > outer[c + 2] - from)
      return false;
  }
  return true;
}

/* Pixels of the head that the box needs along an axis, but for a quarter of a pixel of the frame: for rounding. */
static int least_side(const ern_dub_input *in, int axis) {
  return (int)ceilf(((float)in->box[axis + 2] - 0.25F) * in->head_scale[axis]);
}

static ern_status check_pictures(ern_context *context, const ern_dub_input *in) {
  const ern_image *there = in->recorded_head;
  if (!is_within(in->box, (const int[4]){0, 0, in->width, in->height}) || !is_within(in->box, in->square))
    return ern_fail(context, ERN_E_SHAPE,
                    "dub: the box is at %d, %d with %d x %d pixels, expected the one of ern_dub_box, in the square and "
                    "the frame",
                    in->box[0], in->box[1], in->box[2], in->box[3]);
  if (in->head_width < 1 || in->head_height < 1 || in->head_width > ERN_IMAGE_MAX_SIDE ||
      in->head_height > ERN_IMAGE_MAX_SIDE)
    return ern_fail(context, ERN_E_SHAPE, "dub: the head has %d x %d pixels, expected 1 to %d a side", in->head_width,
                    in->head_height, ERN_IMAGE_MAX_SIDE);
  for (int c = 0; c < 2; c++)
    if (!(in->head_scale[c] > 1e-3F) || !(in->head_scale[c] < 1e3F))
      return ern_fail(context, ERN_E_ARGUMENT, "dub: head_scale[%d] is %g, expected 0.001 to 1000", c,
                      (double)in->head_scale[c]);
  const int least[2] = {least_side(in, 0), least_side(in, 1)};
  if (in->head_width < least[0] || in->head_height < least[1])
    return ern_fail(context, ERN_E_SHAPE,
                    "dub: the head has %d x %d pixels, expected %d x %d: those of the box times head_scale",
                    in->head_width, in->head_height, least[0], least[1]);
  if (there != NULL && (there->data == NULL || there->channels != 1 || there->width < 1 || there->height < 1))
    return ern_fail(context, ERN_E_SHAPE,
                    "dub: recorded_head has %d x %d pixels, %d channels%s, expected a picture with one channel",
                    there->width, there->height, there->channels, there->data == NULL ? ", data NULL" : "");
  return ERN_OK;
}

ern_status ern_dub_box_sized(ern_context *context, const ern_dub_input *input, size_t bytes, int box[4]) {
  ERN_PLAIN_FLOATS;
  ern_dub_input own = {0};
  if (box != NULL) memset(box, 0, 4 * sizeof *box);
  if (context == NULL) return ERN_E_ARGUMENT;
  ERN_NEED(context, input);
  ERN_NEED(context, box);
  ern_status status = ERN_COPY_IN(context, ern_dub_input, &own, input, bytes);
  if (status == ERN_OK) status = check_face(context, &own);
  return status == ERN_OK ? ern_dub_find_box(context, &own, box) : status;
}

ern_status ern_dub_wanted_sized(ern_context *context, const ern_dub_input *input, size_t bytes, uint8_t *wanted) {
  ERN_PLAIN_FLOATS;
  ern_dub_input own = {0};
  if (context == NULL) return ERN_E_ARGUMENT;
  ERN_NEED(context, input);
  ERN_NEED(context, wanted);
  ern_status status = ERN_COPY_IN(context, ern_dub_input, &own, input, bytes);
  if (status == ERN_OK) status = check_face(context, &own);
  if (status == ERN_OK) status = check_pictures(context, &own);
  return status == ERN_OK ? ern_dub_find_wanted(context, &own, wanted) : status;
}

ern_status ern_dub_frame_sized(ern_context *context, const ern_dub_input *input, size_t bytes, uint8_t *rgba,
                               bool *drawn) {
  ERN_PLAIN_FLOATS;
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
  status = check_face(context, &own);
  if (status != ERN_OK) return status;
  const bool empty = own.box[2] == 0 || own.box[3] == 0;
  if (!empty) {
    ERN_NEED(context, head);
    status = check_pictures(context, &own);
    if (status != ERN_OK) return status;
  }
  const size_t pixels = (size_t)own.width * (size_t)own.height;
  for (size_t i = 0; i < pixels; i++) {
    for (size_t c = 0; c < 3; c++) rgba[4 * i + c] = recorded[3 * i + c];
    rgba[4 * i + 3] = 255;
  }
  return empty ? ERN_OK : ern_dub_compose(context, &own, rgba, drawn);
}
