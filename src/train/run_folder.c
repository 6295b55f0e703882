/* SPDX-License-Identifier: MIT
 * X.run: its lock, its names, its log and curve. */
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "io/file.h"
#include "train/trainer.h"

/* "portrait.safetensors" -> "portrait.run": the extension makes room. */
static ern_status folder_name(ern_context *context, const char *output, char **folder) {
  static const char extension[] = ".safetensors";
  const size_t length = strlen(output), tail = sizeof extension - 1;
  const size_t stem = length > tail && strcmp(output + length - tail, extension) == 0 ? length - tail : length;
  void *room = NULL;
  const ern_status status = ern_allocate(context, stem + sizeof ".run", 1, &room);
  *folder = room;
  if (status != ERN_OK) return status;
  memcpy(*folder, output, stem);
  memcpy(*folder + stem, ".run", sizeof ".run");
  return ERN_OK;
}

static ern_status take_lock(ern_context *context, struct ern_run_folder *run) {
  char *path = NULL;
  ern_status status = ern_path_join(context, run->folder, "lock", &path);
  if (status != ERN_OK) return status;
  run->lock = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (run->lock < 0)
    status = ern_fail(context, ERN_E_IO, "%s: cannot be opened: %s", path, strerror(errno));
  else if (flock(run->lock, LOCK_EX | LOCK_NB) != 0)
    status = ern_fail(context, ERN_E_BUSY, "%s: another training holds this lock; use another output or stop that one",
                      path);
  ern_release(context, path);
  return status;
}

ern_status ern_run_folder_open(ern_context *context, const char *output, struct ern_run_folder *run) {
  ern_status status = ERN_OK;
  *run = (struct ern_run_folder){.lock = -1, .fresh = true};
  ERN_TRY(folder_name(context, output, &run->folder));
  if (mkdir(run->folder, 0777) != 0 && errno != EEXIST)
    ERN_TRY(ern_fail(context, ERN_E_IO, "%s: the folder cannot be made: %s", run->folder, strerror(errno)));
  ERN_TRY(ern_path_join(context, run->folder, "state.safetensors", &run->state));
  ERN_TRY(ern_path_join(context, run->folder, "state.next.safetensors", &run->next));
  ERN_TRY(ern_path_join(context, run->folder, "state.previous.safetensors", &run->previous));
  ERN_TRY(ern_path_join(context, run->folder, "log.jsonl", &run->log));
  ERN_TRY(ern_path_join(context, run->folder, "curve.csv", &run->curve));
  ERN_TRY(take_lock(context, run));
  return ERN_OK;
fail:
  ern_run_folder_close(context, run);
  return status;
}

void ern_run_folder_close(ern_context *context, struct ern_run_folder *run) {
  if (run->lock >= 0) close(run->lock);
  ern_release(context, run->folder);
  ern_release(context, run->state);
  ern_release(context, run->next);
  ern_release(context, run->previous);
  ern_release(context, run->log);
  ern_release(context, run->curve);
  ern_release(context, run->log_lines.text);
  ern_release(context, run->curve_lines.text);
  *run = (struct ern_run_folder){.lock = -1};
}

ern_status ern_lines_add(ern_context *context, struct ern_lines *lines, const char *format, ...) {
  enum { LINE_BYTES = 1024 };
  if (lines->room - lines->used < LINE_BYTES) {
    void *room = NULL;
    const size_t larger = 2 * lines->room + 16 * LINE_BYTES;
    const ern_status status = ern_allocate(context, larger, 1, &room);
    if (status != ERN_OK) return status;
    if (lines->used > 0) memcpy(room, lines->text, lines->used);
    ern_release(context, lines->text);
    lines->text = room;
    lines->room = larger;
  }
  va_list arguments;
  va_start(arguments, format);
  const int written = vsnprintf(lines->text + lines->used, LINE_BYTES, format, arguments);
  va_end(arguments);
  if (written > 0) lines->used += (size_t)(written < LINE_BYTES ? written : LINE_BYTES - 1);
  return ERN_OK;
}

static ern_status append(ern_context *context, const char *path, struct ern_lines *lines) {
  size_t done = 0;
  const int file = open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (file < 0) return ern_fail(context, ERN_E_IO, "%s: cannot be opened: %s", path, strerror(errno));
  while (done < lines->used) {
    const ssize_t written = write(file, lines->text + done, lines->used - done);
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) break;
    done += (size_t)written;
  }
  const int error = errno;
  const bool failed = done < lines->used || fsync(file) != 0;
  if (close(file) != 0 || failed)
    return ern_fail(context, ERN_E_IO, "%s: cannot be written: %s", path, strerror(error));
  lines->used = 0;
  return ERN_OK;
}

static ern_status replace(ern_context *context, const char *path, struct ern_lines *lines) {
  const ern_status status = ern_file_write(context, path, lines->text, lines->used);
  if (status == ERN_OK) lines->used = 0;
  return status;
}

ern_status ern_run_folder_flush(ern_context *context, struct ern_run_folder *run) {
  ern_status (*const put)(ern_context *, const char *, struct ern_lines *) = run->fresh ? replace : append;
  ern_status status = put(context, run->log, &run->log_lines);
  if (status == ERN_OK) status = put(context, run->curve, &run->curve_lines);
  if (status == ERN_OK) run->fresh = false;
  return status;
}
