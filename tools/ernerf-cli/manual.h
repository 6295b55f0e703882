/* SPDX-License-Identifier: MIT
 * Manual pages (section 1, macros of man(7)) for a verb and for the program. */
#ifndef ERN_CLI_MANUAL_H
#define ERN_CLI_MANUAL_H

#include "option_table.h"
#include "verbs.h"

void manual_print(const struct args *args);

/* `end`: paragraphs that follow the list of verbs. */
void manual_print_program(const char *summary, const struct verb *verbs, size_t count, const char *end);

#endif
