/* SPDX-License-Identifier: MIT
 * Any bytes as a sound, and as a sound to make speech features of. */
#include <math.h>

#include "ernerf/media.h"
#include "ernerf/speech.h"
#include "fuzz.h"

static void hear(ern_context *context, const char *path) {
  ern_features features;
  if (ern_speech_features(context, path, 1, &features) != ERN_OK) {
    fuzz_refused(context, path);
    FUZZ_REQUIRE(features.data == NULL);
    return;
  }
  FUZZ_REQUIRE(features.windows >= 1 && features.window_length == 16 && features.width == ERN_SPEECH_WIDTH);
  for (size_t i = 0; i < features.windows * 16 * ERN_SPEECH_WIDTH; i++) FUZZ_REQUIRE(isfinite(features.data[i]));
  ern_features_free(context, &features);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static const char path[] = "fuzz.wav";
  ern_context *context = fuzz_context();
  ern_sound sound;
  fuzz_file(path, bytes, count);
  hear(context, path);
  if (ern_sound_read(context, path, &sound) != ERN_OK) {
    fuzz_refused(context, path);
    FUZZ_REQUIRE(sound.data == NULL);
    return 0;
  }
  FUZZ_REQUIRE(sound.rate >= 1 && sound.channels >= 1 && sound.channels <= 8);
  fuzz_touch(sound.data, sound.frames * (size_t)sound.channels * sizeof *sound.data);
  ern_sound_free(context, &sound);
  return 0;
}
