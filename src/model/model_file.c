/* SPDX-License-Identifier: MIT
 * Saves a model, and loads one from a file: the configuration from our metadata or from names and shapes, then every
 * tensor, with strict checks. */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "io/file.h"
#include "io/json.h"
#include "io/npy.h"
#include "model/checkpoint.h"
#include "model/kinds.h"
#include "model/model.h"
#include "model/torso.h"

static bool put_view(json_t *root, const struct ern_view_settings *view) {
  json_t *own = json_pack("{s:i, s:f, s:f, s:f, s:s}", "max_steps", view->max_steps, "dt_gamma", (double)view->dt_gamma,
                          "torso_shrink", (double)view->torso_shrink, "scale", (double)view->scale, "audio_pad",
                          ern_audio_pad_name(view->audio_pad));
  const bool put = own != NULL && json_object_update(root, own) == 0;
  json_decref(own);
  return put;
}

/* Adds the network's description as an object to the metadata, where a network made the features. */
static bool put_speech_network(json_t *root, const ern_model *model) {
  if (model->speech_network[0] == 0) return true;
  return json_object_set_new(root, "speech_network", json_loads(model->speech_network, 0, NULL)) == 0;
}

/* Adds the heights between which the voice ends, where it does. */
static bool put_fade(json_t *root, const struct ern_model_config *c) {
  if (!(c->voice_fade[1] > c->voice_fade[0])) return true;
  json_t *ends = json_pack("[f, f]", (double)c->voice_fade[0], (double)c->voice_fade[1]);
  return json_object_set_new(root, "voice_fade", ends) == 0;
}

ern_status ern_model_metadata(const ern_model *model, char **json) {
  const struct ern_model_config *c = &model->field.config;
  json_t *root = json_pack(
      "{s:s, s:s, s:s, s:i, s:i, s:i, s:b, s:b, s:b, s:b, s:i, s:f, s:I, s:I, s:s, s:s, s:s}", "backbone",
      ern_backbone_name(c->backbone), "attention", ern_attention_name(c->attention), "eye_attention",
      ern_eye_attention_name(c->eye_attention), "levels", c->levels, "feature_width", c->feature_width, "window_length",
      c->window_length, "eye", c->eye, "view", !c->no_view, "torso", c->torso, "torso_gamma", c->torso_gamma, "codes",
      c->codes, "bound", (double)c->bound, "head_steps", (json_int_t)model->head_steps, "torso_steps",
      (json_int_t)model->torso_steps, "speech", model->speech, "clip", model->clip, "consent", model->consent);
  if (root != NULL && ((model->view.is_set && !put_view(root, &model->view)) || !put_speech_network(root, model) ||
                       (model->dub && json_object_set_new(root, "dub", json_true()) != 0) || !put_fade(root, c))) {
    json_decref(root);
    root = NULL;
  }
  *json = ern_json_text(model->context, root, JSON_COMPACT);
  json_decref(root);
  if (*json != NULL) return ERN_OK;
  return ern_fail(model->context, ERN_E_NO_MEMORY, "model: the metadata could not be put together");
}

ern_status ern_model_write(const ern_model *model, const char *path, enum ern_existing existing) {
  struct ern_model_tensors *tensors = NULL;
  char *json = NULL;
  ern_status status = ERN_NEW(model->context, 1, &tensors);
  if (status != ERN_OK) return status;
  ern_model_tensors(model, tensors);
  ERN_TRY(ern_model_metadata(model, &json));
  const struct ern_metadata metadata[] = {{"format", "ernerf"}, {"ernerf", json}};
  status = ern_safetensors_write(model->context, path, tensors->tensor, tensors->count, metadata, 2, existing);
fail:
  ern_release(model->context, json);
  ern_release(model->context, tensors);
  return status;
}

ern_status ern_model_check_name(ern_context *context, const char *path) {
  static const char ending[] = ".safetensors";
  const size_t length = strlen(path), tail = sizeof ending - 1;
  if (length >= tail && strcmp(path + length - tail, ending) == 0) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT, "%s: expected a name that ends in .safetensors, as the file has that format",
                  path);
}

ern_status ern_model_save(const ern_model *model, const char *path) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, model);
  ERN_NEED(model->context, path);
  const ern_status status = ern_model_check_name(model->context, path);
  return status == ERN_OK ? ern_model_write(model, path, ERN_EXISTING_BY_CONTEXT) : status;
}

static void shape_text(char *text, size_t bytes, int dims, const size_t *shape) {
  size_t used = (size_t)snprintf(text, bytes, "[");
  for (int d = 0; d < dims && used < bytes; d++)
    used += (size_t)snprintf(text + used, bytes - used, d > 0 ? ", %zu" : "%zu", shape[d]);
  if (used < bytes) snprintf(text + used, bytes - used, "]");
}

/* The tensor of that name and shape, or an error that says what is there instead. */
static ern_status find_exact(ern_context *context, const struct ern_tensor_file *file, const char *path,
                             const char *name, int dims, const size_t *shape, const struct ern_tensor **found) {
  char expected[96], actual[96];
  shape_text(expected, sizeof expected, dims, shape);
  *found = ern_tensor_file_find(file, name);
  if (*found == NULL)
    return ern_fail(context, ERN_E_MISSING, "%s: tensor %s is missing, expected shape %s", path, name, expected);
  bool same = (*found)->dims == dims;
  for (int d = 0; same && d < dims; d++) same = (*found)->shape[d] == shape[d];
  if (same) return ERN_OK;
  shape_text(actual, sizeof actual, (*found)->dims, (*found)->shape);
  return ern_fail(context, ERN_E_SHAPE, "%s: tensor %s has shape %s, expected %s", path, name, actual, expected);
}

ern_status ern_tensor_take(ern_context *context, const struct ern_tensor_file *file, const char *path, const char *name,
                           int dims, const size_t *shape, float *out) {
  const struct ern_tensor *tensor = NULL;
  const ern_status status = find_exact(context, file, path, name, dims, shape, &tensor);
  if (status != ERN_OK) return status;
  if (ern_tensor_to_float(context, tensor, out) != ERN_OK)
    return ern_fail(context, ERN_E_MISMATCH, "%s: tensor %s: dtype is %s, expected F32, F16, BF16 or F64", path, name,
                    ern_dtype_name(tensor->dtype));
  for (size_t i = 0; i < tensor->count; i++)
    if (!isfinite(out[i]))
      return ern_fail(context, ERN_E_NONFINITE, "%s: tensor %s holds %g at %zu, expected finite values", path, name,
                      (double)out[i], i);
  return ERN_OK;
}

/* ---- configuration ----------------------------------------------------------------------------------------------- */

static ern_status wrong_field(ern_context *context, const char *path, const char *field) {
  return ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf\": field %s is missing or of another type", path,
                  field);
}

/* Files of early versions lack these fields; their models are of the paper's own kinds. */
static ern_status read_kinds(ern_context *context, const json_t *root, const char *path,
                             struct ern_model_config *config) {
  for (int k = 0; k < ERN_KINDS; k++) {
    const json_t *value = json_object_get(root, ern_kind_field((ern_kind)k));
    if (value == NULL) continue;
    if (!json_is_string(value)) return wrong_field(context, path, ern_kind_field((ern_kind)k));
    if (!ern_kind_read(json_string_value(value), (ern_kind)k, config))
      return ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf\": %s is \"%.40s\", expected %s", path,
                      ern_kind_field((ern_kind)k), json_string_value(value), ern_kind_words((ern_kind)k));
  }
  return ERN_OK;
}

/* Missing: 0. */
static ern_status read_steps(ern_context *context, const json_t *root, const char *path, const char *field,
                             uint64_t *steps) {
  const json_t *value = json_object_get(root, field);
  const json_int_t number = json_integer_value(value);
  *steps = (uint64_t)number;
  if (value == NULL || (json_is_integer(value) && number >= 0 && number <= ERN_MODEL_MOST_STEPS)) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf\": %s is no whole number from 0 to %lld", path, field,
                  (long long)ERN_MODEL_MOST_STEPS);
}

/* The view settings: all five fields, or none in a file of an early version. */
static ern_status read_view(ern_context *context, const json_t *root, const char *path,
                            struct ern_view_settings *view) {
  enum { NUMBERS = 4 };
  static const struct {
    const char *name;
    double least, most;
  } fields[NUMBERS] = {{"max_steps", 1, ERN_MAX_STEPS},
                       {"dt_gamma", 0, 1},
                       {"torso_shrink", ERN_LEAST_SHRINK, 1},
                       {"scale", ERN_LEAST_SCALE, ERN_MOST_SCALE}};
  double number[NUMBERS];
  const json_t *pad = json_object_get(root, "audio_pad");
  bool present = pad != NULL;
  for (int i = 0; i < NUMBERS; i++) present |= json_object_get(root, fields[i].name) != NULL;
  if (!present) return ERN_OK;
  for (int i = 0; i < NUMBERS; i++) {
    const json_t *value = json_object_get(root, fields[i].name);
    number[i] = json_number_value(value);
    if (i == 0 ? !json_is_integer(value) : !json_is_number(value)) return wrong_field(context, path, fields[i].name);
    if (!(number[i] >= fields[i].least && number[i] <= fields[i].most))
      return ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf\": %s is %g, expected %g to %g", path,
                      fields[i].name, number[i], fields[i].least, fields[i].most);
  }
  *view = (struct ern_view_settings){
      true, (int)number[0], (float)number[1], (float)number[2], (float)number[3], view->audio_pad};
  if (!json_is_string(pad)) return wrong_field(context, path, "audio_pad");
  if (!ern_audio_pad_read(json_string_value(pad), &view->audio_pad))
    return ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf\": audio_pad is \"%.40s\", expected edge or zero",
                    path, json_string_value(pad));
  return ERN_OK;
}

/* Files of early versions lack some of these fields. */
static ern_status read_text(ern_context *context, const json_t *root, const char *path, const char *field, char *text,
                            size_t bytes) {
  const json_t *value = json_object_get(root, field);
  if (value == NULL) return ERN_OK;
  if (!json_is_string(value) || json_string_length(value) >= bytes) return wrong_field(context, path, field);
  snprintf(text, bytes, "%s", json_string_value(value));
  return ERN_OK;
}

/* The object that describes the network of the features, as text, which is checked when it is used. */
static ern_status read_network(ern_context *context, const json_t *root, const char *path, ern_model *identity) {
  const json_t *network = json_object_get(root, "speech_network");
  char *text = identity->speech_network;
  const size_t capacity = sizeof identity->speech_network;
  if (network == NULL) return ERN_OK;
  const size_t count = json_is_object(network) ? json_dumpb(network, text, capacity - 1, JSON_COMPACT) : 0;
  if (count == 0 || count >= capacity) return wrong_field(context, path, "speech_network");
  text[count] = 0;
  return ERN_OK;
}

/* Missing: the voice reaches the whole head. */
static ern_status read_fade(ern_context *context, const json_t *root, const char *path,
                            struct ern_model_config *config) {
  const json_t *ends = json_object_get(root, "voice_fade");
  const double begin = json_number_value(json_array_get(ends, 0)), end = json_number_value(json_array_get(ends, 1));
  if (ends == NULL) return ERN_OK;
  if (json_array_size(ends) != 2 || !json_is_number(json_array_get(ends, 0)) ||
      !json_is_number(json_array_get(ends, 1)))
    return wrong_field(context, path, "voice_fade");
  if (!((float)begin < (float)end && fabs(begin) <= (double)config->bound && fabs(end) <= (double)config->bound))
    return ern_fail(context, ERN_E_FORMAT,
                    "%s: metadata \"ernerf\": voice_fade is %g, %g, expected two numbers from -%g to %g that ascend",
                    path, begin, end, (double)config->bound, (double)config->bound);
  config->voice_fade[0] = (float)begin;
  config->voice_fade[1] = (float)end;
  return ERN_OK;
}

/* A member of a later version may change the picture, as voice_fade does. */
static ern_status check_members(ern_context *context, json_t *root, const char *path) {
  static const char *const known[] = {"backbone",      "attention", "eye_attention", "levels",     "feature_width",
                                      "window_length", "eye",       "view",          "torso",      "torso_gamma",
                                      "codes",         "bound",     "clip",          "head_steps", "torso_steps",
                                      "speech",        "consent",   "dub",           "voice_fade", "speech_network",
                                      "max_steps",     "dt_gamma",  "torso_shrink",  "scale",      "audio_pad"};
  const char *name = ern_json_unknown_member(root, known, sizeof known / sizeof *known);
  if (name == NULL) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf\": this version knows no %.40s", path, name);
}

static ern_status read_metadata(ern_context *context, const char *text, const char *path,
                                struct ern_model_config *config, ern_model *identity) {
  json_error_t error;
  json_t *root = json_loads(text, JSON_REJECT_DUPLICATES, &error);
  if (!json_is_object(root)) {
    json_decref(root);
    return ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf\" is no JSON object: %s", path, error.text);
  }
  const struct {
    const char *name;
    int *to;
  } integers[] = {{"levels", &config->levels},
                  {"feature_width", &config->feature_width},
                  {"window_length", &config->window_length},
                  {"codes", &config->codes}};
  const struct {
    const char *name;
    bool *to;
  } flags[] = {{"eye", &config->eye}, {"torso", &config->torso}, {"torso_gamma", &config->torso_gamma}};
  ern_status status = ERN_OK;
  ERN_TRY(check_members(context, root, path));
  ERN_TRY(read_kinds(context, root, path, config));
  for (size_t i = 0; i < sizeof integers / sizeof *integers; i++) {
    const json_t *value = json_object_get(root, integers[i].name);
    const json_int_t number = json_integer_value(value);
    if (!json_is_integer(value) || number < 0 || number > 1000000)
      ERN_TRY(wrong_field(context, path, integers[i].name));
    *integers[i].to = (int)number;
  }
  for (size_t i = 0; i < sizeof flags / sizeof *flags; i++) {
    const json_t *value = json_object_get(root, flags[i].name);
    if (!json_is_boolean(value)) ERN_TRY(wrong_field(context, path, flags[i].name));
    *flags[i].to = json_is_true(value);
  }
  const json_t *view = json_object_get(root, "view"); /* missing in files of early versions: true */
  if (view != NULL && !json_is_boolean(view)) ERN_TRY(wrong_field(context, path, "view"));
  config->no_view = view != NULL && !json_is_true(view);
  const json_t *bound = json_object_get(root, "bound");
  const json_t *dub = json_object_get(root, "dub"); /* missing: false */
  if (dub != NULL && !json_is_boolean(dub)) ERN_TRY(wrong_field(context, path, "dub"));
  identity->dub = json_is_true(dub);
  if (!json_is_number(bound)) ERN_TRY(wrong_field(context, path, "bound"));
  config->bound = (float)json_number_value(bound);
  ERN_TRY(read_fade(context, root, path, config));
  ERN_TRY(read_text(context, root, path, "clip", identity->clip, sizeof identity->clip));
  ERN_TRY(read_text(context, root, path, "speech", identity->speech, sizeof identity->speech));
  ERN_TRY(read_text(context, root, path, "consent", identity->consent, sizeof identity->consent));
  ERN_TRY(read_network(context, root, path, identity));
  ERN_TRY(read_steps(context, root, path, "head_steps", &identity->head_steps));
  ERN_TRY(read_steps(context, root, path, "torso_steps", &identity->torso_steps));
  ERN_TRY(read_view(context, root, path, &identity->view));
fail:
  json_decref(root);
  return status;
}

/* Side `axis` of a tensor, 0 where it is not there. */
static size_t side(const struct ern_tensor_file *file, const char *name, int axis) {
  const struct ern_tensor *tensor = ern_tensor_file_find(file, name);
  return tensor != NULL && axis < tensor->dims ? tensor->shape[axis] : 0;
}

static ern_status config_from_shapes(ern_context *context, const struct ern_tensor_file *file, const char *path,
                                     struct ern_model_config *config) {
  const size_t offsets = side(file, "encoder_xy.offsets", 0), width = side(file, "audio_net.encoder_conv.0.weight", 1),
               codes = side(file, "individual_codes", 0), density = side(file, "sigma_net.net.0.weight", 1);
  if (offsets < 3 || offsets > ERN_GRID_MAX_LEVELS + 1)
    return ern_fail(context, ERN_E_FORMAT, "%s: encoder_xy.offsets has %zu values, expected 3 to %d: is this a model?",
                    path, offsets, ERN_GRID_MAX_LEVELS + 1);
  if (width < 1 || width > 4096)
    return ern_fail(context, ERN_E_SHAPE, "%s: audio_net.encoder_conv.0.weight takes %zu channels, expected 1 to 4096",
                    path, width);
  if (codes > 1000000) return ern_fail(context, ERN_E_SHAPE, "%s: individual_codes has %zu rows", path, codes);
  config->levels = (int)offsets - 1;
  config->feature_width = (int)width;
  config->window_length = 0;
  config->codes = (int)codes;
  config->eye = density == 3 * (offsets - 1) + ERN_AUDIO_CODE + 1;
  config->torso = ern_tensor_file_find(file, "torso_net.net.0.weight") != NULL;
  config->torso_gamma = ern_tensor_file_find(file, "torso_gamma") != NULL;
  config->bound = 1;
  if (ern_tensor_file_find(file, "aabb_train") != NULL) {
    float box[6];
    const ern_status status = ern_tensor_take(context, file, path, "aabb_train", 1, (size_t[]){6}, box);
    if (status != ERN_OK) return status;
    config->bound = box[3];
  }
  return ERN_OK;
}

/* ---- tensors ----------------------------------------------------------------------------------------------------- */

static bool is_offsets(const struct ern_field *field, const char *name) {
  char offsets[32];
  for (int g = 0; g < field->encoder.grids; g++) {
    snprintf(offsets, sizeof offsets, "%s.offsets", ern_encoder_grid_name(field, g));
    if (strcmp(name, offsets) == 0) return true;
  }
  return strcmp(name, "torso_encoder.offsets") == 0;
}

/* Names that a file may hold beside the parameters. The public program keeps an eye branch that it does not use. */
static bool is_extra(const ern_model *model, const char *name) {
  static const char *const known[] = {"aabb_train",         "aabb_infer",         "density_grid", "density_bitfield",
                                      "density_grid_torso", "step_counter",       "camera_dR",    "camera_dT",
                                      "camera_unseen",      "torso_motion_unseen"};
  const struct ern_field *field = &model->field;
  if (!field->config.eye && strncmp(name, "eye_att_net.", 12) == 0) return true;
  for (size_t i = 0; i < sizeof known / sizeof *known; i++)
    if (strcmp(name, known[i]) == 0) return true;
  return is_offsets(field, name) || strncmp(name, "state.", 6) == 0;
}

/* A file without the bits has the grid: occupied where grid > min(mean, 10), marked cells counting as 0 in the mean. */
static ern_status bits_from_grid(ern_model *model, const struct ern_tensor_file *file, const char *path) {
  float *grid = NULL;
  ern_status status = ERN_NEW(model->context, ERN_OCCUPANCY_CELLS, &grid);
  if (status != ERN_OK) return status;
  double sum = 0;
  ERN_TRY(ern_tensor_take(model->context, file, path, "density_grid", 2, (size_t[]){1, ERN_OCCUPANCY_CELLS}, grid));
  for (size_t i = 0; i < ERN_OCCUPANCY_CELLS; i++) sum += grid[i] > 0 ? (double)grid[i] : 0;
  const double mean = sum / ERN_OCCUPANCY_CELLS, threshold = mean < 10 ? mean : 10;
  for (size_t i = 0; i < ERN_OCCUPANCY_CELLS; i++)
    if ((double)grid[i] > threshold) model->bits[i / 8] |= (uint8_t)(1u << (i % 8));
fail:
  ern_release(model->context, grid);
  return status;
}

static ern_status take_occupancy(ern_model *model, const struct ern_tensor_file *file, const char *path) {
  const struct ern_tensor *bits = ern_tensor_file_find(file, "density_bitfield");
  ern_status status = ERN_OK;
  if (bits == NULL && ern_tensor_file_find(file, "density_grid") != NULL) {
    ERN_TRY(bits_from_grid(model, file, path));
  } else {
    ERN_TRY(find_exact(model->context, file, path, "density_bitfield", 1, (size_t[]){ERN_OCCUPANCY_BYTES}, &bits));
    if (bits->dtype != ERN_U8)
      ERN_TRY(ern_fail(model->context, ERN_E_MISMATCH, "%s: tensor density_bitfield is %s, expected U8", path,
                       ern_dtype_name(bits->dtype)));
    memcpy(model->bits, bits->data, ERN_OCCUPANCY_BYTES);
  }
  if (model->field.config.torso)
    status = ern_tensor_take(model->context, file, path, "density_grid_torso", 1, (size_t[]){ERN_TORSO_CELLS},
                             model->torso_grid);
fail:
  return status;
}

static double value_of(const struct ern_tensor *tensor, size_t i) {
  int32_t whole;
  float real;
  memcpy(&whole, (const char *)tensor->data + i * sizeof whole, sizeof whole);
  memcpy(&real, &whole, sizeof real);
  return tensor->dtype == ERN_I32 ? (double)whole : (double)real;
}

/* Box and offsets follow from the configuration: a file with other values is of another model, even if the shapes
 * match. */
static ern_status check_derived(const ern_model *model, const struct ern_tensor_file *file, const char *path) {
  struct ern_model_tensors ours;
  const struct ern_tensor *theirs = NULL;
  ern_status status = ERN_OK;
  ern_model_tensors(model, &ours);
  for (const struct ern_tensor *own = ours.tensor; own < ours.tensor + ours.count; own++) {
    if (own->dtype != ERN_I32 && strncmp(own->name, "aabb_", 5) != 0) continue;
    if (ern_tensor_file_find(file, own->name) == NULL) continue;
    ERN_TRY(find_exact(model->context, file, path, own->name, own->dims, own->shape, &theirs));
    if (theirs->dtype != own->dtype)
      ERN_TRY(ern_fail(model->context, ERN_E_MISMATCH, "%s: tensor %s is %s, expected %s", path, own->name,
                       ern_dtype_name(theirs->dtype), ern_dtype_name(own->dtype)));
    for (size_t i = 0; i < own->count; i++)
      if (!(value_of(theirs, i) == value_of(own, i)))
        ERN_TRY(ern_fail(model->context, ERN_E_MISMATCH, "%s: tensor %s: value %zu is %.9g, expected %.9g", path,
                         own->name, i, value_of(theirs, i), value_of(own, i)));
  }
fail:
  return status;
}

/* The camera refinement of the training frames, where one was trained. */
static ern_status take_camera(ern_model *model, const struct ern_tensor_file *file, const char *path) {
  const size_t rows = side(file, "camera_dR", 0), shape[2] = {rows, 3};
  const bool there = ern_tensor_file_find(file, "camera_dR") != NULL || ern_tensor_file_find(file, "camera_dT") != NULL;
  ern_status status = ERN_OK;
  if (!there) return ERN_OK;
  if (rows > 1000000) return ern_fail(model->context, ERN_E_SHAPE, "%s: camera_dR has %zu rows", path, rows);
  ERN_TRY(ERN_NEW(model->context, 6 * rows, &model->camera));
  model->cameras = rows;
  ERN_TRY(ern_tensor_take(model->context, file, path, "camera_dR", 2, shape, model->camera));
  ERN_TRY(ern_tensor_take(model->context, file, path, "camera_dT", 2, shape, model->camera + 3 * rows));
  if (ern_tensor_file_find(file, "camera_unseen") != NULL)
    ERN_TRY(ern_tensor_take(model->context, file, path, "camera_unseen", 2,
                            (size_t[]){ERN_POSE_REGRESSION_ROWS, ERN_POSE_CORRECTION}, model->unseen[0]));
fail:
  return status;
}

/* The regression of the body's motion, where the torso was trained with it. */
static ern_status take_motion(ern_model *model, const struct ern_tensor_file *file, const char *path) {
  model->has_motion = model->field.config.torso && ern_tensor_file_find(file, "torso_motion_unseen") != NULL;
  if (!model->has_motion) return ERN_OK;
  if (side(file, "torso_motion_unseen", 1) == 6) {
    float affine[ERN_POSE_REGRESSION_ROWS][6];
    const ern_status status = ern_tensor_take(model->context, file, path, "torso_motion_unseen", 2,
                                              (size_t[]){ERN_POSE_REGRESSION_ROWS, 6}, affine[0]);
    if (status != ERN_OK) return status;
    for (int k = 0; k <= ERN_POSE_NUMBERS; k++) ern_torso_motion_of_affine(model->motion[k], affine[k]);
    for (int k = ERN_POSE_NUMBERS + 1; k < ERN_POSE_REGRESSION_ROWS; k++)
      memcpy(model->motion[k], affine[k], sizeof affine[k]);
    return ERN_OK;
  }
  return ern_tensor_take(model->context, file, path, "torso_motion_unseen", 2,
                         (size_t[]){ERN_POSE_REGRESSION_ROWS, ERN_MOTION_VALUES}, model->motion[0]);
}

/* Whether the file has every tensor of the configuration: checked before memory is allocated for the sizes that its
 * metadata claims. */
static ern_status check_tensors(ern_context *context, const struct ern_tensor_file *file, const char *path,
                                const struct ern_model_config *config) {
  const struct ern_tensor *tensor = NULL;
  ern_model *planned = NULL;
  ern_status status = ERN_NEW(context, 1, &planned);
  if (status != ERN_OK) return status;
  status = ern_parameters_build(context, config, &planned->field, &planned->table);
  if (status == ERN_OK && ern_tensor_file_metadata(file, "torch") != NULL && !ern_field_is_standard(&planned->field))
    status = ern_fail(context, ERN_E_UNSUPPORTED,
                      "%s: describes a head of backbone %s, attention %s, eye attention %s; a PyTorch file holds "
                      "trihash, channel, sigmoid alone",
                      path, ern_kind_of(config, ERN_KIND_BACKBONE), ern_kind_of(config, ERN_KIND_ATTENTION),
                      ern_kind_of(config, ERN_KIND_EYE_ATTENTION));
  for (int r = 0; r < planned->table.rows && status == ERN_OK; r++) {
    const struct ern_parameter *row = &planned->table.row[r];
    status = find_exact(context, file, path, row->name, row->dims, row->shape, &tensor);
  }
  ern_release(context, planned);
  return status;
}

static ern_status read_config(ern_context *context, const struct ern_tensor_file *file, const char *path,
                              struct ern_model_config *config, ern_model *identity) {
  const char *text = ern_tensor_file_metadata(file, "ernerf"), *steps = ern_tensor_file_metadata(file, "global_step");
  if (text != NULL) {
    const ern_status read = read_metadata(context, text, path, config, identity);
    if (ern_tensor_file_metadata(file, "torch") != NULL) config->window_length = 0; /* a .pth does not say it */
    return read;
  }
  const ern_status status = config_from_shapes(context, file, path, config);
  if (status != ERN_OK || steps == NULL) return status;
  const unsigned long long number = strtoull(steps, NULL, 10);
  if (number > (unsigned long long)ERN_MODEL_MOST_STEPS)
    return ern_fail(context, ERN_E_FORMAT, "%s: global_step is %.30s, expected at most %lld", path, steps,
                    (long long)ERN_MODEL_MOST_STEPS);
  *(config->torso ? &identity->torso_steps : &identity->head_steps) = number;
  return ERN_OK;
}

ern_status ern_model_from_file(ern_model **model, ern_context *context, const struct ern_tensor_file *file,
                               const char *path) {
  struct ern_model_config config = {.head = true};
  ern_model identity = {.view = ern_view_settings_default()}, *made = NULL;
  ern_status status = ERN_OK;
  *model = NULL;
  ERN_TRY(read_config(context, file, path, &config, &identity));
  status = check_tensors(context, file, path, &config);
  if (status == ERN_OK) status = ern_model_make(&made, context, &config);
  if (status == ERN_E_ARGUMENT) { /* an invalid configuration, which is an error of the file */
    char why[256];
    (void)ern_last_error_copy(context, why, sizeof why);
    ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf\": %s", path, why);
    status = ERN_E_FORMAT;
  }
  if (status != ERN_OK) goto fail;
  made->head_steps = identity.head_steps;
  made->torso_steps = identity.torso_steps;
  made->view = identity.view;
  memcpy(made->clip, identity.clip, sizeof made->clip);
  memcpy(made->speech, identity.speech, sizeof made->speech);
  memcpy(made->speech_network, identity.speech_network, sizeof made->speech_network);
  memcpy(made->consent, identity.consent, sizeof made->consent);
  made->dub = identity.dub;
  for (int r = 0; r < made->table.rows; r++) {
    const struct ern_parameter *row = &made->table.row[r];
    ERN_TRY(ern_tensor_take(context, file, path, row->name, row->dims, row->shape, made->block + row->at));
  }
  for (size_t t = 0; t < file->tensor_count; t++) {
    const char *name = file->tensors[t].name;
    if (ern_parameters_find(&made->table, name) == NULL && !is_extra(made, name))
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: tensor %s belongs to no model that this version knows", path, name));
  }
  ERN_TRY(check_derived(made, file, path));
  ERN_TRY(take_occupancy(made, file, path));
  ERN_TRY(take_camera(made, file, path));
  ERN_TRY(take_motion(made, file, path));
  *model = made;
  return ERN_OK;
fail:
  ern_model_free(&made);
  return status;
}

ern_status ern_model_load(ern_model **model, ern_context *context, const char *path) {
  ERN_PLAIN_FLOATS;
  if (model != NULL) *model = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, model);
  ERN_NEED(context, path);
  struct ern_tensor_file file = {0};
  ern_status status = ern_checkpoint_read(context, path, &file);
  if (status == ERN_OK) status = ern_model_from_file(model, context, &file, path);
  ern_tensor_file_free(context, &file);
  return status;
}

/* ---- listing ----------------------------------------------------------------------------------------------------- */

static ern_status npy_tensor(ern_context *context, const char *path, void (*say)(void *, const ern_tensor_info *),
                             void *user) {
  static const char *const type[] = {"F16", "F32", "F64", "U8", "I32", "I64"};
  struct ern_npy array = {0};
  const ern_status status = ern_npy_read(context, path, &array);
  if (status != ERN_OK) return status;
  ern_tensor_info info = {.name = "", .dtype = type[array.type], .dims = array.dims};
  for (int d = 0; d < array.dims; d++) info.shape[d] = array.shape[d];
  say(user, &info);
  ern_npy_free(context, &array);
  return ERN_OK;
}

ern_status ern_file_tensors(ern_context *context, const char *path,
                            void (*say)(void *user, const ern_tensor_info *tensor), void *user) {
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, say);
  const char *dot = strrchr(path, '.');
  if (dot != NULL && strcmp(dot, ".npy") == 0) return npy_tensor(context, path, say, user);
  struct ern_tensor_file file = {0};
  const ern_status status = ern_checkpoint_read(context, path, &file);
  for (size_t t = 0; status == ERN_OK && t < file.tensor_count; t++) {
    const struct ern_tensor *tensor = &file.tensors[t];
    ern_tensor_info info = {.name = tensor->name, .dtype = ern_dtype_name(tensor->dtype), .dims = tensor->dims};
    for (int d = 0; d < tensor->dims; d++) info.shape[d] = tensor->shape[d];
    say(user, &info);
  }
  ern_tensor_file_free(context, &file);
  return status;
}
