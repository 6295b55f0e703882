/* SPDX-License-Identifier: MIT */
#include "prepare/prepare_job.h"
ern_status ern_prepare_pose(struct ern_prepare_job *job) {
  return ern_fail(job->context, ERN_E_UNSUPPORTED, "pose: not there yet");
}
