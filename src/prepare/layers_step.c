/* SPDX-License-Identifier: MIT */
#include "prepare/prepare_job.h"
ern_status ern_prepare_layers(struct ern_prepare_job *job) {
  return ern_fail(job->context, ERN_E_UNSUPPORTED, "layers: not there yet");
}
