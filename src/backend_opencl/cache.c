/* SPDX-License-Identifier: MIT
 * Built kernels in the user's cache folder. An entry is 64 hex digits, the SHA-256 of what follows, then the binary:
 * one that was cut, changed or written by half is built again, not trusted. Nothing here can make a run fail. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "backend_opencl/opencl.h"
#include "core/memory.h"
#include "io/file.h"

enum { PATH_BYTES = 4096, SUM_BYTES = 64, MOST_BYTES = 1 << 28 };

/* False where the user has no such folder. */
static bool cache_folder(char folder[PATH_BYTES]) {
  const char *cache = getenv("XDG_CACHE_HOME"), *home = getenv("HOME");
  int length = -1;
  if (cache != NULL && cache[0] == '/')
    length = snprintf(folder, PATH_BYTES, "%s/libernerf", cache);
  else if (home != NULL && home[0] == '/')
    length = snprintf(folder, PATH_BYTES, "%s/.cache/libernerf", home);
  return length > 0 && length < PATH_BYTES;
}

static bool entry_path(const char *key, char path[PATH_BYTES]) {
  char folder[PATH_BYTES];
  if (!cache_folder(folder)) return false;
  const int length = snprintf(path, PATH_BYTES, "%s/%s.clbin", folder, key);
  return length > 0 && length < PATH_BYTES;
}

ern_status ern_cl_cache_read(ern_context *context, const char *key, uint8_t **bytes, size_t *count) {
  char path[PATH_BYTES], sum[SUM_BYTES + 1];
  uint8_t *all = NULL;
  size_t length = 0;
  *bytes = NULL;
  *count = 0;
  if (!entry_path(key, path)) return ERN_OK;
  if (ern_file_read(context, path, MOST_BYTES, &all, &length) != ERN_OK) return ERN_OK;
  if (length > SUM_BYTES) ern_sha256_hex(all + SUM_BYTES, length - SUM_BYTES, sum);
  if (length <= SUM_BYTES || memcmp(all, sum, SUM_BYTES) != 0) {
    ern_log(context, ERN_LOG_DEBUG, "%s: damaged, the kernels are built again", path);
    ern_release(context, all);
    return ERN_OK;
  }
  memmove(all, all + SUM_BYTES, length - SUM_BYTES);
  *bytes = all;
  *count = length - SUM_BYTES;
  return ERN_OK;
}

void ern_cl_cache_write(ern_context *context, const char *key, const void *bytes, size_t count) {
  char folder[PATH_BYTES], path[PATH_BYTES], sum[SUM_BYTES + 1];
  struct ern_file_writer writer = {0};
  if (!cache_folder(folder) || !entry_path(key, path) || ern_folder_make(context, folder) != ERN_OK) return;
  ern_sha256_hex(bytes, count, sum);
  ern_status status = ern_file_writer_open(context, path, &writer);
  if (status == ERN_OK) status = ern_file_writer_write(&writer, sum, SUM_BYTES);
  if (status == ERN_OK) status = ern_file_writer_write(&writer, bytes, count);
  if (status == ERN_OK) status = ern_file_writer_commit(&writer);
  if (status != ERN_OK) {
    ern_file_writer_abandon(&writer);
    ern_log(context, ERN_LOG_DEBUG, "%s: built kernels are not kept: %s", path, ern_last_error(context));
  }
}
