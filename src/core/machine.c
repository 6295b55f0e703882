/* SPDX-License-Identifier: MIT
 * Where the limits are: /proc/self/cgroup has a line a hierarchy, "4:memory:/a/b" (version 1) or "0::/a/b" (version 2);
 * /proc/self/mountinfo says where the hierarchy is mounted, and which group is at the mount's root, as a container may
 * see only a part of it. The files of /a/b, of /a and of the mount's root each hold a limit. */
#define _GNU_SOURCE /* sched_getaffinity */
#include "core/machine.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <sched.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { PATH_BYTES = 4096, LINE_BYTES = 4096 };

/* Opens a regular file or a kernel file; does not block on a pipe without a writer. */
static FILE *open_file(const char *root, const char *path) {
  char whole[PATH_BYTES];
  if (snprintf(whole, sizeof whole, "%s%s", root, path) >= (int)sizeof whole) return NULL;
  const int descriptor = open(whole, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  FILE *file = descriptor >= 0 ? fdopen(descriptor, "r") : NULL;
  if (file == NULL && descriptor >= 0) close(descriptor);
  return file;
}

/* The next line without its newline; longer lines are skipped. */
static bool next_line(FILE *file, char line[LINE_BYTES]) {
  bool cut = false;
  while (fgets(line, LINE_BYTES, file) != NULL) {
    const size_t length = strlen(line);
    const bool whole = length > 0 && line[length - 1] == '\n';
    if ((whole || feof(file)) && !cut) {
      if (whole) line[length - 1] = 0;
      return true;
    }
    cut = !whole;
  }
  return false;
}

/* ---- a group's files --------------------------------------------------------------------------------------------- */

/* The number that `text` begins with, *end behind it; false where there is none, as in "max" or "-1". */
static bool take_number(const char *text, uint64_t *number, const char **end) {
  char *after = NULL;
  while (*text == ' ') text++;
  if (*text < '0' || *text > '9') return false;
  errno = 0;
  *number = strtoull(text, &after, 10);
  *end = after;
  return errno == 0 && (*after == 0 || *after == ' ');
}

/* Up to two numbers of the first line of FOLDER/NAME; how many there are. */
static int read_numbers(const char *root, const char *folder, const char *name, uint64_t number[2]) {
  char path[PATH_BYTES], line[LINE_BYTES];
  const char *at = line;
  int count = 0;
  if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path) return 0;
  FILE *file = open_file(root, path);
  if (file == NULL) return 0;
  if (next_line(file, line))
    while (count < 2 && take_number(at, &number[count], &at)) count++;
  fclose(file);
  return count;
}

static void limit_memory(const char *root, const char *folder, struct ern_machine_limits *limits) {
  static const char *const names[] = {"memory.max", "memory.high", "memory.limit_in_bytes"};
  uint64_t number[2];
  for (size_t i = 0; i < sizeof names / sizeof *names; i++)
    if (read_numbers(root, folder, names[i], number) == 1 && number[0] > 0 && number[0] < limits->memory)
      limits->memory = number[0];
}

/* Microseconds of processor time in a period of so many microseconds. */
static void limit_cores(const char *root, const char *folder, struct ern_machine_limits *limits) {
  uint64_t quota[2], period[2];
  double cores = INFINITY;
  if (read_numbers(root, folder, "cpu.max", quota) == 2 && quota[1] > 0)
    cores = (double)quota[0] / (double)quota[1];
  else if (read_numbers(root, folder, "cpu.cfs_quota_us", quota) == 1 &&
           read_numbers(root, folder, "cpu.cfs_period_us", period) == 1 && period[0] > 0)
    cores = (double)quota[0] / (double)period[0];
  if (cores > 0 && cores < limits->cores) limits->cores = cores;
}

/* ---- hierarchies ------------------------------------------------------------------------------------------------- */

/* Whether a list with commas has the word. */
static bool has_word(const char *list, const char *word) {
  const size_t length = strlen(word);
  for (const char *at = strstr(list, word); at != NULL; at = strstr(at + length, word))
    if ((at == list || at[-1] == ',') && (at[length] == ',' || at[length] == 0)) return true;
  return false;
}

/* The process' group in the hierarchy of a controller, NULL: that of version 2. */
static bool find_group(const char *root, const char *controller, char group[LINE_BYTES]) {
  char line[LINE_BYTES];
  bool found = false;
  FILE *file = open_file(root, "/proc/self/cgroup");
  if (file == NULL) return false;
  while (!found && next_line(file, line)) {
    char *controllers = strchr(line, ':'), *path = controllers != NULL ? strchr(controllers + 1, ':') : NULL;
    if (path == NULL) continue;
    *controllers++ = *path++ = 0;
    found = path[0] == '/' && (controller != NULL ? has_word(controllers, controller) : controllers[0] == 0);
    if (found) memcpy(group, path, strlen(path) + 1);
  }
  fclose(file);
  return found;
}

/* The part of `group` below `top`; "", the mount's root, where the group is not below it: the process was then put
 * there from outside its own view. */
static const char *below(const char *group, const char *top) {
  const size_t length = strcmp(top, "/") == 0 ? 0 : strlen(top);
  if (strncmp(group, top, length) != 0 || (group[length] != '/' && group[length] != 0)) return "";
  if (strstr(group, "/..") != NULL) return "";
  return strcmp(group + length, "/") == 0 ? "" : group + length;
}

/* Looks at a mount of /proc/self/mountinfo, whose words are: number, parent, device, root, mount point, options, more
 * ..., "-", type, source, the type's options. */
static void look_at_mount(const char *root, char *line, struct ern_machine_limits *limits) {
  char *word[6] = {NULL}, *rest = NULL, *last = NULL, group[LINE_BYTES], folder[2 * LINE_BYTES];
  char *after = strstr(line, " - ");
  if (after == NULL) return;
  *after = 0;
  for (int i = 0; i < 6; i++) word[i] = strtok_r(i == 0 ? line : NULL, " ", &rest);
  const char *type = strtok_r(after + 3, " ", &last), *source = strtok_r(NULL, " ", &last),
             *options = strtok_r(NULL, " ", &last);
  if (word[5] == NULL || type == NULL || source == NULL || strncmp(type, "cgroup", 6) != 0) return;
  const char *const controllers[] = {NULL, "memory", "cpu"};
  for (size_t c = 0; c < sizeof controllers / sizeof *controllers; c++) {
    const bool second = controllers[c] == NULL;
    if (strcmp(type, second ? "cgroup2" : "cgroup") != 0) continue;
    if (!second && (options == NULL || !has_word(options, controllers[c]))) continue;
    if (!find_group(root, controllers[c], group)) continue;
    const size_t mount = strlen(word[4]);
    snprintf(folder, sizeof folder, "%s%s", word[4], below(group, word[3]));
    for (char *slash = folder + strlen(folder); slash != NULL; slash = strrchr(folder, '/')) {
      *slash = 0;
      if (strlen(folder) < mount) break;
      limit_memory(root, folder, limits);
      limit_cores(root, folder, limits);
    }
  }
}

void ern_machine_limits(const char *root, struct ern_machine_limits *limits) {
  char line[LINE_BYTES];
  *limits = (struct ern_machine_limits){.cores = INFINITY, .memory = UINT64_MAX};
  FILE *file = open_file(root, "/proc/self/mountinfo");
  if (file == NULL) return;
  while (next_line(file, line)) look_at_mount(root, line, limits);
  fclose(file);
}

/* ---- both -------------------------------------------------------------------------------------------------------- */

static long allowed_cores(void) {
  cpu_set_t set;
  if (sched_getaffinity(0, sizeof set, &set) == 0) return CPU_COUNT(&set);
  return sysconf(_SC_NPROCESSORS_ONLN); /* a machine with more cores than the set has room for */
}

int ern_machine_cores(void) {
  struct ern_machine_limits limits;
  const long cores = allowed_cores();
  ern_machine_limits("", &limits);
  const double allowed = fmin((double)cores, ceil(limits.cores));
  return allowed >= 1 ? (int)allowed : 1;
}

uint64_t ern_machine_memory(void) {
  struct ern_machine_limits limits;
  const long pages = sysconf(_SC_PHYS_PAGES), page = sysconf(_SC_PAGESIZE);
  ern_machine_limits("", &limits);
  const uint64_t memory = pages > 0 && page > 0 ? (uint64_t)pages * (uint64_t)page : UINT64_MAX;
  const uint64_t least = memory < limits.memory ? memory : limits.memory;
  return least < UINT64_MAX ? least : 0;
}
