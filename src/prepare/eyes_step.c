/* SPDX-License-Identifier: MIT */
#include "prepare/prepare_job.h"
ern_status ern_prepare_eyes(struct ern_prepare_job *job) {
  return ern_fail(job->context, ERN_E_UNSUPPORTED, "eyes: not there yet");
}
