/* SPDX-License-Identifier: MIT
 * Built kernels and tuned sizes of a device, in the user's cache folder. An entry is 64 hex digits, the SHA-256 of the
 * rest; its key, 64 more; then the bytes. An entry that is truncated, changed or of another key is made again. Errors
 * here never make a run fail and do not change its last error. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "backend_opencl/device/cache.h"
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

/* An entry that is missing is not an error. */
static ern_status read_entry(ern_context *context, const char *path, uint8_t **bytes, size_t *count) {
  char before[ERN_ERROR_BYTES];
  ern_error_keep(context, before);
  const ern_status status = ern_file_read(context, path, MOST_BYTES, bytes, count);
  if (status != ERN_OK) ern_error_restore(context, before);
  return status;
}

void ern_cl_cache_read(ern_context *context, const char *key, uint8_t **bytes, size_t *count) {
  char path[PATH_BYTES], sum[SUM_BYTES + 1];
  uint8_t *all = NULL;
  size_t length = 0;
  *bytes = NULL;
  *count = 0;
  if (!entry_path(key, path) || read_entry(context, path, &all, &length) != ERN_OK) return;
  if (length > SUM_BYTES) ern_sha256_hex(all + SUM_BYTES, length - SUM_BYTES, sum);
  if (length <= HEAD_BYTES || memcmp(all, sum, SUM_BYTES) != 0 || memcmp(all + SUM_BYTES, key, SUM_BYTES) != 0) {
    ern_log(context, ERN_LOG_DEBUG, "%s: damaged, it is made again", path);
    ern_release(context, all);
    return;
  }
  memmove(all, all + HEAD_BYTES, length - HEAD_BYTES);
  *bytes = all;
  *count = length - HEAD_BYTES;
}

static ern_status write_entry(ern_context *context, const char *key, const void *bytes, size_t count) {
  char folder[PATH_BYTES], path[PATH_BYTES], sum[SUM_BYTES + 1];
  uint8_t *all = NULL;
  ern_status status = ERN_OK;
  if (!cache_folder(folder) || !entry_path(key, path) || count > MOST_BYTES) return ERN_E_UNSUPPORTED;
  ERN_TRY(ern_folder_make(context, folder));
  ERN_TRY(ERN_NEW(context, HEAD_BYTES + count, &all));
  memcpy(all + SUM_BYTES, key, SUM_BYTES);
  memcpy(all + HEAD_BYTES, bytes, count);
  ern_sha256_hex(all + SUM_BYTES, SUM_BYTES + count, sum);
  memcpy(all, sum, SUM_BYTES);
  ERN_TRY(ern_file_write(context, path, all, HEAD_BYTES + count, ERN_EXISTING_REPLACE));
fail:
  ern_release(context, all);
  return status;
}

bool ern_cl_cache_write(ern_context *context, const char *key, const void *bytes, size_t count) {
  char before[ERN_ERROR_BYTES];
  ern_error_keep(context, before);
  const ern_status status = write_entry(context, key, bytes, count);
  if (status != ERN_OK) {
    ern_log_error(context, ERN_LOG_DEBUG, "OpenCL: nothing is kept in the cache folder: ");
    ern_error_restore(context, before);
  }
  return status == ERN_OK;
}
