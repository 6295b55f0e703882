/* SPDX-License-Identifier: MIT */
#include "media/input.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

ern_status ern_input_check(ern_context *context, const char *path) {
  struct stat about;
  if (stat(path, &about) != 0) {
    const int number = errno;
    char reason[128];
    if (strerror_r(number, reason, sizeof reason) != 0) snprintf(reason, sizeof reason, "error %d", number);
    const ern_status code = number == ENOENT || number == ENOTDIR ? ERN_E_MISSING : ERN_E_IO;
    return ern_fail(context, code, "%s: cannot open: %s", path, reason);
  }
  if (S_ISREG(about.st_mode) && about.st_size == 0)
    return ern_fail(context, ERN_E_FORMAT, "%s: is empty, it has 0 bytes", path);
  if (S_ISREG(about.st_mode)) return ERN_OK;
  return ern_fail(context, ERN_E_IO, "%s: is a %s, expected a regular file", path,
                  S_ISDIR(about.st_mode) ? "folder" : "device or pipe");
}
