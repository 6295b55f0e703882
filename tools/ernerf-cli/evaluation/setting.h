/* SPDX-License-Identifier: MIT
 * The two settings that the paper evaluates in, --setting: head reconstruction and lip synchronization
 * (docs/evaluation.md). */
#ifndef ERN_CLI_SETTING_H
#define ERN_CLI_SETTING_H

#include "evaluation/evaluate.h"

enum setting {
  SETTING_RECONSTRUCTION,  /* frames that were not trained on, with the clip's own speech: each was recorded */
  SETTING_SYNCHRONIZATION, /* other speech over the clip's poses: there are no recorded frames of it */
  SETTING_NONE             /* neither: trained frames, or --audio without --setting */
};

enum { SETTING_OPTIONS = 1 };
/* --setting; *setting is an enum setting. */
void setting_options(int *setting, struct option options[SETTING_OPTIONS]);
/* What the words make of it: *setting, and with synchronization all frames where --split does not say. EXIT_USAGE after
 * a sentence where words contradict the setting, else -1. */
int setting_check(int *setting, const struct args *args, struct portrait *portrait);
/* Synchronization alone: fails where the speech is a file of the clip, and leaves out the frames that come after the
 * end of the speech. Returns 0, or EXIT_FAILURE after a message. */
int setting_open(int setting, struct evaluation *evaluation, const struct portrait *portrait);

/* "reconstruction" or "synchronization"; NULL: neither. */
const char *setting_name(int setting);
/* What is compared, in words. */
const char *setting_words(int setting);
/* Why a figure that compares with recorded frames is not there: of SETTING_SYNCHRONIZATION. */
extern const char setting_no_truth[];

#endif
