/* SPDX-License-Identifier: MIT
 * Options of the public programs (ER-NeRF, RAD-NeRF) that a verb does not have, and what to use here. */
#ifndef ERN_CLI_PUBLIC_OPTIONS_H
#define ERN_CLI_PUBLIC_OPTIONS_H

#include <stddef.h>

/* A sentence for the option of these `length` letters, without dashes; NULL: it is none of theirs. Dashes and
 * underscores within it are the same. */
const char *public_option(const char *name, size_t length);

#endif
