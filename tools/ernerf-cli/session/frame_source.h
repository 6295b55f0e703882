/* SPDX-License-Identifier: MIT
 * The list of frames to draw, each with its pose, its eye value and its window of speech features. */
#ifndef ERN_CLI_FRAME_SOURCE_H
#define ERN_CLI_FRAME_SOURCE_H

#include "ernerf/media.h"
#include "ernerf/render.h"
#include "rate.h"
#include "session/session.h"

/* A frame of the output. Its time lies between two frames of the 25 fps sequence; in an output of 25 fps it is one of
 * them. */
struct source_frame {
  ern_pose pose;                   /* pose.aud_id is the row of the features for frame `place` */
  float motion[ERN_MOTION_VALUES]; /* of the body (ern_frame_input.torso_motion), where frame_source.has_motion */
  ern_split split;                 /* with a clip: frame `index` of that split is the nearer of the two frames */
  size_t index;
  float eye;     /* 0..1 */
  size_t number; /* in the whole output, also if only a part of it is drawn */
  size_t place;  /* number of the 25 fps frame at or before it */
  float toward;  /* 0..1: position between that frame and the next */
};

struct frame_source {
  struct source_frame *source_frame;
  size_t count;
  int64_t *rows; /* rows of the features for all frames at 25 fps, for zero padding */
  size_t row_count;
  struct source_frame *frame; /* [row_count] frames at 25 fps; NULL: source_frame holds them already */
  float *second;              /* scratch for windows, if `frame` is not NULL */
  int64_t *trained;           /* [trained_count] img_id of a clip's training frames; NULL without a clip */
  size_t trained_count;
  bool has_motion;
  ern_camera camera; /* all but the pose; the size is that of the poses' file */
};

enum frame_source_split { FRAME_SOURCE_TRAIN = 0, FRAME_SOURCE_VAL = 1, FRAME_SOURCE_ALL = 2 };

/* Each returns 0, or EXIT_FAILURE after a message. The frames of one split are in the order of its file, those of both
 * splits in the order of img_id. */
int frame_source_of_clip(struct frame_source *frame_source, struct session *session, const ern_clip *clip,
                         enum frame_source_split split);
int frame_source_of_poses(struct frame_source *frame_source, struct session *session, const char *path);
void frame_source_free(struct frame_source *frame_source);

/* Whether the model has a camera refinement, learnt from this clip's frames. */
bool frame_source_refines(const ern_model_info *model, const ern_clip_info *clip);
/* Applies the model's camera refinement to the pose of a clip's frame, after ern_camera_pose: the frame's own
 * refinement, or that of its neighbours. */
void frame_source_refine(const struct frame_source *frame_source, const ern_model *model,
                         const struct source_frame *frame, float pose[16]);

int frame_source_smooth_path(struct frame_source *frame_source, struct session *session, int window);
/* All frames get the pose of frame `frame` (less than the number of frames). */
void frame_source_hold_pose(struct frame_source *frame_source, size_t frame);
/* Turns the head in each frame by yaw and pitch (ern_pose_turn). */
void frame_source_turn(struct frame_source *frame_source, struct pair degrees);
/* Each eye value becomes the mean over the previous, this and the next frame, as in the public code. */
int frame_source_smooth_eye(struct frame_source *frame_source, struct session *session);
void frame_source_fix_eye(struct frame_source *frame_source, float eye);

/* Makes one frame for each of `windows` windows. Window t gets pose and eye value of frame order[t]; NULL: they are
 * replayed forward and backward. */
int frame_source_replay(struct frame_source *frame_source, struct session *session, size_t windows,
                        const size_t *order);
/* Resamples the output to `rate` frames a second: interpolates poses, eye values and, in frame_source_windows, the
 * windows of `features` between the frames at 25 fps. After the last of these the last one is held. At 25 fps nothing
 * changes. */
int frame_source_resample(struct frame_source *frame_source, struct session *session, struct rate rate,
                          const ern_features *features);
/* Frame k of an output: interpolates between frame[at.place] and the next one with the weight at.toward. */
struct source_frame frame_source_between(const struct source_frame *frame, struct rate_place at, size_t k);
/* Frame k, without an end, of an output at `rate` that repeats the frames at 25 fps of frame_source; its last frame is
 * its first one again. */
struct source_frame frame_source_cycle(const struct frame_source *frame_source, struct rate rate, uint64_t k);
/* Keeps frames [begin, end). */
void frame_source_keep(struct frame_source *frame_source, size_t begin, size_t end);
/* Keeps frames [begin, end) of the output. Returns 0, or EXIT_USAGE after a message if they do not exist. */
int frame_source_cut(struct frame_source *frame_source, const struct args *args, const struct range *range);

/* windows[8][window_length][width] of frame k. */
void frame_source_windows(const struct frame_source *frame_source, size_t k, const ern_features *features,
                          ern_audio_pad pad, float *windows);
/* The frames at 25 fps before and after frame k; both are the frame itself if `toward` is 0. */
const struct source_frame *frame_source_before(const struct frame_source *frame_source, size_t k);
const struct source_frame *frame_source_after(const struct frame_source *frame_source, size_t k);
/* The time of frame k in the speech, seconds. */
double frame_source_seconds(const struct frame_source *frame_source, size_t k);
/* Where the body is in frame k (ern_frame_input.torso_motion); NULL where it is not known. */
const float *frame_source_motion(const struct frame_source *frame_source, size_t k);
/* The camera of frame k for a picture of the given size, into which the frame is fitted by `fit`. */
ern_camera frame_source_camera(const struct frame_source *frame_source, size_t k, float scale, int width, int height,
                               ern_fit fit);

#endif
