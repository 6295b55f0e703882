/* SPDX-License-Identifier: MIT */
#include "session/silence_pose.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { FRAMES_A_SECOND = 25, WINDOWS = 8, CODE = 32, MOST_FRAMES = 500 };

void silence_pose_options(struct silence_pose *pose, struct option options[SILENCE_POSE_OPTIONS]) {
  options[0] = (struct option){ARGS_OFF("silence-pose", &pose->off), .seldom = true,
                               .help =
                                   "the mouth rests, as in silent frames of the clip, where nothing is said for 8 "
                                   "frames or more; no: it follows the sound alone (default yes)"};
}

void silence_pose_free(struct silence_pose *pose) {
  free(pose->weight);
  ern_silence_free(&pose->silence);
  *pose = (struct silence_pose){.off = pose->off};
}

/* loudness[count] in dB of the 40 ms of each frame, all channels together; frames past the end of the sound get the
 * least value. */
static void measure(float *loudness, size_t count, const ern_sound *sound) {
  for (size_t t = 0; t < count; t++) {
    const size_t rate = (size_t)sound->rate, from = t * rate / FRAMES_A_SECOND, to = (t + 1) * rate / FRAMES_A_SECOND;
    double sum = 0;
    size_t values = 0;
    for (size_t i = from; i < to && i < sound->frames; i++)
      for (int c = 0; c < sound->channels; c++, values++) {
        const double value = sound->data[i * (size_t)sound->channels + (size_t)c];
        sum += value * value;
      }
    loudness[t] = (float)(10 * log10(values > 0 ? sum / (double)values + 0.1 : 0.1));
  }
}

/* *silence is NULL, after a message, if silence cannot be detected in this clip. Returns as silence_pose_open. */
static int learn(struct session *session, const struct portrait *portrait, ern_silence **silence) {
  const ern_features *features = ern_clip_features(portrait->clip);
  ern_context *context = session->context;
  char path[4096];
  ern_sound sound = {0};
  float *loudness = NULL;
  const bool named = snprintf(path, sizeof path, "%s/aud.wav", portrait->source.path) < (int)sizeof path;
  if (portrait->clip_info.has_sound && named && ern_sound_read(context, path, &sound) == ERN_OK) {
    loudness = malloc(features->windows * sizeof *loudness);
    if (loudness != NULL) measure(loudness, features->windows, &sound);
    ern_sound_free(context, &sound);
    if (loudness == NULL) return session_fail_with(session, "no memory for the loudness of %s", path);
  }
  const ern_status status = ern_silence_learn(context, features, loudness, silence);
  free(loudness);
  if (status == ERN_OK) return 0;
  if (status == ERN_E_NO_MEMORY) return session_fail(session);
  session_note(session, "%s: %s: silence cannot be recognised, so the mouth follows the speech alone: %s",
               session->verb, portrait->source.path, ern_last_error(context));
  return 0;
}

/* The mean code of the rows of `features` whose weight is 1; of every k-th if there are many. */
static int mean_code(struct silence_pose *pose, struct session *session, const struct portrait *portrait,
                     const ern_features *features, const float *weight, float *windows) {
  double sum[CODE] = {0};
  float code[CODE];
  size_t silent = 0, seen = 0, used = 0;
  for (size_t t = 0; t < features->windows; t++) silent += weight[t] >= 1;
  const size_t every = 1 + silent / MOST_FRAMES;
  for (size_t t = 0; t < features->windows; t++) {
    if (weight[t] < 1 || seen++ % every != 0) continue;
    ern_audio_windows(windows, features, (int64_t)t, ERN_AUDIO_PAD_EDGE);
    if (ern_renderer_code(portrait->renderer, windows, features->window_length, code) != ERN_OK)
      return session_fail(session);
    for (int c = 0; c < CODE; c++) sum[c] += (double)code[c];
    used++;
  }
  for (int c = 0; c < CODE && used > 0; c++) pose->code[c] = (float)(sum[c] / (double)used);
  pose->known = used > 0;
  if (!pose->known)
    session_note(session, "%s: %s: is silent nowhere for 8 frames, so the mouth follows the speech alone",
                 session->verb, portrait->source.path);
  return 0;
}

static int find_code(struct silence_pose *pose, struct session *session, const struct portrait *portrait) {
  const ern_features *clip = ern_clip_features(portrait->clip);
  float *weight = malloc(clip->windows * sizeof *weight);
  float *windows = malloc((size_t)WINDOWS * (size_t)clip->window_length * (size_t)clip->width * sizeof *windows);
  int status = 0;
  if (weight == NULL || windows == NULL)
    status = session_fail_with(session, "no memory for %zu frames of speech", clip->windows);
  else if (ern_silence_weights(pose->silence, clip, weight) != ERN_OK)
    status = session_fail(session);
  else
    status = mean_code(pose, session, portrait, clip, weight, windows);
  free(weight);
  free(windows);
  return status;
}

static int find(struct silence_pose *pose, struct session *session, const ern_features *speech) {
  pose->weight = malloc(speech->windows * sizeof *pose->weight);
  pose->rows = speech->windows;
  if (pose->weight == NULL) return session_fail_with(session, "no memory for %zu frames of speech", speech->windows);
  return ern_silence_weights(pose->silence, speech, pose->weight) == ERN_OK ? 0 : session_fail(session);
}

/* Whether the clip's features are of the kind that the model takes; else prints a message. */
static bool features_fit(struct session *session, const struct portrait *portrait) {
  if (portrait->clip == NULL) {
    session_note(session, "%s: without --clip it is not known how the mouth rests, so it follows the speech alone",
                 session->verb);
    return false;
  }
  if (speech_model_fits(&portrait->info, speech_model_clip_kind(portrait->clip))) return true;
  session_note(session,
               "%s: %s: holds %s, the model was trained on %s: silence cannot be recognised, so the mouth follows the "
               "speech alone",
               session->verb, portrait->features_path, speech_model_clip_kind(portrait->clip), portrait->info.speech);
  return false;
}

int silence_pose_learn(struct silence_pose *pose, struct session *session, const struct portrait *portrait) {
  if (pose->off || !features_fit(session, portrait)) return 0;
  const int status = learn(session, portrait, &pose->silence);
  return status == 0 && pose->silence != NULL ? find_code(pose, session, portrait) : status;
}

int silence_pose_open(struct silence_pose *pose, struct session *session, const struct portrait *portrait,
                      const ern_features *speech) {
  const int width = portrait->clip != NULL ? ern_clip_features(portrait->clip)->width : speech->width;
  if (!pose->off && width != speech->width) {
    session_note(session,
                 "render: %s: %d wide, the speech's features are %d: silence cannot be recognised, so the mouth "
                 "follows the speech alone",
                 portrait->features_path, width, speech->width);
    return 0;
  }
  const int status = silence_pose_learn(pose, session, portrait);
  return status == 0 && pose->silence != NULL ? find(pose, session, speech) : status;
}

static float weight_of(const struct silence_pose *pose, const struct source_frame *frame) {
  const int64_t row = frame->pose.aud_id, last = (int64_t)pose->rows - 1;
  return pose->weight[row < 0 ? 0 : row > last ? last : row];
}

float silence_pose_weight(const struct silence_pose *pose, const struct frame_source *frame_source, size_t k) {
  if (!pose->known || pose->weight == NULL) return 0;
  const float from = weight_of(pose, frame_source_before(frame_source, k)),
              to = weight_of(pose, frame_source_after(frame_source, k));
  return from + frame_source->source_frame[k].toward * (to - from);
}

size_t silence_pose_count(const struct silence_pose *pose, const struct frame_source *frame_source) {
  size_t count = 0;
  for (size_t k = 0; k < frame_source->count; k++) count += silence_pose_weight(pose, frame_source, k) > 0;
  return count;
}
