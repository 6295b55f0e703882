/* SPDX-License-Identifier: MIT
 * The help of a verb, printed from its option tables: as plain text, as a manual page, or as a shell completion script.
 */
#ifndef ERN_CLI_HELP_H
#define ERN_CLI_HELP_H

#include "option_table.h"

/* Prints the form that `word` requests: --help, -h; --help=man, --help=bash, --help=zsh. False: `word` is none of
 * these. */
bool help_asked(const struct args *args, const char *word);

/* Prints what --set takes, as the help has the options. */
void help_settings(const struct args *args);

#endif
