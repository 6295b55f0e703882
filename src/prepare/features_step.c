/* SPDX-License-Identifier: MIT
 * The step "features": writes the sound, says how it fits the mouth, and copies the features that the user supplies
 * into the clip. Without them training uses aud.wav, and a video without sound is refused before any frame is read. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "ernerf/speech.h"
#include "io/landmarks.h"
#include "prepare/clip_sound.h"
#include "prepare/prepare_job.h"

#define LEAST_SPEECH 0.2 /* share of the time */

/* Distance between the inner lips in shares of the face's width, for each frame. */
static ern_status openings_of(const struct ern_prepare_job *job, float *opening) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  float p[ERN_LANDMARKS][2];
  for (size_t i = 0; i < job->frames; i++) {
    ERN_TRY(ern_prepare_path(job, path, "ori_imgs/%zu.lms", i));
    ERN_TRY(ern_landmarks_read(job->context, path, p));
    float gap[2];
    for (int c = 0; c < 2; c++) gap[c] = (p[61][c] + p[62][c] + p[63][c] - p[65][c] - p[66][c] - p[67][c]) / 3;
    opening[i] = hypotf(gap[0], gap[1]) / fmaxf(hypotf(p[16][0] - p[0][0], p[16][1] - p[0][1]), 1);
  }
fail:
  return status;
}

/* The sound of a mouth is heard 0.04 s after it is seen, as the mouth moves ahead of its sounds. */
static const double usual_lag = 0.04, tolerated = 0.05; /* seconds */

static ern_status check_lag(struct ern_prepare_job *job, const char *wav) {
  ern_status status = ERN_OK;
  float *opening = NULL;
  ern_features cepstra = {0};
  struct ern_sound_lag lag;
  ERN_TRY(ERN_NEW(job->context, job->frames, &opening));
  ERN_TRY(openings_of(job, opening));
  ERN_TRY(ern_speech_features(job->context, wav, 1, &cepstra));
  ERN_TRY(ern_sound_lag_measure(job->context, &cepstra, opening, job->frames, &lag));
  ern_prepare_figure(job, "sound_fits", lag.correlation);
  const double late = lag.seconds - usual_lag;
  if (!lag.certain) goto fail;
  ern_prepare_figure(job, "sound_late", late);
  if (fabs(late) > tolerated)
    ern_prepare_add_reason(job, ERN_PREPARE_GOOD,
                           "the sound is %.2f s %s than the mouth; --sound-offset %.2f puts them together", fabs(late),
                           late > 0 ? "later" : "earlier", job->options->sound_offset + late);
fail:
  ern_features_free(job->context, &cepstra);
  ern_release(job->context, opening);
  return status;
}

static ern_status write_sound(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  ern_sound sound = {0};
  double missing = 0;
  char path[ERN_PREPARE_PATH];
  ERN_TRY(ern_prepare_sound_read(job, job->frames, &sound, &missing));
  if (sound.data == NULL) return ern_prepare_remove_made(job, "aud.wav");
  const double share = ern_prepare_speech_share(&sound);
  ern_prepare_figure(job, "speech", share);
  if (share < LEAST_SPEECH && job->options->features == NULL)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "speech is heard in %.0f %% of the time; a mouth is learnt from speech: --from, --to and "
                           "--segment choose another part",
                           100 * share);
  ERN_TRY(ern_prepare_register_output(job, "aud.wav", path));
  ERN_TRY(ern_sound_write_wav(job->context, path, &sound));
  ERN_TRY(check_lag(job, path));
fail:
  ern_sound_free(job->context, &sound);
  return status;
}

ern_status ern_prepare_features(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  ern_features features = {0};
  ERN_TRY(write_sound(job));
  if (job->options->features == NULL) return ern_prepare_remove_made(job, "aud.npy"); /* a file of an earlier call */
  ERN_TRY(ern_features_load(job->context, job->options->features, &features));
  ern_prepare_figure(job, "windows", (double)features.windows);
  if (features.windows + ERN_PREPARE_MORE < job->frames)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "%s has %zu windows for %zu frames; the frames after the last window repeat it",
                           job->options->features, features.windows, job->frames);
  ERN_TRY(ern_prepare_register_output(job, "aud.npy", path));
  ERN_TRY(ern_features_save(job->context, path, &features));
fail:
  ern_features_free(job->context, &features);
  return status;
}

static ern_status check_sound(const struct ern_prepare_job *job) {
  ern_video_reader *reader = NULL;
  ern_video_info info = {0};
  ern_status status = ern_video_reader_open(job->context, job->video, &reader);
  if (status != ERN_OK) return status;
  ern_video_reader_info(reader, &info);
  ern_video_reader_free(&reader);
  if (info.has_sound) return ERN_OK;
  return ern_fail(job->context, ERN_E_UNSUPPORTED,
                  "%s: the video has no sound, and a mouth cannot be learnt without; expected a video with speech, or "
                  "--features FILE.npy",
                  job->video);
}

ern_status ern_prepare_features_check(struct ern_prepare_job *job) {
  ern_features features = {0};
  if (job->options->features == NULL) return check_sound(job);
  ern_status status = ern_features_load(job->context, job->options->features, &features);
  if (status == ERN_OK && job->frames > 0 && features.windows > job->frames + ERN_PREPARE_MORE)
    status = ern_fail(job->context, ERN_E_MISMATCH,
                      "%s: has %zu windows, and the clip has %zu frames; expected those of the clip's own sound, one "
                      "for each frame",
                      job->options->features, features.windows, job->frames);
  ern_features_free(job->context, &features);
  return status;
}
