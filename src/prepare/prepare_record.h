/* SPDX-License-Identifier: MIT
 * The record CLIP/prepare.json: the video that the clip was made from, the finished steps and their results. */
#ifndef ERN_PREPARE_PREPARE_RECORD_H
#define ERN_PREPARE_PREPARE_RECORD_H

#include "prepare/prepare_job.h"

/* Opens the folder (creates it where it is missing) and its record. *lock is a descriptor that locks the folder against
 * other processes until it is closed. ERN_E_EXISTS where options->anew is not set and the folder holds files without a
 * record, or the record of another video, from, to or side; ERN_E_BUSY where another process prepares it. */
ERN_NODISCARD ern_status ern_prepare_record_open(struct ern_prepare_job *job, int *lock);
/* ERN_E_STATE where the video is no longer the file that the record has: its pictures or sound would be of two files.
 */
ERN_NODISCARD ern_status ern_prepare_record_check_video(const struct ern_prepare_job *job);
/* Writes job->record. */
ERN_NODISCARD ern_status ern_prepare_record_save(struct ern_prepare_job *job);

/* Whether the record has the step as done with these settings and not refused; *verdict is then its verdict. */
bool ern_prepare_record_has(const struct ern_prepare_job *job, const char *step, const char *settings,
                            ern_prepare_verdict *verdict);
/* Removes the steps named in `stale[count]` from the record, before their files change. */
ERN_NODISCARD ern_status ern_prepare_record_strike(struct ern_prepare_job *job, const char *const *stale, size_t count);
/* Records the step's verdict and figures, and removes the steps named in `stale[count]`. */
ERN_NODISCARD ern_status ern_prepare_record_enter(struct ern_prepare_job *job, const char *settings,
                                                  const char *const *stale, size_t count);

#endif
