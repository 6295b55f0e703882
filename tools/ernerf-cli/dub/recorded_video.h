/* SPDX-License-Identifier: MIT
 * The video that a clip was prepared from: where the clip's square is in it, and its frames by time. */
#ifndef ERN_CLI_RECORDED_VIDEO_H
#define ERN_CLI_RECORDED_VIDEO_H

#include "ernerf/media.h"
#include "session/session.h"

struct recorded_video {
  const char *path;
  ern_video_reader *reader;
  ern_video_info info;
  int square[4]; /* x, y, width, height of the clip's square, pixels of the video */
  double from;   /* seconds from the video's first frame to the clip's */
  double first;  /* time of the video's first frame, seconds */
  /* decoded frames that follow each other, the last ones of `places` at most */
  struct recorded_frame {
    ern_video_frame *frame;
    double at; /* its time, seconds; rises */
  } * window;
  size_t places, count;
  bool ended; /* the window's last frame is the video's */
};

/* Opens the video of a clip that `ernerf prepare` made. Another video than the clip's is refused: by its hash, or where
 * the clip's record has none by its size in bytes. Returns 0, or EXIT_FAILURE after a message, as the next one. */
int recorded_video_open(struct recorded_video *video, struct session *session, const char *path, const char *clip);
/* Keeps so many decoded frames that the times of calls may fall: 128 MiB of yuv420p, but 8 to 64 frames. */
int recorded_video_keep(struct recorded_video *video, struct session *session);
/* *frame = the frame whose time is nearest to `seconds` after the clip's first frame, as `prepare` chooses them, valid
 * until the next call; NULL past the end. The times of calls may not fall, unless frames are kept. */
int recorded_video_frame(struct recorded_video *video, struct session *session, double seconds,
                         const ern_video_frame **frame);
void recorded_video_close(struct recorded_video *video);

#endif
