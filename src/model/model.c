/* SPDX-License-Identifier: MIT */
#include "model/model.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "model/torso_ops.h"

ern_status ern_model_make(ern_model **model, ern_context *context, const struct ern_model_config *config) {
  ern_model *made = NULL;
  *model = NULL;
  ern_status status = ERN_NEW(context, 1, &made);
  if (status != ERN_OK) return status;
  made->context = context;
  made->view = ern_view_settings_default();
  ERN_TRY(ern_parameters_build(context, config, &made->field, &made->table));
  ERN_TRY(ERN_NEW(context, made->field.parameters, &made->block));
  ERN_TRY(ERN_NEW(context, ERN_OCCUPANCY_BYTES, &made->bits));
  if (config->torso) ERN_TRY(ERN_NEW(context, ERN_TORSO_CELLS, &made->torso_grid));
  *model = made;
  return ERN_OK;
fail:
  ern_model_free(&made);
  return status;
}

void ern_model_free(ern_model **model) {
  if (model == NULL || *model == NULL) return;
  ern_context *context = (*model)->context;
  ern_release(context, (*model)->block);
  ern_release(context, (*model)->bits);
  ern_release(context, (*model)->torso_grid);
  ern_release(context, (*model)->camera);
  ern_release(context, *model);
  *model = NULL;
}

static void describe(const ern_model *model, ern_model_info *info) {
  const struct ern_model_config *config = &model->field.config;
  *info = (ern_model_info){.has_torso = config->torso,
                           .has_eye = config->eye,
                           .has_view = !config->no_view,
                           .has_codes = config->codes > 0,
                           .has_gamma = config->torso_gamma,
                           .backbone = config->backbone,
                           .attention = config->attention,
                           .eye_attention = config->eye_attention,
                           .levels = config->levels,
                           .feature_width = config->feature_width,
                           .window_length = config->window_length,
                           .codes = config->codes,
                           .bound = config->bound,
                           .has_view_settings = model->view.is_set,
                           .max_steps = model->view.max_steps,
                           .dt_gamma = model->view.dt_gamma,
                           .torso_shrink = model->view.torso_shrink,
                           .scale = model->view.scale,
                           .audio_pad = model->view.audio_pad,
                           .cameras = model->cameras,
                           .head_steps = model->head_steps,
                           .torso_steps = model->torso_steps,
                           .dub = model->dub,
                           .has_torso_motion = model->has_motion,
                           .voice_fade = {config->voice_fade[0], config->voice_fade[1]}};
  memcpy(info->clip, model->clip, sizeof info->clip);
  memcpy(info->speech, model->speech, sizeof info->speech);
  memcpy(info->speech_network, model->speech_network, sizeof info->speech_network);
  memcpy(info->consent, model->consent, sizeof info->consent);
  for (int r = 0; r < model->table.rows; r++) info->parameters += model->table.row[r].count;
  info->parameter_bytes = info->parameters * sizeof(float);
}

void ern_model_describe_sized(const ern_model *model, ern_model_info *info, size_t bytes) {
  ern_model_info own = {0};
  if (model != NULL) describe(model, &own);
  ern_struct_copy_out(info, bytes, &own, sizeof own);
}

/* m = Rx(a) Ry(b) Rz(c) */
static void euler_matrix(float m[9], const float radians[3]) {
  const double ca = cos((double)radians[0]), sa = sin((double)radians[0]), cb = cos((double)radians[1]),
               sb = sin((double)radians[1]), cc = cos((double)radians[2]), sc = sin((double)radians[2]);
  const double rows[9] = {cb * cc,
                          -cb * sc,
                          sb,
                          ca * sc + sa * sb * cc,
                          ca * cc - sa * sb * sc,
                          -sa * cb,
                          sa * sc - ca * sb * cc,
                          sa * cc + ca * sb * sc,
                          ca * cb};
  for (int i = 0; i < 9; i++) m[i] = (float)rows[i];
}

/* angle: [3] degrees; move: [3] */
static void refine(float pose[16], const float angle[3], const float move[3]) {
  const float degree = 3.14159265358979f / 180;
  float turn[9], old[16];
  euler_matrix(turn, (float[]){angle[0] * degree + 1e-8f, angle[1] * degree + 1e-8f, angle[2] * degree + 1e-8f});
  memcpy(old, pose, sizeof old);
  for (int r = 0; r < 3; r++) {
    for (int c = 0; c < 3; c++)
      pose[4 * r + c] = turn[r] * old[c] + turn[3 + r] * old[4 + c] + turn[6 + r] * old[8 + c];
    pose[4 * r + 3] = old[4 * r + 3] + move[r];
  }
}

void ern_model_refine(const ern_model *model, size_t index, float pose[16]) {
  ERN_PLAIN_FLOATS;
  if (model == NULL || pose == NULL || model->cameras == 0) return;
  const size_t row = index < model->cameras ? index : model->cameras - 1;
  refine(pose, model->camera + 3 * row, model->camera + 3 * (model->cameras + row));
}

/* Width of the Gaussian weights, in frames: a frame's correction says little about frames far away. */
static const double unseen_width = 3;

void ern_model_refine_unseen(const ern_model *model, const int64_t *frames, size_t count, int64_t frame,
                             float pose[16]) {
  ERN_PLAIN_FLOATS;
  double total = 1, sum[ERN_POSE_NUMBERS]; /* starts with weight 1 for the regression's prediction */
  float row[ERN_POSE_NUMBERS];
  if (model == NULL || (frames == NULL && count > 0) || pose == NULL || model->cameras == 0) return;
  ern_pose_regression_predict(model->unseen[0], ERN_POSE_CORRECTION, pose, sum);
  for (size_t i = 0; i < count && i < model->cameras; i++) {
    const double off = ((double)frames[i] - (double)frame) / unseen_width, weight = exp(-off * off / 2);
    total += weight;
    for (size_t k = 0; k < 3; k++) {
      sum[k] += weight * (double)model->camera[3 * i + k];
      sum[3 + k] += weight * (double)model->camera[3 * (model->cameras + i) + k];
    }
  }
  for (size_t k = 0; k < 6; k++) row[k] = (float)(sum[k] / total);
  refine(pose, row, row + 3);
}

static void add_tensor(struct ern_model_tensors *out, const char *name, ern_dtype dtype, int dims, size_t first,
                       size_t second, size_t third, const void *data) {
  struct ern_tensor *tensor = &out->tensor[out->count++];
  *tensor =
      (struct ern_tensor){.name = name, .dtype = dtype, .dims = dims, .shape = {first, second, third}, .data = data};
  tensor->count = 1;
  for (int d = 0; d < dims; d++) tensor->count *= tensor->shape[d];
}

/* First entry of each level, and the end, as in public checkpoints. */
static void add_offsets(struct ern_model_tensors *out, int slot, const char *name, const struct ern_grid *grid) {
  for (int l = 0; l < grid->levels; l++) out->offsets[slot][l] = (int32_t)grid->level[l].offset;
  out->offsets[slot][grid->levels] = (int32_t)grid->entries;
  snprintf(out->offsets_name[slot], sizeof out->offsets_name[slot], "%s.offsets", name);
  add_tensor(out, out->offsets_name[slot], ERN_I32, 1, (size_t)grid->levels + 1, 0, 0, out->offsets[slot]);
}

void ern_model_tensors(const ern_model *model, struct ern_model_tensors *out) {
  const struct ern_field *field = &model->field;
  const float b = field->config.bound, box[6] = {-b, -b / 2, -b, b, b / 2, b};
  out->count = 0;
  memcpy(out->box, box, sizeof box);
  for (int r = 0; r < model->table.rows; r++) {
    const struct ern_parameter *row = &model->table.row[r];
    add_tensor(out, row->name, ERN_F32, row->dims, row->shape[0], row->shape[1], row->shape[2], model->block + row->at);
  }
  add_tensor(out, "aabb_train", ERN_F32, 1, 6, 0, 0, out->box);
  add_tensor(out, "aabb_infer", ERN_F32, 1, 6, 0, 0, out->box);
  for (int g = 0; g < field->encoder.grids; g++)
    add_offsets(out, g, ern_encoder_grid_name(field, g), &field->encoder.grid[g]);
  add_tensor(out, "density_bitfield", ERN_U8, 1, ERN_OCCUPANCY_BYTES, 0, 0, model->bits);
  if (field->config.torso) {
    add_offsets(out, ERN_PLANES, "torso_encoder", &field->torso_grid);
    add_tensor(out, "density_grid_torso", ERN_F32, 1, ERN_TORSO_CELLS, 0, 0, model->torso_grid);
    if (model->has_motion)
      add_tensor(out, "torso_motion_unseen", ERN_F32, 2, ERN_POSE_REGRESSION_ROWS, ERN_MOTION_VALUES, 0, model->motion);
  }
  if (model->cameras > 0) {
    add_tensor(out, "camera_dR", ERN_F32, 2, model->cameras, 3, 0, model->camera);
    add_tensor(out, "camera_dT", ERN_F32, 2, model->cameras, 3, 0, model->camera + 3 * model->cameras);
    add_tensor(out, "camera_unseen", ERN_F32, 2, ERN_POSE_REGRESSION_ROWS, ERN_POSE_CORRECTION, 0, model->unseen);
  }
}
