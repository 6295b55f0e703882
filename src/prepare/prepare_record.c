/* SPDX-License-Identifier: MIT */
#include "prepare/prepare_record.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "io/file.h"
#include "io/json.h"

enum { RECORD_LIMIT = 1 << 22, JSON_LIMIT = 1 << 28, VERSION = 2 };
static const char *const grades[] = {"good", "doubtful", "refused"};

/* A call that was killed in its first write leaves the record's temporary file, which does not count. */
static ern_status is_empty(struct ern_prepare_job *job, bool *empty) {
  DIR *list = opendir(job->folder);
  *empty = true;
  if (list == NULL) return ern_file_fail(job->context, job->folder, "open");
  for (struct dirent *entry = readdir(list); entry != NULL && *empty; entry = readdir(list))
    *empty = strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0 ||
             strcmp(entry->d_name, "prepare.json.ernerf-tmp") == 0;
  closedir(list);
  return ERN_OK;
}

/* The "source" entry of the record. Where it is equal, the frames of an earlier call are valid for this call. */
static json_t *source(const struct ern_prepare_job *job, const struct stat *video) {
  json_t *about = json_pack("{s:I, s:I, s:I, s:f, s:f, s:i}", "bytes", (json_int_t)video->st_size, "modified",
                            (json_int_t)video->st_mtim.tv_sec, "nanoseconds", (json_int_t)video->st_mtim.tv_nsec,
                            "from", job->options->from, "to", job->options->to, "side", job->side);
  if (about == NULL || job->options->segment == NULL ||
      json_object_set_new(about, "segment", json_string(job->options->segment)) == 0)
    return about;
  json_decref(about);
  return NULL;
}

/* Begins a new record; keeps the earlier record's entries for existing files. */
static ern_status begin_record(struct ern_prepare_job *job, json_t *about) {
  json_t *name = json_string(job->video); /* NULL where it is not UTF-8 */
  json_t *made = json_deep_copy(json_object_get(job->record, "made"));
  const json_int_t frames = json_integer_value(json_object_get(job->record, "frames"));
  json_decref(job->record);
  job->record =
      json_pack("{s:i, s:o, s:O, s:I, s:{}, s:o}", "version", VERSION, "video", name != NULL ? name : json_string(""),
                "source", about, "frames", frames, "steps", "made", made != NULL ? made : json_object());
  return job->record != NULL ? ERN_OK : ern_fail(job->context, ERN_E_NO_MEMORY, "%s: no memory", job->folder);
}

static ern_status read_record(struct ern_prepare_job *job, const char *path) {
  ern_status status = ERN_OK;
  uint8_t *text = NULL;
  size_t length = 0;
  ERN_TRY(ern_file_read(job->context, path, RECORD_LIMIT, &text, &length));
  ERN_TRY(ern_json_parse(job->context, path, "", (const char *)text, length, JSON_LIMIT, &job->record));
  const json_int_t version = json_integer_value(json_object_get(job->record, "version"));
  if (version < 1 || version > VERSION || !json_is_object(json_object_get(job->record, "steps")) ||
      !json_is_object(json_object_get(job->record, "source")))
    ERN_TRY(ern_fail(job->context, ERN_E_FORMAT,
                     "%s: is no record of ernerf prepare, version %d; expected one, or a new folder", path, VERSION));
  const json_t *count = json_object_get(job->record, "frames");
  const json_int_t frames = json_integer_value(count);
  if ((count != NULL && !json_is_integer(count)) || frames < 0 || frames > ERN_PREPARE_FRAMES)
    ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s: frames is %" JSON_INTEGER_FORMAT ", expected a count of 0 to %d",
                     path, frames, ERN_PREPARE_FRAMES));
fail:
  ern_release(job->context, text);
  return status;
}

/* Reads the segment that an earlier call chose. */
static ern_status read_segment(struct ern_prepare_job *job, const char *path) {
  json_t *segment = json_object_get(job->record, "segment");
  double from = 0, to = 0;
  if (segment == NULL) return ERN_OK;
  if (json_unpack(segment, "{s:F, s:F}", "from", &from, "to", &to) != 0 || !(from >= 0) || !(to > from) || !(to < 1e9))
    return ern_fail(job->context, ERN_E_FORMAT, "%s: segment is from %g to %g, expected seconds of the video", path,
                    from, to);
  job->segment[0] = from;
  job->segment[1] = to;
  return ERN_OK;
}

/* Whether the record has version 1, which does not list all files that `prepare` made. */
static bool is_earlier(const struct ern_prepare_job *job) {
  return json_integer_value(json_object_get(job->record, "version")) < VERSION;
}

/* Whether an earlier call refused the video; the folder then has no frames. */
static bool is_refused(const struct ern_prepare_job *job) {
  const json_t *face = json_object_get(json_object_get(job->record, "steps"), "face");
  const char *grade = json_string_value(json_object_get(face, "verdict"));
  return json_integer_value(json_object_get(job->record, "frames")) == 0 && grade != NULL &&
         strcmp(grade, grades[ERN_PREPARE_REFUSED]) == 0;
}

static ern_status open_record(struct ern_prepare_job *job, json_t *about) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  bool empty = false;
  ERN_TRY(ern_prepare_path(job, path, "prepare.json"));
  if (access(path, F_OK) != 0) {
    ERN_TRY(is_empty(job, &empty));
    if (!empty)
      ERN_TRY(ern_fail(job->context, ERN_E_EXISTS,
                       "%s: holds files that ernerf prepare did not make, expected a new or an empty folder",
                       job->folder));
    return begin_record(job, about);
  }
  ERN_TRY(read_record(job, path));
  if (is_earlier(job) && !job->options->anew)
    ERN_TRY(ern_fail(job->context, ERN_E_EXISTS,
                     "%s: an earlier version of ernerf prepare made it; expected a new folder, or --overwrite to "
                     "replace it",
                     job->folder));
  if (is_earlier(job)) return begin_record(job, about);
  if (json_equal(json_object_get(job->record, "source"), about)) return read_segment(job, path);
  if (!job->options->anew && !is_refused(job))
    ERN_TRY(ern_fail(
        job->context, ERN_E_EXISTS,
        "%s: was prepared from another video, or with another --from, --to, --size or --segment; expected a new "
        "folder, or --overwrite to replace it",
        job->folder));
  return begin_record(job, about);
fail:
  return status;
}

ern_status ern_prepare_record_open(struct ern_prepare_job *job, int *lock) {
  ern_status status = ERN_OK;
  struct stat video, folder;
  json_t *about = NULL;
  *lock = -1;
  if (stat(job->video, &video) != 0) ERN_TRY(ern_file_fail(job->context, job->video, "open"));
  job->made = access(job->folder, F_OK) != 0;
  ERN_TRY(ern_folder_make(job->context, job->folder));
  about = source(job, &video);
  if (about == NULL) ERN_TRY(ern_fail(job->context, ERN_E_NO_MEMORY, "%s: no memory", job->folder));
  *lock = open(job->folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (*lock < 0) ERN_TRY(ern_file_fail(job->context, job->folder, "open"));
  const bool taken = flock(*lock, LOCK_EX | LOCK_NB) != 0;
  if (taken) job->made = false; /* the other process uses it, empty as it still is */
  if (taken) ERN_TRY(ern_fail(job->context, ERN_E_BUSY, "%s: another process prepares it", job->folder));
  if (fstat(*lock, &folder) != 0) ERN_TRY(ern_file_fail(job->context, job->folder, "open"));
  job->device = folder.st_dev;
  job->inode = folder.st_ino;
  ERN_TRY(open_record(job, about));
fail:
  json_decref(about);
  return status;
}

ern_status ern_prepare_record_check_video(const struct ern_prepare_job *job) {
  struct stat video;
  if (stat(job->video, &video) != 0) return ern_file_fail(job->context, job->video, "open");
  const json_t *before = json_object_get(job->record, "source");
  const json_int_t bytes = json_integer_value(json_object_get(before, "bytes"));
  if (bytes == (json_int_t)video.st_size &&
      json_integer_value(json_object_get(before, "modified")) == (json_int_t)video.st_mtim.tv_sec &&
      json_integer_value(json_object_get(before, "nanoseconds")) == (json_int_t)video.st_mtim.tv_nsec)
    return ERN_OK;
  return ern_fail(job->context, ERN_E_STATE,
                  "%s: was written to while it was read: it has %lld bytes, at the beginning %lld; expected a complete "
                  "file, and --overwrite to prepare %s anew",
                  job->video, (long long)video.st_size, (long long)bytes, job->folder);
}

ern_status ern_prepare_record_save(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], *text = NULL;
  ERN_TRY(ern_prepare_path(job, path, "prepare.json"));
  text = ern_json_text(job->context, job->record, JSON_INDENT(2) | JSON_PRESERVE_ORDER);
  if (text == NULL) ERN_TRY(ern_fail(job->context, ERN_E_NO_MEMORY, "%s: no memory for it", path));
  status = ern_file_write(job->context, path, text, strlen(text), ERN_EXISTING_REPLACE);
fail:
  ern_release(job->context, text);
  return status;
}

bool ern_prepare_record_has(const struct ern_prepare_job *job, const char *step, const char *settings,
                            ern_prepare_verdict *verdict) {
  const json_t *done = json_object_get(json_object_get(job->record, "steps"), step);
  const char *with = json_string_value(json_object_get(done, "settings"));
  const char *grade = json_string_value(json_object_get(done, "verdict"));
  const char *words = json_string_value(json_object_get(done, "words"));
  if (with == NULL || grade == NULL || words == NULL || strcmp(with, settings) != 0) return false;
  for (int i = 0; i < ERN_PREPARE_REFUSED; i++) {
    if (strcmp(grade, grades[i]) != 0) continue;
    verdict->grade = (ern_prepare_grade)i;
    snprintf(verdict->words, sizeof verdict->words, "%s", words);
    return true;
  }
  return false;
}

ern_status ern_prepare_record_strike(struct ern_prepare_job *job, const char *const *stale, size_t count) {
  for (size_t i = 0; i < count; i++) (void)json_object_del(json_object_get(job->record, "steps"), stale[i]);
  return ern_prepare_record_save(job);
}

ern_status ern_prepare_record_enter(struct ern_prepare_job *job, const char *settings, const char *const *stale,
                                    size_t count) {
  json_t *steps = json_object_get(job->record, "steps");
  const ern_prepare_verdict *verdict = job->verdict;
  json_t *words = json_string(verdict->words);
  if (words == NULL) words = json_string("");
  for (size_t i = 0; i < count; i++) (void)json_object_del(steps, stale[i]);
  json_t *entry = json_pack("{s:s, s:o, s:s, s:O}", "verdict", grades[verdict->grade], "words", words, "settings",
                            settings, "figures", job->figures);
  if (entry == NULL || json_object_set_new(steps, verdict->step, entry) != 0)
    return ern_fail(job->context, ERN_E_NO_MEMORY, "%s: no memory for its record", job->folder);
  return ern_prepare_record_save(job);
}
