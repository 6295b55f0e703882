/* SPDX-License-Identifier: MIT
 * The step "features": checks the features that the user supplies and copies them into the clip. Without them training
 * uses aud.wav, and a video without sound is refused before any frame is read. */
#include <stdio.h>
#include <string.h>

#include "ernerf/speech.h"
#include "prepare/prepare_job.h"

ern_status ern_prepare_features(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  ern_features features = {0};
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
