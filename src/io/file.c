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

/* Says what the operating system refused; errno is that of the call that failed. */
static ern_status refused(ern_context *context, const char *path, const char *verb) {
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
  if (reader->descriptor < 0) return refused(context, path, "open");
  if (fstat(reader->descriptor, &about) != 0) ERN_TRY(refused(context, path, "examine"));
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
  if (lseek(reader->descriptor, (off_t)at, SEEK_SET) < 0) return refused(reader->context, reader->path, "read");
  for (size_t done = 0; done < count;) {
    const ssize_t got = read(reader->descriptor, (uint8_t *)bytes + done, count - done);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return refused(reader->context, reader->path, "read");
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
  void *room = NULL;
  struct ern_file_reader reader;
  size_t with_end = 0;
  ERN_TRY(ern_file_reader_open(context, path, limit, &reader));
  if (!ern_size_add(reader.size, 1, &with_end)) ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "%s: too large", path));
  ERN_TRY(ern_allocate(context, with_end, 1, &room));
  ERN_TRY(ern_file_reader_take(&reader, 0, room, reader.size));
  *bytes = room;
  *count = reader.size;
fail:
  ern_file_reader_close(&reader);
  if (status != ERN_OK) ern_release(context, room);
  return status;
}

ern_status ern_file_check_replaceable(ern_context *context, const char *path) {
  struct stat about;
  if (stat(path, &about) != 0 || S_ISREG(about.st_mode)) return ERN_OK;
  return ern_fail(context, ERN_E_IO, "%s: is a %s, expected a regular file or nothing", path,
                  S_ISDIR(about.st_mode) ? "folder" : "device or pipe");
}

/* The bytes of `path` before its last name: "a/" of "a/b", 0 of "b". */
static size_t folder_length(const char *path) {
  const char *slash = strrchr(path, '/');
  return slash != NULL ? (size_t)(slash - path) + 1 : 0;
}

static ern_status sync_descriptor(ern_context *context, const char *path, int descriptor) {
  while (fsync(descriptor) != 0) {
    if (errno != EINTR) return refused(context, path, "flush to the disk");
  }
  return ERN_OK;
}

/* Makes the rename itself durable. */
static ern_status sync_folder_of(ern_context *context, const char *path) {
  ern_status status = ERN_OK;
  char *folder = NULL;
  const size_t length = folder_length(path);
  int descriptor = -1;
  ERN_TRY(ern_string_copy(context, length > 0 ? path : ".", &folder));
  if (length > 0) folder[length] = 0;
  descriptor = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  /* a folder that may be written but not read, or a file system without fsync of folders, is no reason to fail */
  if (descriptor < 0 && errno != EACCES) ERN_TRY(refused(context, folder, "open"));
  while (descriptor >= 0 && fsync(descriptor) != 0) {
    if (errno == EINVAL || errno == ENOTSUP) break;
    if (errno != EINTR) ERN_TRY(refused(context, folder, "flush to the disk"));
  }
fail:
  if (descriptor >= 0) close(descriptor);
  ern_release(context, folder);
  return status;
}

ern_status ern_file_writer_open(ern_context *context, const char *path, struct ern_file_writer *writer) {
  *writer = (struct ern_file_writer){.context = context, .descriptor = -1};
  ern_status status = ERN_OK;
  void *temporary = NULL;
  const size_t room = strlen(path) + 32;
  ERN_TRY(ern_file_check_replaceable(context, path));
  ERN_TRY(ern_allocate(context, room, 1, &temporary));
  snprintf(temporary, room, "%s.tmp-%ld", path, (long)getpid());
  unlink(temporary); /* left over by a killed process of the same number */
  writer->descriptor = open(temporary, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (writer->descriptor < 0) ERN_TRY(refused(context, path, "write"));
  writer->temporary = temporary;
  ERN_TRY(ern_string_copy(context, path, &writer->path));
  return ERN_OK;
fail:
  if (writer->temporary == NULL) ern_release(context, temporary);
  ern_file_writer_abandon(writer);
  return status;
}

void ern_file_writer_abandon(struct ern_file_writer *writer) {
  if (writer == NULL) return;
  if (writer->temporary != NULL) {
    if (writer->descriptor >= 0) close(writer->descriptor);
    unlink(writer->temporary);
  }
  ern_release(writer->context, writer->path);
  ern_release(writer->context, writer->temporary);
  writer->path = writer->temporary = NULL;
  writer->descriptor = -1;
}

ern_status ern_file_writer_write(struct ern_file_writer *writer, const void *bytes, size_t count) {
  ern_status status = ERN_OK;
  const uint8_t *from = bytes;
  if (writer->temporary == NULL) return ern_fail(writer->context, ERN_E_STATE, "file writer: is closed");
  for (size_t done = 0; done < count;) {
    const size_t chunk = count - done < SSIZE_MAX ? count - done : SSIZE_MAX;
    const ssize_t put = write(writer->descriptor, from + done, chunk);
    if (put < 0 && errno == EINTR) continue;
    if (put < 0) ERN_TRY(refused(writer->context, writer->path, "write"));
    done += (size_t)put;
  }
  return ERN_OK;
fail:
  ern_file_writer_abandon(writer);
  return status;
}

ern_status ern_file_writer_commit(struct ern_file_writer *writer) {
  ern_status status = ERN_OK;
  ern_context *context = writer->context;
  if (writer->temporary == NULL) return ern_fail(context, ERN_E_STATE, "file writer: is closed");
  ERN_TRY(sync_descriptor(context, writer->path, writer->descriptor));
  const int closed = close(writer->descriptor);
  writer->descriptor = -1;
  if (closed != 0 && errno != EINTR) ERN_TRY(refused(context, writer->path, "close"));
  if (rename(writer->temporary, writer->path) != 0) ERN_TRY(refused(context, writer->path, "put in place"));
  status = sync_folder_of(context, writer->path);
  ern_release(context, writer->temporary);
  writer->temporary = NULL;
fail:
  ern_file_writer_abandon(writer);
  return status;
}

ern_status ern_file_write(ern_context *context, const char *path, const void *bytes, size_t count) {
  struct ern_file_writer writer;
  ern_status status = ERN_OK;
  ERN_TRY(ern_file_writer_open(context, path, &writer));
  ERN_TRY(ern_file_writer_write(&writer, bytes, count));
  return ern_file_writer_commit(&writer);
fail:
  return status;
}

ern_status ern_file_temporary_name(ern_context *context, const char *path, char **temporary) {
  *temporary = NULL;
  const char *name = path + folder_length(path);
  const char *dot = strrchr(name, '.');
  const char *extension = dot != NULL && dot != name ? dot : "";
  const size_t bytes = strlen(path) + 40;
  void *room = NULL;
  const ern_status status = ern_allocate(context, bytes, 1, &room);
  if (status != ERN_OK) return status;
  snprintf(room, bytes, "%.*s.%.*s.tmp-%ld%s", (int)(name - path), path, (int)(strlen(name) - strlen(extension)), name,
           (long)getpid(), extension);
  *temporary = room;
  return ERN_OK;
}

ern_status ern_file_put_in_place(ern_context *context, const char *temporary, const char *path) {
  ern_status status = ERN_OK;
  const int descriptor = open(temporary, O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) return refused(context, temporary, "open");
  ERN_TRY(ern_file_check_replaceable(context, path));
  ERN_TRY(sync_descriptor(context, temporary, descriptor));
  if (rename(temporary, path) != 0) ERN_TRY(refused(context, path, "put in place"));
  close(descriptor);
  return sync_folder_of(context, path);
fail:
  close(descriptor);
  unlink(temporary);
  return status;
}

ern_status ern_path_join(ern_context *context, const char *dir, const char *name, char **path) {
  *path = NULL;
  const size_t length = strlen(dir), bytes = length + strlen(name) + 2;
  void *room = NULL;
  const ern_status status = ern_allocate(context, bytes, 1, &room);
  if (status != ERN_OK) return status;
  snprintf(room, bytes, "%s%s%s", dir, length > 0 && dir[length - 1] == '/' ? "" : "/", name);
  *path = room;
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
  return refused(context, path, "make the folder");
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
