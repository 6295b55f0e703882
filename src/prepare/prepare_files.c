/* SPDX-License-Identifier: MIT
 * The files that a step depends on: what each leaves in the clip, and by what a file that the user brings is known. */
#include <dirent.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "prepare/prepare_job.h"

/* In the order of the steps: what every frame ID has, and the files by their names. */
static const struct {
  struct {
    const char *folder, *ending; /* folder/ID.ending */
  } numbered[3];
  const char *names[3];
} files[ERN_PREPARE_STEPS] = {
    /* face */ {{{"ori_imgs", "jpg"}}, {"prepare/faces.csv", "aud.wav"}},
    /* pose */ {{{NULL, NULL}}, {"transforms_train.json", "transforms_val.json", "prepare/pose.csv"}},
    /* landmarks */ {{{"ori_imgs", "lms"}}, {NULL}},
    /* layers */ {{{"parsing", "png"}, {"gt_imgs", "jpg"}, {"torso_imgs", "png"}}, {"bc.jpg"}},
    /* eyes */ {{{NULL, NULL}}, {"au.csv"}},
    /* features */ {{{NULL, NULL}}, {"aud.npy"}}};

/* Whether the step's record has no such figure, or one that is not 0. */
static bool has(const struct ern_prepare_job *job, const char *step, const char *figure) {
  const json_t *done = json_object_get(json_object_get(job->record, "steps"), step);
  const json_t *value = json_object_get(json_object_get(done, "figures"), figure);
  return value == NULL || json_number_value(value) != 0;
}

/* Whether a step that was done with these options has written the file. */
static bool is_written(const struct ern_prepare_job *job, const char *name) {
  if (strcmp(name, "aud.wav") == 0) return has(job, "face", "sound");
  if (strcmp(name, "prepare/pose.csv") == 0) return job->options->poses == NULL;
  if (strcmp(name, "au.csv") == 0) return job->options->au != NULL || has(job, "eyes", "blinks");
  if (strcmp(name, "aud.npy") == 0) return job->options->features != NULL;
  return true;
}

static bool is_file(const struct ern_prepare_job *job, const char *name) {
  char path[ERN_PREPARE_PATH];
  struct stat about;
  return snprintf(path, sizeof path, "%s/%s", job->folder, name) < (int)sizeof path && stat(path, &about) == 0 &&
         S_ISREG(about.st_mode);
}

bool ern_prepare_files_there(const struct ern_prepare_job *job, size_t step) {
  if (job->frames == 0) return false;
  for (size_t k = 0; k < sizeof files->names / sizeof *files->names && files[step].names[k] != NULL; k++)
    if (is_written(job, files[step].names[k]) && !is_file(job, files[step].names[k])) return false;
  for (size_t k = 0; k < sizeof files->numbered / sizeof *files->numbered; k++)
    for (size_t i = 0; i < job->frames && files[step].numbered[k].folder != NULL; i++) {
      char name[64];
      snprintf(name, sizeof name, "%s/%zu.%s", files[step].numbered[k].folder, i, files[step].numbered[k].ending);
      if (!is_file(job, name)) return false;
    }
  return true;
}

static bool is_later(struct timespec a, struct timespec b) {
  return a.tv_sec != b.tv_sec ? a.tv_sec > b.tv_sec : a.tv_nsec > b.tv_nsec;
}

/* The count of the folder's regular files; about->st_size becomes the sum of their bytes, about->st_mtim the newest
 * time of the folder and of them. */
static size_t add_files(const char *path, struct stat *about) {
  DIR *list = opendir(path);
  size_t count = 0;
  about->st_size = 0;
  if (list == NULL) return 0;
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list)) {
    struct stat file;
    if (fstatat(dirfd(list), entry->d_name, &file, 0) != 0 || !S_ISREG(file.st_mode)) continue;
    count++;
    about->st_size += file.st_size;
    if (is_later(file.st_mtim, about->st_mtim)) about->st_mtim = file.st_mtim;
  }
  closedir(list);
  return count;
}

const char *ern_prepare_mark(const char *path, char mark[ERN_PREPARE_MARK]) {
  struct stat about;
  mark[0] = 0;
  if (path != NULL && stat(path, &about) == 0) {
    const size_t count = S_ISDIR(about.st_mode) ? add_files(path, &about) : 1;
    snprintf(mark, ERN_PREPARE_MARK, "%s %zu %lld %lld.%09ld", path, count, (long long)about.st_size,
             (long long)about.st_mtim.tv_sec, about.st_mtim.tv_nsec);
  } else if (path != NULL) {
    snprintf(mark, ERN_PREPARE_MARK, "%s", path);
  }
  return mark;
}

ern_status ern_prepare_check_count(const struct ern_prepare_job *job, const char *folder, const char *ending) {
  DIR *list = opendir(folder);
  size_t count = 0;
  if (list == NULL) return ERN_OK; /* what reads the files tells */
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list)) {
    const size_t digits = strspn(entry->d_name, "0123456789");
    count += digits > 0 && strcmp(entry->d_name + digits, ending) == 0;
  }
  closedir(list);
  if (count <= job->frames) return ERN_OK;
  return ern_fail(
      job->context, ERN_E_MISMATCH,
      "%s: has %zu files ID%s, and the clip has %zu frames; expected those of the clip's frames, from 0%s on", folder,
      count, ending, job->frames, ending);
}
