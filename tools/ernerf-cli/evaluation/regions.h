/* SPDX-License-Identifier: MIT
 * Regions of the face that are evaluated separately. */
#ifndef ERN_CLI_REGIONS_H
#define ERN_CLI_REGIONS_H

#include "ernerf/media.h"

/* Boxes in pixels, half-open and clipped to the picture. False without landmarks, or if the clipped box is empty. head:
 * of all 68 landmarks, integer-truncated minima and maxima. mouth: the square around landmarks 48..59. eyes: of
 * landmarks 36..47, and a quarter of its width on each side. */
bool region_head(const ern_clip_frame *frame, int width, int height, ern_box *box);
bool region_mouth(const ern_clip_frame *frame, int width, int height, ern_box *box);
bool region_eyes(const ern_clip_frame *frame, int width, int height, ern_box *box);

#endif
