/* SPDX-License-Identifier: MIT
 * Pages of the manual, section 1, in the macros of man(7): of a verb, and of the program. */
#ifndef ERN_CLI_MANUAL_H
#define ERN_CLI_MANUAL_H

#include "option_table.h"
#include "verbs.h"

void manual_print(const struct args *args);

/* `end`: what stands after the verbs, paragraphs. */
void manual_print_program(const char *summary, const struct verb *verbs, size_t count, const char *end);

#endif
