/* SPDX-License-Identifier: MIT
 * Options of the public programs (ER-NeRF, RAD-NeRF) that a verb does not have, and what to use here. */
#ifndef ERN_CLI_PUBLIC_OPTIONS_H
#define ERN_CLI_PUBLIC_OPTIONS_H

#include <stddef.h>

/* A sentence for the option with the name name[length], without leading dashes; NULL: those programs have no such
 * option. Dashes and underscores within the name are equivalent. */
const char *public_option(const char *name, size_t length);

#endif
