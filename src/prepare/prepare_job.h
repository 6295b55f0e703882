/* SPDX-License-Identifier: MIT
 * What the steps of `prepare` share: the folder of the clip, its frames, its poses, and what a step says of its work.
 *
 * Files of the clip that steps hand on to each other: ori_imgs/ID.jpg (the frames as they are, quality 98),
 * ori_imgs/ID.lms, transforms_*.json, and in prepare/ what no training needs: faces.csv. ID counts from 0. */
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
  ERN_PREPARE_MARK = ERN_PREPARE_PATH + 104,
  ERN_PREPARE_RATE = 25,
  ERN_PREPARE_FRAMES = 30 * 60 * ERN_PREPARE_RATE,
  ERN_PREPARE_MORE = 2, /* rows or windows of one part of a video may be more or fewer than its frames */
  ERN_PREPARE_REACH = 4 /* sides of the clip: a landmark lies less than that from the corner, along x and y */
};

/* Sides of the clip: the range of a focal length. */
#define ERN_PREPARE_FOCAL_LEAST 0.2
#define ERN_PREPARE_FOCAL_MOST 20.0

struct ern_prepare_job {
  ern_context *context;
  const char *video, *folder;
  const ern_prepare_options *options;
  bool made;     /* the folder is this call's: it goes where nothing came into it */
  bool refused;  /* a step refused the video, and the record says so */
  dev_t device;  /* of the folder that the record was opened in */
  ino_t inode;   /* of it; 0: none is open */
  int side;      /* pixels a side of a frame */
  double focal;  /* pixels */
  size_t frames; /* at most ERN_PREPARE_FRAMES; 0 before the step "face", or those of an earlier call */
  /* Seconds of the video: the stretch that was chosen for options->segment; [1] 0: none. */
  double segment[2];
  json_t *record; /* prepare.json */
  /* of the step that runs */
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
  float eyes[2][2]; /* centres x, y; the one that is left in the picture first */
};

/* Whether the folder's name still leads to the folder that the record was opened in. */
bool ern_prepare_stays(const struct ern_prepare_job *job);
/* ERN_E_IO where it does not: what has its name now is somebody else's. */
ERN_NODISCARD ern_status ern_prepare_check_stays(const struct ern_prepare_job *job);
/* FOLDER/ and the rest by printf; ERN_E_ARGUMENT where that is too long, ERN_E_EXISTS where it is a symbolic link,
 * ERN_E_IO as above. */
ERN_NODISCARD ern_status ern_prepare_path(const struct ern_prepare_job *job, char path[ERN_PREPARE_PATH],
                                          const char *format, ...) ERN_PRINTF(3, 4);
/* The part of the video that the clip is, seconds after its first frame; *to 0: up to its end. */
void ern_prepare_part(const struct ern_prepare_job *job, double *from, double *to);
/* A picture of the clip by that name with `channels` 3 or 4, which has the clip's size. */
ERN_NODISCARD ern_status ern_prepare_picture(const struct ern_prepare_job *job, const char *name, int channels,
                                             ern_image *image);

/* poses[job->frames] from and to transforms_train.json (the first ten elevenths) and transforms_val.json. */
ERN_NODISCARD ern_status ern_prepare_poses_read(struct ern_prepare_job *job, struct ern_head_pose *poses);
/* The same from the file that options->poses names, whose focal length and distances are those of a head in a picture.
 * *unheard: frames whose aud_id is not their img_id. */
ERN_NODISCARD ern_status ern_prepare_poses_supplied(struct ern_prepare_job *job, struct ern_head_pose *poses,
                                                    size_t *unheard);
ERN_NODISCARD ern_status ern_prepare_poses_write(struct ern_prepare_job *job, const struct ern_head_pose *poses);
/* poses_supplied.c. The step "pose" with the poses of options->poses. */
ERN_NODISCARD ern_status ern_prepare_poses_take(struct ern_prepare_job *job);
/* The verdict of how far the head turns in all, degrees. */
void ern_prepare_check_turn(struct ern_prepare_job *job, double turn);

/* *faces[*count] in the order of frames; the caller owns it (ern_release). The eyes are where the landmarks of
 * options->landmarks have them, if the user supplied any. */
ERN_NODISCARD ern_status ern_prepare_faces_read(struct ern_prepare_job *job, struct ern_found_face **faces,
                                                size_t *count);
ERN_NODISCARD ern_status ern_prepare_faces_write(struct ern_prepare_job *job, const struct ern_found_face *faces,
                                                 size_t count);

/* prepare_files.c. What the user brings, by its path, its bytes and its time, of a folder by the count, the bytes and
 * the newest time of its files: another content is another mark. Returns `mark`, "" for NULL. */
const char *ern_prepare_mark(const char *path, char mark[ERN_PREPARE_MARK]);
/* Files of a supplied folder by the names ID.ENDING (".lms"): ERN_E_MISMATCH where there are more than frames, as they
 * are then those of a longer video, of which the clip may be another part. */
ERN_NODISCARD ern_status ern_prepare_check_count(const struct ern_prepare_job *job, const char *folder,
                                                 const char *ending);

/* prepare_made.c; `step` counts from 0 ("face"). Whether all files are there that a step which was done with these
 * options has left. */
bool ern_prepare_files_there(const struct ern_prepare_job *job, size_t step);
/* ERN_E_EXISTS where a file is there that the step may write, no call made it, and options->anew is not set. `anew`:
 * "face" runs before it, so the clip may get more frames than job->frames. */
ERN_NODISCARD ern_status ern_prepare_check_files(struct ern_prepare_job *job, size_t step, bool anew);
/* The path of a file that is about to be written, by its name in the clip ("bc.jpg", "gt_imgs/3.jpg"). Notes in the
 * record that a call makes it, or those of all frames; ERN_E_EXISTS as above where it is there and no call made it. */
ERN_NODISCARD ern_status ern_prepare_claim(struct ern_prepare_job *job, const char *name, char path[ERN_PREPARE_PATH]);
/* At the start and the end of a call: notes how the files are that calls have made, so that those which are changed
 * later are the user's; takes back what was noted of files that are not there. */
ERN_NODISCARD ern_status ern_prepare_note_made(struct ern_prepare_job *job);
/* Removes what calls made, of the frames 0..job->frames - 1; with options->anew whatever file has such a name. No link
 * goes, and nothing behind one. job->frames is 0 then. */
ERN_NODISCARD ern_status ern_prepare_clear(struct ern_prepare_job *job);
/* Removes the file of that name right in the clip's folder, where a call made it. */
ERN_NODISCARD ern_status ern_prepare_remove_made(struct ern_prepare_job *job, const char *name);

/* Tells the caller how far the step is; ERN_E_CANCELLED where the caller has enough. */
ERN_NODISCARD ern_status ern_prepare_progress(struct ern_prepare_job *job, size_t done, size_t total);

/* Adds a reason to the step's verdict, which gets the worse of its grade and this one. The words name what was found,
 * what was expected, and what helps. */
void ern_prepare_add_reason(struct ern_prepare_job *job, ern_prepare_grade grade, const char *format, ...)
    ERN_PRINTF(3, 4);
/* A number for prepare.json and the report. */
void ern_prepare_figure(struct ern_prepare_job *job, const char *name, double value);

/* The steps. Each reads what the ones before it left in the folder, and gives its verdict; it replaces its own files
 * alone. */
ern_status ern_prepare_face(struct ern_prepare_job *job);      /* video -> ori_imgs/ID.jpg, aud.wav, faces.csv */
ern_status ern_prepare_pose(struct ern_prepare_job *job);      /* -> transforms_*.json */
ern_status ern_prepare_landmarks(struct ern_prepare_job *job); /* -> ori_imgs/ID.lms */
ern_status ern_prepare_layers(struct ern_prepare_job *job);    /* -> parsing, bc.jpg, torso_imgs, gt_imgs */
ern_status ern_prepare_eyes(struct ern_prepare_job *job);      /* -> au.csv */
ern_status ern_prepare_features(struct ern_prepare_job *job);  /* -> aud.npy where features are supplied */
/* What the user brings for a step, read as the step reads it, once the frames are there, and what is missing for it;
 * nothing is written. */
ERN_NODISCARD ern_status ern_prepare_pose_check(struct ern_prepare_job *job);
ERN_NODISCARD ern_status ern_prepare_landmarks_check(struct ern_prepare_job *job);
ERN_NODISCARD ern_status ern_prepare_layers_check(struct ern_prepare_job *job);
ERN_NODISCARD ern_status ern_prepare_eyes_check(struct ern_prepare_job *job);
ERN_NODISCARD ern_status ern_prepare_features_check(struct ern_prepare_job *job); /* job->frames 0: not known yet */

#ifdef __cplusplus
}
#endif
#endif
