/* SPDX-License-Identifier: MIT
 * What a verb takes, in words: its help, and the same tables as a page of the manual and for the completion of shells.
 */
#ifndef ERN_CLI_HELP_H
#define ERN_CLI_HELP_H

#include "option_table.h"

/* Prints what `word` asks for: --help, -h; --help=man, --help=bash, --help=zsh. False: it asks for none of these. */
bool help_asked(const struct args *args, const char *word);

#endif
