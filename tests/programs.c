/* SPDX-License-Identifier: MIT
 * The main of a folder's executable: FOLDER_tests NAME runs the program of the file NAME.c. The build compiles each
 * file's main under the name NAME_main, and makes the list. Without an argument the names are printed. Cases whose
 * names end in _long are left out unless ERNERF_TEST_LONG is set. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define PROGRAM(name) int name##_main(void);
#include "program_list.h"
#undef PROGRAM

struct program {
  const char *name;
  int (*main)(void);
};
#define PROGRAM(name) {#name, name##_main},
static const struct program programs[] = {
#include "program_list.h"
};

int main(int argc, char **argv) {
  const size_t count = sizeof programs / sizeof *programs;
  if (getenv("ERNERF_TEST_LONG") == NULL) cmocka_set_skip_filter("*_long");
  for (size_t i = 0; argc == 2 && i < count; i++)
    if (strcmp(argv[1], programs[i].name) == 0) return programs[i].main();
  for (size_t i = 0; i < count; i++) puts(programs[i].name);
  if (argc == 1) return 0;
  fprintf(stderr, "usage: %s NAME\n", argv[0]);
  return 2;
}
