/* SPDX-License-Identifier: MIT
 * Shell completion for bash and zsh: prints one shell function, with one part for each verb. */
#ifndef ERN_CLI_COMPLETION_H
#define ERN_CLI_COMPLETION_H

#include "option_table.h"
#include "verbs.h"

/* Prints the part of a verb. */
void completion_print_bash(const struct args *args);
void completion_print_zsh(const struct args *args);

/* Print the text before and after these parts. */
void completion_begin_bash(const struct verb *verbs, size_t count);
void completion_end_bash(void);
void completion_begin_zsh(const struct verb *verbs, size_t count);
void completion_end_zsh(void);

#endif
