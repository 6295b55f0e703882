/* SPDX-License-Identifier: MIT
 * CLIP/prepare.json: which video a clip was made of, which steps are done, and what they found. */
#ifndef ERN_PREPARE_PREPARE_RECORD_H
#define ERN_PREPARE_PREPARE_RECORD_H

#include "prepare/prepare_job.h"

/* Opens the folder, which is made where it is missing, and its record; *lock keeps other processes out until it is
 * closed. ERN_E_EXISTS where the folder holds files and no record, or that of another video, from, to or side and
 * options->anew is not set; ERN_E_BUSY where another process prepares it. */
ERN_NODISCARD ern_status ern_prepare_record_open(struct ern_prepare_job *job, int *lock);
/* Writes job->record. */
ERN_NODISCARD ern_status ern_prepare_record_save(struct ern_prepare_job *job);

/* Whether the step was done and not refused, with these settings; *verdict is then what it said. */
bool ern_prepare_record_has(const struct ern_prepare_job *job, const char *step, const char *settings,
                            ern_prepare_verdict *verdict);
/* Forgets the steps named in `stale[count]`, before their files change. */
ERN_NODISCARD ern_status ern_prepare_record_strike(struct ern_prepare_job *job, const char *const *stale, size_t count);
/* Enters what the step said, and forgets the steps named in `stale[count]`. */
ERN_NODISCARD ern_status ern_prepare_record_enter(struct ern_prepare_job *job, const char *settings,
                                                  const char *const *stale, size_t count);

#endif
