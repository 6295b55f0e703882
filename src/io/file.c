/* SPDX-License-Identifier: MIT */
#include "io/file.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"

ern_status ern_file_fail(ern_context *context, const char *path, const char *verb) {
  const int number = errno;
  char reason[128];
  if (strerror_r(number, reason, sizeof reason) != 0) snprintf(reason, sizeof reason, "error %d", number);
  const ern_status code = number == ENOENT || number == ENOTDIR ? ERN_E_MISSING : ERN_E_IO;
  return ern_fail(context, code, "%s: cannot %s: %s", path, verb, reason);
}

ern_status ern_file_reader_open(ern_context *context, const char *path, size_t limit, struct ern_file_reader *reader) {
  *reader = (struct ern_file_reader){.context = context, .path = path, .descriptor = -1};
  ern_status status = ERN_OK;
  struct stat about;
  /* O_NONBLOCK: opening a pipe must fail below, not wait for a writer */
  reader->descriptor = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
  if (reader->descriptor < 0) return ern_file_fail(context, path, "open");
  if (fstat(reader->descriptor, &about) != 0) ERN_TRY(ern_file_fail(context, path, "examine"));
  if (!S_ISREG(about.st_mode)) {
    ERN_TRY(ern_fail(context, ERN_E_IO, "%s: is a %s, expected a regular file", path,
                     S_ISDIR(about.st_mode) ? "folder" : "device or pipe"));
  }
  if ((uintmax_t)about.st_size > limit) {
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: size is %jd bytes, expected at most %zu", path, (intmax_t)about.st_size,
                     limit));
  }
  reader->size = (size_t)about.st_size;
  return ERN_OK;
fail:
  ern_file_reader_close(reader);
  return status;
}

ern_status ern_file_reader_take(const struct ern_file_reader *reader, size_t at, void *bytes, size_t count) {
  if (lseek(reader->descriptor, (off_t)at, SEEK_SET) < 0) return ern_file_fail(reader->context, reader->path, "read");
  for (size_t done = 0; done < count;) {
    const ssize_t got = read(reader->descriptor, (uint8_t *)bytes + done, count - done);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return ern_file_fail(reader->context, reader->path, "read");
    if (got == 0) {
      return ern_fail(reader->context, ERN_E_IO, "%s: ended after %zu bytes, expected %zu: it shrank while being read",
                      reader->path, at + done, reader->size);
    }
    done += (size_t)got;
  }
  return ERN_OK;
}

void ern_file_reader_close(struct ern_file_reader *reader) {
  if (reader == NULL || reader->descriptor < 0) return;
  close(reader->descriptor);
  reader->descriptor = -1;
}

ern_status ern_file_read(ern_context *context, const char *path, size_t limit, uint8_t **bytes, size_t *count) {
  *bytes = NULL;
  *count = 0;
  ern_status status = ERN_OK;
  uint8_t *all = NULL;
  struct ern_file_reader reader;
  size_t with_end = 0;
  ERN_TRY(ern_file_reader_open(context, path, limit, &reader));
  if (!ern_size_add(reader.size, 1, &with_end)) ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "%s: too large", path));
  ERN_TRY(ERN_NEW(context, with_end, &all));
  ERN_TRY(ern_file_reader_take(&reader, 0, all, reader.size));
  *bytes = all;
  *count = reader.size;
fail:
  ern_file_reader_close(&reader);
  if (status != ERN_OK) ern_release(context, all);
  return status;
}

ern_status ern_path_join(ern_context *context, const char *dir, const char *name, char **path) {
  const size_t length = strlen(dir), bytes = length + strlen(name) + 2;
  const ern_status status = ERN_NEW(context, bytes, path);
  if (status != ERN_OK) return status;
  snprintf(*path, bytes, "%s%s%s", dir, length > 0 && dir[length - 1] == '/' ? "" : "/", name);
  return ERN_OK;
}

static ern_status make_one(ern_context *context, const char *path) {
  struct stat about;
  if (mkdir(path, 0777) == 0) return ERN_OK;
  const int number = errno;
  /* a parent that exists may answer EACCES or EROFS as well as EEXIST */
  if (stat(path, &about) == 0) {
    if (S_ISDIR(about.st_mode)) return ERN_OK;
    return ern_fail(context, ERN_E_IO, "%s: is a file, expected a folder or nothing", path);
  }
  errno = number;
  return ern_file_fail(context, path, "make the folder");
}

size_t ern_text_mark(const uint8_t *bytes, size_t count) {
  return count >= 3 && memcmp(bytes, "\xef\xbb\xbf", 3) == 0 ? 3 : 0;
}

ern_status ern_folder_make(ern_context *context, const char *path) {
  ern_status status = ERN_OK;
  char *copy = NULL;
  if (path[0] == 0) return ern_fail(context, ERN_E_ARGUMENT, "folder: the name is empty");
  ERN_TRY(ern_string_copy(context, path, &copy));
  for (char *slash = strchr(copy + 1, '/'); slash != NULL; slash = strchr(slash + 1, '/')) {
    *slash = 0;
    ERN_TRY(make_one(context, copy));
    *slash = '/';
  }
  ERN_TRY(make_one(context, copy));
fail:
  ern_release(context, copy);
  return status;
}
