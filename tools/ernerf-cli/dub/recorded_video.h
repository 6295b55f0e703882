/* SPDX-License-Identifier: MIT
 * The video that a clip was prepared from: where the clip's square is in it, and its frames by time. */
#ifndef ERN_CLI_RECORDED_VIDEO_H
#define ERN_CLI_RECORDED_VIDEO_H

#include "ernerf/media.h"
#include "session/frame_source.h"

struct recorded_video {
  const char *path;
  ern_video_reader *reader;
  ern_video_info info;
  int square[4]; /* x, y, width, height of the clip's square, pixels of the video */
  double from;   /* seconds from the video's first frame to the clip's */
  double first;  /* time of the video's first frame, seconds */
  double shown;  /* time of the frame that recorded_video_frame gave last, seconds */
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
/* Keeps so many decoded frames that the times of calls may fall: 384 MiB of yuv420p, but 8 to 128 frames.
 * Backward, all frames from the key frame before on are decoded for each so many. */
int recorded_video_keep(struct recorded_video *video, struct session *session);
/* *frame = the frame whose time is nearest to `seconds` after the clip's first frame, as `prepare` chooses them, valid
 * until the next call; NULL past the end. The times of calls may not fall, unless frames are kept. */
int recorded_video_frame(struct recorded_video *video, struct session *session, double seconds,
                         const ern_video_frame **frame);
/* Whether frame k of the clip is that of its second k/25: one that a transforms file lacks would shift those after it.
 * frames: all of the clip at 25 fps. */
int recorded_video_check(struct session *session, const char *clip, const struct frame_source *frames);
/* The second after the clip's first frame that frame k of clip frames shows. */
double recorded_video_second(const struct frame_source *frames, size_t k);
/* A frame of the video as RGB; part: x, y, width, height of a plain one, NULL: all of it. image: {0} before the first
 * call, then the same one; the caller frees it. */
int recorded_video_rgb(struct recorded_video *video, struct session *session, const ern_video_frame *frame,
                       const int part[4], ern_image *image);
/* Where the frame that recorded_video_frame gave last lies among the `count` frames of the clip, which are taken 25
 * times a second: k if frame k of the clip is that picture; between two of them by time. */
struct rate_place recorded_video_place(const struct recorded_video *video, size_t count);
void recorded_video_close(struct recorded_video *video);

#endif
