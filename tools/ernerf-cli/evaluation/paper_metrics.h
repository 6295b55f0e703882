/* SPDX-License-Identifier: MIT
 * The metrics of the paper's tables that need files from the user (network weights, tables): LPIPS, LMD, AUE, FID and
 * Sync (docs/evaluation.md). */
#ifndef ERN_CLI_PAPER_METRICS_H
#define ERN_CLI_PAPER_METRICS_H

#include "evaluation/action_units.h"
#include "evaluation/inception.h"
#include "evaluation/landmark_distance.h"
#include "evaluation/perceptual_distance.h"
#include "evaluation/syncnet.h"

enum { PAPER_METRICS_OPTIONS = 6 + LPIPS_OPTIONS };

/* Zeroed: no metric is requested. */
struct paper_metrics {
  struct perceptual_distance lpips;
  struct landmark_distance lmd;
  struct action_units aue;
  struct inception fid;
  struct syncnet sync;
  bool other_speech; /* set before paper_metrics_open: --setting synchronization, so there are no recorded frames */
};

/* --landmarks --action-units --recorded-action-units --inception
 * --syncnet-video --syncnet-audio --lpips-network --lpips-heads. */
void paper_metrics_options(struct paper_metrics *metrics, struct option options[PAPER_METRICS_OPTIONS]);
/* EXIT_USAGE after a message if one option needs another, else -1. Registers the input files with the session. */
int paper_metrics_check(const struct paper_metrics *metrics, const struct args *args, struct session *session);

/* Opens and reads the user's files. sound: the speech that drives the frames. Returns 0, or EXIT_FAILURE after a
 * message, as the next two do. Call paper_metrics_close in either case. */
int paper_metrics_open(struct paper_metrics *metrics, const struct evaluation *evaluation, const char *sound);
/* Adds frame k, as evaluate_frame has drawn it; metrics of a single frame go into `row`. */
int paper_metrics_add(struct paper_metrics *metrics, const struct evaluation *evaluation, size_t k, json_t *row);
/* After the last frame. */
int paper_metrics_finish(struct paper_metrics *metrics, struct session *session);
void paper_metrics_close(struct paper_metrics *metrics);

/* Prints one line for each metric to standard output; for a metric that was not computed, what it needs. frames: the
 * rows. */
void paper_metrics_print(const struct paper_metrics *metrics, const json_t *frames);
/* One object for each metric, or null; the member `not_computed` tells what each missing metric needs. */
json_t *paper_metrics_json(const struct paper_metrics *metrics, const json_t *frames);

#endif
