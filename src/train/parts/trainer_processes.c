/* SPDX-License-Identifier: MIT
 * Processes that train one model together, through the caller's communicator. */
#include "train/parts/trainer_processes.h"

#include <inttypes.h>

#include "core/status.h"

static ern_status answered(const struct ern_training *t, ern_status status, const char *words) {
  if (status == ERN_OK) return ERN_OK;
  return ern_fail(t->context, status, "train: step %" PRIu64 ": %s", t->step,
                  words[0] != 0 ? words : ern_status_name(status));
}

ern_status ern_trainer_broadcast(const struct ern_training *t, void *bytes, size_t count) {
  char words[ERN_COMMUNICATOR_WORDS] = "";
  return answered(t, t->communicator.broadcast(t->communicator.user, bytes, count, words), words);
}

ern_status ern_trainer_sum(const struct ern_training *t, float *values, size_t count, double *numbers,
                           size_t number_count) {
  char words[ERN_COMMUNICATOR_WORDS] = "";
  if (t->communicator.size == 1) return ERN_OK;
  return answered(t, t->communicator.sum(t->communicator.user, values, count, numbers, number_count, words), words);
}

ern_status ern_trainer_gather(const struct ern_training *t, ern_span values, size_t count, float *host) {
  char words[ERN_COMMUNICATOR_WORDS] = "";
  const size_t rank = (size_t)t->communicator.rank, size = (size_t)t->communicator.size;
  const size_t first = count * rank / size, own = count * (rank + 1) / size - first;
  ern_status status = ERN_OK;
  if (size == 1) return ERN_OK;
  ERN_TRY(t->backend->download_reals(t->stream, host + first, ern_span_part(values, first, own), own));
  ERN_TRY(answered(t, t->communicator.gather(t->communicator.user, host, count, words), words));
  ERN_TRY(t->backend->upload_reals(t->stream, values, host, count));
fail:
  return status;
}

ern_status ern_trainer_wait_for_first(const struct ern_training *t) {
  char byte = 0;
  return t->communicator.size > 1 ? ern_trainer_broadcast(t, &byte, 1) : ERN_OK;
}
