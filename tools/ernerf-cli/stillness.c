/* SPDX-License-Identifier: MIT */
#include "stillness.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
  LONG_ENOUGH = 50, /* frames that the camera stands: telling its rays apart takes as long as 16 */
  MOST_MOMENTS = 256,
  AUDIO_WINDOWS = 8
};

void stillness_options(struct stillness *stillness, struct option options[STILLNESS_OPTIONS]) {
  stillness->levels = 0.5f;
  const struct option rows[] = {
      {.name = "still",
       .kind = OPTION_FLOAT,
       .target = &stillness->levels,
       .low = 0,
       .high = 255,
       .help = "grey levels of 255 that a pixel may be off while the camera stands still, where what hardly changes is "
               "not drawn anew; 0 keeps what cannot change (default 0.5)"},
      {.name = "no-still", .kind = OPTION_FLAG, .target = &stillness->off, .help = "draw every frame from nothing"}};
  ARGS_FILL(options, rows, STILLNESS_OPTIONS);
}

int stillness_check(const struct args *args) {
  return args_given(args, "no-still") ? args_forbid(args, "still", "has nothing to bound with --no-still") : -1;
}

/* Frames of the longest run of one pose. */
static size_t longest_stand(const struct shots *shots) {
  size_t longest = 0, run = 0;
  for (size_t k = 0; k < shots->count; k++) {
    const struct shot *shot = &shots->shot[k];
    const bool same = k > 0 && memcmp(shot->pose.matrix, shot[-1].pose.matrix, sizeof shot->pose.matrix) == 0;
    run = same ? run + 1 : 1;
    if (run > longest) longest = run;
  }
  return longest;
}

int stillness_open(struct stillness *stillness, struct portrait *portrait, struct session *session,
                   const struct shots *shots, const ern_features *features) {
  const size_t values = (size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width;
  const size_t count = shots->count < MOST_MOMENTS ? shots->count : MOST_MOMENTS;
  float eyes[MOST_MOMENTS];
  if (stillness->off) return 0;
  stillness->stands = longest_stand(shots) >= LONG_ENOUGH;
  if (!stillness->stands || stillness->levels <= 0) {
    const ern_status status = ern_renderer_keep_still(portrait->renderer, NULL, features->window_length, NULL, 0, 0);
    return status == ERN_OK ? 0 : session_fail(session);
  }
  float *windows = malloc(count * values * sizeof *windows);
  if (windows == NULL) return session_fail_with(session, "no memory for %zu moments of the speech", count);
  for (size_t k = 0; k < count; k++) {
    const size_t at = count > 1 ? (shots->count - 1) * k / (count - 1) : 0;
    shots_windows(shots, at, features, (ern_audio_pad)portrait->audio_pad, windows + k * values);
    eyes[k] = shots->shot[at].eye;
  }
  const ern_status status = ern_renderer_keep_still(portrait->renderer, windows, features->window_length, eyes, count,
                                                    stillness->levels / 255);
  free(windows);
  return status == ERN_OK ? 0 : session_fail(session);
}

json_t *stillness_report(const struct stillness *stillness, const struct portrait *portrait) {
  const ern_still_work work = ern_renderer_still_work(portrait->renderer);
  if (stillness->off || work.frames == 0) return json_null();
  const double frames = (double)work.frames, levels = stillness->stands ? (double)stillness->levels : 0;
  return json_pack("{s:o, s:o, s:o}", "bound", session_number(levels), "rays", session_number(work.rays / frames),
                   "samples", session_number(work.samples / frames));
}

void stillness_say(const struct stillness *stillness, const struct portrait *portrait, char *text, size_t room) {
  const ern_still_work work = ern_renderer_still_work(portrait->renderer);
  text[0] = 0;
  if (stillness->off || !stillness->stands || work.frames == 0) return;
  snprintf(text, room, ", %.1f %% of rays and %.1f %% of samples drawn anew", 100 * work.rays / (double)work.frames,
           100 * work.samples / (double)work.frames);
}
