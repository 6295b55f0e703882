/* SPDX-License-Identifier: MIT
 * A part of a video at 25 frames a second, whatever its own rate is. */
#ifndef ERN_PREPARE_FOOTAGE_H
#define ERN_PREPARE_FOOTAGE_H

#include "prepare/prepare_job.h"

struct ern_footage {
  const struct ern_prepare_job *job;
  ern_video_reader *reader;
  ern_video_info info;
  ern_image now, next; /* the video's own frames around the wanted time */
  double now_at, next_at, between;
  bool has_now, has_next;
  double first;    /* seconds of the video's first frame */
  double from, to; /* the part, seconds after it; to 0: the end */
  size_t frame;    /* the next one of the clip */
};

ERN_NODISCARD ern_status ern_footage_open(const struct ern_prepare_job *job, struct ern_footage *footage);
/* The frame of the video that is nearest in time to the clip's next one, which lives until the next call; NULL past the
 * end. */
ERN_NODISCARD ern_status ern_footage_next(struct ern_footage *footage, const ern_image **frame);
/* Frames that the clip will have, by what the file says of its length. */
size_t ern_footage_expected(const struct ern_footage *footage);
void ern_footage_close(struct ern_footage *footage); /* accepts a zeroed one */

#endif
