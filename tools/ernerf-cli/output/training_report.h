/* SPDX-License-Identifier: MIT
 * Trainings of several kinds side by side: their curves, what each decibel took, and the files that say so. */
#ifndef ERN_CLI_TRAINING_REPORT_H
#define ERN_CLI_TRAINING_REPORT_H

#include <jansson.h>

#include "ernerf/train.h"
#include "output/curve.h"
#include "session/pareto.h"
#include "session/session.h"
#include "session/statistics.h"

enum { TRAINING_KINDS = 20, TRAINING_SEEDS = 8, TRAINING_MARKS = 5 };

struct training_kind {
  char name[80]; /* what is not the base's, in words */
  int rays, levels, device;
  ern_ray_sampling ray_sampling;
  uint64_t refresh_every; /* as of ern_train_config */
  bool opencl, bf16;
  bool timed;   /* as `train --time` chooses */
  char isa[24]; /* "": the base's */
  uint64_t iters;
  struct curve curve[TRAINING_SEEDS]; /* validations at the same steps for all seeds */
};

enum { FINE_STEPS = 3 };
/* A kind of step: coarse, or of the fine stage with a loss. */
struct fine_step {
  char loss[32];          /* "coarse", "ssim", or the name of LPIPS and its network */
  struct quartiles ms;    /* of a step */
  struct quartiles times; /* a step over the coarse step of the same turn */
};
/* What the loss of the fine stage takes: steps of the first training's kind, in turns. */
struct fine_stage_cost {
  struct fine_step step[FINE_STEPS]; /* the first one is coarse */
  size_t count, turns;               /* count 0: the rays or the clip's pictures have no room for a patch */
  int rays, patch;                   /* a step; pixels a side */
};

struct training_study {
  struct training_kind kind[TRAINING_KINDS]; /* the first one is the base */
  size_t count, seeds, frames;               /* frames: of a validation */
  const char *clip;
  double seconds; /* of training, for each curve */
  char processor[128], base_isa[24];
  int cores;
  struct fine_stage_cost fine;
};

void training_free(struct training_study *study);

/* Of the last validation over the seeds; NaN: not known. */
struct training_end {
  struct mean_and_deviation psnr, mouth; /* dB; share of the mouth's motion that is explained */
};
struct training_end training_final(const struct training_kind *kind, size_t seeds);

/* Seconds until the mean curve over the seeds first reaches `psnr`, between its points along a line; NaN where it does
 * not. The time of the first point is all that is known of what was before. */
double training_seconds_to(const struct training_kind *kind, size_t seeds, double psnr);

/* The object of --json and of training.json; NULL without memory. */
json_t *training_json(const struct training_study *study);
/* Writes DIR/training.md, .csv, .json and the plots. Returns 0, or EXIT_FAILURE after a message. */
int training_write(const struct training_study *study, struct session *session, const char *folder);

#endif
