/* SPDX-License-Identifier: MIT
 * The inputs of a model as arrays: speech features, eye values, head poses; and the files that hold them. libernerf
 * itself reads no pictures, video or sound (media.h). base.h defines the terms "plain data" and "final". */
#ifndef ERNERF_DATA_H
#define ERNERF_DATA_H

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Speech features. Video has 25 frames a second. Window t belongs to video frame t; it holds window_length consecutive
 * feature vectors (rows in speech.h), 50 a second, from the sound around the frame. Windows of length 16 hold the
 * vectors 2t-8 .. 2t+7, those of length 2 (HuBERT) the vectors 2t and 2t+1; of other lengths the program that made them
 * decides which.
 * Plain data, final. */
typedef struct ern_features {
  float *data;       /* [windows][window_length][width] */
  size_t windows;    /* T, >= 1: one for each video frame */
  int window_length; /* vectors in a window, 1..16 */
  int width; /* D, numbers in a vector, 1..4096: 13 built-in (speech.h), 29 DeepSpeech, 44 wav2vec, 1024 HuBERT */
} ern_features;

/* Reads a .npy file of shape [T, window_length, D] in float16, float32 or float64, C order. A value beyond -1e30..1e30
 * is ERN_E_FORMAT, an infinity, a NaN or a float64 above float's range ERN_E_NONFINITE; the error text has its index.
 * Another shape is ERN_E_SHAPE, another type or order ERN_E_UNSUPPORTED. On success the caller owns features->data
 * (ern_features_free). */
ERN_API ERN_NODISCARD ern_status ern_features_load(ern_context *context, const char *path, ern_features *features);
/* Writes such a file as float32 (base.h, "How files are written"). A value that ern_features_load refuses is the same
 * error here, and nothing is written. */
ERN_API ERN_NODISCARD ern_status ern_features_save(ern_context *context, const char *path,
                                                   const ern_features *features);
ERN_API void ern_features_free(ern_context *context, ern_features *features); /* accepts NULL and an empty one */

/* Eye values: how far the eyelids are closed, one for each video frame (25 a second, from frame 0). In a clip's au.csv
 * value i is that of the frame whose img_id is i (ern_pose). Plain data, final. */
typedef struct ern_eyes {
  float *data;  /* [count], 0 (open) to 1 (closed) */
  size_t count; /* frames, >= 1 */
} ern_eyes;

/* Reads eye values. The file is one of
 * - a table (CSV) with a header and a column AU45_r, such as au.csv: the column has intensities a, 0 to 5, and the eye
 *   value is min(a, 2)/2;
 * - text whose first line is a number: one eye value of 0 to 1 in each line;
 * - a file whose name ends in ".npy", of shape [T] or [T, 1] in float16, float32 or float64: eye values of 0 to 1.
 *
 * Anything else is ERN_E_FORMAT, ERN_E_SHAPE or ERN_E_UNSUPPORTED; the error text names row, found and expected.
 * ERN_E_MISSING: no such file, or no such column. On success the caller owns the values (ern_eyes_free). */
ERN_API ERN_NODISCARD ern_status ern_eyes_load(ern_context *context, const char *path, ern_eyes *eyes);
ERN_API void ern_eyes_free(ern_context *context, ern_eyes *eyes); /* accepts NULL and an empty one */

/* One frame of a transforms_*.json file. Plain data, final. */
typedef struct ern_pose {
  int64_t img_id;   /* the number in the names of the frame's files, 0..999999999 */
  int64_t aud_id;   /* the frame's window of the speech features, from 0, 0..999999999 */
  float matrix[16]; /* row-major 4x4, as in the file: from camera to world coordinates; the world is fixed to the head
                       (docs/formats.md). The first 3 rows and columns are a rotation, to within 1e-2. The translation
                       is in the file's unit, metres in files of ern_prepare, -1e6..1e6. The last row is 0 0 0 1 */
} ern_pose;

/* A transforms_*.json file. Plain data, final. */
typedef struct ern_pose_list {
  double focal, cx, cy; /* focal length and principal point, pixels; > 0 */
  int width, height;    /* of the pictures, 1..8192 pixels: w and h of the file; 2 cx and 2 cy where it has neither */
  size_t count;         /* frames, >= 1 */
  ern_pose *poses;      /* [count] */
} ern_pose_list;

/* Reads a transforms_*.json file. Every field is checked for presence, type and range; the error text names file,
 * frame, field, found and expected. ERN_E_FORMAT: a field is missing, or has another type or range. ERN_E_SHAPE: a
 * matrix is not 4x4, or the file is too large. ERN_E_MISSING: no such file. On success the caller owns the list
 * (ern_pose_list_free). */
ERN_API ERN_NODISCARD ern_status ern_pose_list_load(ern_context *context, const char *path, ern_pose_list *list);
ERN_API void ern_pose_list_free(ern_context *context, ern_pose_list *list); /* accepts NULL and an empty one */

/* Checks whether a file could be written at `path`, and changes nothing. A program can call it before hours of work.
 * ERN_E_EXISTS: a file is there, and ern_context_config.keep_files is true. ERN_E_IO: a folder, a device or a pipe is
 * there, or a write-protected file. The folder that holds the file is not checked. */
ERN_API ERN_NODISCARD ern_status ern_file_check_output(ern_context *context, const char *path);

/* Writes `count` bytes to a file, atomically (base.h, "How files are written"). */
ERN_API ERN_NODISCARD ern_status ern_file_save(ern_context *context, const char *path, const void *bytes, size_t count);
/* Writes `count` files that belong together, file i with sizes[i] bytes. No file gets its name before all are complete
 * on the disk. So a full disk leaves the earlier files as they were. */
ERN_API ERN_NODISCARD ern_status ern_files_save(ern_context *context, size_t count, const char *const *paths,
                                                const void *const *bytes, const size_t *sizes);

#ifdef __cplusplus
}
#endif
#endif
