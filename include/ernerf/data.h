/* SPDX-License-Identifier: MIT
 * What goes into a portrait as arrays: speech features and head poses, and their files. No media formats. */
#ifndef ERNERF_DATA_H
#define ERNERF_DATA_H

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Speech features: for video frame t (25 a second) a window of feature vectors at 50 a second around it. */
typedef struct ern_features {
  float *data;       /* [windows][window_length][width] */
  size_t windows;    /* T >= 1, one a video frame */
  int window_length; /* 1..16 */
  int width;         /* D: 29 DeepSpeech, 44 wav2vec, 1024 HuBERT; any 1..4096 */
} ern_features;

/* Reads a .npy file of shape [T, window_length, D] in float16, float32 or float64, C order. Values must be finite.
 * On success the caller owns features->data (ern_features_free). */
ERN_API ERN_NODISCARD ern_status ern_features_load(ern_context *context, const char *path, ern_features *features);
ERN_API void ern_features_free(ern_context *context, ern_features *features); /* accepts NULL and an empty one */

/* One frame of a transforms_*.json file. */
typedef struct ern_pose {
  int64_t img_id;   /* names the frame's files, >= 0 */
  int64_t aud_id;   /* its row in the feature file, >= 0 */
  float matrix[16]; /* camera to world of the tracked head, row-major 4x4, as in the file; finite, last row 0 0 0 1 */
} ern_pose;

typedef struct ern_pose_list {
  double focal, cx, cy; /* pixels */
  int width, height;    /* pixels; 2*cx and 2*cy where the file has neither w nor h */
  size_t count;         /* >= 1 */
  ern_pose *poses;
} ern_pose_list;

/* Reads a transforms_*.json file. On success the caller owns the list (ern_pose_list_free). Every field is checked:
 * presence, type, range, finiteness; an error names file, frame, field, found and expected. */
ERN_API ERN_NODISCARD ern_status ern_pose_list_load(ern_context *context, const char *path, ern_pose_list *list);
ERN_API void ern_pose_list_free(ern_context *context, ern_pose_list *list); /* accepts NULL and an empty one */

#ifdef __cplusplus
}
#endif
#endif
