/* SPDX-License-Identifier: MIT
 * Chooses the best segment of a long video: it has no cut, shows the face in most samples, has varied positions and
 * sizes of the face (a sign of varied poses), and loud sound, which is mostly speech. A probe is a frame at which the
 * search samples the video. */
#ifndef ERN_PREPARE_SEGMENT_H
#define ERN_PREPARE_SEGMENT_H

#include "prepare/prepare_job.h"

/* Parses ern_prepare_options.segment: choose a segment of *length seconds where the part is longer than *longer_than
 * seconds. ERN_E_ARGUMENT where the text is neither "auto" nor a number of 1 to 1800. */
ERN_NODISCARD ern_status ern_segment_read(ern_context *context, const char *text, double *length, double *longer_than);

/* The probes, in order and equally spaced in time; zeroed at the beginning. */
struct ern_segment_search {
  struct ern_segment_probe *probes;
  size_t count, capacity;
  size_t cut; /* the first frame after the first cut since the last probe, 0: no cut */
};

/* Adds a probe. face->frame is its frame; face->width is 0 where no face was found. Uses and clears search->cut. */
ERN_NODISCARD ern_status ern_segment_add(ern_context *context, struct ern_segment_search *search,
                                         const struct ern_found_face *face);
/* Sets job->segment to the best segment of `length` seconds; the probes are `every` frames apart. *found is false where
 * every such segment has a cut. */
ERN_NODISCARD ern_status ern_segment_choose(struct ern_prepare_job *job, const struct ern_segment_search *search,
                                            size_t every, double length, bool *found);
void ern_segment_free(ern_context *context, struct ern_segment_search *search);

#endif
