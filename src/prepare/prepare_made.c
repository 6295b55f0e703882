/* SPDX-License-Identifier: MIT
 * Tracks which files `prepare` made. record.made has an entry for each name of the table below. Numbered files (of
 * frames): their count from ID 0 on, as [count] while the call that writes them runs. Another file: its SHA-256, ""
 * while that call runs. Entries of files that were not written are removed at the end. Other files of the clip are
 * removed or replaced only with options->anew. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "ernerf/model.h"
#include "io/file.h"
#include "prepare/prepare_record.h"

enum { FACE, POSE, LANDMARKS, LAYERS, EYES, FEATURES, REPORT, NAME = 64 };

/* Grouped by folder; "": the clip's own folder. */
static const struct file {
  const char *folder;
  const char *name; /* ".jpg": ID.jpg of every frame */
  int step;
} files[] = {{"ori_imgs", ".jpg", FACE},
             {"ori_imgs", ".lms", LANDMARKS},
             {"parsing", ".png", LAYERS},
             {"gt_imgs", ".jpg", LAYERS},
             {"torso_imgs", ".png", LAYERS},
             {"prepare", "faces.csv", FACE},
             {"prepare", "pose.csv", POSE},
             {"prepare", "shown_0.jpg", REPORT},
             {"prepare", "shown_1.jpg", REPORT},
             {"prepare", "shown_2.jpg", REPORT},
             {"prepare", "shown_3.jpg", REPORT},
             {"prepare", "shown_4.jpg", REPORT},
             {"prepare", "shown_5.jpg", REPORT},
             {"prepare", "shown_6.jpg", REPORT},
             {"prepare", "shown_7.jpg", REPORT},
             {"", "aud.wav", FEATURES},
             {"", "transforms_train.json", POSE},
             {"", "transforms_val.json", POSE},
             {"", "bc.jpg", LAYERS},
             {"", "torso.npy", LAYERS},
             {"", "au.csv", EYES},
             {"", "aud.npy", FEATURES},
             {"", "overlay.mp4", REPORT},
             {"", "report.html", REPORT}};
enum { FILES = sizeof files / sizeof *files };

/* FOLDER/NAME; for numbered files FOLDER/.ENDING, which means those of all frames. */
static void name_of(const struct file *file, char name[NAME]) {
  snprintf(name, NAME, "%s%s%s", file->folder, file->folder[0] != 0 ? "/" : "", file->name);
}

static bool is_numbered(const struct file *file) { return file->name[0] == '.'; }

static bool is_one_of(const struct file *file, const char *name) {
  return file->folder[0] == 0 && strcmp(file->name, name) == 0;
}

/* The step's figure; 0: it is missing in the record, as in one of a version without it. */
static double measured(const struct ern_prepare_job *job, const char *step, const char *figure) {
  const json_t *done = json_object_get(json_object_get(job->record, "steps"), step);
  return json_number_value(json_object_get(json_object_get(done, "figures"), figure));
}

/* Whether the step's figure is missing in the record or not 0. */
static bool has(const struct ern_prepare_job *job, const char *step, const char *figure) {
  const json_t *done = json_object_get(json_object_get(job->record, "steps"), step);
  const json_t *value = json_object_get(json_object_get(done, "figures"), figure);
  return value == NULL || json_number_value(value) != 0;
}

/* Whether a step that was done with these options has written the file. */
static bool is_written(const struct ern_prepare_job *job, const struct file *file) {
  if (is_one_of(file, "aud.wav")) return has(job, "face", "sound");
  if (strcmp(file->name, "pose.csv") == 0) return job->options->poses == NULL;
  if (is_one_of(file, "au.csv")) return job->options->au != NULL || has(job, "eyes", "blinks");
  if (is_one_of(file, "torso.npy")) return measured(job, "layers", "body_motion_known") > 0;
  if (is_one_of(file, "aud.npy")) return job->options->features != NULL;
  return true;
}

static bool is_file(const struct ern_prepare_job *job, const char *name) {
  char path[ERN_PREPARE_PATH];
  struct stat about;
  return snprintf(path, sizeof path, "%s/%s", job->folder, name) < (int)sizeof path && stat(path, &about) == 0 &&
         S_ISREG(about.st_mode);
}

bool ern_prepare_files_there(const struct ern_prepare_job *job, size_t step) {
  char name[NAME];
  if (job->frames == 0) return false;
  for (int k = 0; k < FILES; k++) {
    if (files[k].step != (int)step || !is_written(job, &files[k])) continue;
    const bool numbered = is_numbered(&files[k]);
    name_of(&files[k], name);
    for (size_t i = 0; i < (numbered ? job->frames : 1); i++) {
      if (numbered) snprintf(name, sizeof name, "%s/%zu%s", files[k].folder, i, files[k].name);
      if (!is_file(job, name)) return false;
    }
  }
  return true;
}

static json_t *noted(const struct ern_prepare_job *job, const struct file *file) {
  char name[NAME];
  name_of(file, name);
  return json_object_get(json_object_get(job->record, "made"), name);
}

/* For numbered files: `prepare` made those with an ID below the returned count. */
static size_t made_count(const struct ern_prepare_job *job, const struct file *file) {
  const json_t *note = noted(job, file);
  const json_int_t count = json_integer_value(json_is_array(note) ? json_array_get(note, 0) : note);
  return count > 0 && count <= ERN_PREPARE_FRAMES ? (size_t)count : 0;
}

/* For another file: whether it is unchanged since `prepare` made it, or has been deleted. */
static bool is_made(const struct ern_prepare_job *job, const struct file *file) {
  char name[NAME], path[ERN_PREPARE_PATH], found[65];
  const char *hash = json_string_value(noted(job, file));
  name_of(file, name);
  if (hash == NULL) return false;
  if (hash[0] == 0 || !is_file(job, name)) return true;
  return snprintf(path, sizeof path, "%s/%s", job->folder, name) < (int)sizeof path &&
         ern_file_sha256(job->context, path, found) == ERN_OK && strcmp(found, hash) == 0;
}

/* Removes a regular file; a link, folder or device of that name stays. */
static ern_status take_away(struct ern_prepare_job *job, int folder, const char *inside, const char *name) {
  char path[ERN_PREPARE_PATH];
  struct stat about;
  if (fstatat(folder, name, &about, AT_SYMLINK_NOFOLLOW) != 0 || !S_ISREG(about.st_mode)) return ERN_OK;
  if (unlinkat(folder, name, 0) == 0) return ERN_OK;
  const int refused = errno;
  const ern_status status = ern_prepare_path(job, path, "%s%s%s", inside, inside[0] != 0 ? "/" : "", name);
  errno = refused;
  return status == ERN_OK ? ern_file_fail(job->context, path, "remove") : status;
}

/* Removes the files of the table from `first` on that are in its folder; *next: the first entry of another folder. */
static ern_status clear_folder(struct ern_prepare_job *job, int first, int *next) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], name[NAME];
  const char *inside = files[first].folder;
  int folder = -1;
  for (*next = first; *next < FILES && strcmp(files[*next].folder, inside) == 0;) (*next)++;
  if (snprintf(path, sizeof path, "%s/%s", job->folder, inside) >= (int)sizeof path) return ERN_OK;
  ERN_TRY(ern_prepare_check_folder(job));
  folder = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC | (inside[0] != 0 ? O_NOFOLLOW : 0));
  if (folder < 0) return ERN_OK; /* it does not exist, or is a link */
  for (int k = first; k < *next; k++) {
    if (!is_numbered(&files[k])) {
      if (job->options->anew || is_made(job, &files[k])) ERN_TRY(take_away(job, folder, inside, files[k].name));
      continue;
    }
    const size_t count = job->options->anew ? job->frames : made_count(job, &files[k]);
    for (size_t i = 0; i < count; i++) {
      snprintf(name, sizeof name, "%zu%s", i, files[k].name);
      ERN_TRY(take_away(job, folder, inside, name));
    }
  }
  if (inside[0] != 0) (void)rmdir(path); /* succeeds where it is empty */
fail:
  if (folder >= 0) close(folder);
  return status;
}

ern_status ern_prepare_clear(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  for (int i = 0; i < FILES;) ERN_TRY(clear_folder(job, i, &i));
  job->frames = 0;
  (void)json_object_del(job->record, "frames");
  (void)json_object_del(job->record, "made");
fail:
  return status;
}

/* The table's entry for FOLDER/NAME or NAME; ID.ENDING matches a numbered file, and *id is its number. NULL: no step
 * writes that name. */
static const struct file *find(const char *name, size_t *id) {
  const char *slash = strchr(name, '/');
  const char *last = slash != NULL ? slash + 1 : name;
  const size_t folder = slash != NULL ? (size_t)(slash - name) : 0;
  *id = 0;
  for (int k = 0; k < FILES; k++) {
    const char *own = last + (is_numbered(&files[k]) ? strspn(last, "0123456789") : 0);
    if (strlen(files[k].folder) != folder || strncmp(files[k].folder, name, folder) != 0 ||
        strcmp(files[k].name, own) != 0)
      continue;
    if (is_numbered(&files[k])) *id = strtoul(last, NULL, 10);
    return &files[k];
  }
  return NULL;
}

ern_status ern_prepare_remove_made(struct ern_prepare_job *job, const char *name) {
  size_t id = 0;
  const struct file *file = find(name, &id);
  if (file == NULL || !is_made(job, file)) return ERN_OK;
  ern_status status = ern_prepare_check_folder(job);
  if (status != ERN_OK) return status;
  const int folder = open(job->folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder < 0) return ern_file_fail(job->context, job->folder, "open");
  status = take_away(job, folder, "", name);
  close(folder);
  if (status != ERN_OK) return status;
  (void)json_object_del(json_object_get(job->record, "made"), name);
  return ern_prepare_record_save(job);
}

static ern_status refuse_file(const struct ern_prepare_job *job, const char *path) {
  return ern_fail(job->context, ERN_E_EXISTS,
                  "%s: ernerf prepare did not make it, or it was changed since; expected --overwrite to replace it, or "
                  "no such file",
                  path);
}

/* Checks that numbered files may be written: those of the clip's frames, or of any ID where the frame count is not
 * known yet. */
static ern_status check_numbered(const struct ern_prepare_job *job, const struct file *file, bool any) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  DIR *list = NULL;
  const size_t made = made_count(job, file);
  ERN_TRY(ern_prepare_path(job, path, "%s", file->folder));
  list = opendir(path);
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL; entry = readdir(list)) {
    const size_t digits = strspn(entry->d_name, "0123456789");
    if (digits == 0 || (digits > 1 && entry->d_name[0] == '0') || strcmp(entry->d_name + digits, file->name) != 0)
      continue;
    const size_t id = digits > 9 ? SIZE_MAX : strtoul(entry->d_name, NULL, 10);
    if (id < made || (id >= job->frames && !any)) continue;
    ERN_TRY(ern_prepare_path(job, path, "%s/%s", file->folder, entry->d_name));
    ERN_TRY(refuse_file(job, path));
  }
fail:
  if (list != NULL) closedir(list);
  return status;
}

static ern_status check_named(const struct ern_prepare_job *job, const struct file *file) {
  char name[NAME], path[ERN_PREPARE_PATH];
  struct stat about;
  name_of(file, name);
  const ern_status status = ern_prepare_path(job, path, "%s", name);
  if (status != ERN_OK || stat(path, &about) != 0 || job->options->anew) return status;
  if (!S_ISREG(about.st_mode)) /* it is never removed and would block the clip's own file */
    return ern_fail(job->context, ERN_E_EXISTS, "%s: is no regular file; expected one, or nothing by that name", path);
  return is_made(job, file) ? ERN_OK : refuse_file(job, path);
}

static ern_status check_file(const struct ern_prepare_job *job, const struct file *file, bool any) {
  if (job->options->anew && is_numbered(file)) return ERN_OK;
  return is_numbered(file) ? check_numbered(job, file, any) : check_named(job, file);
}

ern_status ern_prepare_check_files(struct ern_prepare_job *job, size_t step, bool anew) {
  ern_status status = ERN_OK;
  for (int k = 0; k < FILES && !job->options->anew; k++) {
    if (files[k].step != (int)step && files[k].step != REPORT) continue; /* the report is written with any step */
    if (is_one_of(&files[k], "aud.npy") && job->options->features == NULL) continue;
    ERN_TRY(check_file(job, &files[k], anew));
  }
fail:
  return status;
}

/* Takes ownership of `value`. */
static ern_status note(struct ern_prepare_job *job, const struct file *file, json_t *value) {
  char name[NAME];
  name_of(file, name);
  if (!json_is_object(json_object_get(job->record, "made")))
    (void)json_object_set_new(job->record, "made", json_object());
  if (json_object_set_new(json_object_get(job->record, "made"), name, value) == 0) return ERN_OK;
  return ern_fail(job->context, ERN_E_NO_MEMORY, "%s: no memory for its record", job->folder);
}

ern_status ern_prepare_register_output(struct ern_prepare_job *job, const char *name, char path[ERN_PREPARE_PATH]) {
  ern_status status = ERN_OK;
  size_t id = 0;
  const struct file *file = find(name, &id);
  if (file == NULL) return ern_fail(job->context, ERN_E_ARGUMENT, "%s/%s: no step writes it", job->folder, name);
  const json_int_t frames = json_integer_value(json_object_get(job->record, "frames"));
  const bool numbered = is_numbered(file);
  if (!numbered || id >= made_count(job, file)) {
    ERN_TRY(check_file(job, file, file->step == FACE));
    ERN_TRY(note(job, file,
                 numbered ? json_pack("[I]", frames > (json_int_t)id ? frames : (json_int_t)id + 1) : json_string("")));
    ERN_TRY(ern_prepare_record_save(job));
  }
  ERN_TRY(ern_prepare_path(job, path, "%s", name));
fail:
  return status;
}

/* The new entry of numbered files. Where this call wrote them ([count]): the number of files before the first missing
 * one, which it did not reach. Else the old count, or NULL where none of them exists. */
static json_t *count_there(const struct ern_prepare_job *job, const struct file *file) {
  const bool open = json_is_array(noted(job, file));
  const size_t count = made_count(job, file);
  char name[NAME];
  for (size_t i = 0; i < count; i++) {
    snprintf(name, sizeof name, "%s/%zu%s", file->folder, i, file->name);
    const bool there = is_file(job, name);
    if (there && !open) return json_integer((json_int_t)count);
    if (!there && open) return i > 0 ? json_integer((json_int_t)i) : NULL;
  }
  return open && count > 0 ? json_integer((json_int_t)count) : NULL;
}

static json_t *hash_there(const struct ern_prepare_job *job, const struct file *file) {
  const char *before = json_string_value(noted(job, file));
  char name[NAME], path[ERN_PREPARE_PATH], hash[65];
  name_of(file, name);
  if (before == NULL || !is_file(job, name)) return NULL;
  if (before[0] != 0 || snprintf(path, sizeof path, "%s/%s", job->folder, name) >= (int)sizeof path ||
      ern_file_sha256(job->context, path, hash) != ERN_OK)
    return json_string(before);
  return json_string(hash);
}

ern_status ern_prepare_note_made(struct ern_prepare_job *job) {
  const json_t *made = json_object_get(job->record, "made");
  json_t *now = json_object();
  char name[NAME];
  for (int k = 0; k < FILES; k++) {
    json_t *value = is_numbered(&files[k]) ? count_there(job, &files[k]) : hash_there(job, &files[k]);
    name_of(&files[k], name);
    if (value != NULL) (void)json_object_set_new(now, name, value);
  }
  const bool changed = made != NULL && now != NULL && !json_equal(made, now);
  if (changed) (void)json_object_set(job->record, "made", now);
  json_decref(now);
  return changed ? ern_prepare_record_save(job) : ERN_OK;
}
