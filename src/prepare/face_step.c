/* SPDX-License-Identifier: MIT */
#include "prepare/prepare_job.h"
ern_status ern_prepare_face(struct ern_prepare_job *job) {
  return ern_fail(job->context, ERN_E_UNSUPPORTED, "face: not there yet");
}
