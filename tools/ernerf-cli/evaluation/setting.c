/* SPDX-License-Identifier: MIT */
#include "evaluation/setting.h"

#include <inttypes.h>
#include <stdlib.h>
#include <sys/stat.h>

#include "ernerf/speech.h"

const char setting_no_truth[] =
    "needs frames that were recorded with the speech of --audio, which --setting synchronization does not have";

void setting_options(int *setting, struct option options[SETTING_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_CHOICE("setting", setting, "reconstruction|synchronization"),
       .help =
           "setting of the paper's tables: reconstruction: unseen frames with the clip's own speech; synchronization: "
           "other speech, --audio, over the poses of all frames (or of --split), without the figures that need "
           "recorded frames (default: reconstruction, unless --audio or another --split is given)"}};
  ARGS_FILL(options, rows, SETTING_OPTIONS);
}

int setting_check(int *setting, const struct args *args, struct portrait *portrait) {
  static const char *const splits[] = {"train", "val", "all"};
  const bool audio = portrait->source.features != NULL, unseen = portrait->split == FRAME_SOURCE_VAL;
  if (!args_given(args, "setting")) {
    *setting = audio || !unseen ? SETTING_NONE : SETTING_RECONSTRUCTION;
    return -1;
  }
  if (*setting == SETTING_RECONSTRUCTION) {
    if (!unseen)
      return args_refuse(args,
                         "--split is %s, expected val: --setting reconstruction is of frames that were not trained on",
                         splits[portrait->split]);
    return args_forbid(args, "audio",
                       "is other speech than the clip's own, which --setting reconstruction takes; expected --setting "
                       "synchronization");
  }
  if (!audio)
    return args_refuse(args, "--setting synchronization needs --audio: other speech for the poses of the clip");
  if (!args_given(args, "split")) portrait->split = FRAME_SOURCE_ALL;
  return args_forbid(args, "refine-poses sheet lpips-network lpips-heads landmarks action-units recorded-action-units",
                     setting_no_truth);
}

/* Number of frames at 25 fps that the speech covers. */
static int frames_of_speech(const struct evaluation *evaluation, const char *path, size_t *frames) {
  ern_sound sound = {0};
  *frames = evaluation->features->windows;
  if (!ern_speech_is_sound(path)) return 0;
  if (ern_sound_read(evaluation->session->context, path, &sound) != ERN_OK) return session_fail(evaluation->session);
  const double whole = (double)sound.frames * RATE_CLIP / sound.rate; /* a window may go on past the end of the sound */
  if (whole < (double)*frames) *frames = (size_t)whole;
  ern_sound_free(evaluation->session->context, &sound);
  return 0;
}

/* Whether a file is one of the clip's, through links of any kind too. */
static bool is_of_clip(const char *path, const char *clip) {
  char own[4096];
  struct stat file, other;
  if (session_lies_in(path, clip)) return true;
  for (size_t i = 0; ern_clip_content(i) != NULL && stat(path, &file) == 0; i++)
    if (snprintf(own, sizeof own, "%s/%s", clip, ern_clip_content(i)) < (int)sizeof own && stat(own, &other) == 0 &&
        file.st_dev == other.st_dev && file.st_ino == other.st_ino)
      return true;
  return false;
}

int setting_open(int setting, struct evaluation *evaluation, const struct portrait *portrait) {
  struct session *session = evaluation->session;
  struct frame_source *source = &evaluation->frame_source;
  const char *speech = portrait->source.features;
  const size_t all = source->count;
  size_t frames = 0;
  if (setting != SETTING_SYNCHRONIZATION) return 0;
  if (is_of_clip(speech, portrait->source.path))
    return session_fail_with(session,
                             "%s: is in %s, so it is the clip's own speech; expected another file: other speech",
                             speech, portrait->source.path);
  if (frames_of_speech(evaluation, speech, &frames) != 0) return EXIT_FAILURE;
  source->count = 0;
  for (size_t k = 0; k < all; k++) { /* a clip's frames after the end have the last window, and so its aud_id */
    const ern_pose *pose = &source->source_frame[k].pose;
    if (pose->img_id < (int64_t)frames && pose->aud_id < (int64_t)frames)
      source->source_frame[source->count++] = source->source_frame[k];
  }
  if (source->count == 0)
    return session_fail_with(session, "%s: lasts for %zu frames, expected more: the first of the clip's is %" PRId64,
                             speech, frames, source->source_frame[0].pose.img_id);
  if (source->count < all)
    session_note(session, "%s: lasts for %zu frames; the %zu frames after that are left out", speech, frames,
                 all - source->count);
  return 0;
}

const char *setting_name(int setting) {
  static const char *const names[] = {"reconstruction", "synchronization", NULL};
  return names[setting];
}

const char *setting_words(int setting) {
  static const char *const words[] = {"reconstruction: frames that were not trained on, with the clip's own speech",
                                      "synchronization: other speech over the poses of the clip",
                                      "none of the paper's: trained frames, or --audio without --setting"};
  return words[setting];
}
