/* SPDX-License-Identifier: MIT */
#include "media/image.h"

#include <stdio.h>
#include <string.h>

#include "core/memory.h"

ern_status ern_image_check_sides(ern_context *context, const char *what, int width, int height) {
  if (width >= 1 && height >= 1 && width <= ERN_IMAGE_MAX_SIDE && height <= ERN_IMAGE_MAX_SIDE) return ERN_OK;
  return ern_fail(context, ERN_E_SHAPE, "%s: picture is %d x %d pixels, expected sides of 1 to %d", what, width, height,
                  ERN_IMAGE_MAX_SIDE);
}

static ern_status check_channels(ern_context *context, const char *what, int channels) {
  if (channels == 1 || channels == 3 || channels == 4) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT, "%s: picture has %d channels, expected 1, 3 or 4", what, channels);
}

ern_status ern_image_check(ern_context *context, const char *what, const ern_image *image) {
  ern_status status = ERN_OK;
  if (image == NULL || image->data == NULL) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: picture is empty, expected pixels", what);
  }
  ERN_TRY(check_channels(context, what, image->channels));
  ERN_TRY(ern_image_check_sides(context, what, image->width, image->height));
fail:
  return status;
}

ern_status ern_image_make(ern_context *context, const char *what, int width, int height, int channels,
                          ern_image *image) {
  ern_status status = ERN_OK;
  *image = (ern_image){0};
  ERN_TRY(check_channels(context, what, channels));
  ERN_TRY(ern_image_check_sides(context, what, width, height));
  /* at most 8192 * 8192 * 4: fits */
  ERN_TRY(ERN_NEW(context, (size_t)width * (size_t)height * (size_t)channels, &image->data));
  image->width = width, image->height = height, image->channels = channels;
fail:
  return status;
}

ern_status ern_image_fit(ern_context *context, const char *what, int width, int height, int channels,
                         ern_image *image) {
  if (image->data != NULL && image->width == width && image->height == height && image->channels == channels)
    return ERN_OK;
  ern_image_free(context, image);
  return ern_image_make(context, what, width, height, channels, image);
}

ern_status ern_image_turn(ern_context *context, const char *what, const ern_image *from, int orientation,
                          ern_image *turned) {
  const bool swapped = orientation >= 5; /* rows are stored as columns */
  const bool right = orientation == 2 || orientation == 3 || orientation == 7 || orientation == 8;
  const bool bottom = orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7;
  const int width = swapped ? from->height : from->width, height = swapped ? from->width : from->height;
  const size_t channels = (size_t)from->channels;
  const ern_status status = ern_image_fit(context, what, width, height, from->channels, turned);
  if (status != ERN_OK) return status;
  uint8_t *to = turned->data;
  for (int y = 0; y < height; y++)
    for (int x = 0; x < width; x++, to += channels) {
      const int across = swapped ? y : x, down = swapped ? x : y;
      const int u = right ? from->width - 1 - across : across, v = bottom ? from->height - 1 - down : down;
      memcpy(to, from->data + channels * ((size_t)v * (size_t)from->width + (size_t)u), channels);
    }
  return ERN_OK;
}

void ern_image_free(ern_context *context, ern_image *image) {
  if (context == NULL || image == NULL) return;
  ern_release(context, image->data);
  *image = (ern_image){0};
}
