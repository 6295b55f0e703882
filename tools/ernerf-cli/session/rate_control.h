/* SPDX-License-Identifier: MIT
 * Chooses render settings for a time budget. A list of settings with measured error and time, from the most accurate to
 * the fastest, is kept; the controller uses the one that holds the frame rate at the machine's current speed. */
#ifndef ERN_CLI_RATE_CONTROL_H
#define ERN_CLI_RATE_CONTROL_H

#include "session/rung.h"

enum { RATE_CONTROL_OPTIONS = 3 };

/* --hold-fps --quality, and --set front. */
void rate_control_options(struct rate_control *rate_control, struct option options[RATE_CONTROL_OPTIONS]);
/* -1, or EXIT_USAGE after a message if options contradict each other. */
int rate_control_check(const struct rate_control *rate_control, const struct args *args);
/* Whether any of these options was given. */
bool rate_control_asked(const struct rate_control *rate_control);

/* Finds the settings: from the stored front if it matches model, machine and size, else by a short calibration on a few
 * frames. Prints the setting that it begins with, and its cost. Portrait (open), frames and features must outlive it.
 * Returns 0, or EXIT_FAILURE after a message, also if no setting holds the budget. rate_control_close in either case.
 */
int rate_control_open(struct rate_control *rate_control, struct session *session, const struct args *args,
                      const struct portrait *portrait, const struct frame_source *frame_source,
                      const ern_features *features, struct dimensions size, rate_control_draw *draw, void *user);
void rate_control_close(struct rate_control *rate_control);

/* The renderer for the next frame. */
ern_renderer *rate_control_renderer(struct rate_control *rate_control);
/* Milliseconds of processor time that a frame takes at least, with the fastest settings, on a machine of `cores`. */
double rate_control_least(const struct rate_control *rate_control, int cores);
/* The name of that renderer's setting. */
const char *rate_control_name(const struct rate_control *rate_control);
/* Reports the total time of a frame, milliseconds. */
void rate_control_took(struct rate_control *rate_control, double ms);
/* Reports how late the next frame is, milliseconds, by the verb's own clock, which is more accurate than the sum of the
 * frame times. */
void rate_control_late(struct rate_control *rate_control, double ms);
/* Prints a summary. */
void rate_control_summary(const struct rate_control *rate_control, double ms_per_frame);
/* NULL without memory. */
json_t *rate_control_json(const struct rate_control *rate_control);

#endif
