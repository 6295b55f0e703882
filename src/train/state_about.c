/* SPDX-License-Identifier: MIT */
#include "train/state_about.h"

#include <errno.h>
#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/format.h"
#include "core/memory.h"
#include "io/number.h"
#include "train/patches_ops.h"

static const char *const ray_samplings[] = {"uniform", "regions", "dub"};

const char *ern_ray_sampling_name(ern_ray_sampling sampling) {
  const int index = (int)sampling;
  return index >= 0 && index < (int)(sizeof ray_samplings / sizeof *ray_samplings) ? ray_samplings[index] : NULL;
}

/* Jansson's integers have 63 bits: a larger seed is written as a string of its digits. */
static json_t *seed_json(uint64_t seed) {
  char digits[24];
  if (seed <= INT64_MAX) return json_integer((json_int_t)seed);
  snprintf(digits, sizeof digits, "%" PRIu64, seed);
  return json_string(digits);
}

/* Earlier files have a negative number with the same bits for such a seed. */
static bool seed_read(const json_t *value, uint64_t *seed) {
  char *end = NULL;
  *seed = (uint64_t)json_integer_value(value);
  if (json_is_integer(value)) return true;
  const char *digits = json_string_value(value);
  if (digits == NULL || digits[0] < '0' || digits[0] > '9') return false;
  errno = 0;
  *seed = strtoull(digits, &end, 10);
  return errno == 0 && *end == 0;
}

const char *ern_precision_word(bool bf16) { return bf16 ? "bf16" : "fp32"; }

ern_status ern_state_about_text(const ern_trainer *t, char **text) {
  const ern_train_config *c = &t->config;
  *text = NULL;
  json_t *training = json_pack(
      "{s:I, s:f, s:f, s:f, s:I, s:I, s:b, s:I, s:I, s:b, s:s, s:s, s:s, s:f, s:f, s:b, s:b, s:b, s:i, s:f, s:s, s:f, "
      "s:b, s:b, s:s}",
      "iters", (json_int_t)c->iters, "lr", (double)c->lr, "lr_net", (double)c->lr_net, "lr_att", (double)c->lr_att,
      "refresh_every", (json_int_t)c->refresh_every, "ema_every", (json_int_t)c->ema_every, "ema", c->ema, "data_begin",
      (json_int_t)c->data_begin, "data_end", (json_int_t)c->data_end, "torso_layer", t->data.has_torso, "features",
      t->features, "precision", ern_precision_word(t->bf16), "ray_sampling", ern_ray_sampling_name(c->ray_sampling),
      "budget", c->seconds, "seconds_beside", t->beside, "refine_poses", t->poses != NULL, "torso_gamma",
      c->torso_gamma, "torso_random_background", c->torso_random_background, "frames_per_step", c->frames_per_step,
      "fine_share", c->fine_share, "fine_loss", ern_trainer_fine_name(t), "prune_share", (double)c->prune_share,
      "pruned", t->pruned, "head_random_background", c->head_random_background, "fingerprint", t->fingerprint);
  if (training != NULL && t->fine_from != UINT64_MAX) {
    json_t *fine = json_pack("{s:I, s:i, s:f, s:f}", "from", (json_int_t)t->fine_from, "patch_size", c->patch_size,
                             "weight", (double)c->fine_weight, "lips_weight", (double)c->fine_lips_weight);
    if (json_object_set_new(training, "fine", fine) != 0) {
      json_decref(training);
      training = NULL;
    }
  }
  if (training != NULL && c->step_parts > 1 &&
      json_object_set_new(training, "step_parts", json_integer(c->step_parts)) != 0) {
    json_decref(training);
    training = NULL;
  }
  json_t *root = json_pack("{s:b, s:I, s:I, s:o, s:i, s:f, s:o}", "torso", c->torso, "step", (json_int_t)t->step,
                           "ema_updates", (json_int_t)t->ema_updates, "seed", seed_json(c->seed), "rays", c->rays,
                           "seconds", t->seconds + t->pending_seconds, "training", training);
  char *json = root != NULL ? json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(17)) : NULL;
  json_decref(root);
  if (json == NULL) return ern_fail(t->context, ERN_E_NO_MEMORY, "state: the metadata could not be put together");
  const ern_status status = ern_string_copy(t->context, json, text);
  free(json);
  return status;
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

static bool whole_in(const json_t *value, int64_t least, int64_t most) {
  return json_is_integer(value) && json_integer_value(value) >= least && json_integer_value(value) <= most;
}

/* Missing in states of earlier versions, whose rays are uniform. */
static bool read_ray_sampling(const json_t *value, ern_ray_sampling *sampling) {
  *sampling = ERN_RAY_SAMPLING_UNIFORM;
  for (int k = 0; json_is_string(value) && ern_ray_sampling_name((ern_ray_sampling)k) != NULL; k++) {
    *sampling = (ern_ray_sampling)k;
    if (strcmp(json_string_value(value), ray_samplings[k]) == 0) return true;
  }
  return value == NULL;
}

/* 0 in states of earlier versions, which lack it. */
static bool read_seconds(const json_t *value, double *seconds) {
  *seconds = json_number_value(value);
  return value == NULL || (json_is_number(value) && *seconds >= 0 && *seconds <= ERN_TRAIN_MOST_SECONDS);
}

/* False in states of earlier versions, which lack it. */
static bool read_later_flag(const json_t *value, bool *flag) {
  *flag = json_is_true(value);
  return value == NULL || json_is_boolean(value);
}

static bool is_weight(const json_t *value) {
  return json_is_number(value) && json_number_value(value) >= 0 && json_number_value(value) <= ERN_TRAIN_MOST_RATE;
}

/* Missing: no fine stage. */
static bool read_fine(const json_t *value, struct ern_state_about *about) {
  const json_t *from = json_object_get(value, "from"), *side = json_object_get(value, "patch_size"),
               *weight = json_object_get(value, "weight"), *lips = json_object_get(value, "lips_weight");
  about->fine_from = UINT64_MAX;
  if (value == NULL) return true;
  if (!whole_in(from, 0, ERN_MODEL_MOST_STEPS) || !whole_in(side, ERN_PATCH_UNIT, ERN_PATCH_MOST_SIDE) ||
      json_integer_value(side) % ERN_PATCH_UNIT != 0 || !is_weight(weight) || !is_weight(lips))
    return false;
  about->fine_lips_weight = (float)json_number_value(lips);
  about->fine_from = (uint64_t)json_integer_value(from);
  about->patch_size = (int)json_integer_value(side);
  about->fine_weight = (float)json_number_value(weight);
  return true;
}

/* The name of the first field that is missing or out of range, NULL: none. */
static const char *read_training(const json_t *root, struct ern_state_about *about) {
  const struct {
    const char *name;
    uint64_t *to;
    int64_t least;
  } counts[] = {{"iters", &about->iters, 1},
                {"refresh_every", &about->refresh_every, 0},
                {"ema_every", &about->ema_every, 1},
                {"data_begin", &about->data_begin, 0},
                {"data_end", &about->data_end, 1}};
  const struct {
    const char *name;
    float *to;
  } rates[] = {{"lr", &about->lr}, {"lr_net", &about->lr_net}, {"lr_att", &about->lr_att}};
  const struct {
    const char *name;
    bool *to;
  } flags[] = {{"ema", &about->ema}, {"torso_layer", &about->layer}};
  const char *features = json_string_value(json_object_get(root, "features"));
  about->said = true;
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
    const json_t *value = json_object_get(root, counts[i].name);
    if (!whole_in(value, counts[i].least, ERN_MODEL_MOST_STEPS)) return counts[i].name;
    *counts[i].to = (uint64_t)json_integer_value(value);
  }
  for (size_t i = 0; i < sizeof rates / sizeof *rates; i++) {
    const json_t *value = json_object_get(root, rates[i].name);
    const double rate = json_number_value(value);
    if (!json_is_number(value) || !(rate >= 0 && rate <= ERN_TRAIN_MOST_RATE)) return rates[i].name;
    *rates[i].to = (float)rate;
  }
  for (size_t i = 0; i < sizeof flags / sizeof *flags; i++) {
    const json_t *value = json_object_get(root, flags[i].name);
    if (!json_is_boolean(value)) return flags[i].name;
    *flags[i].to = json_is_true(value);
  }
  if (about->data_begin >= about->data_end) return "data_end";
  if (!read_seconds(json_object_get(root, "budget"), &about->budget)) return "budget";
  if (!read_seconds(json_object_get(root, "seconds_beside"), &about->beside)) return "seconds_beside";
  if (!read_ray_sampling(json_object_get(root, "ray_sampling"), &about->ray_sampling)) return "ray_sampling";
  if (!read_later_flag(json_object_get(root, "refine_poses"), &about->refine_poses)) return "refine_poses";
  if (!read_later_flag(json_object_get(root, "torso_gamma"), &about->torso_gamma)) return "torso_gamma";
  if (!read_later_flag(json_object_get(root, "torso_random_background"), &about->torso_random_background))
    return "torso_random_background";
  if (!read_later_flag(json_object_get(root, "head_random_background"), &about->head_random_background))
    return "head_random_background";
  const json_t *frames = json_object_get(root, "frames_per_step"); /* not there: an earlier version's */
  if (frames != NULL && !whole_in(frames, 1, ERN_FRAMES_PER_STEP_MOST)) return "frames_per_step";
  about->frames_per_step = frames != NULL ? (int)json_integer_value(frames) : 1;
  const json_t *parts = json_object_get(root, "step_parts"); /* not there: 1 */
  if (parts != NULL && !whole_in(parts, 1, ERN_STEP_PARTS_MOST)) return "step_parts";
  about->step_parts = parts != NULL ? (int)json_integer_value(parts) : 1;
  if (!read_fine(json_object_get(root, "fine"), about)) return "fine";
  const json_t *share = json_object_get(root, "fine_share"); /* not there: an earlier version's */
  about->fine_share = json_number_value(share);
  const json_t *loss = json_object_get(root, "fine_loss"); /* not there: an earlier version's */
  const char *name = loss != NULL ? json_string_value(loss) : "ssim";
  if (name == NULL || strlen(name) >= sizeof about->fine_loss) return "fine_loss";
  memcpy(about->fine_loss, name, strlen(name) + 1);
  const json_t *prune = json_object_get(root, "prune_share"); /* not there: an earlier version's */
  about->prune_share = (float)json_number_value(prune);
  if (prune != NULL && !(json_is_number(prune) && about->prune_share >= 0 && about->prune_share <= 1))
    return "prune_share";
  if (!read_later_flag(json_object_get(root, "pruned"), &about->pruned)) return "pruned";
  if (share != NULL && !(json_is_number(share) && about->fine_share >= 0 && about->fine_share <= 1))
    return "fine_share";
  if (features == NULL || strlen(features) >= sizeof about->features) return "features";
  memcpy(about->features, features, strlen(features) + 1);
  const json_t *fingerprint = json_object_get(root, "fingerprint"); /* not there: an earlier version's */
  const char *files = fingerprint != NULL ? json_string_value(fingerprint) : "";
  if (files == NULL || strlen(files) >= sizeof about->fingerprint) return "fingerprint";
  memcpy(about->fingerprint, files, strlen(files) + 1);
  const json_t *precision = json_object_get(root, "precision");
  const char *word = json_string_value(precision);
  if (precision == NULL) return NULL;
  about->bf16 = word != NULL && strcmp(word, ern_precision_word(true)) == 0;
  if (word == NULL || (!about->bf16 && strcmp(word, ern_precision_word(false)) != 0)) return "precision";
  return NULL;
}

ern_status ern_state_about_parse(ern_context *context, const char *text, const char *path,
                                 struct ern_state_about *about) {
  json_error_t error;
  json_t *root = json_loads(text, JSON_REJECT_DUPLICATES, &error);
  const json_t *torso = json_object_get(root, "torso"), *step = json_object_get(root, "step"),
               *updates = json_object_get(root, "ema_updates"), *seed = json_object_get(root, "seed"),
               *rays = json_object_get(root, "rays"), *seconds = json_object_get(root, "seconds"),
               *training = json_object_get(root, "training");
  uint64_t seed_value = 0;
  const bool whole = json_is_boolean(torso) && whole_in(step, 0, ERN_MODEL_MOST_STEPS) &&
                     whole_in(updates, 0, ERN_MODEL_MOST_STEPS) && seed_read(seed, &seed_value) &&
                     whole_in(rays, 0, INT32_MAX) && json_is_number(seconds) && json_number_value(seconds) >= 0;
  *about = (struct ern_state_about){.torso = json_is_true(torso),
                                    .step = (uint64_t)json_integer_value(step),
                                    .ema_updates = (uint64_t)json_integer_value(updates),
                                    .seed = seed_value,
                                    .rays = (int)json_integer_value(rays),
                                    .seconds = json_number_value(seconds),
                                    .fine_from = UINT64_MAX};
  const char *wrong = training != NULL ? read_training(training, about) : NULL;
  json_decref(root);
  if (!whole)
    return ern_fail(context, ERN_E_FORMAT,
                    "%s: metadata \"ernerf.state\" lacks a field or holds one of another type or range", path);
  if (wrong != NULL)
    return ern_fail(context, ERN_E_FORMAT,
                    "%s: metadata \"ernerf.state\": training.%s is missing or of another type or range", path, wrong);
  return ERN_OK;
}

/* ---- what has changed -------------------------------------------------------------------------------------------- */

/* A value as text, for comparison: texts are equal exactly where the values are. */
struct value {
  char text[72];
};
static struct value number(float value) {
  struct value made;
  double read = 0;
  int digits = 3;
  do {
    ern_format(made.text, sizeof made.text, "%.*g", digits, (double)value);
    const char *at = made.text;
    (void)ern_number_read(&at, at + strlen(at), &read);
  } while (digits++ < 9 && (float)read != value);
  return made;
}
static struct value count(uint64_t value) {
  struct value made;
  snprintf(made.text, sizeof made.text, "%" PRIu64, value);
  return made;
}
static struct value word(const char *value) {
  struct value made;
  snprintf(made.text, sizeof made.text, "%.64s", value);
  return made;
}

struct change {
  const char *name;
  struct value found, here;
};

static ern_status refuse(const ern_trainer *t, const char *path, const struct change *c) {
  return ern_fail(t->context, ERN_E_MISMATCH, "%s: %s is %s, this training has %s, expected the same", path, c->name,
                  c->found.text, c->here.text);
}

static void log_change(const ern_trainer *t, const char *path, const struct change *c) {
  ern_log(t->context, ERN_LOG_WARNING, "%s: %s was %s, going on with %s", path, c->name, c->found.text, c->here.text);
}

/* Refuses the first of `strict` that differs, then logs all of `loose` that differ. */
static ern_status compare(const ern_trainer *t, const char *path, const struct change *strict, size_t stricts,
                          const struct change *loose, size_t looses) {
  for (size_t i = 0; i < stricts; i++)
    if (strcmp(strict[i].found.text, strict[i].here.text) != 0) return refuse(t, path, &strict[i]);
  for (size_t i = 0; i < looses; i++)
    if (strcmp(loose[i].found.text, loose[i].here.text) != 0) log_change(t, path, &loose[i]);
  return ERN_OK;
}

struct ern_view_settings ern_trainer_view_settings(const ern_trainer *t) {
  const ern_train_config *c = &t->config;
  return (struct ern_view_settings){true, c->max_steps, c->dt_gamma, c->torso_shrink, t->data.scale, c->audio_pad};
}

ern_status ern_trainer_check_view(const ern_trainer *t, const char *path, const struct ern_view_settings *found,
                                  bool torso, bool strict) {
  const struct ern_view_settings here = ern_trainer_view_settings(t);
  const struct change changes[] = {
      {"scale", number(found->scale), number(here.scale)},
      {"dt_gamma", number(found->dt_gamma), number(here.dt_gamma)},
      {"audio_pad", word(ern_audio_pad_name(found->audio_pad)), word(ern_audio_pad_name(here.audio_pad))},
      {"max_steps", count((uint64_t)found->max_steps), count((uint64_t)here.max_steps)},
      {"torso_shrink", number(found->torso_shrink), number(here.torso_shrink)}};
  const size_t all = sizeof changes / sizeof *changes - (torso ? 0 : 1);
  if (!found->said) return ERN_OK;
  return strict ? compare(t, path, changes, all, NULL, 0) : compare(t, path, NULL, 0, changes, all);
}

ern_status ern_state_about_check(const ern_trainer *t, const char *path, const struct ern_state_about *about,
                                 const struct ern_view_settings *view) {
  const ern_train_config *c = &t->config;
  const struct change both[] = {{"seed", count(about->seed), count(c->seed)},
                                {"rays", count((uint64_t)about->rays), count((uint64_t)c->rays)}};
  if (about->rays == 0) return ERN_OK;
  if (!about->said) {
    ern_log(t->context, ERN_LOG_WARNING,
            "%s: does not say how it was trained; going on with scale %s, dt_gamma %s, audio_pad %s, torso_shrink %s, "
            "frames %zu to %zu, lr %s, lr_net %s: give other options where it was trained with those",
            path, number(t->data.scale).text, number(c->dt_gamma).text, ern_audio_pad_name(c->audio_pad),
            number(c->torso_shrink).text, c->data_begin, c->data_end, number(c->lr).text, number(c->lr_net).text);
    return compare(t, path, NULL, 0, both, 2);
  }
  const bool fine = about->fine_from < about->step; /* it has begun */
  const bool planned = about->fine_from != UINT64_MAX || about->fine_share > 0;
  const struct change strict[] = {
      {"the SHA-256 of the speech features and their augmentation (--speech-copies, --speech-warp, --speech-share, "
       "--speech-noise)",
       word(about->features), word(t->features)},
      {"data_begin", count(about->data_begin), count(c->data_begin)},
      {"data_end", count(about->data_end), count(c->data_end)},
      {"torso_layer", count(about->layer), count(t->data.has_torso)},
      {"refine_poses", count(about->refine_poses), count(t->poses != NULL)},
      {"fine_loss", word(planned ? about->fine_loss : ""), word(planned ? ern_trainer_fine_name(t) : "")}};
  const struct change loose[] = {
      {"max_steps", count((uint64_t)view->max_steps), count((uint64_t)c->max_steps)},
      both[0],
      both[1],
      {"iters", count(about->iters), count(c->seconds > 0 ? about->iters : c->iters)},
      {"seconds in all", number((float)about->budget), number((float)c->seconds)},
      {"lr", number(about->lr), number(c->lr)},
      {"lr_net", number(about->lr_net), number(c->lr_net)},
      {"lr_att", number(about->lr_att), number(c->lr_att)},
      {"refresh_every", count(about->refresh_every), count(c->refresh_every)},
      {"torso_random_background", count(about->torso_random_background),
       count(c->torso ? c->torso_random_background : about->torso_random_background)},
      {"head_random_background", count(about->head_random_background),
       count(c->torso ? about->head_random_background : c->head_random_background)},
      {"frames_per_step", count((uint64_t)about->frames_per_step), count((uint64_t)c->frames_per_step)},
      {"step_parts", count((uint64_t)about->step_parts), count((uint64_t)c->step_parts)},
      {"fine_share", number((float)about->fine_share), number((float)c->fine_share)},
      {"prune_share", number(about->prune_share), number(c->prune_share)},
      {"patch_size", count(fine ? (uint64_t)about->patch_size : 0), count(fine ? (uint64_t)c->patch_size : 0)},
      {"fine_weight", number(fine ? about->fine_weight : 0), number(fine ? c->fine_weight : 0)},
      {"fine_lips_weight", number(fine ? about->fine_lips_weight : 0), number(fine ? c->fine_lips_weight : 0)},
      {"ema_every", count(about->ema_every), count(c->ema_every)},
      {"ema", count(about->ema), count(c->ema)},
      {"precision", word(ern_precision_word(about->bf16)), word(ern_precision_word(t->bf16))},
      {"ray_sampling", word(ern_ray_sampling_name(about->ray_sampling)),
       word(ern_ray_sampling_name(c->torso ? about->ray_sampling : c->ray_sampling))}}; /* a torso's are uniform */
  /* The number of samples per ray may change in a resume; the other view settings may not. */
  struct ern_view_settings rest = *view;
  rest.max_steps = c->max_steps;
  const ern_status status = ern_trainer_check_view(t, path, &rest, c->torso, true);
  if (status != ERN_OK) return status;
  if (about->fingerprint[0] != 0 && t->fingerprint[0] != 0 && strcmp(about->fingerprint, t->fingerprint) != 0)
    ern_log(t->context, ERN_LOG_WARNING,
            "%s: files of the clip's frames (pictures, masks, landmarks or blinks) are not those that it began with; "
            "going on with those of now",
            path);
  return compare(t, path, strict, sizeof strict / sizeof *strict, loose, sizeof loose / sizeof *loose);
}
