/* SPDX-License-Identifier: MIT
 * Settings of the training that rendering must use too. The model file keeps them; files of early versions lack
 * them. */
#ifndef ERN_MODEL_VIEW_SETTINGS_H
#define ERN_MODEL_VIEW_SETTINGS_H

#include "ernerf/model.h"

struct ern_view_settings {
  bool is_set;        /* set from the file or by a training; else these are the defaults */
  int max_steps;      /* samples a ray at most, 1..ERN_MAX_STEPS */
  float dt_gamma;     /* step growth with distance, 0..1 */
  float torso_shrink; /* ERN_LEAST_SHRINK..1 */
  float scale;        /* of the poses' translation, ERN_LEAST_SCALE..ERN_MOST_SCALE */
  ern_audio_pad audio_pad;
};

#define ERN_LEAST_SHRINK 1e-3
#define ERN_LEAST_SCALE 1e-3
#define ERN_MOST_SCALE 1e3

/* Those of the public program, except audio_pad. */
static inline struct ern_view_settings ern_view_settings_default(void) {
  return (struct ern_view_settings){false, 16, 1.0f / 256, 0.8f, 4, ERN_AUDIO_PAD_EDGE};
}

#endif
