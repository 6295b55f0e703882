/* SPDX-License-Identifier: MIT
 * Bytes that grow: files are put together here and then written as a whole. */
#ifndef ERN_CLI_BYTES_H
#define ERN_CLI_BYTES_H

#include <stdbool.h>
#include <stddef.h>

#include "ernerf/base.h"

/* Zeroed: empty. Once memory is out, `failed` is set and nothing more is added: look at the end. */
struct bytes {
  char *data; /* with a 0 after the last; NULL: none yet */
  size_t count, capacity;
  bool failed;
};

void bytes_free(struct bytes *bytes);
void bytes_add(struct bytes *bytes, const void *data, size_t count);
void bytes_print(struct bytes *bytes, const char *format, ...) ERN_PRINTF(2, 3);
/* As text of HTML: & < > " ' become entities, control characters and what is no UTF-8 question marks. */
void bytes_print_html(struct bytes *bytes, const char *text);
/* As a field of CSV (RFC 4180): in quotes where it needs them. */
void bytes_print_csv(struct bytes *bytes, const char *text);
/* As base64 (RFC 4648), without line ends. */
void bytes_print_base64(struct bytes *bytes, const void *data, size_t count);

#endif
