/* SPDX-License-Identifier: MIT
 * A growing byte buffer. A file is composed in it and then written as a whole. */
#ifndef ERN_CLI_BYTES_H
#define ERN_CLI_BYTES_H

#include <stdbool.h>
#include <stddef.h>

#include "ernerf/base.h"

/* Zeroed: empty. When memory runs out, `failed` is set and nothing more is added: check it once, at the end. */
struct bytes {
  char *data; /* followed by a 0; NULL: empty */
  size_t count, capacity;
  bool failed;
};

void bytes_free(struct bytes *bytes);
void bytes_add(struct bytes *bytes, const void *data, size_t count);
void bytes_print(struct bytes *bytes, const char *format, ...) ERN_PRINTF(2, 3);
/* In place: control characters, which a terminal would interpret, become spaces. */
void bytes_plain(char *text);
/* Copies the characters that have room in to[size]; bytes that are not UTF-8 become question marks. */
void bytes_utf8(char *to, size_t size, const char *text);
/* As HTML text: & < > " ' become entities; control characters and bytes that are not UTF-8 become question marks. */
void bytes_print_html(struct bytes *bytes, const char *text);
/* As a field of CSV (RFC 4180): quoted if necessary. */
void bytes_print_csv(struct bytes *bytes, const char *text);
/* As base64 (RFC 4648), without line breaks. */
void bytes_print_base64(struct bytes *bytes, const void *data, size_t count);

#endif
