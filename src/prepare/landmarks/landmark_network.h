/* SPDX-License-Identifier: MIT
 * How far the points of a network lie from where they are guessed; the network itself is ern_landmark_network of
 * prepare.h. */
#ifndef ERN_PREPARE_LANDMARK_NETWORK_H
#define ERN_PREPARE_LANDMARK_NETWORK_H

#include "core/status.h"
#include "ernerf/prepare.h"
#include "io/landmarks.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Mean distance of the points 17..67 from those of the guess, in distances of the guess's eyes: the jaw's points lie on
 * different lines in different networks. */
double ern_landmarks_apart(const float points[ERN_LANDMARKS][2], const float guess[ERN_LANDMARKS][2]);

#ifdef __cplusplus
}
#endif
#endif
