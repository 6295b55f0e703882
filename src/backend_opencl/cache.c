/* SPDX-License-Identifier: MIT
 * Built kernels in the user's cache folder. An entry is 64 hex digits, the SHA-256 of what follows; its key, 64 more;
 * then the binary. One that was cut, changed, written by half or is another's is built again, not trusted. Nothing
 * here can make a run fail. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "backend_opencl/opencl.h"
#include "core/memory.h"
#include "io/file.h"

enum { PATH_BYTES = 4096, SUM_BYTES = 64, HEAD_BYTES = 2 * SUM_BYTES /* sum and key */, MOST_BYTES = 1 << 28 };

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
  if (length <= HEAD_BYTES || memcmp(all, sum, SUM_BYTES) != 0 || memcmp(all + SUM_BYTES, key, SUM_BYTES) != 0) {
    ern_log(context, ERN_LOG_DEBUG, "%s: damaged, the kernels are built again", path);
    ern_release(context, all);
    return ERN_OK;
  }
  memmove(all, all + HEAD_BYTES, length - HEAD_BYTES);
  *bytes = all;
  *count = length - HEAD_BYTES;
  return ERN_OK;
}

void ern_cl_cache_write(ern_context *context, const char *key, const void *bytes, size_t count) {
  char folder[PATH_BYTES], path[PATH_BYTES], sum[SUM_BYTES + 1];
  void *room = NULL;
  if (!cache_folder(folder) || !entry_path(key, path) || ern_folder_make(context, folder) != ERN_OK) return;
  if (count > MOST_BYTES || ern_allocate(context, HEAD_BYTES + count, 1, &room) != ERN_OK) return;
  uint8_t *all = room;
  memcpy(all + SUM_BYTES, key, SUM_BYTES);
  memcpy(all + HEAD_BYTES, bytes, count);
  ern_sha256_hex(all + SUM_BYTES, SUM_BYTES + count, sum);
  memcpy(all, sum, SUM_BYTES);
  if (ern_file_write(context, path, all, HEAD_BYTES + count) != ERN_OK)
    ern_log(context, ERN_LOG_DEBUG, "%s: built kernels are not kept: %s", path, ern_last_error(context));
  ern_release(context, room);
}
