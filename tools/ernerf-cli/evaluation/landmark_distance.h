/* SPDX-License-Identifier: MIT
 * LMD: how far the landmarks of drawn frames are from those of the true ones (docs/evaluation.md). */
#ifndef ERN_CLI_LANDMARK_DISTANCE_H
#define ERN_CLI_LANDMARK_DISTANCE_H

#include <jansson.h>

#include "evaluation/evaluate.h"
#include "session/prepare_library.h"

/* Over the frames of an evaluation. Zeroed but for `path`: none yet. */
struct landmark_distance {
  const char *path; /* a network, FILE.onnx, or a folder of ID.lms; NULL: not wanted */
  struct landmark_library library;
  ern_landmark_network *network; /* NULL: a folder */
  uint8_t *rgb;                  /* [height][width][3]: a drawn frame, for the network */
  float (*points)[68][2];        /* [count] of the folder: the drawn frames' */
  double mouth, face;            /* sums over the frames, pixels */
  size_t frames, left_out;       /* left out: the clip has no landmarks of them */
};

/* Mean over the points [begin, end) of the distance of a from b, the mean of these points subtracted from each. */
double landmark_distance(const float a[68][2], const float b[68][2], int begin, int end);

/* Returns 0, or EXIT_FAILURE after a message, as the next one does. All files are read here, and a network sees
 * examples of recorded frames. landmark_distance_close in either case. */
int landmark_distance_open(struct landmark_distance *lmd, const struct evaluation *evaluation);
/* Frame k, as evaluate_frame has drawn it. `row` gets the numbers lmd_mouth and lmd_face, or null. */
int landmark_distance_add(struct landmark_distance *lmd, const struct evaluation *evaluation, size_t k, json_t *row);
void landmark_distance_close(struct landmark_distance *lmd);

#endif
