/* SPDX-License-Identifier: MIT
 * Which frames are drawn: where each has its pose, its eye and its window of speech from. */
#ifndef ERN_CLI_SHOTS_H
#define ERN_CLI_SHOTS_H

#include "ernerf/media.h"
#include "ernerf/render.h"
#include "rate.h"
#include "session.h"

/* A frame of the output. It lies between two frames at 25 a second; at 25 a second it is one of them. */
struct shot {
  ern_pose pose;   /* pose.aud_id is the row of the features, that of frame `place` */
  ern_split split; /* of a clip: its frame is number `index` of that split; the nearer of the two */
  size_t index;
  float eye;     /* 0..1 */
  size_t number; /* of the whole output, also when only a part of it is drawn */
  size_t place;  /* number of the frame at 25 a second that it is, or that comes before it */
  float toward;  /* 0..1: how far on the way from that to the next one */
};

struct shots {
  struct shot *shot;
  size_t count;
  int64_t *rows; /* rows of the features of all frames at 25 a second, for zero padding */
  size_t row_count;
  struct shot *frame; /* [row_count] frames at 25 a second; NULL where the shots are these */
  float *second;      /* room for windows, where there is `frame` */
  ern_camera camera;  /* all but its pose; the size is that of the poses' file */
};

enum shot_split { SHOTS_TRAIN = 0, SHOTS_VAL = 1, SHOTS_ALL = 2 };

/* Each returns 0, or EXIT_FAILURE after a message. The frames of a split come in the order of
 * its file, those of both in the order of img_id. */
int shots_of_clip(struct shots *shots, struct session *session, const ern_clip *clip, enum shot_split split);
int shots_of_poses(struct shots *shots, struct session *session, const char *path);
void shots_free(struct shots *shots);

int shots_smooth_path(struct shots *shots, struct session *session, int window);
/* All frames get the pose of frame `frame`, under shots->count. */
void shots_hold_pose(struct shots *shots, size_t frame);
/* Each head is turned by yaw and pitch (ern_pose_turn). */
void shots_turn(struct shots *shots, struct pair degrees);
/* Each eye becomes the mean of the frame before, this and the next one, as in the public code. */
int shots_smooth_eye(struct shots *shots, struct session *session);
void shots_fix_eye(struct shots *shots, float eye);

/* Frame t is window t of `windows`; poses and eyes go forward and back. */
int shots_replay(struct shots *shots, struct session *session, size_t windows);
/* The output has `rate` frames a second: poses, eyes and, in shots_windows, the windows of `features` are interpolated
 * between the frames at 25 a second; past the last one it stands still. At 25 nothing changes. */
int shots_resample(struct shots *shots, struct session *session, struct rate rate, const ern_features *features);
/* Keeps frames [begin, end) of the output. Returns 0, or EXIT_USAGE after a sentence where they are not there. */
int shots_cut(struct shots *shots, const struct args *args, const struct range *range);

/* windows[8][window_length][width] of shot k. */
void shots_windows(const struct shots *shots, size_t k, const ern_features *features, ern_audio_pad pad,
                   float *windows);
/* The frames at 25 a second that shot k lies between; both are the shot itself where `toward` is 0. */
const struct shot *shots_before(const struct shots *shots, size_t k);
const struct shot *shots_after(const struct shots *shots, size_t k);
/* Where in the speech shot k is, seconds. */
double shots_seconds(const struct shots *shots, size_t k);
/* The camera of shot k, for a picture of the given size into which the frame goes by `fit`. */
ern_camera shots_camera(const struct shots *shots, size_t k, float scale, int width, int height, ern_fit fit);

#endif
