/* SPDX-License-Identifier: MIT
 * A network that finds the landmarks of a face: a square picture of three channels in (NCHW), x, y of 68 points (300-W
 * order) or of 98 (WFLW order) out, as shares of the square or in its pixels. */
#ifndef ERN_PREPARE_LANDMARK_NETWORK_H
#define ERN_PREPARE_LANDMARK_NETWORK_H

#include "core/status.h"
#include "io/landmarks.h"

#ifdef __cplusplus
extern "C" {
#endif

struct ern_landmark_network;

/* The caller frees *network, also where it fails. */
ERN_NODISCARD ern_status ern_landmark_network_open(ern_context *context, const char *path,
                                                   struct ern_landmark_network **network);
void ern_landmark_network_free(struct ern_landmark_network *network); /* accepts NULL */
/* Takes a frame as an example of how the network wants its colours and its square. rgb[side][side][3]; `guess`: about
 * where the points are, pixels of it. */
ERN_NODISCARD ern_status ern_landmark_network_learn(struct ern_landmark_network *network, const uint8_t *rgb, int side,
                                                    const float guess[ERN_LANDMARKS][2]);
/* Decides on the way whose points are nearest to the guesses; ERN_E_UNSUPPORTED where none is near. */
ERN_NODISCARD ern_status ern_landmark_network_decide(struct ern_landmark_network *network);
/* Points of a frame, after that. */
ERN_NODISCARD ern_status ern_landmark_network_run(struct ern_landmark_network *network, const uint8_t *rgb, int side,
                                                  const float guess[ERN_LANDMARKS][2], float points[ERN_LANDMARKS][2]);

/* Mean distance of the points 17..67 from those of the guess, in distances of the guess's eyes: the jaw's points lie on
 * different lines in different networks. */
double ern_landmarks_apart(const float points[ERN_LANDMARKS][2], const float guess[ERN_LANDMARKS][2]);

#ifdef __cplusplus
}
#endif
#endif
