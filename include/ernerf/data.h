/* SPDX-License-Identifier: MIT
 * What goes into a portrait as arrays: speech features and head poses, and their files. No media formats. */
#ifndef ERNERF_DATA_H
#define ERNERF_DATA_H

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Speech features: for video frame t (25 a second) a window of feature vectors at 50 a second around it.
 * Plain data, final. */
typedef struct ern_features {
  float *data;       /* [windows][window_length][width] */
  size_t windows;    /* T >= 1, one a video frame */
  int window_length; /* 1..16 */
  int width;         /* D: 29 DeepSpeech, 44 wav2vec, 1024 HuBERT; any 1..4096 */
} ern_features;

/* Reads a .npy file of shape [T, window_length, D] in float16, float32 or float64, C order. Values are -1e30 to 1e30;
 * what is beyond is refused by its place: ERN_E_FORMAT, or ERN_E_NONFINITE for infinity and NaN.
 * On success the caller owns features->data (ern_features_free). */
ERN_API ERN_NODISCARD ern_status ern_features_load(ern_context *context, const char *path, ern_features *features);
/* Writes such a file as float32 (base.h, "How files are written"). */
ERN_API ERN_NODISCARD ern_status ern_features_save(ern_context *context, const char *path,
                                                   const ern_features *features);
ERN_API void ern_features_free(ern_context *context, ern_features *features); /* accepts NULL and an empty one */

/* How far the lids are closed, frame by frame. Plain data, final. */
typedef struct ern_eyes {
  float *data;  /* [count], 0 open .. 1 closed */
  size_t count; /* >= 1, frames */
} ern_eyes;

/* Reads a curve of the lids; the file's form says what its numbers are:
 * a table with a header and a column AU45_r, such as au.csv: intensities a of 0 to 5, the eye is min(a, 2)/2;
 * text without a header: one number of 0 to 1 a line; a .npy file of shape [T] or [T, 1] in float16, float32 or
 * float64: 0 to 1. Anything else is ERN_E_FORMAT or ERN_E_SHAPE and names row, found and expected; ERN_E_MISSING: no
 * file, or no such column. On success the caller owns the curve (ern_eyes_free). */
ERN_API ERN_NODISCARD ern_status ern_eyes_load(ern_context *context, const char *path, ern_eyes *eyes);
ERN_API void ern_eyes_free(ern_context *context, ern_eyes *eyes); /* accepts NULL and an empty one */

/* One frame of a transforms_*.json file. Plain data, final. */
typedef struct ern_pose {
  int64_t img_id;   /* names the frame's files, >= 0 */
  int64_t aud_id;   /* its row in the feature file, >= 0 */
  float matrix[16]; /* camera to world of the tracked head, row-major 4x4, as in the file; rotation
                       within 1e3, place within 1e6, last row 0 0 0 1 */
} ern_pose;

/* A transforms_*.json file. Plain data, final. */
typedef struct ern_pose_list {
  double focal, cx, cy; /* pixels */
  int width, height;    /* pixels; 2*cx and 2*cy where the file has neither w nor h */
  size_t count;         /* >= 1 */
  ern_pose *poses;      /* [count] */
} ern_pose_list;

/* Reads a transforms_*.json file. On success the caller owns the list (ern_pose_list_free). Every field is checked:
 * presence, type, range, finiteness; an error names file, frame, field, found and expected. */
ERN_API ERN_NODISCARD ern_status ern_pose_list_load(ern_context *context, const char *path, ern_pose_list *list);
ERN_API void ern_pose_list_free(ern_context *context, ern_pose_list *list); /* accepts NULL and an empty one */

/* ERN_E_EXISTS where the context keeps files and a file is at `path`, so that a program can ask before it works for
 * hours; ERN_E_IO where a folder, a device or a pipe is there, or a file that may not be written. Touches nothing. */
ERN_API ERN_NODISCARD ern_status ern_file_check_output(ern_context *context, const char *path);

/* Writes a file, whole or not at all (base.h, "How files are written"). */
ERN_API ERN_NODISCARD ern_status ern_file_save(ern_context *context, const char *path, const void *bytes, size_t count);
/* The same of `count` files, sizes[i] bytes each, which belong together: no file gets its final name before all are
 * whole on the disk, so a full disk leaves what was there. */
ERN_API ERN_NODISCARD ern_status ern_files_save(ern_context *context, size_t count, const char *const *paths,
                                                const void *const *bytes, const size_t *sizes);

#ifdef __cplusplus
}
#endif
#endif
