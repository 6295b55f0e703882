/* SPDX-License-Identifier: MIT
 * What an evaluation keeps of its frames: a table, how sure their means are, and a sheet of the best, the median and
 * the worst frame. */
#ifndef ERN_CLI_FRAME_FIGURES_H
#define ERN_CLI_FRAME_FIGURES_H

#include <jansson.h>

#include "bytes.h"
#include "evaluation/evaluate.h"

/* frames: an array of objects, one a frame, with the numbers "psnr", "ssim", "psnr_head", "psnr_mouth" or null, "id",
 * "split", "ms"; where they were computed also "lpips", "lmd_mouth",
 * "lmd_face". A line a frame; an empty field where a number is null. */
void frame_figures_csv(const json_t *frames, struct bytes *csv);

/* Half of the 95 % interval of the mean of a number over the frames that have it, 1.96 s/sqrt(n), s being their sample
 * standard deviation; NAN for fewer than 2. Frames count as independent, which neighbours of a video are not: the
 * interval is too small by what they have in common. */
double frame_figures_interval(const json_t *frames, const char *name);

enum { FRAME_FIGURES_SHOWN = 3 };
/* Places of the largest, the median and the least of `count` >= 1 values; of equal ones the earlier counts as larger.
 * Returns 0, or -1 without memory. */
int frame_figures_rank(const double *values, size_t count, size_t place[FRAME_FIGURES_SHOWN]);

/* Pictures of one frame side by side, rgb[height][(2 count + 1) width][3]: `count` drawn ones ([height][width][4]
 * each), the recorded frame ([height][width][3]), and 4 times the difference of each from it. */
void frame_figures_row(uint8_t *rgb, const uint8_t *const *drawn, size_t count, const uint8_t *truth, size_t width,
                       size_t height);

/* Draws the best, the median and the worst frame by PSNR (of equal ones the first) once more and writes a PNG, a row
 * each: from left to right the model's picture, the recorded frame, 4 times their difference. Returns 0, or
 * EXIT_FAILURE after a message. */
int frame_figures_sheet(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model,
                        const json_t *frames, const char *path);

#endif
