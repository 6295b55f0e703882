/* SPDX-License-Identifier: MIT
 * Values that the processes of a training exchange. Internal. */
#ifndef ERN_TRAIN_TRAINER_PROCESSES_H
#define ERN_TRAIN_TRAINER_PROCESSES_H

#include "train/parts/trainer_shared.h"

ERN_NODISCARD ern_status ern_trainer_broadcast(const struct ern_training *t, void *bytes, size_t count);
/* Gathers `count` values on the backend: before, this process has the range that ern_communicator.gather defines;
 * afterwards all. host [count]: room */
ERN_NODISCARD ern_status ern_trainer_gather(const struct ern_training *t, ern_span values, size_t count, float *host);
/* Returns after rank 0 has called it. */
ERN_NODISCARD ern_status ern_trainer_wait_for_first(const struct ern_training *t);
ERN_NODISCARD ern_status ern_trainer_sum(const struct ern_training *t, float *values, size_t count, double *numbers,
                                         size_t number_count);

#endif
