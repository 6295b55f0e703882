/* SPDX-License-Identifier: MIT
 * --video of `ernerf live`: recorded frames, forward and backward without an end, with the rendered lower face in them.
 * A thread reads them ahead, as those of a backward part are decoded from the key frame before them on. */
#ifndef ERN_CLI_LIVE_VIDEO_H
#define ERN_CLI_LIVE_VIDEO_H

#include "bounded_queue.h"
#include "dub/dubbed_frame.h"
#include "dub/recorded_video.h"
#include "session/portrait.h"

enum { LIVE_VIDEO_PICTURES = 32 };

struct live_video {
  const char *path; /* from the command line; NULL: the portrait is drawn whole */
  /* made */
  struct session *session;
  struct rate rate;
  struct recorded_video recorded; /* the thread's, while it runs */
  struct dubbed_frame dubbed;
  struct frame_source clip_frames;  /* all of the clip */
  const struct frame_source *poses; /* of one period, then its first one again */
  bool in_place;                    /* outside `region` the recorded pixels are coded as they were decoded */
  int region[4]; /* x, y, width, height of what is composed, pixels of the video: the boxes of all poses, or all */
  struct live_recorded {
    ern_video_frame *frame;
    ern_image rgb;                 /* its region */
    struct source_frame place;     /* what it shows: between two of clip_frames */
  } pictures[LIVE_VIDEO_PICTURES]; /* the queue's */
  struct bounded_queue queue;
  pthread_t reader;
  bool running;
  struct session reading;            /* the thread's own, which holds its message: the frame may not be needed */
  char failed[SESSION_HELD];         /* that message */
  uint64_t taken;                    /* pictures that left the queue */
  const struct live_recorded *shown; /* the last one of them; its place in the queue is not free yet */
};

/* The next ones return 0, or EXIT_FAILURE after a message. */

/* Opens the video that the clip was prepared from; another one is refused. */
int live_video_open(struct live_video *video, struct session *session, const char *clip);
/* Of all poses of the clip, keeps those between the two frames where the video turns. */
int live_video_keep_poses(struct live_video *video, struct session *session, const struct portrait *portrait,
                          struct frame_source *poses);
/* Starts the thread. in_place: the output takes recorded frames. poses: those that were kept, forward and backward,
 * then the first one again. They must outlive the video. */
int live_video_start(struct live_video *video, struct session *session, const struct portrait *portrait,
                     const struct frame_source *poses, struct rate rate, bool in_place);
/* Makes `number` the recorded frame that is drawn on, that of frame_source_cycle(poses, rate, number). Numbers do not
 * fall. */
int live_video_show(struct live_video *video, uint64_t number);
/* rgba: the region of the shown frame with the lower face of `whole`, which is frame k of `frames`. */
ern_status live_video_draw(struct live_video *video, ern_renderer *renderer, const struct frame_source *frames,
                           size_t k, const ern_frame_input *whole, uint8_t *rgba);
/* rgb: [height][width][3] of the region, to compare settings by. It has the pixels of rgba that live_video_draw drew,
 * as often as they fit, so that its PSNR is theirs; black where none was. */
void live_video_colours(const struct live_video *video, const uint8_t *rgba, float *rgb);
/* After live_video_draw, where frames are coded in place: rgba becomes what was drawn, `part` its place in the frame
 * (dubbed_frame_cut), and *recorded, which the caller frees, the recorded frame. */
int live_video_cut(struct live_video *video, uint8_t *rgba, int part[4], ern_video_frame **recorded);
void live_video_close(struct live_video *video); /* in any state */

#endif
