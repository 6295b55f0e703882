/* SPDX-License-Identifier: MIT
 * The step "features": those that the user brings are checked and put into the clip; else aud.wav speaks for itself. */
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "ernerf/speech.h"
#include "prepare/prepare_job.h"

ern_status ern_prepare_features(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  ern_features features = {0};
  ERN_TRY(ern_prepare_remove_made(job, "aud.npy")); /* of other features */
  if (job->options->features == NULL) {
    ERN_TRY(ern_prepare_path(job, path, "aud.wav"));
    if (access(path, F_OK) != 0)
      ern_prepare_judge(job, ERN_PREPARE_REFUSED,
                        "the video has no sound, and a mouth cannot be learnt without; expected a video with speech, "
                        "or --features FILE.npy");
    goto fail;
  }
  ERN_TRY(ern_features_load(job->context, job->options->features, &features));
  ern_prepare_figure(job, "windows", (double)features.windows);
  if (features.windows + 2 < job->frames)
    ern_prepare_judge(job, ERN_PREPARE_DOUBTFUL,
                      "%s has %zu windows for %zu frames; frames past the last one hear its end",
                      job->options->features, features.windows, job->frames);
  ERN_TRY(ern_prepare_claim(job, "aud.npy"));
  ERN_TRY(ern_prepare_path(job, path, "aud.npy"));
  ERN_TRY(ern_features_save(job->context, path, &features));
fail:
  ern_features_free(job->context, &features);
  return status;
}

ern_status ern_prepare_features_check(struct ern_prepare_job *job) {
  ern_features features = {0};
  if (job->options->features == NULL) return ERN_OK;
  ern_status status = ern_features_load(job->context, job->options->features, &features);
  if (status == ERN_OK) status = ern_prepare_check_claim(job, "aud.npy");
  ern_features_free(job->context, &features);
  return status;
}
