/* SPDX-License-Identifier: MIT
 * Shared by the code for picture files: memory for pictures, and the checks of pictures and files that callers pass. */
#ifndef ERN_MEDIA_IMAGE_H
#define ERN_MEDIA_IMAGE_H

#include <stdbool.h>

#include "core/status.h"
#include "ernerf/media.h"

/* Makes *image of that size, zeroed; sides 1..ERN_IMAGE_MAX_SIDE, channels 1, 3 or 4. `what` names the picture in
 * the error (a path, or a word). On failure *image is zeroed. */
ERN_NODISCARD ern_status ern_image_make(ern_context *context, const char *what, int width, int height, int channels,
                                        ern_image *image);

/* Makes *image again where its size or number of channels is another. */
ERN_NODISCARD ern_status ern_image_fit(ern_context *context, const char *what, int width, int height, int channels,
                                       ern_image *image);

/* *turned = `from`, which is stored in EXIF's orientation 1..8, upright. *turned: {0}, or an image, whose memory is
 * used again where it fits. */
ERN_NODISCARD ern_status ern_image_turn(ern_context *context, const char *what, const ern_image *from, int orientation,
                                        ern_image *turned);

/* ERN_E_SHAPE where a side is not in 1..ERN_IMAGE_MAX_SIDE. */
ERN_NODISCARD ern_status ern_image_check_sides(ern_context *context, const char *what, int width, int height);

/* ERN_E_ARGUMENT where a picture of the caller is not valid: its sides, channels or data. */
ERN_NODISCARD ern_status ern_image_check(ern_context *context, const char *what, const ern_image *image);

/* *format: OpenImageIO's name of the format, recognised by the file's first bytes; "" on failure. Reads the header of
 * PNG, JPEG, GIF and OpenEXR files: ERN_E_SHAPE where it claims a side that is not in 1..ERN_IMAGE_MAX_SIDE,
 * ERN_E_FORMAT where the file is empty or too short for what it claims, or where its first bytes match no supported
 * format. */
ERN_NODISCARD ern_status ern_image_check_head(ern_context *context, const char *path, const char **format);

/* ERN_E_FORMAT where a PNG file ends before its last chunk, or where a chunk that a decoder needs has not the checksum
 * that it states; ERN_OK for any other file. Chunks of pixels are looked at only where pixels is true. libpng, under
 * OpenImageIO, prints and leaks memory on such files, so this check comes first. */
ERN_NODISCARD ern_status ern_image_check_png_whole(ern_context *context, const char *path, bool pixels);

/* "cICP" or "cHRM": the chunk in which a PNG says that its colours are not those of sRGB or of a television; NULL: none
 * does, or the file is no PNG. An sRGB chunk overrules cHRM. */
const char *ern_image_png_other_colours(const char *path);

/* Whether a TIFF says that its colours are multiplied by alpha. One that says nothing of its fourth channel, as OpenCV
 * writes, holds colours as they are. */
bool ern_image_tiff_is_multiplied(const char *path);

/* The colours of `image` (3 or 4 channels; alpha stays), which are those of the profile, become those of sRGB, cut off
 * where sRGB has no such colour. They stay where the profile is that of sRGB, and, with a warning, where it is not one
 * of a matrix and curves, or is damaged. `path` is for the warning. */
ERN_NODISCARD ern_status ern_colour_profile_apply(ern_context *context, const char *path, const uint8_t *profile,
                                                  size_t bytes, ern_image *image);

#endif
