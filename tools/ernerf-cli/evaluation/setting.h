/* SPDX-License-Identifier: MIT
 * The two settings that the paper evaluates in, --setting: head reconstruction and lip synchronization
 * (docs/evaluation.md). */
#ifndef ERN_CLI_SETTING_H
#define ERN_CLI_SETTING_H

#include "evaluation/evaluate.h"

enum setting {
  SETTING_RECONSTRUCTION,  /* unseen frames with the clip's own speech: recorded frames exist */
  SETTING_SYNCHRONIZATION, /* other speech with the clip's poses: no recorded frames exist */
  SETTING_NONE             /* neither: trained frames, or --audio without --setting */
};

enum { SETTING_OPTIONS = 1 };
/* --setting; *setting is an enum setting. */
void setting_options(int *setting, struct option options[SETTING_OPTIONS]);
/* Derives *setting from the options; with synchronization and without --split, selects all frames. EXIT_USAGE after a
 * message if options contradict the setting, else -1. */
int setting_check(int *setting, const struct args *args, struct portrait *portrait);
/* For synchronization only: fails if the speech is a file of the clip, and drops the frames after the end of the
 * speech. Returns 0, or EXIT_FAILURE after a message. */
int setting_open(int setting, struct evaluation *evaluation, const struct portrait *portrait);

/* "reconstruction" or "synchronization"; NULL: neither. */
const char *setting_name(int setting);
/* A text that tells what is compared. */
const char *setting_words(int setting);
/* With SETTING_SYNCHRONIZATION: the reason why figures that need recorded frames are missing. */
extern const char setting_no_truth[];

#endif
