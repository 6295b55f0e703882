/* SPDX-License-Identifier: MIT
 * Writes files atomically: a locked temporary file beside the final path, synchronised to disk and then renamed. */
#define _GNU_SOURCE /* S_ISVTX, statx */
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf/data.h"
#include "io/file.h"

static const char suffix[] = ".ernerf-tmp";
/* The sticky bit, which has no effect on a file on Linux, marks a temporary file as made by this program. */
static const mode_t mark = S_ISVTX;
enum { NAME_BYTES = 255 /* of one name, on the usual file systems */, MOST_LINKS = 40, MOST_TRIES = 100 };

/* ---- the place --------------------------------------------------------------------------------------------------- */

/* The bytes of `path` before its last name: 2 of "a/b", 0 of "b". */
static size_t folder_length(const char *path) {
  const char *slash = strrchr(path, '/');
  return slash != NULL ? (size_t)(slash - path) + 1 : 0;
}

static ern_status join(ern_context *context, const char *folder, size_t folder_bytes, const char *name, char **path) {
  const size_t bytes = folder_bytes + strlen(name) + 1;
  const ern_status status = ERN_NEW(context, bytes, path);
  if (status == ERN_OK) snprintf(*path, bytes, "%.*s%s", (int)folder_bytes, folder, name);
  return status;
}

/* `path`, or its target if it is a symbolic link, even if the target does not exist. */
static ern_status follow_links(ern_context *context, const char *path, char **place) {
  ern_status status = ern_string_copy(context, path, place);
  for (int links = 0; status == ERN_OK; links++) {
    char target[PATH_MAX], *next = NULL;
    const ssize_t length = readlink(*place, target, sizeof target - 1);
    if (length < 0) return ERN_OK; /* not a link, or does not exist; opening it gives the error */
    target[length] = 0;
    if (links == MOST_LINKS) status = ern_fail(context, ERN_E_IO, "%s: too many symbolic links", path);
    if (status == ERN_OK) status = join(context, *place, target[0] == '/' ? 0 : folder_length(*place), target, &next);
    ern_release(context, *place);
    *place = next;
  }
  return status;
}

/* PLACE.ernerf-tmp; where that name would be too long, the name's hash replaces it. */
static ern_status temporary_of(ern_context *context, const char *place, char **temporary) {
  const size_t folder = folder_length(place), length = strlen(place + folder);
  char name[NAME_BYTES + 1];
  if (length + sizeof suffix <= sizeof name) {
    snprintf(name, sizeof name, "%s%s", place + folder, suffix);
  } else {
    char hex[65];
    ern_sha256_hex(place + folder, length, hex);
    snprintf(name, sizeof name, "%s%s", hex, suffix);
  }
  return join(context, place, folder, name, temporary);
}

bool ern_file_is_temporary(const char *name) {
  const size_t length = strlen(name), tail = sizeof suffix - 1;
  return length > tail && strcmp(name + length - tail, suffix) == 0;
}

/* Refuses what a rename cannot replace although its permissions allow it: `at`, the file or folder of `path`. A kernel
 * or file system that does not tell refuses the rename itself. */
static ern_status check_attributes(ern_context *context, const char *path, const char *at) {
  struct statx about;
  if (statx(AT_FDCWD, at, 0, 0, &about) != 0) return ERN_OK;
  if ((about.stx_attributes & STATX_ATTR_APPEND) != 0)
    return ern_fail(context, ERN_E_IO, "%s: cannot write: %s is append-only (lsattr)", path, at);
#ifdef STATX_ATTR_MOUNT_ROOT
  if (S_ISREG(about.stx_mode) && (about.stx_attributes & STATX_ATTR_MOUNT_ROOT) != 0)
    return ern_fail(
        context, ERN_E_IO,
        "%s: cannot write: a file is mounted there, which cannot be replaced; expected one in a mounted folder", path);
#endif
  return ERN_OK;
}

/* Whether the folder of `path` lets this user make a file there and give it that name. `there`: the file that it has,
 * or NULL. In a folder with the sticky bit, such as /tmp, a file is replaced by its owner alone. */
static ern_status check_folder(ern_context *context, const char *path, const struct stat *there) {
  ern_status status = ERN_OK;
  char *folder = NULL;
  struct stat about;
  ERN_TRY(follow_links(context, path, &folder));
  const size_t length = folder_length(folder);
  folder[length] = 0;
  const char *name = length > 0 ? folder : ".";
  if (stat(name, &about) == 0) { /* a folder that is missing may be made later */
    if (faccessat(AT_FDCWD, name, W_OK | X_OK, AT_EACCESS) != 0) ERN_TRY(ern_file_fail(context, path, "write"));
    ERN_TRY(check_attributes(context, path, name));
    const uid_t user = geteuid();
    if (there != NULL && (about.st_mode & S_ISVTX) != 0 && user != 0 && user != there->st_uid && user != about.st_uid)
      ERN_TRY(ern_fail(context, ERN_E_IO,
                       "%s: cannot write: the file is another user's, in a folder where each user replaces only their "
                       "own",
                       path));
  }
fail:
  ern_release(context, folder);
  return status;
}

ern_status ern_file_check_replaceable(ern_context *context, const char *path) {
  struct stat about;
  if (path[0] == 0) return ern_fail(context, ERN_E_ARGUMENT, "the path of a file to write is empty");
  if (stat(path, &about) != 0) /* without an entry of that name there is nothing to replace */
    return errno == ENOENT ? check_folder(context, path, NULL)
                           : ern_fail(context, ERN_E_IO, "%s: cannot write: %s", path, strerror(errno));
  if (!S_ISREG(about.st_mode))
    return ern_fail(context, ERN_E_IO, "%s: is a %s, expected a regular file or nothing", path,
                    S_ISDIR(about.st_mode) ? "folder" : "device or pipe");
  if (access(path, W_OK) != 0 && (errno == EACCES || errno == EPERM))
    return ern_fail(context, ERN_E_IO, "%s: cannot write: the file is write-protected", path);
  const ern_status status = check_attributes(context, path, path);
  return status == ERN_OK ? check_folder(context, path, &about) : status;
}

static ern_status refuse_existing(ern_context *context, const char *path) {
  return ern_fail(context, ERN_E_EXISTS, "%s: is there already, expected a name that is free", path);
}

ern_status ern_file_check_output(ern_context *context, const char *path) {
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  const ern_status status = ern_file_check_replaceable(context, path);
  if (status != ERN_OK || !ern_keeps_files(context) || access(path, F_OK) != 0) return status;
  return refuse_existing(context, path);
}

/* ---- the temporary file ------------------------------------------------------------------------------------------ */

/* Whether a name in a folder is still that of the open file: another process may have removed it and made another file
 * there. */
static bool is_named(int folder, const char *name, int descriptor) {
  struct stat named, opened;
  return fstatat(folder, name, &named, AT_SYMLINK_NOFOLLOW) == 0 && fstat(descriptor, &opened) == 0 &&
         named.st_dev == opened.st_dev && named.st_ino == opened.st_ino;
}

/* The reason why the open temporary file may not be written, as text; NULL: it is locked and may be. `made`: this open
 * created it. *again: it disappeared while it was being locked. */
static const char *lock_temporary(const char *temporary, int descriptor, bool made, bool *again) {
  struct stat opened;
  if (fstat(descriptor, &opened) != 0 || !S_ISREG(opened.st_mode)) return "is no regular file";
  if (opened.st_uid != geteuid()) return "belongs to another user";
  if (flock(descriptor, LOCK_EX | LOCK_NB) != 0) {
    if (errno == EWOULDBLOCK) return "is being written by another process";
    if (!made) return "was left over, and this file system has no locks to tell whether a process still writes it";
  }
  if (!made && (opened.st_mode & mark) == 0) return "is there, and was not made by this program";
  /* The process that held the lock may have renamed or removed the file in between. */
  *again = !is_named(AT_FDCWD, temporary, descriptor);
  /* Removes a leftover, as its permissions may come from another umask. A kill between link() and unlink() leaves a
   * second link to a finished file: only the temporary name is removed. */
  const bool fresh = made && opened.st_nlink == 1;
  if (!*again && !fresh) *again = unlink(temporary) == 0;
  return *again || !fresh ? "is made and removed over and over" : NULL;
}

/* Makes the temporary file, locked. An existing file is replaced only where it is a regular file of this user that has
 * the mark and is not locked. */
static ern_status open_temporary(struct ern_file_writer *writer) {
  const char *wrong = NULL, *name = writer->temporary;
  const int flags = O_RDWR | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK;
  bool again = true;
  for (int tries = 0; again && tries < MOST_TRIES; tries++) {
    int descriptor = open(name, flags | O_CREAT | O_EXCL, 0666 | mark);
    const bool made = descriptor >= 0;
    if (!made && errno == EEXIST) {
      descriptor = open(name, flags);
      if (descriptor < 0 && errno == ENOENT) continue; /* it was removed in between */
    }
    if (descriptor < 0) return ern_file_fail(writer->context, writer->path, "write");
    again = false;
    wrong = lock_temporary(name, descriptor, made, &again);
    if (wrong == NULL) {
      writer->descriptor = descriptor;
    } else {
      close(descriptor);
    }
  }
  if (writer->descriptor >= 0) return ERN_OK;
  return ern_fail(writer->context, ERN_E_BUSY, "%s: cannot write: %s %s", writer->path, name,
                  wrong != NULL ? wrong : "is made and removed over and over");
}

/* The folder of the temporary file, through which the file is found even after the folder is moved. A folder without
 * read permission cannot be opened: then only the path is used. */
static void open_folder(struct ern_file_writer *writer) {
  char folder[PATH_MAX];
  const size_t length = folder_length(writer->temporary);
  if (length >= sizeof folder) return;
  snprintf(folder, sizeof folder, "%.*s", (int)length, length > 0 ? writer->temporary : "");
  writer->folder = open(length > 0 ? folder : ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
}

static void remove_temporary(const struct ern_file_writer *writer) {
  const char *name = writer->temporary + folder_length(writer->temporary);
  if (is_named(AT_FDCWD, writer->temporary, writer->descriptor))
    unlink(writer->temporary);
  else if (writer->folder >= 0 && is_named(writer->folder, name, writer->descriptor))
    unlinkat(writer->folder, name, 0);
}

/* ---- the writer -------------------------------------------------------------------------------------------------- */

ern_status ern_file_writer_open(ern_context *context, const char *path, enum ern_existing existing,
                                struct ern_file_writer *writer) {
  *writer = (struct ern_file_writer){
      .context = context,
      .descriptor = -1,
      .folder = -1,
      .keep = existing == ERN_EXISTING_KEEP || (existing == ERN_EXISTING_BY_CONTEXT && ern_keeps_files(context))};
  ern_status status = ERN_OK;
  struct stat before;
  ERN_TRY(ern_file_check_replaceable(context, path));
  if (writer->keep && access(path, F_OK) == 0) ERN_TRY(refuse_existing(context, path));
  ERN_TRY(ern_string_copy(context, path, &writer->path));
  ERN_TRY(follow_links(context, path, &writer->place));
  ERN_TRY(temporary_of(context, writer->place, &writer->temporary));
  ERN_TRY(open_temporary(writer));
  open_folder(writer);
  /* A file that others may not read stays so. Permissions of another group are set only once the file belongs to it. A
   * file system without modes is no reason to fail. */
  struct stat own;
  if (stat(writer->place, &before) == 0 && fstat(writer->descriptor, &own) == 0)
    (void)fchmod(writer->descriptor, (before.st_mode & (own.st_gid == before.st_gid ? 0777 : 0707)) | mark);
  return ERN_OK;
fail:
  ern_file_writer_abandon(writer);
  return status;
}

void ern_file_writer_abandon(struct ern_file_writer *writer) {
  if (writer == NULL) return;
  if (writer->temporary != NULL && writer->descriptor >= 0) {
    remove_temporary(writer);
    close(writer->descriptor);
  }
  if (writer->temporary != NULL && writer->folder >= 0) close(writer->folder);
  ern_release(writer->context, writer->path);
  ern_release(writer->context, writer->place);
  ern_release(writer->context, writer->temporary);
  writer->path = writer->place = writer->temporary = NULL;
  writer->descriptor = writer->folder = -1;
}

ern_status ern_file_writer_write(struct ern_file_writer *writer, const void *bytes, size_t count) {
  ern_status status = ERN_OK;
  const uint8_t *from = bytes;
  if (writer->temporary == NULL) return ern_fail(writer->context, ERN_E_STATE, "file writer: is closed");
  for (size_t done = 0; done < count;) {
    const size_t chunk = count - done < SSIZE_MAX ? count - done : SSIZE_MAX;
    const ssize_t put = write(writer->descriptor, from + done, chunk);
    if (put < 0 && errno == EINTR) continue;
    if (put < 0) ERN_TRY(ern_file_fail(writer->context, writer->path, "write"));
    done += (size_t)put;
  }
  return ERN_OK;
fail:
  ern_file_writer_abandon(writer);
  return status;
}

static ern_status sync_descriptor(ern_context *context, const char *path, int descriptor) {
  while (fsync(descriptor) != 0) {
    if (errno != EINTR) return ern_file_fail(context, path, "flush to the disk");
  }
  return ERN_OK;
}

/* Makes the new name itself durable. Takes no memory: the file is in place, so that want of memory may not make it an
 * error. Cuts `path` after its folder. */
static ern_status sync_folder_of(ern_context *context, char *path) {
  ern_status status = ERN_OK;
  const size_t length = folder_length(path);
  if (length > 0) path[length] = 0;
  const char *folder = length > 0 ? path : ".";
  const int descriptor = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  /* a folder that may be written but not read, or a file system without fsync of folders, is no reason to fail */
  if (descriptor < 0 && errno != EACCES) ERN_TRY(ern_file_fail(context, folder, "open"));
  while (descriptor >= 0 && fsync(descriptor) != 0) {
    if (errno == EINVAL || errno == ENOTSUP) break;
    if (errno != EINTR) ERN_TRY(ern_file_fail(context, folder, "flush to the disk"));
  }
fail:
  if (descriptor >= 0) close(descriptor);
  return status;
}

/* Gives the file its name. link() never replaces a file; where the file system has no links, a check precedes the
 * rename. */
static ern_status put_in_place(struct ern_file_writer *writer) {
  const char *from = writer->temporary, *to = writer->place;
  if (!is_named(AT_FDCWD, from, writer->descriptor))
    return ern_fail(writer->context, ERN_E_IO, "%s: cannot put in place: %s was removed or replaced by another process",
                    writer->path, from);
  if (writer->keep) {
    if (link(from, to) == 0) return unlink(from) == 0 ? ERN_OK : ern_file_fail(writer->context, from, "remove");
    if (errno == EEXIST || access(to, F_OK) == 0) return refuse_existing(writer->context, writer->path);
  }
  return rename(from, to) == 0 ? ERN_OK : ern_file_fail(writer->context, writer->path, "put in place");
}

/* Leaves the file under its temporary name, after an error of put_in_place. It may be gone from its folder, too. */
static ern_status leave_temporary(struct ern_file_writer *writer, ern_status why) {
  char reason[PATH_MAX + 256];
  struct stat opened;
  if (fstat(writer->descriptor, &opened) != 0 || opened.st_nlink == 0) return why;
  (void)ern_last_error_copy(writer->context, reason, sizeof reason);
  close(writer->descriptor);
  writer->descriptor = -1;
  return ern_fail(writer->context, why, "%s; it is kept, in the folder where it was written, as %s", reason,
                  writer->temporary + folder_length(writer->temporary));
}

/* Removes the mark, and gives the file the owner, group and permissions of the one that it has replaced; where the
 * group cannot be set, it has no permissions. */
static void finish_mode(int descriptor, const struct stat *replaced) {
  struct stat placed;
  if (fstat(descriptor, &placed) != 0) return;
  mode_t mode = placed.st_mode & 0777;
  if (replaced != NULL && (placed.st_uid != replaced->st_uid || placed.st_gid != replaced->st_gid)) {
    const bool own = fchown(descriptor, replaced->st_uid, replaced->st_gid) == 0 ||
                     fchown(descriptor, (uid_t)-1, replaced->st_gid) == 0;
    mode = replaced->st_mode & (own || placed.st_gid == replaced->st_gid ? 0777 : 0707);
  }
  (void)fchmod(descriptor, mode);
}

ern_status ern_file_writer_commit(struct ern_file_writer *writer) {
  ern_status status = ERN_OK;
  if (writer->temporary == NULL) return ern_fail(writer->context, ERN_E_STATE, "file writer: is closed");
  ERN_TRY(sync_descriptor(writer->context, writer->path, writer->descriptor));
  struct stat before;
  const bool replaces = stat(writer->place, &before) == 0;
  status = put_in_place(writer);
  if (status != ERN_OK && writer->stays) status = leave_temporary(writer, status);
  ERN_TRY(status);
  finish_mode(writer->descriptor, replaces ? &before : NULL);
  const int closed = close(writer->descriptor); /* also releases the lock */
  const int number = errno;
  writer->descriptor = -1;
  ERN_TRY(sync_folder_of(writer->context, writer->place));
  errno = number;
  if (closed != 0 && errno != EINTR) ERN_TRY(ern_file_fail(writer->context, writer->path, "close"));
fail:
  ern_file_writer_abandon(writer);
  return status;
}

ern_status ern_file_write(ern_context *context, const char *path, const void *bytes, size_t count,
                          enum ern_existing existing) {
  struct ern_file_writer writer;
  ern_status status = ERN_OK;
  ERN_TRY(ern_file_writer_open(context, path, existing, &writer));
  ERN_TRY(ern_file_writer_write(&writer, bytes, count));
  return ern_file_writer_commit(&writer);
fail:
  return status;
}

ern_status ern_file_save(ern_context *context, const char *path, const void *bytes, size_t count) {
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  if (count > 0) ERN_NEED(context, bytes);
  return ern_file_write(context, path, bytes, count, ERN_EXISTING_BY_CONTEXT);
}

ern_status ern_files_save(ern_context *context, size_t count, const char *const *paths, const void *const *bytes,
                          const size_t *sizes) {
  ERN_NEED(context, context);
  if (count == 0) return ERN_OK;
  ERN_NEED(context, paths);
  ERN_NEED(context, bytes);
  ERN_NEED(context, sizes);
  for (size_t i = 0; i < count; i++) {
    ERN_NEED(context, paths[i]);
    if (sizes[i] > 0) ERN_NEED(context, bytes[i]);
    for (size_t j = 0; j < i; j++)
      if (strcmp(paths[i], paths[j]) == 0)
        return ern_fail(context, ERN_E_ARGUMENT,
                        "%s: paths[%zu] and paths[%zu] are both this, expected a file of its own each", paths[i], j, i);
  }
  struct ern_file_writer *writer = NULL;
  size_t opened = 0;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, count, &writer));
  for (; opened < count; opened++) {
    struct ern_file_writer *w = &writer[opened];
    ERN_TRY(ern_file_writer_open(context, paths[opened], ERN_EXISTING_BY_CONTEXT, w));
    status = ern_file_writer_write(w, bytes[opened], sizes[opened]); /* which abandons it where it fails */
    if (status == ERN_OK) status = sync_descriptor(context, w->path, w->descriptor);
    if (status != ERN_OK) ern_file_writer_abandon(w);
    ERN_TRY(status);
  }
  for (size_t i = 0; i < count; i++) ERN_TRY(ern_file_writer_commit(&writer[i]));
fail:
  for (size_t i = 0; i < opened; i++) ern_file_writer_abandon(&writer[i]);
  ern_release(context, writer);
  return status;
}
