/* SPDX-License-Identifier: MIT
 * The words of a command line, read by tables: a row an option, a table a group. Dashes and underscores are the same in
 * names; `--name value` and `--name=value` both do, and of one letter `-n value` and `-nvalue`. */
#ifndef ERN_CLI_ARGS_H
#define ERN_CLI_ARGS_H

#include "ernerf/base.h"
#include "option_table.h"
#include "session/rate.h"

enum { EXIT_USAGE = 2 }; /* wrong words; 1 (EXIT_FAILURE) is for work that failed */

/* Reads argv[0 .. argc - 1], the words after the verb. Returns -1 to go on, else the exit status: EXIT_SUCCESS after
 * --help, EXIT_USAGE after a sentence on stderr. */
int args_parse(struct args *args, int argc, char **argv);

/* Whether the option was on the command line. `name` must be one of the tables. */
bool args_given(const struct args *args, const char *name);

/* Says "ernerf VERB: ..." and where the help is, on stderr. Returns EXIT_USAGE. */
int args_refuse(const struct args *args, const char *format, ...) ERN_PRINTF(2, 3);

/* Leaves `names` (split at spaces) of a shared table out of the help. */
void args_unlist(struct args *args, const char *names);

/* EXIT_USAGE with a sentence when one of `names` (split at spaces) was given, for the reason `why`; else -1. */
int args_forbid(const struct args *args, const char *names, const char *why);

/* Of `count` names the one nearest to `name` by edits; NULL where more than a third of its letters would change. */
const char *args_nearest(const char *name, const char *const *names, size_t count);

#endif
