/* SPDX-License-Identifier: MIT
 * Measures of a rendered picture against the true one that PSNR does not capture: sharpness, and the seam between head
 * and torso. */
#ifndef ERN_CLI_PICTURE_MEASURES_H
#define ERN_CLI_PICTURE_MEASURES_H

#include <stdbool.h>
#include <stddef.h>

#include "ernerf/media.h"

/* Grey pictures are [height][width], 0..1. The grey of a colour is that of Rec. 601. */
void grey_of_bytes(float *grey, const uint8_t *rgb, size_t pixels);
void grey_of_colours(float *grey, const float *rgb, size_t pixels);

/* Sum of the squared gradient (central differences) over the box's inner pixels; the box is clipped to the picture. */
double gradient_energy(const float *grey, int width, int height, const ern_box *box);

/* Uses the band along the neck: from the jaw (the line through landmarks 4..12) 0.35 eye distances down. Adds the
 * squared differences in it to *sum and their number to *count. False without landmarks or if the band lies outside the
 * picture. */
bool neck_difference(const ern_clip_frame *frame, const float *truth, const float *rendered, int width, int height,
                     double *sum, size_t *count);

#endif
