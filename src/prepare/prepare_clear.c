/* SPDX-License-Identifier: MIT
 * Takes away what an earlier call made in the clip's folder, so that nothing of one video stays among the files of
 * another. */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "io/file.h"
#include "prepare/prepare_job.h"

/* Folders of the clip, with the files that frame ID has in each. "": the clip's own. */
static const struct {
  const char *folder;
  const char *numbered[2]; /* what follows the ID */
  const char *names[10];
} made[] = {{"ori_imgs", {".jpg", ".lms"}, {NULL}},
            {"parsing", {".png"}, {NULL}},
            {"gt_imgs", {".jpg"}, {NULL}},
            {"torso_imgs", {".png"}, {NULL}},
            {"prepare",
             {NULL},
             {"faces.csv", "pose.csv", "shown_0.jpg", "shown_1.jpg", "shown_2.jpg", "shown_3.jpg", "shown_4.jpg",
              "shown_5.jpg", "shown_6.jpg", "shown_7.jpg"}},
            {"",
             {NULL},
             {"bc.jpg", "au.csv", "aud.wav", "aud.npy", "transforms_train.json", "transforms_val.json", "overlay.mp4",
              "report.html"}}};

/* A file that is no link goes; what else has that name stays. */
static ern_status take_away(struct ern_prepare_job *job, int folder, const char *inside, const char *name) {
  char path[ERN_PREPARE_PATH];
  struct stat about;
  if (fstatat(folder, name, &about, AT_SYMLINK_NOFOLLOW) != 0 || !S_ISREG(about.st_mode)) return ERN_OK;
  if (unlinkat(folder, name, 0) == 0) return ERN_OK;
  const int refused = errno;
  const ern_status status = ern_prepare_path(job, path, "%s%s%s", inside, inside[0] != 0 ? "/" : "", name);
  errno = refused;
  return status == ERN_OK ? ern_file_refused(job->context, path, "remove") : status;
}

static ern_status clear_folder(struct ern_prepare_job *job, size_t which) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], name[64];
  const char *inside = made[which].folder;
  int folder = -1;
  ERN_TRY(ern_prepare_path(job, path, "%s", inside));
  folder = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC | (inside[0] != 0 ? O_NOFOLLOW : 0));
  if (folder < 0) return ERN_OK; /* there is none, or it is a link */
  for (size_t k = 0; k < 2 && made[which].numbered[k] != NULL; k++)
    for (size_t i = 0; i < job->frames; i++) {
      snprintf(name, sizeof name, "%zu%s", i, made[which].numbered[k]);
      ERN_TRY(take_away(job, folder, inside, name));
    }
  for (size_t k = 0; k < sizeof made[which].names / sizeof *made[which].names && made[which].names[k] != NULL; k++)
    ERN_TRY(take_away(job, folder, inside, made[which].names[k]));
  if (inside[0] != 0) (void)rmdir(path); /* where nothing else is in it */
fail:
  if (folder >= 0) close(folder);
  return status;
}

ern_status ern_prepare_clear(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof made / sizeof *made; i++) ERN_TRY(clear_folder(job, i));
  job->frames = 0;
  (void)json_object_del(job->record, "frames");
fail:
  return status;
}

ern_status ern_prepare_remove(struct ern_prepare_job *job, const char *name) {
  const int folder = open(job->folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder < 0) return ern_file_refused(job->context, job->folder, "open");
  const ern_status status = take_away(job, folder, "", name);
  close(folder);
  return status;
}
