/* SPDX-License-Identifier: MIT
 * Tests the contract of base.h on arguments: a table with one check for each public function, and a scan of the headers
 * that finds functions without a check. */
#ifndef ERN_TESTS_ARGUMENTS_H
#define ERN_TESTS_ARGUMENTS_H

#include <stdbool.h>

#include "core/status.h"
#include "support.h"

struct arguments_check {
  const char *name; /* of the function */
  void (*run)(void);
};

/* A check and its row: CHECK(ern_version) { ... }, and ROW(ern_version) in the table. */
#define CHECK(name) static void check_##name(void)
#define ROW(name) \
  { #name, check_##name }

/* The call returns ERN_E_ARGUMENT, and the context's last error is new and contains these words. */
#define REFUSED(context, words, call)                                   \
  do {                                                                  \
    ern_error_restore(context, (const char[ERN_ERROR_BYTES]){""});      \
    support_expect(context, call, ERN_E_ARGUMENT, words, (char *)NULL); \
  } while (0)

/* The same for calls without a context. */
#define REFUSED_ALONE(call) assert_int_equal(call, ERN_E_ARGUMENT)

/* An output struct of any size in bytes, smaller or larger than the library's: a fill or ..._sized function writes
 * exactly this many bytes, zeros where the library has no member. `call` uses `it` and `bytes`. */
#define KEEPS_TO(type, call)                                                                    \
  do {                                                                                          \
    const size_t sizes[] = {0, 1, 8, sizeof(type) - 1, sizeof(type), sizeof(type) + 40};        \
    for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++) {                                 \
      union {                                                                                   \
        type it;                                                                                \
        unsigned char bytes[sizeof(type) + 64];                                                 \
      } guarded;                                                                                \
      const size_t bytes = sizes[k];                                                            \
      type *it = &guarded.it;                                                                   \
      memset(&guarded, 0xa5, sizeof guarded);                                                   \
      call;                                                                                     \
      for (size_t i = bytes; i < sizeof guarded; i++) assert_int_equal(guarded.bytes[i], 0xa5); \
      for (size_t i = sizeof(type); i < bytes; i++) assert_int_equal(guarded.bytes[i], 0);      \
      if (bytes > 1) assert_true(guarded.bytes[0] != 0xa5 || guarded.bytes[1] != 0xa5);         \
    }                                                                                           \
  } while (0)

/* The same for a configuration, which holds its own size. */
#define FILLS(type, fill)                                                \
  do {                                                                   \
    fill(NULL, sizeof(type));                                            \
    KEEPS_TO(type, {                                                     \
      fill(it, bytes);                                                   \
      if (bytes >= 8) assert_true(it->cookie != 0 && it->size == bytes); \
    });                                                                  \
  } while (0)

/* A struct of a program that was built for a later version is refused, by its name. */
#define REFUSED_LATER(context, type, call) \
  support_expect(context, call, ERN_E_UNSUPPORTED, #type ": found ", "a later version", (char *)NULL)

static inline bool arguments_among(const char *name, const struct arguments_check *table, size_t count) {
  for (size_t i = 0; i < count; i++)
    if (strcmp(name, table[i].name) == 0) return true;
  return false;
}

/* The function that a declaration declares, whose text begins at `at`: the first word before a parenthesis. */
static inline void arguments_function(const char *at, char name[128]) {
  const char *end = strchr(at, '('), *begin = end;
  assert_non_null(end);
  while (begin > at &&
         (begin[-1] == '_' || (begin[-1] >= 'a' && begin[-1] <= 'z') || (begin[-1] >= '0' && begin[-1] <= '9')))
    begin--;
  assert_true(end - begin > 0 && end - begin < 128);
  memcpy(name, begin, (size_t)(end - begin));
  name[end - begin] = 0;
}

/* Whether a line begins the declaration of a function, or the definition of an inline one. */
static inline bool arguments_declares(const char *line) {
  const bool word = (*line >= 'a' && *line <= 'z') || (*line >= 'A' && *line <= 'Z');
  return word && strncmp(line, "typedef ", 8) != 0 && line[strcspn(line, "(\n")] == '(';
}

/* Every function of a header has a row; returns how many there are. `header` is a path in the repository. */
static inline size_t arguments_cover(const char *header, const struct arguments_check *table, size_t count) {
  static char text[1 << 16];
  char path[2048], name[128];
  size_t found = 0;
  assert_non_null(getenv("ERNERF_SOURCE"));
  snprintf(path, sizeof path, "%s/%s", getenv("ERNERF_SOURCE"), header);
  FILE *file = fopen(path, "rb");
  assert_non_null(file);
  const size_t bytes = fread(text, 1, sizeof text - 1, file);
  assert_true(bytes > 0 && bytes < sizeof text - 1);
  text[bytes] = 0;
  fclose(file);
  for (const char *line = text; line != NULL; line = strchr(line, '\n')) {
    if (*line == '\n') line++;
    if (!arguments_declares(line)) continue;
    arguments_function(line, name);
    if (!arguments_among(name, table, count))
      fail_msg("%s: %s has no check of its arguments; it needs a row in tests/api/test_arguments*.c", header, name);
    found++;
  }
  return found;
}

static inline void arguments_run(const struct arguments_check *table, size_t count) {
  for (size_t i = 0; i < count; i++) table[i].run();
}

#endif
