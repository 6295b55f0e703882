/* SPDX-License-Identifier: MIT
 * Shared code of the fuzz targets. libFuzzer calls LLVMFuzzerTestOneInput, or replay.c does. */
#ifndef ERN_TESTS_FUZZ_H
#define ERN_TESTS_FUZZ_H

#include <fcntl.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/memory.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count);

/* Aborts the program if a guarantee of a reader does not hold. */
#define FUZZ_REQUIRE(holds)                                                      \
  do {                                                                           \
    if (!(holds)) {                                                              \
      fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #holds); \
      abort();                                                                   \
    }                                                                            \
  } while (0)

/* One context for all inputs, as in a program that reads many files. */
static inline ern_context *fuzz_context(void) {
  static ern_context *context;
  if (context == NULL && ern_context_create(&context, NULL) != ERN_OK) abort();
  return context;
}

/* Writes these bytes to the file `path` in the working folder. */
static inline void fuzz_file(const char *path, const uint8_t *bytes, size_t count) {
  const int file = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0644);
  FUZZ_REQUIRE(file >= 0);
  for (size_t done = 0; done < count;) {
    const ssize_t written = write(file, bytes + done, count - done);
    FUZZ_REQUIRE(written > 0);
    done += (size_t)written;
  }
  FUZZ_REQUIRE(close(file) == 0);
}

/* Checks a failed reader: it must return an error status, and a message that begins with the file's name. */
static inline void fuzz_refused(const ern_context *context, const char *path) {
  FUZZ_REQUIRE(strncmp(ern_last_error(context), path, strlen(path)) == 0);
}

/* A copy in the library's memory, which a reader may take over; ends the program without memory. */
static inline uint8_t *fuzz_copy(ern_context *context, const uint8_t *bytes, size_t count) {
  uint8_t *copy = NULL;
  if (ERN_NEW(context, count + 1, &copy) != ERN_OK) abort();
  if (count > 0) memcpy(copy, bytes, count);
  return copy;
}

/* Reads every byte of a tensor: a wrong size or offset causes an out-of-bounds read. */
static inline void fuzz_touch(const void *data, size_t count) {
  const volatile uint8_t *bytes = (const volatile uint8_t *)data;
  for (size_t i = 0; i < count; i++) (void)bytes[i];
}

#endif
