/* SPDX-License-Identifier: MIT
 * What killed processes left half-written. */
#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "ernerf/data.h"

/* A process of the number is there. Our own number was that of a killed one before: so it is in a container. */
static bool runs(long number) { return number != (long)getpid() && (kill((pid_t)number, 0) == 0 || errno != ESRCH); }

/* "BEGIN*.tmp-NUMBER", or ".STEM*.tmp-NUMBER.*" with the stem of BEGIN, of a process that is gone. */
static bool is_leftover(const char *name, const char *begin) {
  static const char mark[] = ".tmp-";
  const bool dotted = name[0] == '.' && begin[0] != '.';
  const char *dot = strrchr(begin, '.'), *at = NULL;
  const size_t length = dotted && dot != NULL ? (size_t)(dot - begin) : strlen(begin);
  if (strncmp(name + dotted, begin, length) != 0) return false;
  for (const char *next = strstr(name, mark); next != NULL; next = strstr(next + 1, mark)) at = next;
  if (at == NULL || !isdigit((unsigned char)at[sizeof mark - 1])) return false;
  char *end = NULL;
  errno = 0;
  const long number = strtol(at + sizeof mark - 1, &end, 10);
  if (errno != 0 || number <= 0 || number > INT32_MAX) return false;
  return (*end == 0 || (name[0] == '.' && *end == '.')) && !runs(number);
}

void ern_leftovers_remove(const char *path) {
  const char *slash = strrchr(path, '/'), *begin = slash != NULL ? slash + 1 : path;
  char *folder = slash != NULL ? strdup(path) : NULL;
  if (slash != NULL && folder == NULL) return;
  if (folder != NULL) folder[slash - path + 1] = 0;
  DIR *list = opendir(folder != NULL ? folder : ".");
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list))
    if (is_leftover(entry->d_name, begin)) (void)unlinkat(dirfd(list), entry->d_name, 0);
  if (list != NULL) closedir(list);
  free(folder);
}
