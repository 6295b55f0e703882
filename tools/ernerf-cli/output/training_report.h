/* SPDX-License-Identifier: MIT
 * Compares trainings of several kinds: their validation curves, the time to reach a quality, and report files. */
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
  char name[80]; /* its differences from the base, as text */
  int rays, levels, device;
  ern_ray_sampling ray_sampling;
  uint64_t refresh_every; /* as of ern_train_config */
  bool opencl, bf16;
  bool timed;   /* with the defaults of `train --time` */
  char isa[24]; /* "": the base's */
  uint64_t iters;
  struct curve curve[TRAINING_SEEDS]; /* all seeds are validated at the same steps */
};

enum { FINE_STEPS = 3 };
/* A kind of step: coarse, or of the fine stage with a loss. */
struct fine_step {
  char loss[32];          /* "coarse", "ssim", or the name of LPIPS and its network */
  struct quartiles ms;    /* of a step */
  struct quartiles times; /* ratio to the coarse step of the same turn */
};
/* Time of steps with the fine stage's loss, measured in turns with the settings of the first kind. */
struct fine_stage_cost {
  struct fine_step step[FINE_STEPS]; /* the first one is coarse */
  size_t count, turns;               /* count 0: the rays or the clip's pictures are too few or small for a patch */
  int rays, patch;                   /* rays a step; side of a patch in pixels */
};

struct training_study {
  struct training_kind kind[TRAINING_KINDS]; /* the first one is the base */
  size_t count, seeds, frames;               /* frames: of a validation */
  const char *clip;
  double seconds; /* of training for each curve */
  char processor[128], base_isa[24];
  int cores;
  struct fine_stage_cost fine;
};

void training_free(struct training_study *study);

/* Results of the last validation over the seeds; NaN: not known. */
struct training_end {
  struct mean_and_deviation psnr, mouth; /* dB; explained share of the mouth's motion */
};
struct training_end training_final(const struct training_kind *kind, size_t seeds);

/* Seconds until the mean curve over the seeds first reaches `psnr`, by linear interpolation between its points; NaN:
 * never. If the first point is already above it, returns the time of that point. */
double training_seconds_to(const struct training_kind *kind, size_t seeds, double psnr);

/* The object of --json and of training.json; NULL without memory. */
json_t *training_json(const struct training_study *study);
/* Writes DIR/training.md, .csv, .json and the plots. Returns 0, or EXIT_FAILURE after a message. */
int training_write(const struct training_study *study, struct session *session, const char *folder);

#endif
