/* SPDX-License-Identifier: MIT */
#include "core/format.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

locale_t ern_locale_plain(void) {
  const locale_t plain = newlocale(LC_ALL_MASK, "C", (locale_t)0); /* in glibc and musl a constant */
  return plain != (locale_t)0 ? uselocale(plain) : (locale_t)0;
}

void ern_locale_restore(locale_t host) {
  if (host != (locale_t)0) freelocale(uselocale(host));
}

int ern_format_list(char *text, size_t bytes, const char *format, va_list values) {
  const locale_t host = ern_locale_plain();
  if (bytes > 0) text[0] = 0;
  const int length = host != (locale_t)0 ? vsnprintf(text, bytes, format, values) : -1;
  ern_locale_restore(host);
  return length;
}

int ern_format(char *text, size_t bytes, const char *format, ...) {
  va_list values;
  va_start(values, format);
  const int length = ern_format_list(text, bytes, format, values);
  va_end(values);
  return length;
}

bool ern_format_read(const char *text, double *value) {
  char *end = NULL;
  if (text[0] == 0 || strspn(text, "0123456789+-.eE") != strlen(text)) return false;
  const locale_t host = ern_locale_plain();
  *value = strtod(text, &end);
  ern_locale_restore(host);
  return *end == 0 && isfinite(*value);
}
