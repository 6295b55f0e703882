/* SPDX-License-Identifier: MIT
 * A trained portrait and its file. */
#ifndef ERNERF_MODEL_H
#define ERNERF_MODEL_H

#include <stdbool.h>

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Read-only once loaded: any number of renderers, in any threads, may share one. */
typedef struct ern_model ern_model;

/* Reads a .safetensors file with the public checkpoint's tensor names, ours or converted. Strict: every tensor with its
 * shape and finite values, or an error that names the first that is wrong. On success the caller owns *model. */
ERN_API ERN_NODISCARD ern_status ern_model_load(ern_model **model, ern_context *context, const char *path);
ERN_API void ern_model_free(ern_model **model); /* accepts NULL and a pointer to NULL */

/* Writes the model: weights as float32, occupancy as bits, configuration and identity in the metadata. Atomic. */
ERN_API ERN_NODISCARD ern_status ern_model_save(const ern_model *model, const char *path);

typedef struct ern_model_info {
  bool has_torso;                   /* head and torso, else the head alone */
  bool has_eye;                     /* follows the eye value */
  bool has_codes;                   /* individual codes of the training frames */
  bool has_gamma;                   /* trained scale of the torso's key points */
  int levels;                       /* of the tri-plane encoder */
  int feature_width;                /* D of the speech features it was trained on */
  int codes;                        /* rows of the individual codes */
  float bound;                      /* half side of the scene */
  uint64_t head_steps, torso_steps; /* training steps behind it; 0 where the file does not say */
  char clip[65];                    /* identity of the clip it was trained on, "" where the file does not say */
  size_t parameters;                /* trained numbers */
  size_t parameter_bytes;
} ern_model_info;
ERN_API void ern_model_describe(const ern_model *model, ern_model_info *info);

/* One tensor of a file, for listing. */
typedef struct ern_tensor_info {
  const char *name, *dtype; /* dtype as safetensors writes it: "F32" */
  int dims;
  size_t shape[4];
} ern_tensor_info;

/* Lists the tensors of a .safetensors or .npy file (which has one, without a name), after checking the file as a whole.
 */
ERN_API ERN_NODISCARD ern_status ern_file_tensors(ern_context *context, const char *path,
                                                  void (*say)(void *user, const ern_tensor_info *tensor), void *user);

#ifdef __cplusplus
}
#endif
#endif
