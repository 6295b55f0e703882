/* SPDX-License-Identifier: MIT
 * The step "features": writes the sound, says how it fits the mouth, and copies the features that the user supplies
 * into the clip. Without them training uses aud.wav, and a video without sound is refused before any frame is read. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "ernerf/speech.h"
#include "io/landmarks.h"
#include "io/speech_share.h"
#include "prepare/clip_sound.h"
#include "prepare/prepare_job.h"
#include "prepare/stabilized_crop.h"

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

/* Share of the face's width by which the lips of a person who speaks open at least. Of eight people who speak it was 7
 * to 19 %, of two who do not 0.2 and 0.5 %. */
static const double least_opening = 0.02;

/* *moves: whether the lips open and close, from the tenth part of the frames to the twentieth, as in the landmarks. */
static ern_status check_lips(struct ern_prepare_job *job, const float *opening, bool *moves) {
  float *sorted = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(job->context, job->frames, &sorted));
  memcpy(sorted, opening, job->frames * sizeof *sorted);
  const double closed = (double)ern_quantile(sorted, job->frames, 0.1);
  const double opens = (double)ern_quantile(sorted, job->frames, 0.95) - closed;
  ern_prepare_figure(job, "lips_open", opens);
  *moves = opens >= least_opening;
  if (!*moves)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "the lips open by %.1f %% of the face's width, expected %.0f %% or more of a person who "
                           "speaks: is the voice another one's? A mouth is learnt from its own speech",
                           100 * opens, 100 * least_opening);
fail:
  ern_release(job->context, sorted);
  return status;
}

/* Seconds: a mouth moves up to 0.05 s ahead of its sound in videos that nobody would call late. */
static const double tolerated = 0.08;

/* *late: how much later the sound `wav` of the clip is than the mouth; 0 where that is not certain, or too little. The
 * step is doubtful where the lips hardly move. */
static ern_status measure_lag(struct ern_prepare_job *job, const char *wav, double *late) {
  ern_status status = ERN_OK;
  float *opening = NULL;
  ern_features cepstra = {0};
  struct ern_sound_lag lag;
  bool moves = false;
  *late = 0;
  ERN_TRY(ERN_NEW(job->context, job->frames, &opening));
  ERN_TRY(openings_of(job, opening));
  ERN_TRY(check_lips(job, opening, &moves));
  ERN_TRY(ern_speech_features(job->context, wav, 1, &cepstra));
  ERN_TRY(ern_sound_lag_measure(job->context, &cepstra, opening, job->frames, &lag));
  ern_prepare_figure(job, "sound_fits", lag.correlation);
  if (!lag.certain || !moves) goto fail; /* what trembles may fit any sound */
  ern_prepare_figure(job, "sound_late", lag.seconds);
  if (fabs(lag.seconds) > tolerated) *late = lag.seconds;
fail:
  ern_features_free(job->context, &cepstra);
  ern_release(job->context, opening);
  return status;
}

/* Writes aud.wav; *share: ern_speech_share, or -1: the video has no sound. */
static ern_status write_wav(struct ern_prepare_job *job, double offset, char path[ERN_PREPARE_PATH], double *share) {
  ern_status status = ERN_OK;
  ern_sound sound = {0};
  double missing = 0;
  *share = -1;
  ERN_TRY(ern_prepare_sound_read(job, job->frames, offset, &sound, &missing));
  if (sound.data == NULL) return ern_prepare_remove_made(job, "aud.wav");
  *share = ern_speech_share(&sound);
  ERN_TRY(ern_prepare_register_output(job, "aud.wav", path));
  ERN_TRY(ern_sound_write_wav(job->context, path, &sound));
fail:
  ern_sound_free(job->context, &sound);
  return status;
}

/* *moved: how much later the sound of the video is taken. */
static ern_status write_sound(struct ern_prepare_job *job, double *moved) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  double offset = 0, late = 0, share = 0;
  bool automatic = false;
  ERN_TRY(ern_sound_offset_read(job->context, job->options->sound_offset, &offset, &automatic));
  ERN_TRY(write_wav(job, offset, path, &share));
  if (share < 0 && offset != 0)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL, "the video has no sound that --sound-offset could move");
  if (share < 0) return ERN_OK;
  *moved = offset;
  ern_prepare_figure(job, "speech", share);
  if (share < ERN_SPEECH_SHARE && job->options->features == NULL)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "speech is heard in %.0f %% of the time; a mouth is learnt from speech: --from, --to and "
                           "--segment choose another part",
                           100 * share);
  ERN_TRY(measure_lag(job, path, &late));
  if (late == 0) return ERN_OK;
  const char *where = late > 0 ? "later" : "earlier";
  if (automatic) {
    *moved = late;
    ERN_TRY(write_wav(job, late, path, &share));
    ern_prepare_add_reason(
        job, ERN_PREPARE_GOOD,
        "the sound of the video is %.2f s %s than the mouth, and that of the clip is moved by as much "
        "(--sound-offset 0 leaves it)",
        fabs(late), where);
  } else {
    ern_prepare_add_reason(job, ERN_PREPARE_GOOD, "the sound is %.2f s %s than the mouth: --sound-offset %.2f",
                           fabs(late), where, offset + late);
  }
fail:
  return status;
}

ern_status ern_prepare_features(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  ern_features features = {0};
  double moved = 0;
  ERN_TRY(write_sound(job, &moved));
  if (job->options->features == NULL) return ern_prepare_remove_made(job, "aud.npy"); /* a file of an earlier call */
  ERN_TRY(ern_features_load(job->context, job->options->features, &features));
  ern_prepare_figure(job, "windows", (double)features.windows);
  if (features.windows + ERN_PREPARE_MORE < job->frames)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "%s has %zu windows for %zu frames; the frames after the last window repeat it",
                           job->options->features, features.windows, job->frames);
  if (moved != 0)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "%s is taken as it is, and the sound of the clip is moved by %.2f s; expected features of "
                           "the clip's aud.wav, not of the video's sound, or --sound-offset 0",
                           job->options->features, -moved);
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
