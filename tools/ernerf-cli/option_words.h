/* SPDX-License-Identifier: MIT
 * What help, manual and completion call an option and its value. */
#ifndef ERN_CLI_OPTION_WORDS_H
#define ERN_CLI_OPTION_WORDS_H

#include "option_table.h"

enum { HELP_BYTES = 1280 };

/* What stands before a name: one dash before a single letter. */
const char *option_dashes(const char *name);

/* What stands for the value of an option; NULL: it has none. */
const char *option_value(const struct option *option);

/* What the option does, its default and its range. */
const char *option_text(const struct option *option, char text[HELP_BYTES]);

#endif
