/* SPDX-License-Identifier: MIT
 * The mouth where nothing is said: which frames of a speech are silent, and the clip's resting code. */
#ifndef ERN_CLI_REST_H
#define ERN_CLI_REST_H

#include "portrait.h"

struct rest {
  bool off; /* from the command line */
  bool known;
  float code[32]; /* mean of the clip's silent frames */
  float *weight;  /* of each row of the speech's features: 0 speech .. 1 rest; NULL where nothing is known */
  size_t rows;
};

enum { REST_OPTIONS = 1 };
/* --no_rest. */
void rest_options(struct rest *rest, struct option options[REST_OPTIONS]);

/* Learns silence from the portrait's clip and finds it in `speech`. Where that cannot be, says so and leaves `known`
 * false: the frames are then those of the speech alone. Returns 0, or EXIT_FAILURE after a message. */
int rest_open(struct rest *rest, struct session *session, const struct portrait *portrait, const ern_features *speech);
void rest_free(struct rest *rest);

/* How far the mouth is at rest in shot k. */
float rest_of(const struct rest *rest, const struct shots *shots, size_t k);
/* Frames of these shots in which it is, fully or in part. */
size_t rest_count(const struct rest *rest, const struct shots *shots);

#endif
