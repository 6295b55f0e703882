/* SPDX-License-Identifier: MIT */
#include "model/torch_layout.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/format.h"
#include "core/memory.h"
#include "io/json.h"
#include "model/checkpoint.h"
#include "model/kinds.h"
#include "model/torso_ops.h"

enum { PUBLIC_CODES = 10000, PUBLIC_LEVELS = 12, MOST_STATE = 1 << 20 /* bytes of memory */ };

void ern_torch_layout_free(struct ern_torch_layout *l) {
  for (size_t i = 0; i < l->tensors; i++) ern_release(l->context, l->owned[i]);
  json_decref(l->tree);
  l->tensors = 0;
  l->tree = NULL;
}

/* ---- tensors ----------------------------------------------------------------------------------------------------- */

/* A tensor of zeros; its bytes are the last of l->owned. */
static ern_status add(struct ern_torch_layout *l, const char *prefix, const char *name, ern_dtype dtype, int dims,
                      const size_t *shape) {
  size_t count = 1;
  if (l->tensors >= ERN_TORCH_LAYOUT_TENSORS)
    return ern_fail(l->context, ERN_E_SHAPE, "%s: more tensors than a model has", l->path);
  for (int d = 0; d < dims; d++) count *= shape[d];
  void *bytes = ern_allocate(l->context, count, ern_dtype_bytes(dtype));
  if (bytes == NULL) return ERN_E_NO_MEMORY;
  struct ern_tensor *tensor = &l->tensor[l->tensors];
  snprintf(l->name[l->tensors], sizeof l->name[0], "%s%s", prefix, name);
  *tensor =
      (struct ern_tensor){.name = l->name[l->tensors], .dtype = dtype, .dims = dims, .count = count, .data = bytes};
  for (int d = 0; d < dims; d++) tensor->shape[d] = shape[d];
  l->owned[l->tensors++] = bytes;
  return ERN_OK;
}

/* Pads [rows][columns] with zeros. The public program has 10,000 codes, and a column for the eye in the first density
 * layer. */
static ern_status add_padded(struct ern_torch_layout *l, const char *prefix, const struct ern_parameter *row,
                             const float *values) {
  const struct ern_model_config *config = &l->model->field.config;
  size_t shape[ERN_PARAMETER_DIMS] = {row->shape[0], row->shape[1], row->shape[2]};
  if (strncmp(row->name, "individual_codes", 16) == 0 && shape[0] < PUBLIC_CODES) shape[0] = PUBLIC_CODES;
  if (strcmp(row->name, "sigma_net.net.0.weight") == 0 && !config->eye) shape[1]++;
  const ern_status status = add(l, prefix, row->name, ERN_F32, row->dims, shape);
  if (status != ERN_OK || values == NULL) return status;
  const size_t from = row->dims > 1 ? row->count / row->shape[0] : 1,
               to = row->dims > 1 ? from / row->shape[1] * shape[1] : 1;
  float *padded = l->owned[l->tensors - 1];
  for (size_t i = 0; i < row->shape[0]; i++) memcpy(padded + i * to, values + i * from, from * sizeof(float));
  return ERN_OK;
}

static ern_status add_copy(struct ern_torch_layout *l, const char *name, ern_dtype dtype, size_t count,
                           const void *values) {
  const ern_status status = add(l, "", name, dtype, 1, &count);
  if (status == ERN_OK) memcpy(l->owned[l->tensors - 1], values, count * ern_dtype_bytes(dtype));
  return status;
}

/* Parameters whose names begin with `start`, in the order of the table. */
static ern_status add_rows(struct ern_torch_layout *l, const char *start) {
  const struct ern_parameter_table *table = &l->model->table;
  for (int r = 0; r < table->rows; r++) {
    const struct ern_parameter *row = &table->row[r];
    if (!ern_checkpoint_in_group(row->name, start)) continue;
    const ern_status status = add_padded(l, "", row, l->model->block + row->at);
    if (status != ERN_OK) return status;
  }
  return ERN_OK;
}

static ern_status add_grid(struct ern_torch_layout *l, const char *name, const struct ern_grid *grid) {
  char start[32], offsets[48];
  int32_t values[ERN_GRID_MAX_LEVELS + 1];
  snprintf(start, sizeof start, "%s.", name);
  snprintf(offsets, sizeof offsets, "%s.offsets", name);
  for (int i = 0; i < grid->levels; i++) values[i] = (int32_t)grid->level[i].offset;
  values[grid->levels] = (int32_t)grid->entries;
  const ern_status status = add_rows(l, start);
  return status == ERN_OK ? add_copy(l, offsets, ERN_I32, (size_t)grid->levels + 1, values) : status;
}

/* The density grid where the file has it; else 20 in occupied cells, which gives the same bits with the threshold
 * min(mean, 10). */
static ern_status add_density(struct ern_torch_layout *l, double *mean) {
  static const char *const names[] = {"density_grid", "state.density_grid"};
  const struct ern_tensor *have = NULL;
  const ern_status status = add(l, "", "density_grid", ERN_F32, 2, (size_t[]){1, ERN_OCCUPANCY_CELLS});
  if (status != ERN_OK) return status;
  float *grid = l->owned[l->tensors - 1];
  for (size_t i = 0; i < 2 && have == NULL; i++) have = ern_tensor_file_find(l->file, names[i]);
  if (have != NULL && have->count == ERN_OCCUPANCY_CELLS) {
    const ern_status taken = ern_tensor_to_float(l->context, have, grid);
    if (taken != ERN_OK) return taken;
  } else {
    for (size_t i = 0; i < ERN_OCCUPANCY_CELLS; i++) grid[i] = (l->model->bits[i / 8] >> (i % 8) & 1) != 0 ? 20.0f : 0;
  }
  double sum = 0;
  for (size_t i = 0; i < ERN_OCCUPANCY_CELLS; i++) sum += grid[i] > 0 ? (double)grid[i] : 0;
  *mean = sum / ERN_OCCUPANCY_CELLS;
  return ERN_OK;
}

static ern_status add_buffers(struct ern_torch_layout *l, double mean[2]) {
  const ern_model *model = l->model;
  const float b = model->field.config.bound, box[6] = {-b, -b / 2, -b, b, b / 2, b};
  ern_status status = ERN_OK;
  ERN_TRY(add_copy(l, "aabb_train", ERN_F32, 6, box));
  ERN_TRY(add_copy(l, "aabb_infer", ERN_F32, 6, box));
  ERN_TRY(add_density(l, &mean[0]));
  ERN_TRY(add_copy(l, "density_bitfield", ERN_U8, ERN_OCCUPANCY_BYTES, model->bits));
  if (model->field.config.torso) {
    double sum = 0;
    ERN_TRY(add_copy(l, "density_grid_torso", ERN_F32, ERN_TORSO_CELLS, model->torso_grid));
    for (size_t i = 0; i < ERN_TORSO_CELLS; i++) sum += (double)model->torso_grid[i];
    mean[1] = sum / ERN_TORSO_CELLS;
  }
  status = add(l, "", "step_counter", ERN_I32, 2, (size_t[]){16, 2});
fail:
  return status;
}

/* In the order of the public program's state dict. */
static ern_status add_model(struct ern_torch_layout *l, double mean[2]) {
  const struct ern_field *field = &l->model->field;
  const size_t inputs = (size_t)field->feature_rows;
  ern_status status = ERN_OK;
  ERN_TRY(add_rows(l, "individual_codes"));
  if (field->config.torso) {
    ERN_TRY(add_rows(l, "individual_codes_torso"));
    ERN_TRY(add_rows(l, "anchor_points"));
  }
  if (l->model->cameras > 0) {
    ERN_TRY(add(l, "", "camera_dR", ERN_F32, 2, (size_t[]){l->model->cameras, 3}));
    memcpy(l->owned[l->tensors - 1], l->model->camera, 3 * l->model->cameras * sizeof(float));
    ERN_TRY(add(l, "", "camera_dT", ERN_F32, 2, (size_t[]){l->model->cameras, 3}));
    memcpy(l->owned[l->tensors - 1], l->model->camera + 3 * l->model->cameras, 3 * l->model->cameras * sizeof(float));
  }
  ERN_TRY(add_buffers(l, mean));
  ERN_TRY(add_rows(l, "audio_net."));
  ERN_TRY(add_rows(l, "audio_att_net."));
  for (int p = 0; p < ERN_PLANES; p++) ERN_TRY(add_grid(l, ern_encoder_grid_name(field, p), &field->encoder.grid[p]));
  if (field->config.eye) {
    ERN_TRY(add_rows(l, "eye_att_net."));
  } else {
    ERN_TRY(add(l, "", "eye_att_net.net.0.weight", ERN_F32, 2, (size_t[]){16, inputs}));
    ERN_TRY(add(l, "", "eye_att_net.net.1.weight", ERN_F32, 2, (size_t[]){1, 16}));
  }
  static const char *const nets[] = {"sigma_net.", "color_net.", "unc_net.", "aud_ch_att_net."};
  for (size_t i = 0; i < sizeof nets / sizeof *nets; i++) ERN_TRY(add_rows(l, nets[i]));
  if (field->config.torso) {
    ERN_TRY(add_rows(l, "torso_deform_net."));
    ERN_TRY(add_grid(l, "torso_encoder", &field->torso_grid));
    ERN_TRY(add_rows(l, "torso_net."));
  }
fail:
  return status;
}

/* ---- training state ---------------------------------------------------------------------------------------------- */

struct about_state {
  bool there, torso;
  int64_t step, updates;
};

static ern_status read_about(const struct ern_torch_layout *l, struct about_state *about) {
  const char *text = ern_tensor_file_metadata(l->file, "ernerf.state");
  json_t *root = NULL;
  const ern_status status =
      text == NULL ? ERN_OK
                   : ern_json_parse(l->context, l->path, "metadata \"ernerf.state\" of what is converted: ", text,
                                    strlen(text), MOST_STATE, &root);
  if (status != ERN_OK) return status;
  *about = (struct about_state){.there = root != NULL,
                                .torso = json_is_true(json_object_get(root, "torso")),
                                .step = json_integer_value(json_object_get(root, "step")),
                                .updates = json_integer_value(json_object_get(root, "ema_updates"))};
  json_decref(root);
  if (about->step >= 0 && about->step <= ERN_MODEL_MOST_STEPS && about->updates >= 0 &&
      about->updates <= ERN_MODEL_MOST_STEPS)
    return ERN_OK;
  return ern_fail(
      l->context, ERN_E_FORMAT,
      "%s: metadata \"ernerf.state\" of what is converted: step is %lld, ema_updates %lld, expected 0 to %lld", l->path,
      (long long)about->step, (long long)about->updates, (long long)ERN_MODEL_MOST_STEPS);
}

static json_t *tensor_of(const char *name) { return json_pack("{s:s}", "tensor", name); }

/* Takes ownership of `value`, which is NULL where there was no memory for it. */
static void put_item(struct ern_torch_layout *l, json_t *list, json_t *value) {
  if (json_array_append_new(list, value) != 0) l->lost = true;
}

static void put_pair(struct ern_torch_layout *l, json_t *pairs, json_t *key, json_t *value) {
  put_item(l, pairs, json_pack("[o, o]", key, value));
}

/* A block of the state file, laid out as `like`, a tensor of the model; zeros where the file lacks the row (the eye
 * branch that only the public program has). */
static ern_status add_state(struct ern_torch_layout *l, const char *prefix, const char *source,
                            const struct ern_tensor *like, bool fall_back) {
  const struct ern_parameter *row = ern_parameters_find(&l->model->table, like->name);
  char name[ERN_PARAMETER_NAME + 24];
  float *values = NULL;
  snprintf(name, sizeof name, "%s%s", source, like->name);
  if (row == NULL) {
    const ern_status added = add(l, prefix, like->name, ERN_F32, like->dims, like->shape);
    if (added == ERN_OK && fall_back) memcpy(l->owned[l->tensors - 1], like->data, like->count * sizeof(float));
    return added;
  }
  if (ern_tensor_file_find(l->file, name) == NULL)
    return add_padded(l, prefix, row, fall_back ? l->model->block + row->at : NULL);
  ern_status status = ERN_NEW(l->context, row->count, &values);
  if (status == ERN_OK) status = ern_tensor_take(l->context, l->file, l->path, name, row->dims, row->shape, values);
  if (status == ERN_OK) status = add_padded(l, prefix, row, values);
  ern_release(l->context, values);
  return status;
}

/* AdamW's state of one tensor. We keep no first moment: with beta1 = 0 the next step overwrites it. */
static ern_status add_moments(struct ern_torch_layout *l, const struct ern_tensor *like, int64_t step, json_t *state,
                              int64_t number) {
  ern_status status = ERN_OK;
  ERN_TRY(add(l, "count.", like->name, ERN_F32, 0, NULL));
  *(float *)l->owned[l->tensors - 1] = (float)step;
  const char *count = l->tensor[l->tensors - 1].name;
  ERN_TRY(add(l, "first.", like->name, ERN_F32, like->dims, like->shape));
  const char *first = l->tensor[l->tensors - 1].name;
  ERN_TRY(add_state(l, "moment.", "state.moment.", like, false));
  const char *moment = l->tensor[l->tensors - 1].name;
  json_t *one = json_pack("{s:[[s, o], [s, o], [s, o]]}", "dict", "step", tensor_of(count), "exp_avg", tensor_of(first),
                          "exp_avg_sq", tensor_of(moment));
  put_pair(l, state, json_integer(number), one);
fail:
  return status;
}

static json_t *group_of(double rate, double start, double decay, json_t *params) {
  return json_pack("{s:[[s, f], [s, f], [s, {s:[f, f]}], [s, f], [s, b], [s, n], [s, b], [s, b], [s, f], [s, o]]}",
                   "dict", "lr", rate, "weight_decay", decay, "betas", "tuple", 0.0, 0.99, "eps", 1e-8, "amsgrad", 0,
                   "foreach", "maximize", 0, "capturable", 0, "initial_lr", start, "params", params);
}

/* optimizer and lr_scheduler. The rates are the public program's defaults with its 100,000 steps; it computes its own
 * from base_lrs at its next step. */
static ern_status put_optimizer(struct ern_torch_layout *l, const struct about_state *about, size_t model_tensors,
                                json_t *root) {
  json_t *state = json_array(), *groups = json_array(), *base = json_array(), *last = json_array(),
         *lambdas = json_array();
  const double factor = pow(0.5, (double)about->step / 100000);
  int64_t number = 0;
  ern_status status = ERN_OK;
  for (size_t g = 0; ern_checkpoint_group(about->torso, g) != NULL && status == ERN_OK; g++) {
    const char *group = ern_checkpoint_group(about->torso, g);
    const bool grid = strstr(group, "encoder") != NULL, attention = strcmp(group, "audio_att_net.") == 0,
               camera = strncmp(group, "camera_", 7) == 0;
    const double rate = grid ? 1e-2 : (attention ? 5e-3 : (camera ? 1e-5 : 1e-3));
    json_t *params = json_array();
    for (size_t i = 0; i < model_tensors && status == ERN_OK; i++) {
      const struct ern_tensor like = l->tensor[i];
      if (!ern_checkpoint_in_group(like.name, group)) continue;
      if (!camera) status = add_moments(l, &like, about->step, state, number);
      put_item(l, params, json_integer(number++));
    }
    const bool empty = json_array_size(params) == 0;
    const int times = empty ? 0 : 1;
    if (empty) json_decref(params);
    for (int k = 0; k < times; k++) {
      put_item(l, groups, group_of(rate * factor, rate, grid ? 1e-2 : (attention ? 1e-4 : 0), params));
      put_item(l, base, json_real(rate));
      put_item(l, last, json_real(rate * factor));
      put_item(l, lambdas, json_null());
    }
    if (about->torso && g == 0) { /* the public program's group of an encoder that has no tensors */
      put_item(l, groups, group_of(rate * factor, rate, 0, json_array()));
      put_item(l, base, json_real(rate));
      put_item(l, last, json_real(rate * factor));
      put_item(l, lambdas, json_null());
    }
  }
  put_pair(l, root, json_string("optimizer"),
           json_pack("{s:[[s, {s:o}], [s, o]]}", "dict", "state", "dict", state, "param_groups", groups));
  put_pair(l, root, json_string("lr_scheduler"),
           json_pack("{s:[[s, o], [s, I], [s, b], [s, I], [s, b], [s, o], [s, o]]}", "dict", "base_lrs", base,
                     "last_epoch", (json_int_t)about->step, "verbose", 0, "_step_count", (json_int_t)about->step + 1,
                     "_get_lr_called_within_step", 0, "_last_lr", last, "lr_lambdas", lambdas));
  put_pair(l, root, json_string("scaler"), json_pack("{s:[]}", "dict"));
  return status;
}

static ern_status put_average(struct ern_torch_layout *l, const struct about_state *about, size_t model_tensors,
                              json_t *root) {
  json_t *shadow = json_array();
  ern_status status = ERN_OK;
  for (size_t i = 0; i < model_tensors && status == ERN_OK; i++) {
    const struct ern_tensor like = l->tensor[i];
    if (ern_checkpoint_is_buffer(like.name)) continue;
    status = add_state(l, "average.", "state.average.", &like, true);
    if (status == ERN_OK) put_item(l, shadow, tensor_of(l->tensor[l->tensors - 1].name));
  }
  put_pair(l, root, json_string("ema"),
           json_pack("{s:[[s, f], [s, I], [s, o], [s, n]]}", "dict", "decay", 0.95, "num_updates",
                     (json_int_t)about->updates, "shadow_params", shadow, "collected_params"));
  return status;
}

/* ---- all --------------------------------------------------------------------------------------------------------- */

/* Logs the view settings that differ from the public program's defaults: it ignores ours in the file, and needs them as
 * options. */
static void tell_view(const struct ern_torch_layout *l) {
  const struct ern_view_settings own = ern_view_settings_default(), *view = &l->model->view;
  char words[160] = "";
  size_t used = 0;
  const struct {
    const char *name;
    double own, found;
  } numbers[] = {{"scale", (double)own.scale, (double)view->scale},
                 {"dt_gamma", (double)own.dt_gamma, (double)view->dt_gamma},
                 {"max_steps", own.max_steps, view->max_steps},
                 {"torso_shrink", (double)own.torso_shrink, (double)view->torso_shrink}};
  for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
    if (numbers[i].own != numbers[i].found && used < sizeof words)
      used += (size_t)ern_format(words + used, sizeof words - used, " --%s %g", numbers[i].name, numbers[i].found);
  if (used > 0) ern_log(l->context, ERN_LOG_WARNING, "%s: give the public program%s", l->path, words);
}

/* Refuses what the public program does not support, and logs the options that it needs. */
static ern_status check(const struct ern_torch_layout *l) {
  const struct ern_model_config *config = &l->model->field.config;
  if (!ern_field_is_standard(&l->model->field))
    return ern_fail(l->context, ERN_E_UNSUPPORTED,
                    "%s: a head of backbone %s, attention %s, eye attention %s has no place in the public program, "
                    "whose are trihash, channel, sigmoid",
                    l->path, ern_kind_of(config, ERN_KIND_BACKBONE), ern_kind_of(config, ERN_KIND_ATTENTION),
                    ern_kind_of(config, ERN_KIND_EYE_ATTENTION));
  if (config->no_view)
    return ern_fail(l->context, ERN_E_UNSUPPORTED,
                    "%s: a head whose colour does not depend on the view has no place in the public program", l->path);
  if (config->torso_gamma)
    return ern_fail(l->context, ERN_E_UNSUPPORTED,
                    "%s: torso_gamma (the paper's scale of the key points) has no place in the public program",
                    l->path);
  if (config->bound > 1)
    return ern_fail(l->context, ERN_E_UNSUPPORTED,
                    "%s: bound is %g: the public program keeps more than one occupancy grid for it, expected 1",
                    l->path, (double)config->bound);
  if (config->levels != PUBLIC_LEVELS)
    ern_log(l->context, ERN_LOG_WARNING,
            "%s: %d levels, the public program builds %d: set num_levels to %d in its network.py to load it", l->path,
            config->levels, PUBLIC_LEVELS, config->levels);
  if (config->bound < 1)
    ern_log(l->context, ERN_LOG_WARNING, "%s: give the public program --bound %g", l->path, (double)config->bound);
  if (config->codes > PUBLIC_CODES)
    ern_log(l->context, ERN_LOG_WARNING, "%s: %d individual codes: give the public program --ind_num %d", l->path,
            config->codes, config->codes);
  if (config->codes == 0)
    ern_log(l->context, ERN_LOG_WARNING, "%s: no individual codes: give the public program --ind_dim 0", l->path);
  if (l->model->cameras > 0)
    ern_log(l->context, ERN_LOG_INFO,
            "%s: the corrections of poses that were not trained on (camera_unseen) have no place in the public "
            "program, and are left out",
            l->path);
  if (l->model->has_motion)
    ern_log(l->context, ERN_LOG_WARNING,
            "%s: the body's motion (torso_motion_unseen) has no place in the public program, which will draw the torso "
            "where the body is on average",
            l->path);
  if (ern_field_fades(&l->model->field))
    ern_log(
        l->context, ERN_LOG_WARNING,
        "%s: the height at which the voice ends (voice_fade) has no place in the public program, which will draw the "
        "head less well above the nose, and move it with the voice; `ernerf train --set voice-fade=no` makes a head "
        "without it",
        l->path);
  tell_view(l);
  if (!config->eye)
    ern_log(l->context, ERN_LOG_INFO, "%s: the missing eye branch is written as zeros; give --exp_eye", l->path);
  return ERN_OK;
}

/* Our description of the model, as it is after the padding, and of its training: the public program ignores them. */
static ern_status put_own(struct ern_torch_layout *l, json_t *root) {
  const struct ern_model_config *config = &l->model->field.config;
  const char *state = ern_tensor_file_metadata(l->file, "ernerf.state");
  ern_model padded = *l->model;
  char *text = NULL;
  padded.field.config.eye = true;
  if (config->codes > 0 && config->codes < PUBLIC_CODES) padded.field.config.codes = PUBLIC_CODES;
  const ern_status status = ern_model_metadata(&padded, &text);
  if (status != ERN_OK) return status;
  put_pair(l, root, json_string("ernerf"), json_string(text));
  ern_release(l->context, text);
  if (state != NULL) put_pair(l, root, json_string("ernerf_state"), json_string(state));
  return ERN_OK;
}

ern_status ern_torch_layout_make(struct ern_torch_layout *l) {
  struct about_state about = {0};
  const int64_t step = (int64_t)(l->model->field.config.torso ? l->model->torso_steps : l->model->head_steps);
  double mean[2] = {0};
  json_t *root = json_array(), *model = json_array();
  ern_status status = ERN_OK;
  ERN_TRY(read_about(l, &about));
  ERN_TRY(check(l));
  ERN_TRY(add_model(l, mean));
  const size_t model_tensors = l->tensors;
  for (size_t i = 0; i < model_tensors; i++)
    put_pair(l, model, json_string(l->tensor[i].name), tensor_of(l->tensor[i].name));
  put_pair(l, root, json_string("epoch"), json_integer(0));
  put_pair(l, root, json_string("global_step"), json_integer(about.there ? about.step : step));
  put_pair(l, root, json_string("stats"),
           json_pack("{s:[[s, []], [s, []], [s, []], [s, []], [s, n]]}", "dict", "loss", "valid_loss", "results",
                     "checkpoints", "best_result"));
  put_pair(l, root, json_string("mean_count"), json_integer(0));
  put_pair(l, root, json_string("mean_density"), json_real(mean[0]));
  put_pair(l, root, json_string("mean_density_torso"), json_real(mean[1]));
  if (about.there) {
    ERN_TRY(put_optimizer(l, &about, model_tensors, root));
    ERN_TRY(put_average(l, &about, model_tensors, root));
  }
  put_pair(l, root, json_string("model"), json_pack("{s:O}", "ordered", model));
  ERN_TRY(put_own(l, root));
  l->tree = json_pack("{s:O}", "dict", root);
  if (l->lost || l->tree == NULL) ERN_TRY(ern_fail(l->context, ERN_E_NO_MEMORY, "%s: no memory for the tree", l->path));
fail:
  json_decref(root);
  json_decref(model);
  return status;
}
