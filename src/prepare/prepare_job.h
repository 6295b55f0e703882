/* SPDX-License-Identifier: MIT
 * Shared by the steps of `prepare`: the clip's folder, its frames, its poses, and the verdict of a step.
 *
 * Files of the clip that steps pass to later steps: ori_imgs/ID.jpg (the unchanged frames, JPEG quality 98),
 * ori_imgs/ID.lms, transforms_*.json, and in prepare/ files that training does not need: faces.csv. ID counts from 0.
 */
#ifndef ERN_PREPARE_PREPARE_JOB_H
#define ERN_PREPARE_PREPARE_JOB_H

#include <jansson.h>
#include <sys/types.h>

#include "core/memory.h"
#include "core/status.h"
#include "ernerf/data.h"
#include "ernerf/media.h"
#include "ernerf/prepare.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
  ERN_PREPARE_PATH = 4096,
  ERN_PREPARE_FINGERPRINT_BYTES = ERN_PREPARE_PATH + 104,
  ERN_PREPARE_RATE = 25,
  ERN_PREPARE_FRAMES = 30 * 60 * ERN_PREPARE_RATE,
  ERN_PREPARE_MORE = 2, /* allowed difference between the rows or windows of a part of a video and its frames */
  ERN_PREPARE_REACH = 4 /* in sides of the clip: the limit of |x| and |y| of a landmark */
};

/* The range of a focal length, in sides of the clip. */
#define ERN_PREPARE_FOCAL_LEAST 0.2
#define ERN_PREPARE_FOCAL_MOST 20.0

struct ern_prepare_job {
  ern_context *context;
  const char *video, *folder;
  const ern_prepare_options *options;
  bool made;     /* this call created the folder, and removes it where it stays empty */
  bool refused;  /* a step refused the video, and the record says so */
  dev_t device;  /* st_dev of the folder that the record was opened in */
  ino_t inode;   /* st_ino of it; 0: no record is open */
  int side;      /* pixels a side of a frame */
  double focal;  /* pixels */
  size_t frames; /* at most ERN_PREPARE_FRAMES; 0 before the step "face", or the count of an earlier call */
  /* Begin and end of the segment that was chosen for options->segment, seconds of the video; [1] 0: none. */
  double segment[2];
  json_t *record; /* prepare.json */
  /* of the running step */
  ern_prepare_verdict *verdict;
  json_t *figures; /* an object of numbers for prepare.json and the report */
};

/* X_camera = rotation X_head + translation, metres; both right-handed: x right in the picture, y up, z towards the
 * viewer. The head's frame: its origin is the middle of the head, z goes out of the face (head_shape.h). A point is
 * seen at pixel (c + f X/-Z, c - f Y/-Z), c = side/2. */
struct ern_head_pose {
  double rotation[3][3], translation[3];
};

/* A face as the detector found it, pixels of the clip. */
struct ern_found_face {
  size_t frame;
  float x, y, width, height;
  bool has_eyes;
  float eyes[2][2]; /* centres x, y; the left one in the picture first */
  float sharpness;  /* ern_face_sharpness; 0: not measured. Not in the file */
};

/* Whether the folder's path still names the folder that the record was opened in. */
bool ern_prepare_folder_unchanged(const struct ern_prepare_job *job);
/* ERN_E_IO where it does not: another folder has taken the path. */
ERN_NODISCARD ern_status ern_prepare_check_folder(const struct ern_prepare_job *job);
/* Formats FOLDER/ and the rest by printf. ERN_E_ARGUMENT where the path is too long, ERN_E_EXISTS where it is a
 * symbolic link, ERN_E_IO as in ern_prepare_check_folder. */
ERN_NODISCARD ern_status ern_prepare_path(const struct ern_prepare_job *job, char path[ERN_PREPARE_PATH],
                                          const char *format, ...) ERN_PRINTF(3, 4);
/* The part of the video that becomes the clip, seconds after the video's first frame; *to 0: up to its end. */
void ern_prepare_part(const struct ern_prepare_job *job, double *from, double *to);
/* Reads the picture `name` of the clip with `channels` 3 or 4; it has the clip's size. */
ERN_NODISCARD ern_status ern_prepare_picture(const struct ern_prepare_job *job, const char *name, int channels,
                                             ern_image *image);

/* Reads and writes poses[job->frames]: transforms_train.json has the first ten elevenths, transforms_val.json the rest.
 */
ERN_NODISCARD ern_status ern_prepare_poses_read(struct ern_prepare_job *job, struct ern_head_pose *poses);
/* Reads the poses from the file options->poses. Checks that its focal length and distances are plausible for a head.
 * *audio_mismatches: the number of frames whose aud_id is not their img_id. */
ERN_NODISCARD ern_status ern_prepare_poses_supplied(struct ern_prepare_job *job, struct ern_head_pose *poses,
                                                    size_t *audio_mismatches);
ERN_NODISCARD ern_status ern_prepare_poses_write(struct ern_prepare_job *job, const struct ern_head_pose *poses);
/* pose/poses_supplied.c. The step "pose" with the poses of options->poses. */
ERN_NODISCARD ern_status ern_prepare_poses_take(struct ern_prepare_job *job);
/* Adds the verdict on the head's total range of rotation, degrees. */
void ern_prepare_check_turn(struct ern_prepare_job *job, double turn);

/* *faces[*count] in the order of frames; the caller owns it (ern_release). Where the user supplied options->landmarks,
 * the eyes are taken from them. */
ERN_NODISCARD ern_status ern_prepare_faces_read(struct ern_prepare_job *job, struct ern_found_face **faces,
                                                size_t *count);
ERN_NODISCARD ern_status ern_prepare_faces_write(struct ern_prepare_job *job, const struct ern_found_face *faces,
                                                 size_t count);

/* prepare_files.c. Writes a fingerprint of the user's file: path, size, modification time; of a folder: path, count,
 * total size, newest time of its files. A changed file has another mark. Returns `mark`, "" for path NULL. */
const char *ern_prepare_fingerprint(const char *path, char mark[ERN_PREPARE_FINGERPRINT_BYTES]);
/* Counts the files ID.ENDING (".lms") of a supplied folder. ERN_E_MISMATCH where there are more than frames: they then
 * belong to a longer video, and the clip may be another part of it. */
ERN_NODISCARD ern_status ern_prepare_check_count(const struct ern_prepare_job *job, const char *folder,
                                                 const char *ending);

/* prepare_made.c; `step` counts from 0 ("face"). Whether all files exist that the step writes with these options. */
bool ern_prepare_files_there(const struct ern_prepare_job *job, size_t step);
/* ERN_E_EXISTS where a file that the step may write exists, `prepare` did not make it, and options->anew is not set.
 * `anew`: "face" runs before it, so the clip may get more frames than job->frames. */
ERN_NODISCARD ern_status ern_prepare_check_files(struct ern_prepare_job *job, size_t step, bool anew);
/* The path of a file that is about to be written; `name` is relative to the clip ("bc.jpg", "gt_imgs/3.jpg"). Records
 * that `prepare` made it, or for a frame's file those of all frames. ERN_E_EXISTS as in ern_prepare_check_files. */
ERN_NODISCARD ern_status ern_prepare_register_output(struct ern_prepare_job *job, const char *name,
                                                     char path[ERN_PREPARE_PATH]);
/* Call it at the start and the end of a call. Records the state of the files that `prepare` made, so that a file that
 * changes later counts as the user's; drops the entries of files that do not exist. */
ERN_NODISCARD ern_status ern_prepare_note_made(struct ern_prepare_job *job);
/* Removes the files that `prepare` made for frames 0..job->frames - 1; with options->anew every file of such a name.
 * Never removes a symbolic link or follows one. Sets job->frames to 0. */
ERN_NODISCARD ern_status ern_prepare_clear(struct ern_prepare_job *job);
/* Removes the file `name` directly in the clip's folder, where `prepare` made it. */
ERN_NODISCARD ern_status ern_prepare_remove_made(struct ern_prepare_job *job, const char *name);

/* Reports the step's progress to the caller; ERN_E_CANCELLED where the caller cancels. */
ERN_NODISCARD ern_status ern_prepare_progress(struct ern_prepare_job *job, size_t done, size_t total);

/* Adds a reason to the step's verdict, whose grade becomes the worse of its own and this one. The text states what was
 * found, what was expected, and a remedy. */
void ern_prepare_add_reason(struct ern_prepare_job *job, ern_prepare_grade grade, const char *format, ...)
    ERN_PRINTF(3, 4);
/* Adds a number to prepare.json and the report. */
void ern_prepare_figure(struct ern_prepare_job *job, const char *name, double value);

/* The steps. Each reads the files of the earlier steps from the folder and sets its verdict; it replaces only its own
 * files. */
ern_status ern_prepare_face(struct ern_prepare_job *job);      /* video -> ori_imgs/ID.jpg, faces.csv */
ern_status ern_prepare_pose(struct ern_prepare_job *job);      /* -> transforms_*.json */
ern_status ern_prepare_landmarks(struct ern_prepare_job *job); /* -> ori_imgs/ID.lms */
ern_status ern_prepare_layers(struct ern_prepare_job *job);    /* -> parsing, bc.jpg, torso_imgs, gt_imgs */
ern_status ern_prepare_eyes(struct ern_prepare_job *job);      /* -> au.csv */
ern_status ern_prepare_features(struct ern_prepare_job *job);  /* -> aud.wav; aud.npy where features are supplied */
/* Checks of the files that the user supplies for a step, and of what the step still needs. They read the files as the
 * step does, after the frames exist, and write nothing. */
ERN_NODISCARD ern_status ern_prepare_pose_check(struct ern_prepare_job *job);
ERN_NODISCARD ern_status ern_prepare_landmarks_check(struct ern_prepare_job *job);
ERN_NODISCARD ern_status ern_prepare_layers_check(struct ern_prepare_job *job);
ERN_NODISCARD ern_status ern_prepare_eyes_check(struct ern_prepare_job *job);
ERN_NODISCARD ern_status ern_prepare_features_check(struct ern_prepare_job *job); /* job->frames 0: not known yet */

#ifdef __cplusplus
}
#endif
/* prepare_settings.c. ERN_E_ARGUMENT where a member is outside of its range. */
ERN_NODISCARD ern_status ern_prepare_settings_check(ern_context *context, const ern_prepare_options *options);

#endif
