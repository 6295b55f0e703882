/* SPDX-License-Identifier: MIT */
#include "verbs/speech_augmentation.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/speech.h"

/* Found by experiment (docs/results.md): training overfits a short speech; stronger copies and noise reduce
 * this. With a long speech they cost accuracy. */
enum { SHORT_FRAMES = 1000 }; /* training frames, 40 s */
struct strength {
  int copies;      /* in other voices */
  float low, high; /* factors of their frequencies, evenly spaced on a logarithmic scale */
  float share;     /* of the steps that train on a copy */
  float noise;     /* ern_dataset.speech_noise */
};
static const struct strength of_long = {4, 0.85f, 1.17f, 0.5f, 0}, of_short = {8, 0.75f, 1.3f, 0.5f, 0.35f},
                             of_short_cepstra = {8, 0.75f, 1.3f, 0.9f, 0.7f};
enum { MOST_COPIES = 8 };

void speech_augmentation_options(struct speech_augmentation *speech,
                                 struct option options[SPEECH_AUGMENTATION_OPTIONS]) {
  *speech = (struct speech_augmentation){0};
  const struct option rows[] = {
      {ARGS_CHOICE("speech-augment", &speech->off, "auto|off"),
       .help = "data augmentation of the speech, so that other voices move the mouth too; auto: 4 copies with warped "
               "frequencies in half of the steps, and of a clip of fewer than 1000 training frames 8 and noise, "
               "against overfitting; only if the speech is a sound and the features are of a built-in kind (default "
               "auto; off with --paper)"}};
  ARGS_FILL(options, rows, SPEECH_AUGMENTATION_OPTIONS);
}

int speech_augmentation_make(const struct speech_augmentation *speech, struct session *session, ern_clip *clip,
                             ern_dataset *dataset) {
  float warps[MOST_COPIES];
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  if (speech->off || !info.hears_sound || info.speech_network[0] != 0) return 0;
  const struct strength *chosen = info.frames[ERN_SPLIT_TRAIN] >= SHORT_FRAMES   ? &of_long
                                  : strcmp(info.speech, ERN_SPEECH_CEPSTRA) == 0 ? &of_short_cepstra
                                                                                 : &of_short;
  const double low = log((double)chosen->low), high = log((double)chosen->high);
  for (int k = 0; k < chosen->copies; k++) warps[k] = (float)exp(low + (high - low) * k / (chosen->copies - 1));
  if (ern_clip_vary_speech(clip, warps, (size_t)chosen->copies) != ERN_OK) return session_fail(session);
  ern_clip_dataset(clip, dataset);
  dataset->copy_share = chosen->share;
  dataset->speech_noise = chosen->noise;
  return 0;
}
