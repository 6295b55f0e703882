/* SPDX-License-Identifier: MIT
 * Any bytes as a picture. */
#include "ernerf/media.h"
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static const char path[] = "fuzz.png";
  ern_context *context = fuzz_context();
  ern_image image;
  int width = 0, height = 0;
  fuzz_file(path, bytes, count);
  const ern_status sized = ern_image_size(context, path, &width, &height);
  if (sized != ERN_OK) fuzz_refused(context, path);
  for (int channels = 3; channels <= 4; channels++) {
    if (ern_image_read(context, path, channels, &image) != ERN_OK) {
      fuzz_refused(context, path);
      FUZZ_REQUIRE(image.data == NULL);
      continue;
    }
    FUZZ_REQUIRE(sized == ERN_OK && image.width == width && image.height == height && image.channels == channels);
    fuzz_touch(image.data, (size_t)width * (size_t)height * (size_t)channels);
    ern_image_free(context, &image);
  }
  return 0;
}
