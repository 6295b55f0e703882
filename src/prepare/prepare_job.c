/* SPDX-License-Identifier: MIT
 * Paths, pictures, progress and verdicts of a step of `prepare`. */
#include "prepare/prepare_job.h"

#include "core/format.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

bool ern_prepare_folder_unchanged(const struct ern_prepare_job *job) {
  struct stat about;
  return job->inode == 0 ||
         (stat(job->folder, &about) == 0 && about.st_dev == job->device && about.st_ino == job->inode);
}

ern_status ern_prepare_check_folder(const struct ern_prepare_job *job) {
  if (ern_prepare_folder_unchanged(job)) return ERN_OK;
  return ern_fail(job->context, ERN_E_IO,
                  "%s: is no longer the folder that this call began in, which was moved or removed; expected it to "
                  "stay until the end",
                  job->folder);
}

/* Refuses a symbolic link as a file of the clip or as its folder: the link's target belongs to someone else. */
static ern_status refuse_links(const struct ern_prepare_job *job, char path[ERN_PREPARE_PATH], size_t begin) {
  struct stat about;
  for (char *slash = strchr(path + begin, '/');; slash = NULL) {
    if (slash != NULL) *slash = 0;
    if (lstat(path, &about) == 0 && S_ISLNK(about.st_mode))
      return ern_fail(job->context, ERN_E_EXISTS, "%s: is a symbolic link, expected a file or folder of the clip",
                      path);
    if (slash == NULL) return ERN_OK;
    *slash = '/';
  }
}

ern_status ern_prepare_path(const struct ern_prepare_job *job, char path[ERN_PREPARE_PATH], const char *format, ...) {
  const int before = snprintf(path, ERN_PREPARE_PATH, "%s/", job->folder);
  int after = -1;
  const ern_status status = ern_prepare_check_folder(job);
  if (status != ERN_OK) return status;
  if (before > 0 && before < ERN_PREPARE_PATH) {
    va_list list;
    va_start(list, format);
    after = ern_format_list(path + before, (size_t)(ERN_PREPARE_PATH - before), format, list);
    va_end(list);
  }
  if (after >= 0 && after < ERN_PREPARE_PATH - before) return refuse_links(job, path, (size_t)before);
  return ern_fail(job->context, ERN_E_ARGUMENT, "%s: the path is too long, expected at most %d bytes", job->folder,
                  ERN_PREPARE_PATH - 64);
}

void ern_prepare_part(const struct ern_prepare_job *job, double *from, double *to) {
  *from = job->segment[1] > 0 ? job->segment[0] : job->options->from;
  *to = job->segment[1] > 0 ? job->segment[1] : job->options->to;
}

ern_status ern_prepare_picture(const struct ern_prepare_job *job, const char *name, int channels, ern_image *image) {
  char path[ERN_PREPARE_PATH];
  ern_status status = ern_prepare_path(job, path, "%s", name);
  if (status == ERN_OK) status = ern_image_read(job->context, path, channels, image);
  if (status != ERN_OK || (image->width == job->side && image->height == job->side)) return status;
  status = ern_fail(job->context, ERN_E_SHAPE, "%s: the picture is %d x %d, expected %d x %d as the clip's", path,
                    image->width, image->height, job->side, job->side);
  ern_image_free(job->context, image);
  return status;
}

ern_status ern_prepare_progress(struct ern_prepare_job *job, size_t done, size_t total) {
  const ern_prepare_options *options = job->options;
  if (options->progress == NULL || options->progress(options->user, job->verdict->step, done, total) == 0)
    return ERN_OK;
  return ern_fail(job->context, ERN_E_CANCELLED, "%s: stopped in the step \"%s\"", job->folder, job->verdict->step);
}

void ern_prepare_add_reason(struct ern_prepare_job *job, ern_prepare_grade grade, const char *format, ...) {
  ern_prepare_verdict *verdict = job->verdict;
  const size_t used = strlen(verdict->words);
  char *to = verdict->words + used;
  size_t left = sizeof verdict->words - used;
  if (grade > verdict->grade) verdict->grade = grade;
  if (used > 0 && left > 2) {
    memcpy(to, "; ", 3);
    to += 2;
    left -= 2;
  }
  va_list list;
  va_start(list, format);
  (void)ern_format_list(to, left, format, list);
  va_end(list);
}

void ern_prepare_figure(struct ern_prepare_job *job, const char *name, double value) {
  (void)json_object_set_new(job->figures, name, json_real(value)); /* left out for NaN and infinity, which JSON lacks */
}
