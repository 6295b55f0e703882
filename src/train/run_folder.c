/* SPDX-License-Identifier: MIT
 * The run folder X.run: its lock, paths, log and curve. */
#include "train/run_folder.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/format.h"
#include "core/memory.h"
#include "io/file.h"

/* "portrait.safetensors" -> "portrait.run": the extension is replaced. */
static ern_status folder_name(ern_context *context, const char *output, char **folder) {
  static const char extension[] = ".safetensors";
  const size_t length = strlen(output), tail = sizeof extension - 1;
  const size_t stem = length > tail && strcmp(output + length - tail, extension) == 0 ? length - tail : length;
  const ern_status status = ERN_NEW(context, stem + sizeof ".run", folder);
  if (status != ERN_OK) return status;
  memcpy(*folder, output, stem);
  memcpy(*folder + stem, ".run", sizeof ".run");
  return ERN_OK;
}

static ern_status take_lock(ern_context *context, struct ern_run_folder *run) {
  char *path = NULL;
  ern_status status = ern_path_join(context, run->folder, "lock", &path);
  if (status != ERN_OK) return status;
  run->lock = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0644);
  if (run->lock < 0)
    status = ern_fail(context, ERN_E_IO, "%s: cannot be opened: %s", path, strerror(errno));
  else if (flock(run->lock, LOCK_EX | LOCK_NB) != 0)
    status = ern_fail(context, ERN_E_BUSY, "%s: another training holds this lock; use another output or stop that one",
                      path);
  ern_release(context, path);
  return status;
}

/* Checks in advance that the files which a training writes at its end can be written. */
static ern_status check_places(ern_context *context, const char *output, const struct ern_run_folder *run) {
  const char *const files[] = {output, run->state, run->next, run->previous, run->good, run->log, run->curve};
  ern_status status = ERN_OK;
  for (size_t i = 0; status == ERN_OK && i < sizeof files / sizeof *files; i++)
    status = ern_file_check_replaceable(context, files[i]);
  const char *const appended[] = {run->log, run->curve}; /* states need no check: a rename replaces the link itself */
  struct stat about;
  for (size_t i = 0; status == ERN_OK && i < sizeof appended / sizeof *appended; i++)
    if (lstat(appended[i], &about) == 0 && S_ISLNK(about.st_mode))
      status = ern_fail(context, ERN_E_IO, "%s: is a symbolic link, expected a regular file or nothing", appended[i]);
  return status;
}

static ern_status make_folder(ern_context *context, const char *folder, bool *made) {
  struct stat about;
  *made = mkdir(folder, 0777) == 0;
  if (*made) return ERN_OK;
  if (errno != EEXIST) return ern_fail(context, ERN_E_IO, "%s: the folder cannot be made: %s", folder, strerror(errno));
  if (lstat(folder, &about) != 0)
    return ern_fail(context, ERN_E_IO, "%s: the folder cannot be examined: %s", folder, strerror(errno));
  if (S_ISDIR(about.st_mode)) return ERN_OK;
  return ern_fail(context, ERN_E_IO, "%s: is a %s, expected a folder or nothing", folder,
                  S_ISLNK(about.st_mode) ? "symbolic link" : "file"); /* a link may lead to another training's folder */
}

ern_status ern_run_folder_name(ern_context *context, const char *output, struct ern_run_folder *run) {
  ern_status status = ERN_OK;
  *run = (struct ern_run_folder){.lock = -1, .fresh = true};
  ERN_TRY(folder_name(context, output, &run->folder));
  ERN_TRY(ern_path_join(context, run->folder, "state.safetensors", &run->state));
  ERN_TRY(ern_path_join(context, run->folder, "state.next.safetensors", &run->next));
  ERN_TRY(ern_path_join(context, run->folder, "state.previous.safetensors", &run->previous));
  ERN_TRY(ern_path_join(context, run->folder, "state.good.safetensors", &run->good));
  ERN_TRY(ern_path_join(context, run->folder, "log.jsonl", &run->log));
  ERN_TRY(ern_path_join(context, run->folder, "curve.csv", &run->curve));
fail:
  return status;
}

ern_status ern_run_folder_open(ern_context *context, const char *output, struct ern_run_folder *run) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_run_folder_name(context, output, run));
  ERN_TRY(check_places(context, output, run));
  ERN_TRY(make_folder(context, run->folder, &run->made));
  ERN_TRY(take_lock(context, run));
  return ERN_OK;
fail:
  ern_run_folder_close(context, run);
  return status;
}

/* path: X.run/lock */
static bool is_held(const struct ern_run_folder *run, const char *path) {
  struct stat held, there;
  return fstat(run->lock, &held) == 0 && stat(path, &there) == 0 && held.st_dev == there.st_dev &&
         held.st_ino == there.st_ino;
}

ern_status ern_run_folder_check_held(ern_context *context, const struct ern_run_folder *run) {
  char *path = NULL;
  ern_status status = ern_path_join(context, run->folder, "lock", &path);
  if (status != ERN_OK) return status;
  if (!is_held(run, path))
    status =
        ern_fail(context, ERN_E_IO,
                 "%s: is not the lock of this training any more: the folder was moved, removed or replaced, or the "
                 "program is in another working folder; nothing is saved",
                 path);
  ern_release(context, path);
  return status;
}

ern_status ern_run_folder_check_outside(ern_context *context, const struct ern_run_folder *run, const char *path) {
  const char *const files[] = {run->state, run->next, run->previous, run->good};
  struct stat about, other;
  if (path == NULL || stat(path, &about) != 0) return ERN_OK;
  for (size_t i = 0; i < sizeof files / sizeof *files; i++)
    if (stat(files[i], &other) == 0 && other.st_dev == about.st_dev && other.st_ino == about.st_ino)
      return ern_fail(context, ERN_E_ARGUMENT,
                      "%s: is an input in %s, whose states this training replaces; expected another output", path,
                      run->folder);
  return ERN_OK;
}

/* Writes to `name` the first name in X.run that is neither the lock nor a temporary file of a killed process; false:
 * there is none. */
static bool find_earlier(const char *folder, char name[256]) {
  DIR *list = opendir(folder);
  bool found = false;
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL && !found; entry = readdir(list)) {
    found = strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0 && strcmp(entry->d_name, "lock") != 0 &&
            !ern_file_is_temporary(entry->d_name);
    if (found) snprintf(name, 256, "%s", entry->d_name);
  }
  if (list != NULL) closedir(list);
  return found;
}

static bool has_state(const struct ern_run_folder *run) {
  return access(run->state, F_OK) == 0 || access(run->next, F_OK) == 0 || access(run->previous, F_OK) == 0;
}

ern_status ern_run_folder_check_free(ern_context *context, const char *output, const struct ern_run_folder *run,
                                     bool resume) {
  char name[256] = "";
  const bool model = access(output, F_OK) == 0, resumable = !resume && has_state(run);
  if (!model && !find_earlier(run->folder, name)) return ERN_OK;
  return ern_fail(context, ERN_E_EXISTS,
                  "%s%s%s: is there already, from an earlier training; %s, --overwrite replaces it",
                  model ? output : run->folder, model ? "" : "/", name,
                  resumable ? "--resume goes on with it" : "it has no state that --resume could go on from");
}

ern_status ern_run_folder_reserve(ern_context *context, const char *output, bool resume, bool overwrite,
                                  struct ern_run_folder *run) {
  const ern_status status = ern_run_folder_open(context, output, run);
  if (status != ERN_OK || overwrite || (resume && has_state(run))) return status;
  return ern_run_folder_check_free(context, output, run, resume);
}

/* Removes a folder that this call made, and its lock, if nothing was saved there. */
static void remove_empty(ern_context *context, const struct ern_run_folder *run) {
  char name[256], *lock = NULL;
  if (!run->made || find_earlier(run->folder, name)) return;
  if (run->lock >= 0 && ern_path_join(context, run->folder, "lock", &lock) == ERN_OK && is_held(run, lock))
    (void)unlink(lock);
  ern_release(context, lock);
  (void)rmdir(run->folder);
}

void ern_run_folder_close(ern_context *context, struct ern_run_folder *run) {
  remove_empty(context, run);
  if (run->lock >= 0) {
    (void)flock(run->lock, LOCK_UN); /* explicit, as a forked child of the host may hold the same open file */
    close(run->lock);
  }
  ern_release(context, run->folder);
  ern_release(context, run->state);
  ern_release(context, run->next);
  ern_release(context, run->previous);
  ern_release(context, run->good);
  ern_release(context, run->log);
  ern_release(context, run->curve);
  ern_release(context, run->log_lines.text);
  ern_release(context, run->curve_lines.text);
  *run = (struct ern_run_folder){.lock = -1};
}

ern_status ern_lines_add(ern_context *context, struct ern_lines *lines, const char *format, ...) {
  enum { LINE_BYTES = 1024 };
  if (lines->capacity - lines->used < LINE_BYTES) {
    char *larger = NULL;
    const size_t bytes = 2 * lines->capacity + 16 * LINE_BYTES;
    const ern_status status = ERN_NEW(context, bytes, &larger);
    if (status != ERN_OK) return status;
    if (lines->used > 0) memcpy(larger, lines->text, lines->used);
    ern_release(context, lines->text);
    lines->text = larger;
    lines->capacity = bytes;
  }
  va_list arguments;
  va_start(arguments, format);
  const int written = ern_format_list(lines->text + lines->used, LINE_BYTES, format, arguments);
  va_end(arguments);
  if (written > 0) lines->used += (size_t)(written < LINE_BYTES ? written : LINE_BYTES - 1);
  return ERN_OK;
}

enum { LOG_LIMIT = 1 << 30 /* bytes: enough for millions of steps */ };

static bool write_lines(int file, const struct ern_lines *lines) {
  for (size_t done = 0; done < lines->used;) {
    const ssize_t written = write(file, lines->text + done, lines->used - done);
    if (written < 0 && errno == EINTR) continue;
    if (written == 0) errno = EIO;
    if (written <= 0) return false;
    done += (size_t)written;
  }
  return fsync(file) == 0;
}

/* A file with several hard links, such as in a snapshot, becomes a copy, so that the other links' content does not
 * change. */
static ern_status leave_links(ern_context *context, const char *path) {
  struct stat about;
  uint8_t *bytes = NULL;
  size_t count = 0;
  if (stat(path, &about) != 0 || about.st_nlink < 2) return ERN_OK;
  ern_status status = ern_file_read(context, path, LOG_LIMIT, &bytes, &count);
  if (status == ERN_OK) status = ern_file_write(context, path, bytes, count, ERN_EXISTING_REPLACE);
  ern_release(context, bytes);
  return status;
}

/* Appends all of the lines or none: a partial line would stay in front of the next one. */
static ern_status append(ern_context *context, const char *path, struct ern_lines *lines) {
  const ern_status alone = leave_links(context, path);
  if (alone != ERN_OK) return alone;
  const int file = open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | O_NOFOLLOW, 0666);
  if (file < 0) return ern_fail(context, ERN_E_IO, "%s: cannot be opened: %s", path, strerror(errno));
  const off_t before = lseek(file, 0, SEEK_END);
  bool failed = before < 0 || !write_lines(file, lines);
  int error = errno;
  if (failed && before >= 0 && ftruncate(file, before) != 0) error = errno;
  if (close(file) != 0 && !failed) {
    failed = true;
    error = errno;
  }
  if (failed) return ern_fail(context, ERN_E_IO, "%s: cannot be written: %s", path, strerror(error));
  lines->used = 0;
  return ERN_OK;
}

ern_status ern_run_folder_flush(ern_context *context, struct ern_run_folder *run) {
  const ern_status status = append(context, run->log, &run->log_lines);
  return status == ERN_OK ? append(context, run->curve, &run->curve_lines) : status;
}

/* ---- what was written before ------------------------------------------------------------------------------------- */

/* The validation pictures of the steps that the curve names: those of the training that wrote it. */
static void remove_pictures(const struct ern_run_folder *run) {
  FILE *curve = fopen(run->curve, "r");
  char line[256], picture[4096];
  while (curve != NULL && fgets(line, sizeof line, curve) != NULL) {
    unsigned long long step = 0;
    if (sscanf(line, "%llu,", &step) == 1 &&
        snprintf(picture, sizeof picture, "%s/val_%06llu.png", run->folder, step) < (int)sizeof picture)
      (void)unlink(picture);
  }
  if (curve != NULL) fclose(curve);
}

/* Empties a file, which keeps its permissions; a file with several hard links loses only this one. */
static void empty(const char *path) {
  struct stat about;
  if (stat(path, &about) != 0 || about.st_nlink > 1 || truncate(path, 0) != 0) (void)unlink(path);
}

/* Removes the table of an earlier training's validations, which the program writes beside the curve. Without a curve,
 * the table is this training's own. */
static void remove_measures(const struct ern_run_folder *run) {
  static const char head[] = "step,mouth_explained,";
  char path[4096], line[sizeof head] = "";
  if (access(run->curve, F_OK) != 0 || snprintf(path, sizeof path, "%s/measures.csv", run->folder) >= (int)sizeof path)
    return;
  const int file = open(path, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
  if (file < 0) return;
  const bool own = read(file, line, sizeof line - 1) == (ssize_t)sizeof line - 1 && strcmp(line, head) == 0;
  close(file);
  if (own) (void)unlink(path);
}

/* Called before the first save of a new training, whose own state is complete by then. */
void ern_run_folder_clear(struct ern_run_folder *run) {
  const char *const paths[] = {run->previous, run->good, run->state};
  remove_pictures(run);
  remove_measures(run);
  for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) (void)unlink(paths[i]);
  empty(run->log);
  empty(run->curve);
}

/* The bytes of whole lines up to `step`; lines without a step, such as a header, count too. `mark` is what stands
 * before the step. */
static size_t lines_until(const char *text, size_t count, const char *mark, uint64_t step) {
  size_t kept = 0;
  while (kept < count) {
    const char *line = text + kept, *end = memchr(line, '\n', count - kept);
    if (end == NULL) break; /* a partial line of a killed process */
    const size_t skip = strlen(mark);
    if (strncmp(line, mark, skip) == 0 && line[skip] >= '0' && line[skip] <= '9' &&
        strtoull(line + skip, NULL, 10) > step)
      break;
    kept += (size_t)(end - line) + 1;
  }
  return kept;
}

/* *there: whether the last line that is kept is that of the step itself. */
static ern_status trim(ern_context *context, const char *path, const char *mark, uint64_t step, bool *there) {
  uint8_t *bytes = NULL;
  size_t count = 0;
  *there = false;
  if (access(path, F_OK) != 0) return ERN_OK;
  ern_status status = ern_file_read(context, path, LOG_LIMIT, &bytes, &count);
  if (status != ERN_OK) return status;
  const size_t kept = lines_until((const char *)bytes, count, mark, step);
  *there = step > 0 && kept > lines_until((const char *)bytes, count, mark, step - 1);
  if (kept == 0)
    (void)unlink(path);
  else if (kept < count)
    status = ern_file_write(context, path, bytes, kept, ERN_EXISTING_REPLACE);
  ern_release(context, bytes);
  return status;
}

ern_status ern_run_folder_trim(ern_context *context, struct ern_run_folder *run, uint64_t step) {
  bool there = false;
  ern_status status = trim(context, run->log, "{\"step\": ", step, &there);
  if (status == ERN_OK) status = trim(context, run->curve, "", step, &there);
  run->unmeasured = !there;
  return status;
}
