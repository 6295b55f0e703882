/* SPDX-License-Identifier: MIT */
#include "session/frame_reuse.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
  LONG_ENOUGH = 50, /* frames with a still camera: classifying its rays takes as long as 16 frames */
  MOST_SPEECH_FRAMES = 256,
  AUDIO_WINDOWS = 8
};

void frame_reuse_options(struct frame_reuse *frame_reuse, struct option options[FRAME_REUSE_OPTIONS]) {
  frame_reuse->levels = 0.5f;
  const struct option rows[] = {
      {ARGS_FLOAT("reuse-rays", &frame_reuse->levels, -1, 255), .seldom = true,
       .help = "while the camera does not move, interpolate rays that change little; X is the largest error of a "
               "pixel in grey levels of 255; 0: reuse only rays that cannot change; -1: render every frame completely "
               "(default 0.5)"}};
  ARGS_FILL(options, rows, FRAME_REUSE_OPTIONS);
}

/* Frames of the longest run of one pose. */
static size_t longest_still_run(const struct frame_source *frame_source) {
  size_t longest = 0, run = 0;
  for (size_t k = 0; k < frame_source->count; k++) {
    const struct source_frame *source_frame = &frame_source->source_frame[k];
    const bool same =
        k > 0 && memcmp(source_frame->pose.matrix, source_frame[-1].pose.matrix, sizeof source_frame->pose.matrix) == 0;
    run = same ? run + 1 : 1;
    if (run > longest) longest = run;
  }
  return longest;
}

int frame_reuse_open(struct frame_reuse *frame_reuse, struct portrait *portrait, struct session *session,
                     const struct frame_source *frame_source, const ern_features *features) {
  const size_t values = (size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width;
  const size_t count = frame_source->count < MOST_SPEECH_FRAMES ? frame_source->count : MOST_SPEECH_FRAMES;
  float eyes[MOST_SPEECH_FRAMES];
  if (frame_reuse->levels < 0) return 0;
  frame_reuse->camera_is_still = longest_still_run(frame_source) >= LONG_ENOUGH;
  if (!frame_reuse->camera_is_still || frame_reuse->levels <= 0) {
    const ern_status status = ern_renderer_reuse_rays(portrait->renderer, NULL, features->window_length, NULL, 0, 0);
    return status == ERN_OK ? 0 : session_fail(session);
  }
  float *windows = malloc(count * values * sizeof *windows);
  if (windows == NULL) return session_fail_with(session, "no memory for %zu moments of the speech", count);
  for (size_t k = 0; k < count; k++) {
    const size_t at = count > 1 ? (frame_source->count - 1) * k / (count - 1) : 0;
    frame_source_windows(frame_source, at, features, (ern_audio_pad)portrait->audio_pad, windows + k * values);
    eyes[k] = frame_source->source_frame[at].eye;
  }
  const ern_status status = ern_renderer_reuse_rays(portrait->renderer, windows, features->window_length, eyes, count,
                                                    frame_reuse->levels / 255);
  free(windows);
  return status == ERN_OK ? 0 : session_fail(session);
}

void frame_reuse_add(struct frame_reuse *frame_reuse, const ern_renderer *renderer) {
  const ern_ray_reuse_work work = ern_renderer_ray_reuse_work(renderer);
  frame_reuse->work.frames += work.frames;
  frame_reuse->work.rays += work.rays;
  frame_reuse->work.samples += work.samples;
}

json_t *frame_reuse_report(const struct frame_reuse *frame_reuse) {
  const ern_ray_reuse_work *work = &frame_reuse->work;
  if (frame_reuse->levels < 0 || work->frames == 0) return json_null();
  const double frames = (double)work->frames, levels = frame_reuse->camera_is_still ? (double)frame_reuse->levels : 0;
  return json_pack("{s:o, s:I, s:o, s:o}", "bound", session_number(levels), "frames", (json_int_t)work->frames, "rays",
                   session_number(work->rays / frames), "samples", session_number(work->samples / frames));
}

void frame_reuse_say(const struct frame_reuse *frame_reuse, char *text, size_t capacity) {
  const ern_ray_reuse_work *work = &frame_reuse->work;
  text[0] = 0;
  if (frame_reuse->levels < 0 || !frame_reuse->camera_is_still || work->frames == 0) return;
  snprintf(text, capacity, ", %.1f %% of rays and %.1f %% of samples rendered again",
           100 * work->rays / (double)work->frames, 100 * work->samples / (double)work->frames);
}
