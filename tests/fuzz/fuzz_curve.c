/* SPDX-License-Identifier: MIT
 * Any bytes as the curve.csv that a training left, and that a plot is made from. */
#include <stdarg.h>

#include "fuzz.h"
#include "output/curve.h"

/* The program's words, formatted and not said. */
int session_fail_with(struct session *session, const char *format, ...) {
  char text[4096];
  va_list values;
  (void)session;
  va_start(values, format);
  vsnprintf(text, sizeof text, format, values);
  va_end(values);
  return EXIT_FAILURE;
}

/* The file is never drawn here. */
bool session_skips_link(struct session *session, const char *path) {
  (void)session, (void)path;
  return false;
}

int session_write(struct session *session, const char *path, const void *bytes, size_t count) {
  (void)session, (void)path, (void)bytes, (void)count;
  return EXIT_FAILURE;
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  struct session session = {.verb = "fuzz"};
  struct curve curve = {0};
  fuzz_file("fuzz.csv", bytes, count);
  if (curve_read(&curve, &session, "fuzz.csv") == 0) {
    for (size_t i = 1; i < curve.count; i++) FUZZ_REQUIRE(curve.point[i].step > curve.point[i - 1].step);
  }
  curve_free(&curve);
  return 0;
}
