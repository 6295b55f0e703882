/* SPDX-License-Identifier: MIT
 * The mouth where nothing is said: which frames of a speech are silent, and the clip's resting code. */
#ifndef ERN_CLI_SILENCE_POSE_H
#define ERN_CLI_SILENCE_POSE_H

#include "session/portrait.h"

struct silence_pose {
  bool off; /* from the command line */
  bool known;
  float code[32]; /* mean of the clip's silent frames */
  float *weight;  /* of each row of the speech's features: 0 speech .. 1 rest; NULL where nothing is known */
  size_t rows;
};

enum { SILENCE_POSE_OPTIONS = 1 };
/* --no-silence-pose. */
void silence_pose_options(struct silence_pose *rest, struct option options[SILENCE_POSE_OPTIONS]);

/* Learns silence from the portrait's clip and finds it in `speech`. Where that cannot be, says so and leaves `known`
 * false: the frames are then those of the speech alone. Returns 0, or EXIT_FAILURE after a message. */
int silence_pose_open(struct silence_pose *rest, struct session *session, const struct portrait *portrait,
                      const ern_features *speech);
void silence_pose_free(struct silence_pose *rest);

/* How far the mouth is at rest in frame k. */
float silence_pose_of(const struct silence_pose *rest, const struct frame_source *frame_source, size_t k);
/* Frames of these frames in which it is, fully or in part. */
size_t silence_pose_count(const struct silence_pose *rest, const struct frame_source *frame_source);

#endif
