/* SPDX-License-Identifier: MIT
 * Any bytes as a sound. */
#include "ernerf/media.h"
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static const char path[] = "fuzz.wav";
  ern_context *context = fuzz_context();
  ern_sound sound;
  volatile unsigned sum = 0;
  fuzz_file(path, bytes, count);
  if (ern_sound_read(context, path, &sound) != ERN_OK) {
    fuzz_refused(context, path);
    FUZZ_REQUIRE(sound.data == NULL);
    return 0;
  }
  FUZZ_REQUIRE(sound.rate >= 1 && sound.channels >= 1 && sound.channels <= 8);
  sum += fuzz_touch(sound.data, sound.frames * (size_t)sound.channels * sizeof *sound.data);
  ern_sound_free(context, &sound);
  return 0;
}
