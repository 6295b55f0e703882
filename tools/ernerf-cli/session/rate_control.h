/* SPDX-License-Identifier: MIT
 * A budget in place of settings: settings of measured error and time, from the most accurate to the fastest, and the one
 * that holds a rate at the pace that the machine has now. */
#ifndef ERN_CLI_RATE_CONTROL_H
#define ERN_CLI_RATE_CONTROL_H

#include "session/rung.h"

enum { RATE_CONTROL_OPTIONS = 4 };

/* --hold-fps --budget --quality --front. */
void rate_control_options(struct rate_control *rate_control, struct option options[RATE_CONTROL_OPTIONS]);
/* -1, or EXIT_USAGE after a sentence where words contradict each other. */
int rate_control_check(const struct rate_control *rate_control, const struct args *args);
/* Whether anything of it was asked for. */
bool rate_control_asked(const struct rate_control *rate_control);

/* Finds the settings: from the front that belongs to model, machine and size, else by a quick look at a few frames;
 * says which one it begins with and what it costs. Portrait (open), frames and features must outlive it. Returns 0, or
 * EXIT_FAILURE after a message, also where nothing holds the budget. rate_control_close in either case. */
int rate_control_open(struct rate_control *rate_control, struct session *session, const struct args *args,
                      const struct portrait *portrait, const struct frame_source *frame_source,
                      const ern_features *features, struct dimensions size, rate_control_draw *draw, void *user);
void rate_control_close(struct rate_control *rate_control);

/* What the next frame is drawn with. */
ern_renderer *rate_control_renderer(struct rate_control *rate_control);
/* The name of that setting. */
const char *rate_control_name(const struct rate_control *rate_control);
/* A frame took so long, all in all, milliseconds. */
void rate_control_took(struct rate_control *rate_control, double ms);
/* The next frame is so many milliseconds late by the verb's own clock, which knows better than the sum of times. */
void rate_control_late(struct rate_control *rate_control, double ms);
/* Says how it went. */
void rate_control_summary(const struct rate_control *rate_control, double ms_per_frame);
/* NULL without memory. */
json_t *rate_control_json(const struct rate_control *rate_control);

#endif
