/* SPDX-License-Identifier: MIT
 * The mouth where nothing is said: which frames of a speech are silent, and the clip's silence code. */
#ifndef ERN_CLI_SILENCE_POSE_H
#define ERN_CLI_SILENCE_POSE_H

#include "session/portrait.h"

struct silence_pose {
  bool off; /* from the command line */
  bool known;
  float code[32]; /* mean of the clip's silent frames */
  float *weight;  /* of each row of the speech's features: 0 speech .. 1 silence; NULL where nothing is known */
  size_t rows;
  ern_silence *silence; /* learnt from the clip; NULL: silence cannot be told */
};

enum { SILENCE_POSE_OPTIONS = 1 };
/* --no-silence-pose. */
void silence_pose_options(struct silence_pose *pose, struct option options[SILENCE_POSE_OPTIONS]);

/* Learns silence, and the code of it, from the portrait's clip. Where that cannot be, says so and leaves `known` false.
 * Returns as the next one. */
int silence_pose_learn(struct silence_pose *pose, struct session *session, const struct portrait *portrait);
/* The same, and finds it in `speech`. Where that cannot be, says so and leaves `known`
 * false: the frames are then those of the speech alone. Returns 0, or EXIT_FAILURE after a message. */
int silence_pose_open(struct silence_pose *pose, struct session *session, const struct portrait *portrait,
                      const ern_features *speech);
void silence_pose_free(struct silence_pose *pose);

/* Weight of the silence code in frame k, 0..1. */
float silence_pose_of(const struct silence_pose *pose, const struct frame_source *frame_source, size_t k);
/* Frames of these frames in which it is above 0. */
size_t silence_pose_count(const struct silence_pose *pose, const struct frame_source *frame_source);

#endif
