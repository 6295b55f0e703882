/* SPDX-License-Identifier: MIT
 * LMD: the distance between the landmarks of drawn and of recorded frames (docs/evaluation.md). */
#ifndef ERN_CLI_LANDMARK_DISTANCE_H
#define ERN_CLI_LANDMARK_DISTANCE_H

#include <jansson.h>

#include "evaluation/evaluate.h"
#include "session/prepare_library.h"

/* Sums over the frames of an evaluation. Initial state: zero except for `path`. */
struct landmark_distance {
  const char *path; /* a network, FILE.onnx, or a folder of ID.lms; NULL: not requested */
  struct landmark_library library;
  ern_landmark_network *network; /* NULL: a folder */
  uint8_t *rgb;                  /* [height][width][3]: a drawn frame, for the network */
  float (*points)[68][2];        /* [count] landmarks of the drawn frames, read from the folder */
  double mouth, face;            /* sums over the frames, pixels */
  size_t frames, left_out;       /* left out: frames without landmarks in the clip */
};

/* Mean distance between a and b over the points [begin, end), after the mean of these points is subtracted from each
 * set. */
double landmark_distance(const float a[68][2], const float b[68][2], int begin, int end);

/* Returns 0, or EXIT_FAILURE after a message, as the next one does. Reads all files, and calibrates a network on
 * examples of recorded frames. Call landmark_distance_close in either case. */
int landmark_distance_open(struct landmark_distance *lmd, const struct evaluation *evaluation);
/* Adds frame k, as evaluate_frame has drawn it, and the numbers lmd_mouth and lmd_face, or null, to `row`. */
int landmark_distance_add(struct landmark_distance *lmd, const struct evaluation *evaluation, size_t k, json_t *row);
void landmark_distance_close(struct landmark_distance *lmd);

#endif
