/* SPDX-License-Identifier: MIT
 * Command-line parser driven by option tables: one row for each option, one table for each group. Dashes and
 * underscores are equivalent in names. `--name value` and `--name=value` are accepted, and for a single letter `-n
 * value` and `-nvalue`. */
#ifndef ERN_CLI_ARGS_H
#define ERN_CLI_ARGS_H

#include "ernerf/base.h"
#include "option_table.h"
#include "rate.h"
#include "setting_choice.h"

enum { EXIT_USAGE = 2 }; /* wrong usage; EXIT_FAILURE (1) means that the work failed */

/* Parses argv[0 .. argc - 1], the arguments after the verb. Returns -1 to continue, else the exit status: EXIT_SUCCESS
 * after --help, EXIT_USAGE after a message on stderr. */
int args_parse(struct args *args, int argc, char **argv);

/* Whether the option was on the command line. `name` must be in one of the tables. */
bool args_given(const struct args *args, const char *name);

/* Prints "ernerf VERB: ..." and how to get help on stderr. Returns EXIT_USAGE. */
int args_refuse(const struct args *args, const char *format, ...) ERN_PRINTF(2, 3);

/* Hides the options `names` (separated by spaces) of a shared table from the help. */
void args_unlist(struct args *args, const char *names);

/* If one of `names` (separated by spaces) was given, EXIT_USAGE after a message with the reason `why`; else -1. */
int args_forbid(const struct args *args, const char *names, const char *why);

/* The same of a setting of --set, by its name, and of all settings of a scope. */
int args_forbid_setting(const struct args *args, const struct setting_choice *choice, const char *name,
                        const char *why);
int args_forbid_settings(const struct args *args, const struct setting_choice *choice, ern_setting_scope scope,
                         const char *why);

/* The one of `count` names with the least edit distance to `name`; NULL if more than a third of its letters would
 * change. */
const char *args_nearest(const char *name, const char *const *names, size_t count);

#endif
