/* SPDX-License-Identifier: MIT
 * Any bytes as a video. */
#include <math.h>

#include "ernerf/media.h"
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  enum { MOST_FRAMES = 20 };
  static const char path[] = "fuzz.mp4";
  ern_context *context = fuzz_context();
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  fuzz_file(path, bytes, count);
  if (ern_video_reader_open(context, path, &reader) != ERN_OK) {
    fuzz_refused(context, path);
    FUZZ_REQUIRE(reader == NULL);
    return 0;
  }
  for (int i = 0; i < MOST_FRAMES && !end; i++) {
    if (ern_video_reader_frame(reader, &image, &seconds, &end) != ERN_OK) {
      fuzz_refused(context, path);
      break;
    }
    if (end) break;
    FUZZ_REQUIRE(isfinite(seconds));
    fuzz_touch(image.data, (size_t)image.width * (size_t)image.height * 3);
  }
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  return 0;
}
