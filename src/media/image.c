/* SPDX-License-Identifier: MIT */
#include "media/image.h"

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
  void *data = NULL;
  *image = (ern_image){0};
  ERN_TRY(check_channels(context, what, channels));
  ERN_TRY(ern_image_check_sides(context, what, width, height));
  /* at most 8192 * 8192 * 4: fits */
  ERN_TRY(ern_allocate(context, (size_t)width * (size_t)height, (size_t)channels, &data));
  *image = (ern_image){.width = width, .height = height, .channels = channels, .data = data};
fail:
  return status;
}

void ern_image_free(ern_context *context, ern_image *image) {
  if (image == NULL) return;
  ern_release(context, image->data);
  *image = (ern_image){0};
}
