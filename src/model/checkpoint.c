/* SPDX-License-Identifier: MIT */
#include "model/checkpoint.h"

#include <inttypes.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/memory.h"
#include "io/file.h"

static const size_t file_limit = (size_t)1 << 30; /* as of a safetensors file */

const char *ern_checkpoint_group(bool torso, size_t number) {
  static const char *const head[] = {"audio_net.",  "encoder_xy.", "encoder_yz.",     "encoder_xz.",
                                     "sigma_net.",  "color_net.",  "audio_att_net.",  "individual_codes",
                                     "camera_dT",   "camera_dR",   "aud_ch_att_net.", "unc_net.",
                                     "eye_att_net."};
  static const char *const body[] = {"torso_encoder.", "torso_net.", "torso_deform_net.", "anchor_points",
                                     "individual_codes_torso"};
  if (torso) return number < sizeof body / sizeof *body ? body[number] : NULL;
  return number < sizeof head / sizeof *head ? head[number] : NULL;
}

bool ern_checkpoint_in_group(const char *name, const char *group) {
  const size_t length = strlen(group);
  if (ern_checkpoint_is_buffer(name)) return false;
  return group[length - 1] == '.' ? strncmp(name, group, length) == 0 : strcmp(name, group) == 0;
}

bool ern_checkpoint_is_buffer(const char *name) {
  static const char *const buffers[] = {"aabb_train",       "aabb_infer",         "density_grid",
                                        "density_bitfield", "density_grid_torso", "step_counter"};
  for (size_t i = 0; i < sizeof buffers / sizeof *buffers; i++)
    if (strcmp(name, buffers[i]) == 0) return true;
  const char *dot = strrchr(name, '.');
  return dot != NULL && strcmp(dot, ".offsets") == 0;
}

/* ---- whose a tensor is ------------------------------------------------------------------------------------------- */

/* Limits far above any model: tensors, optimizer parameters and groups, and entries kept for one. A larger dict is not
 * a model's, and looking up each of its keys would take quadratic time. */
enum { MOST_TENSORS = 4096, MOST_KEYS = 64, MOST_NAME = 255 };

/* Trained tensors of a model dict in some order. */
struct trained {
  const struct ern_pickle_value **value;
  size_t count;
};

struct reading {
  ern_context *context;
  const char *path;
  struct ern_torch *torch;
  struct ern_pickle_value *model; /* NULL: the file has none */
  bool trains, torso;             /* trains: an optimizer's state was recognised */
};

static const char *key_of(const struct ern_pickle_value *dict, size_t pair) {
  const struct ern_pickle_value *key = dict->as.list.item[2 * pair];
  return key->kind == ERN_PICKLE_TEXT ? key->as.words.text : NULL;
}

/* The model dict, or a dict of nothing but tensors. */
static struct ern_pickle_value *find_model(struct ern_pickle_value *root) {
  struct ern_pickle_value *model = ern_pickle_get(root, "model");
  if (ern_pickle_is_dict(model)) return model;
  if (!ern_pickle_is_dict(root) || root->as.list.count == 0) return NULL;
  for (size_t i = 0; i < root->as.list.count / 2; i++)
    if (key_of(root, i) == NULL || root->as.list.item[2 * i + 1]->kind != ERN_PICKLE_TENSOR) return NULL;
  return root;
}

static ern_status name_model(const struct reading *r) {
  ern_status status = ERN_OK;
  for (size_t i = 0; i < r->model->as.list.count / 2 && status == ERN_OK; i++) {
    struct ern_pickle_value *value = r->model->as.list.item[2 * i + 1];
    const char *key = key_of(r->model, i);
    if (key == NULL || value->kind != ERN_PICKLE_TENSOR)
      return ern_fail(r->context, ERN_E_FORMAT, "%s: entry %zu (%s) of the model is no tensor with a name", r->path, i,
                      key != NULL ? key : "?");
    if (strnlen(key, MOST_NAME + 1) > MOST_NAME)
      return ern_fail(r->context, ERN_E_FORMAT, "%s: entry %zu (%.40s...) of the model has a name of over %d bytes",
                      r->path, i, key, MOST_NAME);
    status = ern_torch_name(r->context, r->torch, value, key, "");
  }
  return status;
}

/* Tensors of the model dict that belong to the group (NULL: all that are trained), added to the list. */
static void add_group(const struct reading *r, const char *group, struct trained *list) {
  for (size_t i = 0; i < r->model->as.list.count / 2; i++) {
    const char *name = key_of(r->model, i);
    if (group != NULL ? ern_checkpoint_in_group(name, group) : !ern_checkpoint_is_buffer(name))
      list->value[list->count++] = r->model->as.list.item[2 * i + 1];
  }
}

static bool same_shape(const struct ern_pickle_value *a, const struct ern_pickle_value *b) {
  bool same = a != NULL && a->kind == ERN_PICKLE_TENSOR && a->as.tensor.dims == b->as.tensor.dims;
  for (int d = 0; same && d < b->as.tensor.dims; d++) same = a->as.tensor.shape[d] == b->as.tensor.shape[d];
  return same;
}

static struct ern_pickle_value *get_number(const struct ern_pickle_value *dict, int64_t number) {
  for (size_t i = 0; ern_pickle_is_dict(dict) && i < dict->as.list.count / 2; i++) {
    const struct ern_pickle_value *key = dict->as.list.item[2 * i];
    if (key->kind == ERN_PICKLE_INT && key->as.integer == number) return dict->as.list.item[2 * i + 1];
  }
  return NULL;
}

/* ern_pickle_get of a dict with few keys; NULL where it has many. */
static struct ern_pickle_value *get_of_few(const struct ern_pickle_value *dict, const char *key) {
  return ern_pickle_is_dict(dict) && dict->as.list.count <= 2 * MOST_KEYS ? ern_pickle_get(dict, key) : NULL;
}

/* ---- optimizer --------------------------------------------------------------------------------------------------- */

/* Numbers of the parameters of all groups in order; false where they are not a valid list or more than `most`. */
static bool list_numbers(const struct ern_pickle_value *groups, int64_t *number, size_t most, size_t *count) {
  *count = 0;
  if (groups == NULL || groups->kind != ERN_PICKLE_LIST || groups->as.list.count > MOST_TENSORS) return false;
  for (size_t g = 0; g < groups->as.list.count; g++) {
    const struct ern_pickle_value *params = get_of_few(groups->as.list.item[g], "params");
    if (params == NULL || params->kind != ERN_PICKLE_LIST) return false;
    for (size_t i = 0; i < params->as.list.count; i++) {
      if (*count >= most || params->as.list.item[i]->kind != ERN_PICKLE_INT) return false;
      number[(*count)++] = params->as.list.item[i]->as.integer;
    }
  }
  return true;
}

/* The order of a head's or a torso's groups fits when count and shapes do. */
static bool order_fits(const struct reading *r, bool torso, const struct ern_pickle_value *state, const int64_t *number,
                       size_t count, struct trained *list) {
  list->count = 0;
  for (size_t g = 0; ern_checkpoint_group(torso, g) != NULL; g++) add_group(r, ern_checkpoint_group(torso, g), list);
  if (list->count != count || count == 0) return false;
  for (size_t i = 0; i < count; i++) {
    const struct ern_pickle_value *one = get_number(state, number[i]);
    if (one != NULL && !same_shape(get_of_few(one, "exp_avg_sq"), list->value[i])) return false;
  }
  return true;
}

static ern_status name_optimizer(struct reading *r, struct trained *list, int64_t *number, size_t capacity) {
  static const struct {
    const char *key, *prefix;
  } parts[] = {{"exp_avg_sq", "state.moment."}, {"exp_avg", "state.first."}, {"step", "state.count."}};
  const struct ern_pickle_value *optimizer = ern_pickle_get(r->torch->pickle.root, "optimizer"),
                                *state = ern_pickle_get(optimizer, "state");
  size_t count = 0;
  if (optimizer == NULL) return ERN_OK;
  r->trains = ern_pickle_is_dict(state) && state->as.list.count <= 2 * (size_t)MOST_TENSORS &&
              list_numbers(ern_pickle_get(optimizer, "param_groups"), number, capacity, &count);
  if (r->trains) r->trains = order_fits(r, false, state, number, count, list);
  if (!r->trains && count > 0) r->trains = r->torso = order_fits(r, true, state, number, count, list);
  if (!r->trains) {
    ern_log(r->context, ERN_LOG_WARNING,
            "%s: the optimizer's groups are in no order that is known, so its state is not used", r->path);
    return ERN_OK;
  }
  for (size_t i = 0; i < count; i++) {
    const struct ern_pickle_value *one = get_number(state, number[i]);
    for (size_t p = 0; p < sizeof parts / sizeof *parts; p++) {
      struct ern_pickle_value *tensor = get_of_few(one, parts[p].key);
      if (tensor == NULL || tensor->kind != ERN_PICKLE_TENSOR) continue;
      const ern_status status =
          ern_torch_name(r->context, r->torch, tensor, parts[p].prefix, list->value[i]->as.tensor.name);
      if (status != ERN_OK) return status;
    }
  }
  return ERN_OK;
}

/* ---- average ----------------------------------------------------------------------------------------------------- */

static ern_status name_average(const struct reading *r, struct trained *list, const char *key, const char *prefix) {
  const struct ern_pickle_value *shadow = ern_pickle_get(ern_pickle_get(r->torch->pickle.root, "ema"), key);
  if (shadow == NULL || shadow->kind != ERN_PICKLE_LIST) return ERN_OK;
  list->count = 0;
  add_group(r, NULL, list);
  bool fits = list->count == shadow->as.list.count;
  for (size_t i = 0; fits && i < list->count; i++) fits = same_shape(shadow->as.list.item[i], list->value[i]);
  if (!fits) {
    ern_log(r->context, ERN_LOG_WARNING, "%s: ema.%s has %zu tensors that are not the model's %zu, so it is not used",
            r->path, key, shadow->as.list.count, list->count);
    return ERN_OK;
  }
  for (size_t i = 0; i < list->count; i++) {
    const ern_status status =
        ern_torch_name(r->context, r->torch, shadow->as.list.item[i], prefix, list->value[i]->as.tensor.name);
    if (status != ERN_OK) return status;
  }
  return ERN_OK;
}

/* ---- the file ---------------------------------------------------------------------------------------------------- */

static int64_t count_of(const struct ern_pickle_value *dict, const char *key) {
  const struct ern_pickle_value *value = ern_pickle_get(dict, key);
  return value != NULL && value->kind == ERN_PICKLE_INT && value->as.integer > 0 ? value->as.integer : 0;
}

/* Copies metadata into one block: the list, and the texts that it points to. */
static ern_status put_metadata(ern_context *context, const struct ern_metadata *from, size_t count,
                               struct ern_tensor_file *file) {
  size_t bytes = count * sizeof *from;
  for (size_t i = 0; i < count; i++) bytes += strlen(from[i].value) + 1;
  file->metadata = ern_allocate(context, bytes, 1);
  if (file->metadata == NULL) return ERN_E_NO_MEMORY;
  char *at = (char *)(file->metadata + count);
  for (size_t i = 0; i < count; i++) {
    const size_t length = strlen(from[i].value) + 1;
    memcpy(at, from[i].value, length);
    file->metadata[file->metadata_count++] = (struct ern_metadata){from[i].key, at};
    at += length;
  }
  return ERN_OK;
}

static const char *text_of(const struct ern_pickle_value *dict, const char *key) {
  const struct ern_pickle_value *value = ern_pickle_get(dict, key);
  return value != NULL && value->kind == ERN_PICKLE_TEXT ? value->as.words.text : NULL;
}

static ern_status name_all(struct reading *r) {
  int64_t *numbers = NULL;
  struct trained list = {0};
  ern_status status = ERN_OK;
  if (r->model == NULL) return ERN_OK;
  const size_t most = r->model->as.list.count / 2;
  ERN_TRY(name_model(r));
  if (most > MOST_TENSORS) {
    ern_log(r->context, ERN_LOG_WARNING,
            "%s: has %zu tensors, which are no model's: no state of a training is looked for", r->path, most);
    return ERN_OK;
  }
  ERN_TRY(ERN_NEW(r->context, most, &numbers));
  ERN_TRY(ERN_NEW(r->context, 2 * most + 1, &list.value));
  ERN_TRY(name_optimizer(r, &list, numbers, most));
  ERN_TRY(name_average(r, &list, "shadow_params", "state.average."));
  ERN_TRY(name_average(r, &list, "collected_params", "state.collected."));
fail:
  ern_release(r->context, numbers);
  ern_release(r->context, list.value);
  return status;
}

static ern_status read_torch(ern_context *context, const char *path, uint8_t *bytes, size_t count,
                             struct ern_tensor_file *file) {
  struct ern_torch torch = {0};
  char *tree = NULL, about[256], steps[32];
  ern_status status = ern_torch_open(context, path, bytes, count, &torch);
  if (status != ERN_OK) return status;
  struct ern_pickle_value *root = torch.pickle.root; /* valid as long as the file */
  struct reading r = {.context = context, .path = path, .torch = &torch, .model = find_model(root)};
  ERN_TRY(name_all(&r));
  const int64_t step = count_of(root, "global_step"), updates = count_of(ern_pickle_get(root, "ema"), "num_updates");
  ERN_TRY(ern_torch_tensors(context, &torch, r.model != NULL && r.model != root ? "state.file." : "", file, &tree));
  snprintf(steps, sizeof steps, "%" PRId64, step);
  snprintf(about, sizeof about, "{\"torso\":%s,\"step\":%" PRId64 ",\"ema_updates\":%" PRId64 ",\"seconds\":0.0}",
           r.torso ? "true" : "false", step, updates);
  struct ern_metadata list[4] = {{"torch", tree}, {"global_step", steps}};
  size_t entries = 2;
  if (text_of(root, "ernerf") != NULL) list[entries++] = (struct ern_metadata){"ernerf", text_of(root, "ernerf")};
  const char *state = text_of(root, "ernerf_state");
  if (r.trains) list[entries++] = (struct ern_metadata){"ernerf.state", state != NULL ? state : about};
  ERN_TRY(put_metadata(context, list, entries, file));
fail:
  if (status != ERN_OK) ern_tensor_file_free(context, file);
  ern_torch_close(context, &torch);
  ern_release(context, tree);
  return status;
}

static ern_status read_whole(const struct ern_file_reader *reader, bool zip, struct ern_tensor_file *file) {
  uint8_t *bytes = NULL;
  ern_status status = ERN_OK;
  if (zip) ERN_TRY(ern_torch_check_end(reader));
  ERN_TRY(ERN_NEW(reader->context, reader->size, &bytes));
  ERN_TRY(ern_file_reader_take(reader, 0, bytes, reader->size));
  return read_torch(reader->context, reader->path, bytes, reader->size, file);
fail:
  ern_release(reader->context, bytes);
  return status;
}

ern_status ern_checkpoint_read(ern_context *context, const char *path, struct ern_tensor_file *file) {
  enum { START = 512 };
  struct ern_file_reader reader;
  uint8_t start[START] = {0};
  *file = (struct ern_tensor_file){0};
  ern_status status = ern_file_reader_open(context, path, file_limit, &reader);
  if (status != ERN_OK) return status;
  const size_t there = reader.size < START ? reader.size : START;
  ERN_TRY(ern_file_reader_take(&reader, 0, start, there));
  const bool zip = ern_torch_is_zip(start, there);
  status =
      ern_torch_is_torch(start, there) ? read_whole(&reader, zip, file) : ern_safetensors_read(context, path, file);
fail:
  ern_file_reader_close(&reader);
  return status;
}
