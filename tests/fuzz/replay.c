/* SPDX-License-Identifier: MIT
 * fuzz_replay NAME FOLDER...: gives each file of the folders to the fuzz target fuzz_NAME. The build compiles each
 * target's LLVMFuzzerTestOneInput under the name fuzz_NAME, and makes the list. */
#include <dirent.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef int fuzz_target(const uint8_t *bytes, size_t count);
#define TARGET(name) fuzz_target fuzz_##name;
#include "target_list.h"
#undef TARGET

struct target {
  const char *name;
  fuzz_target *run;
};
#define TARGET(name) {#name, fuzz_##name},
static const struct target targets[] = {
#include "target_list.h"
};

static int replay(fuzz_target *run, const char *folder, const char *name) {
  static uint8_t bytes[1 << 20];
  char path[2048];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  FILE *file = fopen(path, "rb");
  if (file == NULL) return 0;
  const size_t count = fread(bytes, 1, sizeof bytes, file);
  fclose(file);
  run(bytes, count);
  return 1;
}

int main(int argc, char **argv) {
  fuzz_target *run = NULL;
  int files = 0;
  for (size_t i = 0; argc > 1 && i < sizeof targets / sizeof *targets; i++)
    if (strcmp(argv[1], targets[i].name) == 0) run = targets[i].run;
  if (run == NULL) {
    fprintf(stderr, "usage: %s NAME FOLDER...; names:", argv[0]);
    for (size_t i = 0; i < sizeof targets / sizeof *targets; i++) fprintf(stderr, " %s", targets[i].name);
    fprintf(stderr, "\n");
    return 2;
  }
  for (int i = 2; i < argc; i++) {
    DIR *list = opendir(argv[i]);
    for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list))
      if (entry->d_name[0] != '.') files += replay(run, argv[i], entry->d_name);
    if (list != NULL) closedir(list);
  }
  printf("%d files replayed\n", files);
  return files > 0 ? EXIT_SUCCESS : EXIT_FAILURE; /* a missing corpus is a failure */
}
