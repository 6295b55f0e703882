/* SPDX-License-Identifier: MIT
 * Reports on the frames of an evaluation: a table, confidence intervals of the means, and a picture sheet of the best,
 * the median and the worst frame. */
#ifndef ERN_CLI_FRAME_FIGURES_H
#define ERN_CLI_FRAME_FIGURES_H

#include <jansson.h>

#include "bytes.h"
#include "evaluation/evaluate.h"

/* frames: an array of objects, one a frame, with the numbers "psnr", "ssim", "psnr_head", "psnr_mouth" or null, "id",
 * "split", "ms"; where they were computed also "lpips", "lmd_mouth", "lmd_face". Writes one line for each frame; null
 * becomes an empty field. */
void frame_figures_csv(const json_t *frames, struct bytes *csv);

/* Half-width of the 95 % confidence interval of the mean of a number over the frames that have it: 1.96 s/sqrt(n),
 * where s is the sample standard deviation; NAN for fewer than 2. Frames are treated as independent. Neighbouring
 * frames of a video are correlated, so the interval is too small. */
double frame_figures_interval(const json_t *frames, const char *name);

enum { FRAME_FIGURES_SHOWN = 3 };
/* Indices of the largest, the median and the smallest of `count` >= 1 values; of equal values the earlier ranks higher.
 * Returns 0, or -1 without memory. */
int frame_figures_rank(const double *values, size_t count, size_t place[FRAME_FIGURES_SHOWN]);

/* Pictures of one frame side by side, rgb[height][(2 count + 1) width][3]: `count` drawn ones ([height][width][4]
 * each), the recorded frame ([height][width][3]), and 4 times the difference of each from it. */
void frame_figures_row(uint8_t *rgb, const uint8_t *const *drawn, size_t count, const uint8_t *truth, size_t width,
                       size_t height);

/* Draws the best, the median and the worst frame by PSNR (of equal ones the first) once more and writes a PNG with one
 * row for each: from left to right the model's picture, the recorded frame, 4 times their difference. Returns 0, or
 * EXIT_FAILURE after a message. */
int frame_figures_sheet(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model,
                        const json_t *frames, const char *path);

#endif
