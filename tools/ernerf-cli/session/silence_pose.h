/* SPDX-License-Identifier: MIT
 * The mouth's pose during silence: finds the silent frames of a speech, and learns the clip's silence code. */
#ifndef ERN_CLI_SILENCE_POSE_H
#define ERN_CLI_SILENCE_POSE_H

#include "session/portrait.h"

struct silence_pose {
  bool off; /* from the command line */
  bool known;
  float code[32]; /* mean of the clip's silent frames */
  float *weight;  /* for each row of the speech's features: 0 speech .. 1 silence; NULL: unknown */
  size_t rows;
  ern_silence *silence; /* detector learnt from the clip; NULL: silence cannot be detected */
};

enum { SILENCE_POSE_OPTIONS = 1 };
/* --set silence-pose. */
void silence_pose_options(struct silence_pose *pose, struct option options[SILENCE_POSE_OPTIONS]);

/* Learns to detect silence, and the silence code, from the portrait's clip. If that is impossible, prints a message and
 * leaves `known` false. Returns as the next one. */
int silence_pose_learn(struct silence_pose *pose, struct session *session, const struct portrait *portrait);
/* The same, and also detects the silence in `speech`. If that is impossible, prints a message and leaves `known` false:
 * the speech alone then drives the frames. Returns 0, or EXIT_FAILURE after a message. */
int silence_pose_open(struct silence_pose *pose, struct session *session, const struct portrait *portrait,
                      const ern_features *speech);
void silence_pose_free(struct silence_pose *pose);

/* Weight of the silence code in frame k, 0..1. */
float silence_pose_weight(const struct silence_pose *pose, const struct frame_source *frame_source, size_t k);
/* Number of frames in which that weight is above 0. */
size_t silence_pose_count(const struct silence_pose *pose, const struct frame_source *frame_source);

#endif
