/* SPDX-License-Identifier: MIT */
#include "verbs/speech_augmentation.h"

#include <math.h>
#include <stdlib.h>

enum { MOST_COPIES = 16 };

/* Found by experiment (docs/results.md): training overfits a short speech; stronger copies and noise reduce
 * this. With a long speech they cost accuracy. */
enum { SHORT_FRAMES = 1000 }; /* training frames, 40 s */
static const struct speech_augmentation of_long = {.copies = 4, .range = {0.85f, 1.17f}, .share = 0.5f},
                                        of_short = {.copies = 8, .range = {0.75f, 1.3f}, .share = 0.9f, .noise = 0.7f};

void speech_augmentation_options(struct speech_augmentation *speech,
                                 struct option options[SPEECH_AUGMENTATION_OPTIONS]) {
  *speech = of_long;
  const struct option rows[] = {
      {.name = "speech-copies",
       .kind = OPTION_INT,
       .target = &speech->copies,
       .low = 0,
       .high = MOST_COPIES,
       .help = "number of copies of the speech with warped frequencies, so that other voices move the mouth too; "
               "only if the speech is a sound and the features are of the built-in kind; 8 if the clip has fewer "
               "than 1000 training frames"},
      {.name = "speech-warp",
       .kind = OPTION_PAIR,
       .target = &speech->range,
       .low = 0.5,
       .high = 2,
       .help = "lowest and highest frequency factor of the copies, 0.5 to 2; the factors between are evenly spaced on "
               "a logarithmic scale (default 0.85,1.17; 0.75,1.3 if the clip has fewer than 1000 training frames)"},
      {.name = "speech-share",
       .kind = OPTION_FLOAT,
       .target = &speech->share,
       .low = 0,
       .high = 1,
       .help = "share of the steps that use a copy, 0 to 1; 0.9 if the clip has fewer than 1000 training frames"},
      {.name = "speech-noise",
       .kind = OPTION_FLOAT,
       .target = &speech->noise,
       .low = 0,
       .high = ERN_SPEECH_NOISE_MOST,
       .help = "standard deviation of the noise that each step adds to the speech features, in standard deviations of "
               "each feature, against overfitting a short speech (default 0; 0.7 if the features are the built-in "
               "kind, computed from a sound, and the clip has fewer than 1000 training frames)"}};
  ARGS_FILL(options, rows, SPEECH_AUGMENTATION_OPTIONS);
}

/* Chooses the values for options that were not given. */
static void choose(struct speech_augmentation *speech, const struct args *args, bool published,
                   const ern_clip_info *info) {
  const struct speech_augmentation *chosen = info->frames[ERN_SPLIT_TRAIN] < SHORT_FRAMES ? &of_short : &of_long;
  if (!args_given(args, "speech-copies")) speech->copies = published ? 0 : chosen->copies;
  if (!args_given(args, "speech-warp")) speech->range = chosen->range;
  if (!args_given(args, "speech-share")) speech->share = chosen->share;
  if (!args_given(args, "speech-noise")) speech->noise = published ? 0 : chosen->noise;
}

int speech_augmentation_make(struct speech_augmentation *speech, struct session *session, const struct args *args,
                             bool published, ern_clip *clip) {
  float warps[MOST_COPIES];
  ern_clip_info info;
  if (published && !args_given(args, "speech-copies")) speech->copies = 0;
  const int unused = speech->copies == 0 ? args_forbid(args, "speech-warp speech-share",
                                                       "is about copies of the speech, of which there are none")
                                         : -1;
  if (unused >= 0) return unused;
  ern_clip_describe(clip, &info);
  if (!info.hears_sound || info.speech_network[0] != 0) {
    const int status =
        args_forbid(args, "speech-copies speech-warp speech-share",
                    info.hears_sound ? "is for features of the built-in kind, and a network makes these"
                                     : "is for speech that is given as sound, and this is given as features");
    return status >= 0 ? status : 0;
  }
  choose(speech, args, published, &info);
  const double low = log((double)speech->range.first), high = log((double)speech->range.second);
  for (int k = 0; k < speech->copies; k++)
    warps[k] = (float)exp(speech->copies > 1 ? low + (high - low) * k / (speech->copies - 1) : (low + high) / 2);
  return ern_clip_vary_speech(clip, warps, (size_t)speech->copies) == ERN_OK ? 0 : session_fail(session);
}
