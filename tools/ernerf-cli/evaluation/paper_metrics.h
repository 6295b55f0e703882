/* SPDX-License-Identifier: MIT
 * The metrics of the paper's tables that need what the user brings: LPIPS, LMD, AUE, FID and Sync (docs/evaluation.md).
 */
#ifndef ERN_CLI_PAPER_METRICS_H
#define ERN_CLI_PAPER_METRICS_H

#include "evaluation/action_units.h"
#include "evaluation/inception.h"
#include "evaluation/landmark_distance.h"
#include "evaluation/perceptual_distance.h"
#include "evaluation/syncnet.h"

enum { PAPER_METRICS_OPTIONS = 6 + LPIPS_OPTIONS };

/* Zeroed: none of them is wanted. */
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
/* EXIT_USAGE after a sentence where one option needs another, else -1. The session learns of the inputs. */
int paper_metrics_check(const struct paper_metrics *metrics, const struct args *args, struct session *session);

/* Opens and reads what was brought. sound: the speech that the frames are drawn from. Returns 0, or EXIT_FAILURE after
 * a message, as the next three do. paper_metrics_close in either case. */
int paper_metrics_open(struct paper_metrics *metrics, const struct evaluation *evaluation, const char *sound);
/* Frame k, as evaluate_frame has drawn it; what a frame has of its own goes into `row`. */
int paper_metrics_add(struct paper_metrics *metrics, const struct evaluation *evaluation, size_t k, json_t *row);
/* After the last frame. */
int paper_metrics_finish(struct paper_metrics *metrics, struct session *session);
void paper_metrics_close(struct paper_metrics *metrics);

/* To standard output, a line each, also where a metric was not computed: then with what it needs. frames: the rows. */
void paper_metrics_print(const struct paper_metrics *metrics, const json_t *frames);
/* An object a metric, or null; the member `not_computed` has what each of these needs. */
json_t *paper_metrics_json(const struct paper_metrics *metrics, const json_t *frames);

#endif
