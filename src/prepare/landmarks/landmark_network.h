/* SPDX-License-Identifier: MIT
 * The distance of a network's points from a guess; the network itself is ern_landmark_network of prepare.h. */
#ifndef ERN_PREPARE_LANDMARK_NETWORK_H
#define ERN_PREPARE_LANDMARK_NETWORK_H

#include "core/status.h"
#include "ernerf/prepare.h"
#include "io/landmarks.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Mean distance of points 17..67 from the guess, as a multiple of the guess's eye distance. The jaw's points are left
 * out: networks place them on different lines. */
double ern_landmarks_distance(const float points[ERN_LANDMARKS][2], const float guess[ERN_LANDMARKS][2]);

#ifdef __cplusplus
}
#endif
#endif
