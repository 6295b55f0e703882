/* SPDX-License-Identifier: MIT
 * Comparison of two portraits on the same frames: the state of `ernerf compare`, and its figures. */
#ifndef ERN_CLI_COMPARE_H
#define ERN_CLI_COMPARE_H

#include <jansson.h>
#include <sys/stat.h>

#include "bytes.h"
#include "evaluation/comparison.h"
#include "evaluation/evaluate.h"
#include "evaluation/frame_figures.h"
#include "evaluation/perceptual_distance.h"
#include "lab/compare_side.h"
#include "session/portrait.h"

enum { COMPARE_SIDES = 2, COMPARE_FIGURES = 5, COMPARE_MEASURES = 7, COMPARE_SHOWN = FRAME_FIGURES_SHOWN };

struct compare {
  struct session session;
  struct portrait asked;           /* options and CLIP, shared by both sides */
  const char *path[COMPARE_SIDES]; /* A and B */
  const char *folder;
  /* made */
  struct compare_side side[COMPARE_SIDES];
  ern_clip *clip; /* if both sides are videos; NULL: a model's clip is used */
  struct comparison comparison;
  struct evaluated *evaluated[COMPARE_SIDES]; /* [frames] */
  struct perceptual_distance perceptual;      /* of both sides */
  double *lpips[COMPARE_SIDES];               /* [frames]; NULL: not requested */
  json_t *rows[COMPARE_SIDES + 1];            /* arrays with one row for each frame: A, B, B - A */
  size_t shown[COMPARE_SHOWN];                /* frames: B relative to A at best, median, at worst */
  struct stat video;                          /* the video's file while it has a temporary name; st_ino 0: none */
  bool made_folder;
  bool begun; /* a marker file of the running comparison exists; it is removed at the end (compare_files.c) */
};

extern const char compare_letters[COMPARE_SIDES];            /* "AB" */
extern const char *const compare_shown_names[COMPARE_SHOWN]; /* "best" ... */

/* Figures of a frame: PSNR, SSIM, PSNR of the head, PSNR of the mouth, and LPIPS, which is the last. */
struct compare_figure {
  const char *name, *title; /* "psnr", "PSNR" */
  int digits;               /* of a table */
  bool smaller;             /* smaller is better; else larger is */
};
extern const struct compare_figure compare_figures[COMPARE_FIGURES];
/* Number of figures: all with the weights of LPIPS, else all but LPIPS. */
size_t compare_figure_count(const struct compare *c);

/* Summary over the frames that have the figure; NaN: none has it. interval: half-width of the mean's 95 % confidence
 * interval, NaN for fewer than two frames. */
struct compare_summary {
  double mean[COMPARE_SIDES], interval[COMPARE_SIDES];
  double difference, difference_interval; /* B - A by frame */
  size_t wins[COMPARE_SIDES], equal;      /* frames in which the side is better; in which both are equal */
};

size_t compare_frames(const struct compare *c);
const struct source_frame *compare_frame(const struct compare *c, size_t k);
/* Figure `figure` of frame k; NaN: the frame lacks the region. */
double compare_value(const struct compare *c, size_t side, size_t k, size_t figure);
/* The same, B - A. */
double compare_difference(const struct compare *c, size_t k, size_t figure);

/* After the last frame: fills rows and shown. Returns 0, or EXIT_FAILURE after a message. */
int compare_make_rows(struct compare *c);
struct compare_summary compare_summarise(const struct compare *c, size_t figure);

/* Figures over all frames together, such as the motion of the mouth. NaN: not known for this clip. */
struct compare_measure {
  const char *title;
  const char *best; /* the value of the recorded frames themselves */
  double value[COMPARE_SIDES];
};
void compare_measures(const struct compare *c, struct compare_measure measures[COMPARE_MEASURES]);

/* The object of --json and of compare.json; NULL without memory. */
json_t *compare_json(const struct compare *c);
void compare_csv(const struct compare *c, struct bytes *csv);
/* The table for standard output. */
void compare_text(const struct compare *c, struct bytes *text);

#endif
