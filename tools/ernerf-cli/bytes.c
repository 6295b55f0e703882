/* SPDX-License-Identifier: MIT */
#include "bytes.h"

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void bytes_free(struct bytes *bytes) {
  free(bytes->data);
  *bytes = (struct bytes){0};
}

/* Makes room for `more` bytes and a 0. */
static bool grow(struct bytes *bytes, size_t more) {
  if (bytes->failed) return false;
  if (more < bytes->capacity - bytes->count) return true;
  size_t capacity = bytes->capacity > 0 ? bytes->capacity : 256;
  while (capacity <= SIZE_MAX / 2 && capacity - bytes->count <= more) capacity *= 2;
  char *data = capacity - bytes->count > more ? realloc(bytes->data, capacity) : NULL;
  bytes->failed = data == NULL;
  if (data == NULL) return false;
  bytes->data = data;
  bytes->capacity = capacity;
  return true;
}

void bytes_add(struct bytes *bytes, const void *data, size_t count) {
  if (!grow(bytes, count)) return;
  if (count > 0) memcpy(bytes->data + bytes->count, data, count);
  bytes->count += count;
  bytes->data[bytes->count] = 0;
}

void bytes_print(struct bytes *bytes, const char *format, ...) {
  va_list values, again;
  va_start(values, format);
  va_copy(again, values);
  const int count = vsnprintf(NULL, 0, format, values);
  if (count < 0) bytes->failed = true;
  if (count >= 0 && grow(bytes, (size_t)count)) {
    vsnprintf(bytes->data + bytes->count, (size_t)count + 1, format, again);
    bytes->count += (size_t)count;
  }
  va_end(again);
  va_end(values);
}

void bytes_plain(char *text) {
  for (unsigned char *at = (unsigned char *)text; *at != 0; at++) {
    const bool second = at[0] == 0xc2 && at[1] >= 0x80 && at[1] < 0xa0; /* U+0080 to U+009F */
    if (second) *at++ = ' ';
    if (second || *at < 0x20 || *at == 0x7f) *at = ' ';
  }
}

/* Bytes of the UTF-8 character at `text`, 0 where it is none (RFC 3629: no overlong form, surrogate or end of text). */
static size_t utf8_bytes(const unsigned char *text) {
  const unsigned char a = text[0], b = a != 0 ? text[1] : 0;
  const size_t count = a < 0x80                ? 1
                       : a >= 0xc2 && a < 0xe0 ? 2
                       : a >= 0xe0 && a < 0xf0 ? 3
                       : a >= 0xf0 && a < 0xf5 ? 4
                                               : 0;
  for (size_t i = 1; i < count; i++)
    if ((text[i] & 0xc0) != 0x80) return 0;
  const bool bad =
      (a == 0xe0 && b < 0xa0) || (a == 0xed && b >= 0xa0) || (a == 0xf0 && b < 0x90) || (a == 0xf4 && b >= 0x90);
  return bad ? 0 : count;
}

void bytes_utf8(char *to, size_t size, const char *text) {
  size_t at = 0;
  for (const unsigned char *from = (const unsigned char *)text; *from != 0;) {
    const size_t valid = utf8_bytes(from), count = valid > 0 ? valid : 1;
    if (at + count >= size) break;
    memcpy(to + at, valid > 0 ? (const char *)from : "?", count);
    at += count;
    from += count;
  }
  to[at] = 0;
}

void bytes_print_html(struct bytes *bytes, const char *text) {
  static const char special[] = "&<>\"'";
  static const char *const entities[] = {"&amp;", "&lt;", "&gt;", "&quot;", "&#39;"};
  for (const unsigned char *at = (const unsigned char *)text; *at != 0;) {
    const char *found = strchr(special, *at);
    const size_t count = utf8_bytes(at);
    if (found != NULL)
      bytes_print(bytes, "%s", entities[found - special]);
    else if (count == 0 || *at < 0x20 || *at == 0x7f)
      bytes_add(bytes, "?", 1);
    else
      bytes_add(bytes, at, count);
    at += count > 0 ? count : 1;
  }
}

void bytes_print_csv(struct bytes *bytes, const char *text) {
  if (strpbrk(text, ",\"\r\n") == NULL) {
    bytes_add(bytes, text, strlen(text));
    return;
  }
  bytes_add(bytes, "\"", 1);
  for (; *text != 0; text++) bytes_add(bytes, *text == '"' ? "\"\"" : text, *text == '"' ? 2 : 1);
  bytes_add(bytes, "\"", 1);
}

void bytes_print_base64(struct bytes *bytes, const void *data, size_t count) {
  static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  const unsigned char *from = data;
  for (size_t i = 0; i < count; i += 3) {
    const size_t left = count - i;
    const unsigned word =
        (unsigned)from[i] << 16 | (left > 1 ? (unsigned)from[i + 1] << 8 : 0) | (left > 2 ? from[i + 2] : 0);
    const char four[4] = {digits[word >> 18], digits[word >> 12 & 63], left > 1 ? digits[word >> 6 & 63] : '=',
                          left > 2 ? digits[word & 63] : '='};
    bytes_add(bytes, four, sizeof four);
  }
}
