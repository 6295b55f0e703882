/* SPDX-License-Identifier: MIT
 * What bash and zsh need to complete a command line: a function of the shell, of a part a verb. */
#ifndef ERN_CLI_COMPLETION_H
#define ERN_CLI_COMPLETION_H

#include "option_table.h"
#include "verbs.h"

/* The part of a verb. */
void completion_print_bash(const struct args *args);
void completion_print_zsh(const struct args *args);

/* What stands before the parts and after them. */
void completion_begin_bash(const struct verb *verbs, size_t count);
void completion_end_bash(void);
void completion_begin_zsh(const struct verb *verbs, size_t count);
void completion_end_zsh(void);

#endif
