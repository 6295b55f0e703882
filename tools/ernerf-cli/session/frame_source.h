/* SPDX-License-Identifier: MIT
 * Which frames are drawn: where each has its pose, its eye and its window of speech from. */
#ifndef ERN_CLI_FRAME_SOURCE_H
#define ERN_CLI_FRAME_SOURCE_H

#include "ernerf/media.h"
#include "ernerf/render.h"
#include "session/rate.h"
#include "session/session.h"

/* A frame of the output. It lies between two frames at 25 a second; at 25 a second it is one of them. */
struct source_frame {
  ern_pose pose;   /* pose.aud_id is the row of the features, that of frame `place` */
  ern_split split; /* of a clip: its frame is number `index` of that split; the nearer of the two */
  size_t index;
  float eye;     /* 0..1 */
  size_t number; /* of the whole output, also when only a part of it is drawn */
  size_t place;  /* number of the frame at 25 a second that it is, or that comes before it */
  float toward;  /* 0..1: how far on the way from that to the next one */
};

struct frame_source {
  struct source_frame *source_frame;
  size_t count;
  int64_t *rows; /* rows of the features of all frames at 25 a second, for zero padding */
  size_t row_count;
  struct source_frame *frame; /* [row_count] frames at 25 a second; NULL where the frames are these */
  float *second;              /* room for windows, where there is `frame` */
  int64_t *trained;           /* [trained_count] img_id of a clip's training frames; NULL without a clip */
  size_t trained_count;
  ern_camera camera; /* all but its pose; the size is that of the poses' file */
};

enum frame_source_split { FRAME_SOURCE_TRAIN = 0, FRAME_SOURCE_VAL = 1, FRAME_SOURCE_ALL = 2 };

/* Each returns 0, or EXIT_FAILURE after a message. The frames of a split come in the order of
 * its file, those of both in the order of img_id. */
int frame_source_of_clip(struct frame_source *frame_source, struct session *session, const ern_clip *clip,
                         enum frame_source_split split);
int frame_source_of_poses(struct frame_source *frame_source, struct session *session, const char *path);
void frame_source_free(struct frame_source *frame_source);

/* Whether the model has a camera refinement, and not that of another clip's frames. */
bool frame_source_refines(const ern_model_info *model, const ern_clip_info *clip);
/* The pose of a clip's frame, after ern_camera_pose, as the model's camera refinement has it: the frame's own, or that
 * of its neighbours. */
void frame_source_refine(const struct frame_source *frame_source, const ern_model *model,
                         const struct source_frame *frame, float pose[16]);

int frame_source_smooth_path(struct frame_source *frame_source, struct session *session, int window);
/* All frames get the pose of frame `frame`, under frames->count. */
void frame_source_hold_pose(struct frame_source *frame_source, size_t frame);
/* Each head is turned by yaw and pitch (ern_pose_turn). */
void frame_source_turn(struct frame_source *frame_source, struct pair degrees);
/* Each eye becomes the mean of the frame before, this and the next one, as in the public code. */
int frame_source_smooth_eye(struct frame_source *frame_source, struct session *session);
void frame_source_fix_eye(struct frame_source *frame_source, float eye);

/* Frame t is window t of `windows`; poses and eyes go forward and back. */
int frame_source_replay(struct frame_source *frame_source, struct session *session, size_t windows);
/* The output has `rate` frames a second: poses, eyes and, in frame_source_windows, the windows of `features` are
 * interpolated between the frames at 25 a second; past the last one it stands still. At 25 nothing changes. */
int frame_source_resample(struct frame_source *frame_source, struct session *session, struct rate rate,
                          const ern_features *features);
/* Frame k of an output, which lies at.toward of the way from frame[at.place] to the next one. */
struct source_frame frame_source_between(const struct source_frame *frame, struct rate_place at, size_t k);
/* Keeps frames [begin, end) of the output. Returns 0, or EXIT_USAGE after a sentence where they are not there. */
int frame_source_cut(struct frame_source *frame_source, const struct args *args, const struct range *range);

/* windows[8][window_length][width] of frame k. */
void frame_source_windows(const struct frame_source *frame_source, size_t k, const ern_features *features,
                          ern_audio_pad pad, float *windows);
/* The frames at 25 a second that frame k lies between; both are the frame itself where `toward` is 0. */
const struct source_frame *frame_source_before(const struct frame_source *frame_source, size_t k);
const struct source_frame *frame_source_after(const struct frame_source *frame_source, size_t k);
/* Where in the speech frame k is, seconds. */
double frame_source_seconds(const struct frame_source *frame_source, size_t k);
/* The camera of frame k, for a picture of the given size into which the frame goes by `fit`. */
ern_camera frame_source_camera(const struct frame_source *frame_source, size_t k, float scale, int width, int height,
                               ern_fit fit);

#endif
