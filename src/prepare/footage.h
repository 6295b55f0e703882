/* SPDX-License-Identifier: MIT
 * Reads a part of a video at 25 frames a second, for any rate of the video. */
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
  size_t frame;    /* the next frame of the clip */
  size_t left_out; /* frames of the part whose time is not later than that of the one before */
};

ERN_NODISCARD ern_status ern_footage_open(const struct ern_prepare_job *job, struct ern_footage *footage);
/* *frame = the video's frame nearest in time to the clip's next frame, valid until the next call; NULL past the end. */
ERN_NODISCARD ern_status ern_footage_next(struct ern_footage *footage, const ern_image **frame);
/* Number of frames that the clip will have, by the duration in the file's header. */
size_t ern_footage_expected(const struct ern_footage *footage);
void ern_footage_close(struct ern_footage *footage); /* accepts a zeroed one */

#endif
