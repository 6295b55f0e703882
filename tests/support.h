/* SPDX-License-Identifier: MIT
 * Shared code of the tests: a context, files of a test, and checks of error messages. */
#ifndef ERN_TESTS_SUPPORT_H
#define ERN_TESTS_SUPPORT_H

#include <dirent.h>
#include <locale.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "ernerf/base.h"

static inline ern_context *support_context(void) {
  ern_context *context = NULL;
  assert_int_equal(ern_context_create(&context, NULL), ERN_OK);
  return context;
}

/* A log (`log` of ern_context_config) that appends warnings and errors, a line each, to `user`: char[SUPPORT_LINES],
 * "" at first. */
enum { SUPPORT_LINES = 8192 };
static inline void support_keep_warnings(void *user, ern_log_level level, const char *line) {
  char *lines = user;
  const size_t used = strlen(lines);
  if (level <= ERN_LOG_WARNING) snprintf(lines + used, SUPPORT_LINES - used, "%s\n", line);
}

/* Writes a file in the working folder of the test. */
static inline void support_write(const char *path, const void *bytes, size_t count) {
  FILE *file = fopen(path, "wb");
  assert_non_null(file);
  assert_int_equal(fwrite(bytes, 1, count, file), count);
  assert_int_equal(fclose(file), 0);
}

static inline void support_write_text(const char *path, const char *text) { support_write(path, text, strlen(text)); }

/* Makes the locale comma_XX in the working folder, where a real number is written 0,5, and lets setlocale find it. Few
 * machines have one of their own. Returns false, with a message, where none can be made. */
static inline bool support_comma_locale(void) {
  char here[512];
  support_write_text("comma_XX.src",
                     "LC_NUMERIC\ndecimal_point \",\"\nthousands_sep \"\"\ngrouping -1\nEND LC_NUMERIC\n"
                     "LC_CTYPE\nEND LC_CTYPE\n");
  (void)system("localedef -c -i comma_XX.src -f ANSI_X3.4-1968 ./comma_XX >comma.log 2>&1");
  const bool made =
      getcwd(here, sizeof here) != NULL && setenv("LOCPATH", here, 1) == 0 && setlocale(LC_NUMERIC, "comma_XX") != NULL;
  setlocale(LC_NUMERIC, "C");
  if (!made) print_message("skipped: no locale can be made here (Debian's package locales)\n");
  return made;
}

/* Checks the status, and that the last error contains each of the texts; the list ends with NULL. */
static inline void support_expect(const ern_context *context, ern_status found, ern_status expected, ...) {
  if (found != expected) {
    fail_msg("status %s, expected %s: %s", ern_status_name(found), ern_status_name(expected), ern_last_error(context));
  }
  va_list words;
  va_start(words, expected);
  for (const char *word = va_arg(words, const char *); word != NULL; word = va_arg(words, const char *)) {
    if (strstr(ern_last_error(context), word) == NULL) {
      fail_msg("the error \"%s\" does not say \"%s\"", ern_last_error(context), word);
    }
  }
  va_end(words);
}

/* Skips the test if ERNERF_SHARED is unset; call it before anything is created that would be left over. */
static inline void support_needs_shared(void) {
  const char *shared = getenv("ERNERF_SHARED");
  if (shared == NULL || shared[0] == 0) skip();
}

/* path = ERNERF_SHARED/NAME; skips the test if that is unset. */
static inline void support_shared(const char *name, char path[1024]) {
  const char *shared = getenv("ERNERF_SHARED");
  if (shared == NULL || shared[0] == 0) skip();
  snprintf(path, 1024, "%s/%s", shared, name);
}

/* Fails the test with the library's error message unless the status is ERN_OK. */
static inline void support_ok(const ern_context *context, ern_status found) {
  if (found != ERN_OK) fail_msg("status %s: %s", ern_status_name(found), ern_last_error(context));
}

/* Removes a file, or a folder with all that is in it, that an earlier run of the test left in its working folder. */
static inline void support_clear(const char *path) {
  DIR *list = opendir(path);
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list)) {
    char inside[2048];
    if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
    if (snprintf(inside, sizeof inside, "%s/%s", path, entry->d_name) < (int)sizeof inside) support_clear(inside);
  }
  if (list != NULL) closedir(list);
  remove(path);
}

/* Counts what a context has allocated and not yet released, and refuses the allocation of number `refuse_at`. */
struct support_meter {
  size_t now, most;        /* bytes */
  size_t count, refuse_at; /* allocations; refuse_at 0: none is refused */
};

static inline void *support_meter_allocate(void *user, size_t bytes, size_t alignment) {
  struct support_meter *meter = (struct support_meter *)user;
  if (++meter->count == meter->refuse_at) return NULL;
  const size_t sizes[2] = {bytes, alignment}; /* stored directly before the block, for release */
  assert_true(alignment >= sizeof sizes);
  uint8_t *block = (uint8_t *)aligned_alloc(alignment, bytes + alignment);
  if (block == NULL) return NULL;
  memcpy(block + alignment - sizeof sizes, sizes, sizeof sizes);
  meter->now += bytes;
  meter->most = meter->now > meter->most ? meter->now : meter->most;
  return block + alignment;
}

static inline void support_meter_release(void *user, void *memory) {
  struct support_meter *meter = (struct support_meter *)user;
  size_t sizes[2];
  memcpy(sizes, (uint8_t *)memory - sizeof sizes, sizeof sizes);
  meter->now -= sizes[0];
  free((uint8_t *)memory - sizes[1]);
}

static inline ern_context *support_metered_context(struct support_meter *meter) {
  ern_context *context = NULL;
  ern_context_config config = ern_context_config_default();
  config.allocate = support_meter_allocate;
  config.release = support_meter_release;
  config.user = meter;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  return context;
}

/* Refuses each allocation of `work` in turn: it must return ERN_E_NO_MEMORY, or succeed without it, and leak nothing.
 * Ends when `work` makes fewer allocations than the refused number. */
static inline void support_refuse_each(ern_status (*work)(ern_context *context)) {
  struct support_meter meter = {0};
  ern_context *context = support_metered_context(&meter);
  const size_t empty = meter.now;
  size_t refused = 0; /* number of refusals that made `work` fail */
  for (size_t at = 1; at == 1 || meter.count >= meter.refuse_at; at++) {
    meter.count = 0;
    meter.refuse_at = at;
    const ern_status status = work(context);
    if (status != ERN_OK && status != ERN_E_NO_MEMORY) {
      fail_msg("allocation %zu refused: status %s: %s", at, ern_status_name(status), ern_last_error(context));
    }
    if (meter.now != empty) fail_msg("allocation %zu refused: %zu bytes are left over", at, meter.now - empty);
    if (meter.count < at) assert_int_equal(status, ERN_OK);
    refused += status != ERN_OK;
  }
  assert_true(refused > 0);
  ern_context_free(&context);
  assert_int_equal(meter.now, 0);
}

#endif
