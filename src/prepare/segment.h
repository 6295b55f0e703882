/* SPDX-License-Identifier: MIT
 * The best stretch of a long video: without a cut, with the face in most looks, places and sizes of the face that
 * differ (a sign of poses that differ), and sound that is loud, which is mostly speech. */
#ifndef ERN_PREPARE_SEGMENT_H
#define ERN_PREPARE_SEGMENT_H

#include "prepare/prepare_job.h"

/* ern_prepare_options.segment: *length seconds of a part that is longer than *longer_than. ERN_E_ARGUMENT for what is
 * neither "auto" nor a number of 1 to 1800. */
ERN_NODISCARD ern_status ern_segment_read(ern_context *context, const char *text, double *length, double *longer_than);

/* The looks at a video, in order and equally far apart; zeroed at the beginning. */
struct ern_segment_search {
  struct ern_segment_look *looks;
  size_t count, capacity;
  size_t cut; /* frame that the first cut since the last look leads to, 0: none */
};

/* The face's frame is that of the look; its width is 0 where none was found. Takes and clears search->cut. */
ERN_NODISCARD ern_status ern_segment_add(ern_context *context, struct ern_segment_search *search,
                                         const struct ern_found_face *face);
/* The stretch among the looks at `frames` frames, `every` apart, becomes job->segment; *found is false where each of
 * that length has a cut. */
ERN_NODISCARD ern_status ern_segment_choose(struct ern_prepare_job *job, const struct ern_segment_search *search,
                                            size_t every, double length, bool *found);
void ern_segment_free(ern_context *context, struct ern_segment_search *search);

#endif
