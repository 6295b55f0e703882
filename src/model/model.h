/* SPDX-License-Identifier: MIT
 * A model in memory: configuration, parameter block, occupancy, identity; and its file. */
#ifndef ERN_MODEL_MODEL_H
#define ERN_MODEL_MODEL_H

#include "ernerf/model.h"
#include "io/safetensors.h"
#include "model/parameters.h"
#include "model/pose_regression.h"
#include "model/view_settings.h"

struct ern_model {
  ern_context *context;
  struct ern_field field;
  struct ern_parameter_table table;
  float *block;      /* [field.parameters] */
  uint8_t *bits;     /* [ERN_OCCUPANCY_BYTES] */
  float *torso_grid; /* [ERN_TORSO_CELLS], NULL without a torso */
  float *camera;     /* trained refinement of the training poses: [cameras][3] degrees, then [cameras][3] moves */
  size_t cameras;    /* 0: there is none */
  /* Fits on the poses (pose_regression.h), for untrained frames: of `camera`, and of the body's motion. */
  float unseen[ERN_POSE_REGRESSION_ROWS][ERN_POSE_CORRECTION];
  bool has_motion; /* the torso was trained with the body's motion (ern_frame_input) */
  float motion[ERN_POSE_REGRESSION_ROWS][ERN_MOTION_VALUES];
  uint64_t head_steps, torso_steps;
  struct ern_view_settings view;
  char speech[64];          /* kind of the speech features; "": unknown */
  char speech_network[512]; /* a JSON object; "": no network made them */
  char clip[65];
  char consent[ERN_CONSENT_BYTES]; /* UTF-8 */
  bool dub;                        /* as of ern_model_info */
};

/* Steps of a training, at most, in a file that is read: whole numbers up to here are exact in a double. */
#define ERN_MODEL_MOST_STEPS ((int64_t)1 << 53)

/* A model of that configuration with all values 0 and the default view settings. */
ERN_NODISCARD ern_status ern_model_make(ern_model **model, ern_context *context, const struct ern_model_config *config);

/* Parameters and buffers as tensors that point into the model (`tensors` has room for ERN_MODEL_TENSORS), and the
 * metadata text, owned by the caller (ern_release). What a state file adds comes after them. */
enum { ERN_MODEL_TENSORS = ERN_MAX_PARAMETERS + 16 };
struct ern_model_tensors {
  struct ern_tensor tensor[ERN_MODEL_TENSORS];
  size_t count;
  int32_t offsets[ERN_PLANES + 1][ERN_GRID_MAX_LEVELS + 1]; /* of the encoder's grids, and of the torso's */
  char offsets_name[ERN_PLANES + 1][32];
  float box[6];
};
void ern_model_tensors(const ern_model *model, struct ern_model_tensors *out);
/* ERN_E_ARGUMENT where the name does not end in .safetensors. */
ERN_NODISCARD ern_status ern_model_check_name(ern_context *context, const char *path);
/* ern_model_save; `existing` says what happens to a file at `path`. */
ERN_NODISCARD ern_status ern_model_write(const ern_model *model, const char *path, enum ern_existing existing);
ERN_NODISCARD ern_status ern_model_metadata(const ern_model *model, char **json);

/* Makes a model of an open file; tensors whose names begin with `state.` are left to the caller. `path` is for
 * messages. */
ERN_NODISCARD ern_status ern_model_from_file(ern_model **model, ern_context *context,
                                             const struct ern_tensor_file *file, const char *path);

/* Copies a tensor of exactly this shape into out; errors name path, tensor and both shapes. Values must be finite. */
ERN_NODISCARD ern_status ern_tensor_take(ern_context *context, const struct ern_tensor_file *file, const char *path,
                                         const char *name, int dims, const size_t *shape, float *out);

#endif
