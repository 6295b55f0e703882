/* SPDX-License-Identifier: MIT
 * The output's frame rate, and which frames of the 25 fps clip lie before and after an output frame. */
#ifndef ERN_CLI_RATE_H
#define ERN_CLI_RATE_H

#include <stdbool.h>
#include <stddef.h>

enum { RATE_CLIP = 25, RATE_TEXT_BYTES = 24 };

/* numerator / denominator frames a second, in lowest terms. */
struct rate {
  int numerator, denominator; /* 1 to 1000000 each */
};

/* "30", "12.5", "24000/1001", from 1 to 240; the customary decimals of NTSC rates (23.976, 23.98, 29.97, 47.952, 59.94,
 * 119.88) are those rates: 24000/1001 and so on. False: `text` is not a rate. */
bool rate_read(const char *text, struct rate *rate);
/* As rate_read accepts it: "25", "30000/1001". */
void rate_words(struct rate rate, char text[RATE_TEXT_BYTES]);
/* Frames a second. */
double rate_value(struct rate rate);

/* Number of frames at this rate that cover `count` frames at 25 fps, rounded up; 0 if it does not fit a size_t. */
size_t rate_frames(struct rate rate, size_t count);

/* Frame k is shown at k / rate seconds. This time lies between frames `place` and `place` + 1 of the `count` (>= 1)
 * frames at 25 fps, with the interpolation weight `toward` (0 <= toward < 1) of the second. After the last frame it is
 * clamped to the last. */
struct rate_place {
  size_t place;
  double toward;
};
struct rate_place rate_at(struct rate rate, size_t k, size_t count);

#endif
