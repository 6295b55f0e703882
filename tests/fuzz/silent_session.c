/* SPDX-License-Identifier: MIT
 * What the readers of the command line need of its session: their words are formatted and not said, and nothing is
 * written. */
#include <stdarg.h>

#include "fuzz.h"
#include "output/curve.h"

/* The words begin with the name of the file that was read, which is fuzz.csv or fuzz.json. */
int session_fail_with(struct session *session, const char *format, ...) {
  static const char path[] = "fuzz.";
  char text[4096];
  va_list values;
  (void)session;
  va_start(values, format);
  vsnprintf(text, sizeof text, format, values);
  va_end(values);
  FUZZ_REQUIRE(strncmp(text, path, strlen(path)) == 0);
  return EXIT_FAILURE;
}

bool session_skips_link(struct session *session, const char *path) {
  (void)session, (void)path;
  return false;
}

int session_write(struct session *session, const char *path, const void *bytes, size_t count) {
  (void)session, (void)path, (void)bytes, (void)count;
  return EXIT_FAILURE;
}
