/* SPDX-License-Identifier: MIT
 * The 68 landmarks (300-W order; left and right as in the picture) of a generic face, millimetres from the middle of
 * the eyes: x right, y up, z out of the face. Drawn up from adults' mean proportions: eyes 63 mm apart; nose 48 mm,
 * mouth 67 mm and chin 106 mm below them. */
#ifndef ERN_PREPARE_LANDMARKS_TEMPLATE_H
#define ERN_PREPARE_LANDMARKS_TEMPLATE_H

#include "io/landmarks.h"

static const double ern_landmarks_template[ERN_LANDMARKS][3] = {
    /* jaw, 0..16 */
    {-70, -2, -75},
    {-69, -20, -72},
    {-67, -38, -68},
    {-63, -55, -60},
    {-56, -71, -48},
    {-46, -85, -33},
    {-33, -96, -18},
    {-17, -103, -8},
    {0, -106, -4},
    {17, -103, -8},
    {33, -96, -18},
    {46, -85, -33},
    {56, -71, -48},
    {63, -55, -60},
    {67, -38, -68},
    {69, -20, -72},
    {70, -2, -75},
    /* brows, 17..26 */
    {-52, 18, -6},
    {-45, 24, 0},
    {-36, 26, 5},
    {-26, 24, 9},
    {-17, 20, 11},
    {17, 20, 11},
    {26, 24, 9},
    {36, 26, 5},
    {45, 24, 0},
    {52, 18, -6},
    /* nose, 27..35 */
    {0, 5, 13},
    {0, -8, 19},
    {0, -21, 26},
    {0, -33, 33},
    {-13, -43, 13},
    {-7, -46, 18},
    {0, -48, 21},
    {7, -46, 18},
    {13, -43, 13},
    /* eyes, 36..47 */
    {-46, -1, -6},
    {-36.5, 4.5, 0},
    {-26.5, 4.5, 1},
    {-17, -1.5, 0},
    {-26.5, -5, 0},
    {-36.5, -5, -1},
    {17, -1.5, 0},
    {26.5, 4.5, 1},
    {36.5, 4.5, 0},
    {46, -1, -6},
    {36.5, -5, -1},
    {26.5, -5, 0},
    /* lips, 48..67: outer, then inner */
    {-25, -67, 5},
    {-16, -62, 12},
    {-6, -59, 15.5},
    {0, -60, 16},
    {6, -59, 15.5},
    {16, -62, 12},
    {25, -67, 5},
    {16, -73, 11},
    {7, -76.5, 14},
    {0, -77, 15},
    {-7, -76.5, 14},
    {-16, -73, 11},
    {-21, -67, 6},
    {-7, -66, 12},
    {0, -66, 12.5},
    {7, -66, 12},
    {21, -67, 6},
    {7, -68.5, 12},
    {0, -69, 12.5},
    {-7, -68.5, 12}};

/* Distance of the mouth's line below the eyes, millimetres. */
#define ERN_TEMPLATE_MOUTH 67.0

#endif
