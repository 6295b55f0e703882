/* SPDX-License-Identifier: MIT */
#include "train/state_about.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/format.h"
#include "core/memory.h"
#include "core/setting_table.h"
#include "io/json.h"
#include "train/patches_ops.h"
#include "train/train_settings.h"

static json_t *settings_json(const ern_train_config *config) {
  json_t *settings = json_object();
  char text[ERN_SETTING_TEXT_BYTES];
  const ern_setting *s;
  for (size_t i = 0; settings != NULL && (s = ern_train_setting(i)) != NULL; i++) {
    if (s->resume == ERN_RESUME_FREE) continue;
    ern_setting_write(s, config, text);
    if (json_object_set_new(settings, s->name, json_string(text)) == 0) continue;
    json_decref(settings);
    settings = NULL;
  }
  return settings;
}

ern_status ern_state_about_text(ern_context *context, const struct ern_state_about *about, char **text) {
  const bool fine = about->fine_from != UINT64_MAX;
  json_t *training = json_pack(
      "{s:o, s:b, s:s, s:s, s:f, s:o*, s:s, s:o*, s:b}", "settings", settings_json(&about->config), "torso_layer",
      about->layer, "features", about->features, "fingerprint", about->fingerprint, "seconds_beside", about->beside,
      "fine_from", fine ? json_integer((json_int_t)about->fine_from) : NULL, "fine_loss", about->fine_loss,
      "fine_value", isfinite(about->fine_value) ? json_real(about->fine_value) : NULL, "pruned", about->pruned);
  json_t *root =
      json_pack("{s:b, s:I, s:I, s:f, s:o}", "torso", about->torso, "step", (json_int_t)about->step, "ema_updates",
                (json_int_t)about->ema_updates, "seconds", about->seconds, "training", training);
  *text = ern_json_text(context, root, JSON_COMPACT | JSON_REAL_PRECISION(17));
  json_decref(root);
  if (*text != NULL) return ERN_OK;
  return ern_fail(context, ERN_E_NO_MEMORY, "state: the metadata could not be put together");
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

static bool is_step(const json_t *value) {
  return json_is_integer(value) && json_integer_value(value) >= 0 && json_integer_value(value) <= ERN_MODEL_MOST_STEPS;
}

static bool read_seconds(const json_t *value, double *seconds) {
  *seconds = json_number_value(value);
  return json_is_number(value) && *seconds >= 0 && *seconds <= ERN_TRAIN_MOST_SECONDS;
}

static bool read_text(const json_t *value, size_t bytes, char *text) {
  const char *found = json_string_value(value);
  if (found == NULL || strlen(found) >= bytes) return false;
  strcpy(text, found);
  return true;
}

static const ern_setting *kept_setting(const char *name) {
  const ern_setting *s;
  for (size_t i = 0; (s = ern_train_setting(i)) != NULL; i++)
    if (s->resume != ERN_RESUME_FREE && strcmp(s->name, name) == 0) return s;
  return NULL;
}

/* A setting that is missing was added later, and has its default. *wrong: a name that is unknown or whose value is out
 * of range, in the memory of `root`; NULL: none. */
static bool read_settings(json_t *root, ern_train_config *config, const char **wrong) {
  const char *name;
  json_t *value;
  *wrong = NULL;
  json_object_foreach(root, name, value) {
    *wrong = name;
    if (!ern_setting_read(kept_setting(name), json_string_value(value), config)) return false;
  }
  *wrong = NULL;
  return json_is_object(root) && config->data_begin < config->data_end && config->patch_size % ERN_PATCH_UNIT == 0;
}

/* The name of the first field that is missing, unknown or out of range, in the memory of `root`; NULL: none. The
 * training may depend on what a later version keeps. */
static const char *read_training(json_t *root, struct ern_state_about *about) {
  static const char *const known[] = {"settings",  "torso_layer", "features",   "fingerprint", "seconds_beside",
                                      "fine_from", "fine_loss",   "fine_value", "pruned"};
  const json_t *layer = json_object_get(root, "torso_layer"), *pruned = json_object_get(root, "pruned"),
               *fine_from = json_object_get(root, "fine_from"), *fine_value = json_object_get(root, "fine_value");
  const char *wrong;
  about->has_settings = true;
  if (!read_settings(json_object_get(root, "settings"), &about->config, &wrong))
    return wrong != NULL ? wrong : "settings";
  if (!json_is_boolean(layer)) return "torso_layer";
  about->layer = json_is_true(layer);
  if (!read_text(json_object_get(root, "features"), sizeof about->features, about->features)) return "features";
  if (!read_text(json_object_get(root, "fingerprint"), sizeof about->fingerprint, about->fingerprint))
    return "fingerprint";
  if (!read_seconds(json_object_get(root, "seconds_beside"), &about->beside)) return "seconds_beside";
  if (fine_from != NULL && !is_step(fine_from)) return "fine_from";
  if (fine_from != NULL) about->fine_from = (uint64_t)json_integer_value(fine_from);
  if (!read_text(json_object_get(root, "fine_loss"), sizeof about->fine_loss, about->fine_loss)) return "fine_loss";
  if (fine_value != NULL && !json_is_number(fine_value)) return "fine_value";
  if (fine_value != NULL) about->fine_value = json_number_value(fine_value);
  if (!json_is_boolean(pruned)) return "pruned";
  about->pruned = json_is_true(pruned);
  return ern_json_unknown_member(root, known, sizeof known / sizeof *known);
}

ern_status ern_state_about_parse(ern_context *context, const char *text, const char *path,
                                 struct ern_state_about *about) {
  static const char *const known[] = {"torso", "step", "ema_updates", "seconds", "training"};
  json_error_t error;
  json_t *root = json_loads(text, JSON_REJECT_DUPLICATES, &error), *training = json_object_get(root, "training");
  const json_t *torso = json_object_get(root, "torso"), *step = json_object_get(root, "step"),
               *updates = json_object_get(root, "ema_updates");
  ern_status status = ERN_OK;
  *about = (struct ern_state_about){.torso = json_is_true(torso),
                                    .step = (uint64_t)json_integer_value(step),
                                    .ema_updates = (uint64_t)json_integer_value(updates),
                                    .config = ern_train_config_default(),
                                    .fine_from = UINT64_MAX,
                                    .fine_value = NAN};
  if (!json_is_boolean(torso) || !is_step(step) || !is_step(updates) ||
      !read_seconds(json_object_get(root, "seconds"), &about->seconds))
    ERN_TRY(ern_fail(context, ERN_E_FORMAT,
                     "%s: metadata \"ernerf.state\" lacks a field or holds one of another type or range", path));
  const char *later = ern_json_unknown_member(root, known, sizeof known / sizeof *known);
  if (later != NULL)
    ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: metadata \"ernerf.state\": this version knows no %.40s", path, later));
  const char *wrong = training != NULL ? read_training(training, about) : NULL;
  if (wrong != NULL)
    ERN_TRY(ern_fail(context, ERN_E_FORMAT,
                     "%s: metadata \"ernerf.state\": training.%.64s is missing, unknown, or of another type or range",
                     path, wrong));
fail:
  json_decref(root);
  return status;
}

/* ---- what has changed -------------------------------------------------------------------------------------------- */

/* Refuses (`strict`) or logs a value that differs. */
static ern_status compare(const struct ern_training *t, const char *path, const char *name, const char *found,
                          const char *here, bool strict) {
  if (strcmp(found, here) == 0) return ERN_OK;
  if (strict)
    return ern_fail(t->context, ERN_E_MISMATCH, "%s: %s is %s, this training has %s, expected the same", path, name,
                    found, here);
  ern_log(t->context, ERN_LOG_WARNING, "%s: %s was %s, going on with %s", path, name, found, here);
  return ERN_OK;
}

static ern_status compare_setting(const struct ern_training *t, const char *path, const ern_setting *s,
                                  const ern_train_config *found, const ern_train_config *here, bool strict) {
  char texts[2][ERN_SETTING_TEXT_BYTES];
  ern_setting_write(s, found, texts[0]);
  ern_setting_write(s, here, texts[1]);
  return compare(t, path, s->name, texts[0], texts[1], strict);
}

struct ern_view_settings ern_trainer_view_settings(const struct ern_training *t) {
  const ern_train_config *c = &t->config;
  return (struct ern_view_settings){true, c->max_steps, c->dt_gamma, c->torso_shrink, t->data.scale, c->audio_pad};
}

ern_status ern_trainer_check_view(const struct ern_training *t, const char *path, const struct ern_view_settings *view,
                                  bool torso, bool strict) {
  static const char *const names[] = {"dt_gamma", "audio_pad", "max_steps", "torso_shrink"};
  ern_train_config found = t->config;
  char texts[2][ERN_SETTING_TEXT_BYTES];
  const ern_setting *s;
  if (!view->is_set) return ERN_OK;
  found.dt_gamma = view->dt_gamma;
  found.audio_pad = view->audio_pad;
  found.max_steps = view->max_steps;
  if (torso) found.torso_shrink = view->torso_shrink;
  ern_format(texts[0], sizeof texts[0], "%.9g", (double)view->scale);
  ern_format(texts[1], sizeof texts[1], "%.9g", (double)t->data.scale);
  ern_status status = compare(t, path, "scale", texts[0], texts[1], strict);
  for (size_t i = 0; (s = ern_train_setting(i)) != NULL; i++)
    for (size_t k = 0; k < sizeof names / sizeof *names && status == ERN_OK; k++)
      if (strcmp(s->name, names[k]) == 0) status = compare_setting(t, path, s, &found, &t->config, strict);
  return status;
}

/* Whether a resume compares a setting of this training with that of the state. */
static bool is_compared(const struct ern_state_about *here, const struct ern_state_about *about, const ern_setting *s) {
  if (s->resume != ERN_RESUME_LOGGED && s->resume != ERN_RESUME_SAME) return false;
  if (here->config.seconds > 0 && strcmp(s->name, "iters") == 0) return false; /* an estimate */
  return s->scope == ERN_SCOPE_ANY || (s->scope == ERN_SCOPE_TORSO && here->torso) ||
         (s->scope == ERN_SCOPE_HEAD && !here->torso) || (s->scope == ERN_SCOPE_FINE && about->fine_from < about->step);
}

static ern_status compare_settings(const struct ern_training *t, const char *path, const struct ern_state_about *about,
                                   const struct ern_state_about *here, bool strict) {
  const ern_setting *s;
  ern_status status = ERN_OK;
  for (size_t i = 0; (s = ern_train_setting(i)) != NULL && status == ERN_OK; i++)
    if (is_compared(here, about, s) && (s->resume == ERN_RESUME_SAME) == strict)
      status = compare_setting(t, path, s, &about->config, &here->config, strict);
  return status;
}

/* Whether two fingerprints are the same as far as both are known: one of an earlier version is the beginning of
 * today's. */
static bool do_agree(const char *one, const char *other) {
  const size_t first = strlen(one), second = strlen(other);
  return strncmp(one, other, first < second ? first : second) == 0;
}

ern_status ern_state_about_check(const struct ern_training *t, const char *path, const struct ern_state_about *about,
                                 const struct ern_state_about *here, const struct ern_view_settings *view) {
  const bool planned = about->fine_from != UINT64_MAX || about->config.fine_share > 0;
  ern_status status = ERN_OK;
  if (!about->has_settings) return ERN_OK;
  /* The number of samples per ray may change in a resume; the other view settings may not. */
  struct ern_view_settings rest = *view;
  rest.max_steps = t->config.max_steps;
  ERN_TRY(ern_trainer_check_view(t, path, &rest, t->config.torso, true));
  if (!do_agree(about->fingerprint, here->fingerprint))
    ern_log(t->context, ERN_LOG_WARNING,
            "%s: files of the clip's frames (pictures, masks, landmarks, blinks or torso.npy) are not those that it "
            "began with; going on with those of now",
            path);
  ERN_TRY(compare(t, path, "the SHA-256 of the speech features and their augmentation (--speech-augment)",
                  about->features, here->features, true));
  ERN_TRY(compare(t, path, "torso_layer", about->layer ? "yes" : "no", here->layer ? "yes" : "no", true));
  if (planned) ERN_TRY(compare(t, path, "fine_loss", about->fine_loss, here->fine_loss, true));
  ERN_TRY(compare_settings(t, path, about, here, true));
  ERN_TRY(compare_settings(t, path, about, here, false));
fail:
  return status;
}
