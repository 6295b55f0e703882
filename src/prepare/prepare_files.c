/* SPDX-License-Identifier: MIT
 * Files that the user supplies: the fingerprint of a file or folder, and the number of files in a folder. */
#include <dirent.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "prepare/prepare_job.h"

static bool is_later(struct timespec a, struct timespec b) {
  return a.tv_sec != b.tv_sec ? a.tv_sec > b.tv_sec : a.tv_nsec > b.tv_nsec;
}

/* Returns the number of the folder's regular files; about->st_size becomes the sum of their bytes, about->st_mtim the
 * newest time of the folder and of them. */
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

const char *ern_prepare_fingerprint(const char *path, char mark[ERN_PREPARE_FINGERPRINT_BYTES]) {
  struct stat about;
  mark[0] = 0;
  if (path != NULL && stat(path, &about) == 0) {
    const size_t count = S_ISDIR(about.st_mode) ? add_files(path, &about) : 1;
    snprintf(mark, ERN_PREPARE_FINGERPRINT_BYTES, "%s %zu %lld %lld.%09ld", path, count, (long long)about.st_size,
             (long long)about.st_mtim.tv_sec, about.st_mtim.tv_nsec);
  } else if (path != NULL) {
    snprintf(mark, ERN_PREPARE_FINGERPRINT_BYTES, "%s", path);
  }
  return mark;
}

ern_status ern_prepare_check_count(const struct ern_prepare_job *job, const char *folder, const char *ending) {
  DIR *list = opendir(folder);
  size_t count = 0;
  if (list == NULL) return ERN_OK; /* the code that reads the files reports it */
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
