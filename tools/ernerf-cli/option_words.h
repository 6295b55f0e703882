/* SPDX-License-Identifier: MIT
 * How help, manual pages and shell completion print an option and its value. */
#ifndef ERN_CLI_OPTION_WORDS_H
#define ERN_CLI_OPTION_WORDS_H

#include "option_table.h"

enum { HELP_BYTES = 1280 };

#define OPTION_SET_HELP \
  "what is seldom set, again for each; --set help lists all names, with meaning, range and default"

/* The dashes before a name: one for a single letter, else two. */
const char *option_dashes(const char *name);

/* Whether the help has a line for it. */
bool option_is_listed(const struct option *option);

/* Whether a verb has --set: settings, or options that are seldom given. */
bool option_takes_set(const struct args *args);

/* The placeholder for the option's value; NULL: the option takes no value. */
const char *option_value(const struct option *option);

/* The help text of the option, with its default and its range. */
const char *option_text(const struct option *option, char text[HELP_BYTES]);

#endif
