/* SPDX-License-Identifier: MIT
 * Synthetic speech features, with silence where a test needs it. */
#ifndef ERN_TESTS_MADE_SPEECH_H
#define ERN_TESTS_MADE_SPEECH_H

#include "support.h"

#include <math.h>
#include <stdbool.h>

#include "core/rng.h"
#include "ernerf/data.h"

enum { MADE_FRAMES = 150 };

struct made_speech {
  ern_features features;
  float loudness[MADE_FRAMES], weight[MADE_FRAMES];
};

static inline float made_noise(uint32_t seed, size_t i) {
  return 2 * ern_uniform(ern_random_at(seed, (uint32_t)i, 0, ERN_RNG_INIT).word[0]) - 1;
}

/* Frames [silent[k], silent[k + 1]) for even k are silent: all their vectors are the same. In each other frame a
 * different value is high. Noise is added to all. The list ends with MADE_FRAMES. */
static inline void made_speech(struct made_speech *s, int length, int width, uint32_t seed, const int *silent) {
  const size_t vectors = (size_t)MADE_FRAMES * (size_t)length;
  *s = (struct made_speech){.features = {.windows = MADE_FRAMES, .window_length = length, .width = width}};
  s->features.data = malloc(vectors * (size_t)width * sizeof(float));
  assert_non_null(s->features.data);
  for (size_t v = 0; v < vectors; v++) {
    const int t = (int)(v / (size_t)length);
    int k = 0;
    while (silent[k] < MADE_FRAMES && silent[k] <= t) k++;
    const bool said = k % 2 == 0;
    float *x = s->features.data + v * (size_t)width;
    for (int i = 0; i < width; i++)
      x[i] = sinf((float)i) + (said ? 0.3f : 0.1f) * made_noise(seed, v * (size_t)width + (size_t)i) +
             (said || i % 9 != 0 ? 0 : 3);
    if (said) x[(v * 7) % (size_t)width] += 4;
    s->loudness[t] = (said ? 60 : 20) + 5 * made_noise(seed + 1, (size_t)t);
  }
}

#endif
