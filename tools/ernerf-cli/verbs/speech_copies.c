/* SPDX-License-Identifier: MIT */
#include "verbs/speech_copies.h"

#include <math.h>
#include <stdlib.h>

enum { MOST_COPIES = 16 };

/* Found by trying (docs/history-small-steps.md): a short speech is overfitted, which
 * copies that differ more reduce. With a long one they cost accuracy. */
enum { SHORT_FRAMES = 1000 }; /* of training, 40 s */
static const struct speech_copies of_short = {.count = 8, .range = {0.75f, 1.3f}, .share = 0.9f};

void speech_copies_options(struct speech_copies *copies, struct option options[SPEECH_COPIES_OPTIONS]) {
  *copies = (struct speech_copies){.count = 4, .range = {0.85f, 1.17f}, .share = 0.5f};
  const struct option rows[] = {
      {.name = "speech-copies",
       .kind = OPTION_INT,
       .target = &copies->count,
       .low = 0,
       .high = MOST_COPIES,
       .help = "of speech that is given as sound: copies with other frequencies, so that other voices move the same "
               "mouth; 8 if the clip has fewer than 1000 training frames"},
      {.name = "speech-warp",
       .kind = OPTION_PAIR,
       .target = &copies->range,
       .low = 0.5,
       .high = 2,
       .help = "the range of their factors, evenly spaced on a logarithmic scale (default 0.85,1.17; "
               "0.75,1.3 if the clip has fewer than 1000 training frames)"},
      {.name = "speech-share",
       .kind = OPTION_FLOAT,
       .target = &copies->share,
       .low = 0,
       .high = 1,
       .help = "of the steps that hear a copy; 0.9 if the clip has fewer than 1000 training frames"}};
  ARGS_FILL(options, rows, SPEECH_COPIES_OPTIONS);
}

static void choose(struct speech_copies *copies, const struct args *args, const ern_clip_info *info) {
  if (copies->count == 0 || info->frames[ERN_SPLIT_TRAIN] >= SHORT_FRAMES) return;
  if (!args_given(args, "speech-copies")) copies->count = of_short.count;
  if (!args_given(args, "speech-warp")) copies->range = of_short.range;
  if (!args_given(args, "speech-share")) copies->share = of_short.share;
}

int speech_copies_make(struct speech_copies *copies, struct session *session, const struct args *args, ern_clip *clip) {
  float warps[MOST_COPIES];
  ern_clip_info info;
  const int unheard = copies->count == 0 ? args_forbid(args, "speech-warp speech-share",
                                                       "is about copies of the speech, and --speech-copies is 0")
                                         : -1;
  if (unheard >= 0) return unheard;
  ern_clip_describe(clip, &info);
  if (!info.hears_sound || info.speech_network[0] != 0) {
    const int status =
        args_forbid(args, SPEECH_COPIES_NAMES,
                    info.hears_sound ? "is for sound that the built-in kind is made of, and a network hears this"
                                     : "is for speech that is given as sound, and this is given as features");
    return status >= 0 ? status : 0;
  }
  choose(copies, args, &info);
  const double low = log((double)copies->range.first), high = log((double)copies->range.second);
  for (int k = 0; k < copies->count; k++)
    warps[k] = (float)exp(copies->count > 1 ? low + (high - low) * k / (copies->count - 1) : (low + high) / 2);
  return ern_clip_vary_speech(clip, warps, (size_t)copies->count) == ERN_OK ? 0 : session_fail(session);
}
