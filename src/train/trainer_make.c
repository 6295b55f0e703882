/* SPDX-License-Identifier: MIT
 * Creates and frees a trainer: checks configuration and data, allocates memory, initialises the values or loads them
 * from a state or a file. */
#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/floats.h"
#include "core/format.h"
#include "core/memory.h"
#include "core/sized.h"
#include "io/file.h"
#include "io/speech_description.h"
#include "model/torso_ops.h"
#include "render/frame_input.h"
#include "train/parts/trainer_data.h"
#include "train/parts/trainer_fade.h"
#include "train/parts/trainer_model.h"
#include "train/parts/trainer_motion.h"
#include "train/state_about.h"
#include "train/train_settings.h"
#include "train/trainer.h"

/* ---- checks ------------------------------------------------------------------------------------------------------ */

static ern_status check_range(ern_context *context, const char *name, double found, double least, double most) {
  if (found >= least && found <= most) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT, "train: %s is %g, expected %g to %g", name, found, least, most);
}

static ern_status check_config(ern_context *context, const ern_train_config *c) {
  if (c->resume && c->output == NULL)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "train: resume is set, and output is NULL: expected the model of a training");
  if (c->output != NULL) {
    const ern_status status = ern_model_check_name(context, c->output);
    if (status != ERN_OK) return status;
  }
  const ern_status settings = ern_train_settings_check(context, c);
  if (settings != ERN_OK) return settings;
  if (c->torso_output != NULL && (c->torso || c->output == NULL))
    return ern_fail(context, ERN_E_ARGUMENT, "train: torso_output is set, expected NULL without a head's output");
  if (c->frames_per_step > c->rays)
    return ern_fail(context, ERN_E_ARGUMENT, "train: frames_per_step is %d, expected at most the %d rays of a step",
                    c->frames_per_step, c->rays);
  const ern_status parts = ern_trainer_parts_check(context, c);
  if (parts != ERN_OK) return parts;
  if (c->torso && c->head == NULL && c->from == NULL)
    return ern_fail(context, ERN_E_ARGUMENT, "train: a torso needs the head it goes under");
  return ERN_OK;
}

static ern_status check_features(ern_context *context, const ern_features *features) {
  const size_t each = (size_t)features->window_length * (size_t)features->width, count = features->windows * each;
  for (size_t i = 0; i < count; i++) {
    char where[64];
    if (ern_feature_fits(features->data[i])) continue;
    snprintf(where, sizeof where, "train: window %zu of the speech", i / each);
    return ern_feature_refuse(context, where, i % each, features->data[i]);
  }
  return ERN_OK;
}

static ern_status check_all_features(ern_context *context, const ern_dataset *d) {
  ern_status status = check_features(context, d->features);
  if (status == ERN_OK)
    status = check_range(context, "speech_noise", (double)d->speech_noise, 0, ERN_SPEECH_NOISE_MOST);
  if (status != ERN_OK || d->copy_count == 0) return status;
  if (d->copies == NULL || !(d->copy_share >= 0 && d->copy_share <= 1))
    return ern_fail(context, ERN_E_ARGUMENT, "train: %zu copies of the speech%s, share %g, expected 0 to 1",
                    d->copy_count, d->copies == NULL ? " that are NULL" : "", (double)d->copy_share);
  for (size_t k = 0; k < d->copy_count && status == ERN_OK; k++) {
    const ern_features *copy = &d->copies[k];
    if (copy->data == NULL || copy->windows != d->features->windows || copy->width != d->features->width ||
        copy->window_length != d->features->window_length)
      return ern_fail(context, ERN_E_SHAPE, "train: copy %zu of the speech is [%zu, %d, %d]%s, expected [%zu, %d, %d]",
                      k, copy->windows, copy->window_length, copy->width, copy->data == NULL ? " without data" : "",
                      d->features->windows, d->features->window_length, d->features->width);
    status = check_features(context, copy);
  }
  return status;
}

/* A name that is kept in the model. */
static ern_status check_name(ern_context *context, const char *what, const char *name, size_t most) {
  if (name == NULL) return ERN_OK;
  json_t *text = json_string(name); /* NULL: no UTF-8 */
  const bool fits = text != NULL && strlen(name) <= most;
  json_decref(text);
  if (fits) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT, "train: the %s is %s, expected UTF-8 of at most %zu bytes", what,
                  strlen(name) > most ? "longer" : "no UTF-8", most);
}

static ern_status check_data(struct ern_training *t) {
  const ern_dataset *d = &t->data;
  ern_train_config *c = &t->config;
  if (d->frames[0] < 1 || d->frames[0] > UINT32_MAX || d->frame == NULL || d->pixels == NULL || d->features == NULL ||
      d->background == NULL)
    return ern_fail(t->context, ERN_E_ARGUMENT, "train: the data lacks frames, features, a background or a callback");
  if (d->width < 1 || d->height < 1 || d->width > 8192 || d->height > 8192 || !(d->focal > 0) || !isfinite(d->focal) ||
      !isfinite(d->cx) || !isfinite(d->cy))
    return ern_fail(t->context, ERN_E_ARGUMENT, "train: the camera is %d x %d, focal %g, centre %g, %g", d->width,
                    d->height, d->focal, d->cx, d->cy);
  if (c->data_end == 0) c->data_end = d->frames[0];
  if (c->data_begin >= c->data_end || c->data_end > d->frames[0])
    return ern_fail(t->context, ERN_E_ARGUMENT, "train: the frames %zu to %zu are asked for, there are %zu",
                    c->data_begin, c->data_end, d->frames[0]);
  if (c->torso && !d->has_torso)
    return ern_fail(t->context, ERN_E_MISSING,
                    "train: the clip has no torso images (torso_imgs), so no torso can be learnt");
  if (!c->torso && c->eye_attention == ERN_EYE_ATTENTION_CONCAT && !d->has_eye)
    return ern_fail(t->context, ERN_E_MISSING,
                    "train: the eye attention is %s, but the clip has no eye values (au.csv) for it",
                    ern_eye_attention_name(c->eye_attention));
  if (c->codes < 0) c->codes = (int)d->frames[0];
  if (c->codes > 0 && (size_t)c->codes < d->frames[0])
    return ern_fail(t->context, ERN_E_ARGUMENT,
                    "train: %d individual codes for %zu training frames, expected at least as many", c->codes,
                    d->frames[0]);
  ern_status status = check_name(t->context, "kind of the speech", d->speech, sizeof t->model->speech - 1);
  if (status == ERN_OK) status = check_name(t->context, "identity", d->identity, sizeof t->identity - 1);
  if (status == ERN_OK) status = check_name(t->context, "fingerprint", d->fingerprint, sizeof t->fingerprint - 1);
  if (status == ERN_OK) status = check_name(t->context, "consent", c->consent, ERN_CONSENT_BYTES - 1);
  if (status == ERN_OK) status = ern_features_check(t->context, "train", d->features);
  return status == ERN_OK ? check_all_features(t->context, d) : status;
}

/* ---- model ------------------------------------------------------------------------------------------------------- */

/* The configured number of levels; the backbone's own where none is configured, or where it supports no other. */
static int levels_of(const ern_train_config *config) {
  static const int own[] = {[ERN_BACKBONE_TRIHASH] = 14, [ERN_BACKBONE_HASH3D] = 16, [ERN_BACKBONE_TRIPLANE] = 1};
  const bool known = (size_t)config->backbone < sizeof own / sizeof *own;
  return config->levels > 0 ? config->levels : known ? own[config->backbone] : 0;
}

static struct ern_model_config head_config(const struct ern_training *t) {
  return (struct ern_model_config){.backbone = t->config.backbone,
                                   .attention = t->config.attention,
                                   .eye_attention = t->config.eye_attention,
                                   .levels = levels_of(&t->config),
                                   .feature_width = t->data.features->width,
                                   .window_length = t->data.features->window_length,
                                   .head = true,
                                   .eye = t->data.has_eye,
                                   .no_view = t->config.no_view,
                                   .codes = t->config.codes,
                                   .bound = t->config.bound};
}

static ern_status check_head(const struct ern_training *t, const ern_model *head) {
  if (head->field.config.feature_width != t->data.features->width)
    return ern_fail(t->context, ERN_E_MISMATCH, "train: the head takes features %d wide, the clip's are %d wide",
                    head->field.config.feature_width, t->data.features->width);
  const int length = head->field.config.window_length;
  if (length > 0 && length != t->data.features->window_length)
    return ern_fail(t->context, ERN_E_MISMATCH,
                    "train: the head was trained on windows of %d vectors of speech, the clip's have %d", length,
                    t->data.features->window_length);
  /* The torso's own shrink is chosen again. */
  const ern_status status = ern_trainer_check_view(t, "the head", &head->view, false, true);
  if (status != ERN_OK) return status;
  if (head->dub)
    ern_log(t->context, ERN_LOG_WARNING,
            "train: the head was trained for `ernerf dub`, which shows no torso; outside the lower face it is blurred");
  if (head->clip[0] == 0)
    ern_log(t->context, ERN_LOG_WARNING, "train: the head's file does not say which clip it is of");
  if (ern_trainer_is_foreign(t, head)) {
    if (!t->config.force)
      return ern_fail(t->context, ERN_E_MISMATCH,
                      "train: the head was trained on another clip (%.12s..., this one is %.12s...)", head->clip,
                      t->identity);
    ern_log(t->context, ERN_LOG_WARNING, "train: the head was trained on another clip%s",
            head->cameras > 0 ? "; its pose corrections are of that clip's frames, and are left out" : "");
  }
  return ERN_OK;
}

/* Kind and network of the speech features, into the model; a torso takes them from its head. */
static ern_status take_speech(struct ern_training *t) {
  ern_model *model = t->model;
  const ern_model *head = t->config.torso ? t->config.head : NULL;
  const char *kind = t->data.speech, *network = t->data.speech_network;
  struct ern_speech_description description;
  if (head != NULL) {
    memcpy(model->speech, head->speech, sizeof model->speech);
    memcpy(model->speech_network, head->speech_network, sizeof model->speech_network);
    return ERN_OK;
  }
  if (kind != NULL) snprintf(model->speech, sizeof model->speech, "%s", kind);
  if (network == NULL || network[0] == 0) return ERN_OK;
  const ern_status status = ern_speech_description_parse(t->context, "train: speech_network", network, &description);
  if (status == ERN_E_FORMAT) return ERN_E_ARGUMENT; /* the caller's text; the error is already recorded */
  if (status != ERN_OK) return status;
  if (kind == NULL || strcmp(kind, description.kind) != 0)
    return ern_fail(t->context, ERN_E_ARGUMENT, "train: the speech is of the kind %s, and its network of %s",
                    kind != NULL ? kind : "NULL", description.kind);
  return ern_speech_description_text(t->context, &description, model->speech_network);
}

static ern_status make_model(struct ern_training *t) {
  struct ern_model_config config = head_config(t);
  ern_status status = ERN_OK;
  if (t->config.torso && t->config.head != NULL) {
    ERN_TRY(check_head(t, t->config.head));
    config = t->config.head->field.config;
    config.window_length = t->data.features->window_length;
    t->config.bound = config.bound;
    if (config.codes > 0 && (size_t)config.codes < t->data.frames[0]) config.codes = (int)t->data.frames[0];
  }
  if (t->config.torso) {
    config.torso = true;
    config.torso_gamma = t->config.torso_gamma;
  }
  ERN_TRY(ern_model_make(&t->model, t->context, &config));
  t->model->view = ern_trainer_view_settings(t);
  memcpy(t->model->clip, t->identity, sizeof t->model->clip);
  t->model->dub =
      t->config.torso ? t->config.head != NULL && t->config.head->dub : t->config.ray_sampling == ERN_RAY_SAMPLING_DUB;
  ERN_TRY(take_speech(t));
  if (t->config.consent != NULL)
    snprintf(t->model->consent, sizeof t->model->consent, "%s", t->config.consent);
  else if (t->config.head != NULL)
    ern_trainer_keep_consent(t, t->config.head);
  ern_parameters_init(t->model->block, &t->model->table, t->config.torso, t->config.seed);
  if (t->config.torso && t->config.head != NULL) {
    ern_trainer_copy_rows(t->model, t->config.head, false);
    if (!ern_trainer_is_foreign(t, t->config.head)) ERN_TRY(ern_trainer_copy_camera(t->model, t->config.head));
    ern_trainer_log_codes(t, "the head", t->config.head->field.config.codes);
  }
fail:
  return status;
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

static ern_status take_host(ern_trainer *t) {
  const uint8_t *head = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ern_pool_make(t->shared.context, t->shared.config.threads, &t->shared.pool));
  ERN_TRY(ERN_NEW(t->shared.context, t->shared.data.frames[0], &t->shared.views));
  for (size_t i = 0; i < t->shared.data.frames[0]; i++)
    ERN_TRY(ern_trainer_view(&t->shared, 0, i, &t->shared.views[i]));
  const ern_train_config *c = &t->shared.config;
  /* a torso keeps its head's, and a dubbed frame shows nothing above the nose */
  if (!c->torso && c->voice_fade && c->ray_sampling != ERN_RAY_SAMPLING_DUB) ERN_TRY(ern_trainer_fade_find(&t->shared));
  ERN_TRY(ern_trainer_motion_set(&t->shared, c->torso && c->torso_motion && t->shared.data.has_torso_motion));
  ERN_TRY(ern_trainer_head(&t->shared, t->shared.config.data_begin, &head)); /* so that an invalid one is found now */
  ERN_TRY(ern_trainer_poses_make(&t->poses, &t->fine));
  t->state.poses = t->poses;
  ERN_TRY(ern_trainer_speech_make(&t->speech, &t->shared));
  ERN_TRY(ern_trainer_parts_make(&t->parts, &t->shared));
fail:
  return status;
}

/* Checks that the average can have enough updates by the last step. With config.seconds the number of steps is not
 * known beforehand. */
static ern_status check_average(const ern_trainer *t) {
  const ern_train_config *c = &t->shared.config;
  const uint64_t every = c->ema_every, least = ERN_LEAST_EMA_UPDATES, done = t->shared.step / every,
                 updates = t->values.ema_updates + (c->iters > t->shared.step ? c->iters / every - done : 0);
  if (!c->ema || t->state.output == NULL || c->seconds > 0 || updates >= least) return ERN_OK;
  const uint64_t missing = least - t->values.ema_updates,
                 left = c->iters > t->shared.step ? c->iters - t->shared.step : 0;
  char shorter[64] = "";
  if (left >= missing)
    snprintf(shorter, sizeof shorter, "at most %" PRIu64 " steps between updates or ", left / missing);
  return ern_fail(t->shared.context, ERN_E_ARGUMENT,
                  "train: the average of %" PRIu64 " steps in all with %" PRIu64 " between its updates has %" PRIu64
                  " updates, expected at least %" PRIu64 ": choose %s%" PRIu64 " steps in all or more",
                  c->iters, every, updates, least, shorter, (done + missing) * every);
}

/* The SHA-256 of the speech features; with data augmentation, also over its settings and each copy. */
static void name_features(struct ern_training *t) {
  const ern_features *f = t->data.features;
  const size_t bytes = f->windows * (size_t)f->window_length * (size_t)f->width * sizeof(float);
  char text[160], copy[65];
  ern_sha256_hex(f->data, bytes, t->features);
  for (size_t k = 0; k < t->data.copy_count; k++) {
    ern_sha256_hex(t->data.copies[k].data, bytes, copy);
    const int length = ern_format(text, sizeof text, "%s%s%a", t->features, copy, (double)t->data.copy_share);
    ern_sha256_hex(text, (size_t)length, t->features);
  }
  if (t->data.speech_noise > 0) {
    const int length = ern_format(text, sizeof text, "%s%a", t->features, (double)t->data.speech_noise);
    ern_sha256_hex(text, (size_t)length, t->features);
  }
}

/* Refuses files at X that the first save must not replace: any file of an earlier training; with a resume, a file that
 * is not a model of this clip. */
static ern_status check_output(ern_trainer *t, bool resumed) {
  char before[ERN_ERROR_BYTES];
  ern_model *model = NULL;
  t->state.run.keep = !resumed && !t->shared.config.overwrite;
  if (t->shared.config.overwrite) return ERN_OK;
  if (!resumed)
    return ern_run_folder_check_free(t->shared.context, t->state.output, &t->state.run, t->shared.config.resume);
  if (access(t->state.output, F_OK) != 0) return ERN_OK;
  ern_error_keep(t->shared.context, before);
  const ern_status loaded = ern_model_load(&model, t->shared.context, t->state.output);
  const bool clip = loaded == ERN_OK && strcmp(model->clip, t->shared.identity) == 0;
  const bool torso = loaded == ERN_OK && model->field.config.torso, own = clip && torso == t->shared.config.torso;
  ern_model_free(&model);
  ern_error_restore(t->shared.context, before);
  if (own || loaded == ERN_E_NO_MEMORY) return loaded;
  return ern_fail(t->shared.context, ERN_E_EXISTS, "%s: is %s, and would be replaced; --overwrite does that",
                  t->state.output,
                  !clip   ? "no model of this clip"
                  : torso ? "a portrait with a torso"
                          : "a head without a torso");
}

/* Initial values, then those that a resume or --from puts in their place. */
static ern_status fill(ern_trainer *t) {
  const size_t n = t->shared.model->field.parameters;
  bool resumed = false;
  ern_status status = ERN_OK;
  ERN_TRY(t->shared.backend->upload_reals(t->shared.stream, t->shared.parameters, t->shared.model->block, n));
  ERN_TRY(t->shared.backend->copy(t->shared.stream, t->values.average, t->shared.parameters, n));
  ERN_TRY(
      t->shared.backend->upload_bytes(t->shared.stream, t->occupancy.bits, t->shared.model->bits, ERN_OCCUPANCY_BYTES));
  if (!t->shared.config.torso) {
    ERN_TRY(ern_trainer_mark(&t->occupancy));
    ERN_TRY(ern_trainer_list(&t->occupancy));
  }
  if (t->shared.config.resume && t->state.output != NULL) {
    ERN_TRY(ern_trainer_resume(&t->state, &resumed));
    ern_trainer_follow_time(&t->shared, t->shared.step);
    if (t->shared.step > t->shared.config.iters)
      ERN_TRY(ern_fail(t->shared.context, ERN_E_STATE,
                       "%s: the state is at step %" PRIu64 ", expected at most the %" PRIu64 " of --iters",
                       t->state.run.folder, t->shared.step, t->shared.config.iters));
  }
  if (t->state.output != NULL) ERN_TRY(check_output(t, resumed));
  if (t->shared.config.resume && t->state.output != NULL && !resumed)
    ern_log(t->shared.context, ERN_LOG_WARNING, "resume: nothing was saved in %s yet; starting at step 0",
            t->state.run.folder);
  if (!resumed && t->shared.config.from != NULL) ERN_TRY(ern_trainer_take_file(&t->state, t->shared.config.from));
  if (t->state.output != NULL && (!resumed || access(t->state.run.curve, F_OK) != 0))
    ERN_TRY(ern_lines_add(t->shared.context, &t->state.run.curve_lines, "step,seconds,psnr\n"));
fail:
  return status;
}

/* Only rank 0 reads and writes files. */
static void leave_files(ern_train_config *config) {
  config->output = config->from = config->torso_output = NULL;
  config->resume = false;
}

ern_status ern_trainer_create_sized(ern_trainer **trainer, ern_backend *backend, const ern_dataset *dataset,
                                    size_t dataset_bytes, const ern_train_config *config) {
  ERN_PLAIN_FLOATS;
  if (trainer != NULL) *trainer = NULL;
  ERN_NEED(NULL, backend);
  ern_context *context = backend->context;
  ERN_NEED(context, trainer);
  ERN_NEED(context, dataset);
  ern_train_config chosen = ern_train_config_default();
  ern_dataset data = {0};
  ern_trainer *t = NULL;
  ern_status status = ERN_OK;
  if (config != NULL) ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_train_config, &chosen, config));
  ERN_TRY(ERN_COPY_IN(context, ern_dataset, &data, dataset, dataset_bytes));
  ERN_TRY(check_config(context, &chosen));
  if (chosen.communicator != NULL && chosen.communicator->rank > 0) leave_files(&chosen);
  ERN_TRY(ERN_NEW(context, 1, &t));
  t->shared.context = context;
  t->shared.backend = backend;
  t->shared.data = data;
  t->shared.config = chosen;
  t->state = (struct ern_trainer_state){
      .training = &t->shared, .values = &t->values, .occupancy = &t->occupancy, .fine = &t->fine, .run = {.lock = -1}};
  t->torso_run.lock = -1;
  t->shared.communicator = (ern_communicator){.size = 1};
  if (chosen.communicator != NULL) t->shared.communicator = *chosen.communicator;
  t->shared.config.communicator = NULL;
  ERN_TRY(ern_trainer_fine_take(&t->fine, &t->shared));
  ERN_TRY(check_data(&t->shared));
  if (data.identity != NULL) memcpy(t->shared.identity, data.identity, strlen(data.identity) + 1);
  if (data.fingerprint != NULL) memcpy(t->shared.fingerprint, data.fingerprint, strlen(data.fingerprint) + 1);
  ERN_TRY(make_model(&t->shared));
  ERN_TRY(ern_trainer_choose_precision(&t->shared, "train", chosen.precision));
  ERN_TRY(backend->stream_make(backend, chosen.threads, &t->shared.stream));
  ERN_TRY(ern_trainer_values_make(&t->values, &t->shared));
  ERN_TRY(ern_trainer_occupancy_make(&t->occupancy, &t->shared, &t->speech));
  ERN_TRY(take_host(t));
  ERN_TRY(check_range(context, "scale", (double)t->shared.data.scale, ERN_LEAST_SCALE, ERN_MOST_SCALE));
  if (chosen.output != NULL) {
    ERN_TRY(ern_string_copy(context, chosen.output, &t->state.output));
    if (!chosen.resume && chosen.from == NULL) ERN_TRY(check_average(t)); /* before the folder is made */
    if (chosen.torso_output != NULL) {
      ERN_TRY(ern_run_folder_reserve(context, chosen.torso_output, chosen.resume, chosen.overwrite, &t->torso_run));
      ERN_TRY(ern_run_folder_check_outside(context, &t->torso_run, chosen.from));
    }
    ERN_TRY(ern_run_folder_open(context, t->state.output, &t->state.run));
    ERN_TRY(ern_run_folder_check_outside(context, &t->state.run, chosen.from));
  }
  if (chosen.output != NULL || t->shared.communicator.size > 1) name_features(&t->shared);
  ERN_TRY(fill(t));
  ERN_TRY(ern_trainer_share_state(t));
  ERN_TRY(ern_trainer_fine_begin(&t->fine));
  ERN_TRY(ern_trainer_batches_make(&t->batches, &t->fine, &t->speech, t->poses));
  /* a training that is resumed for longer refreshes again */
  t->occupancy.pruned = t->occupancy.pruned && ern_trainer_prune_due(&t->fine);
  ERN_TRY(check_average(t));
  /* the caller's texts and head are no longer used, only copies */
  t->shared.config.output = t->state.output;
  t->shared.config.from = t->shared.config.torso_output = NULL;
  t->shared.config.head = NULL;
  *trainer = t;
  return ERN_OK;
fail:
  ern_trainer_free(&t);
  return status;
}

void ern_trainer_free(ern_trainer **trainer) {
  if (trainer == NULL || *trainer == NULL) return;
  ern_trainer *t = *trainer;
  *trainer = NULL;
  ern_run_folder_close(t->shared.context, &t->state.run);
  ern_run_folder_close(t->shared.context, &t->torso_run);
  t->shared.backend->buffer_free(t->shared.backend, t->values.reals);
  ern_trainer_occupancy_free(&t->occupancy, t->shared.backend);
  t->shared.backend->buffer_free(t->shared.backend, t->fine.filter);
  ern_trainer_batches_free(&t->batches, t->shared.backend);
  t->shared.backend->stream_free(t->shared.stream);
  ern_pool_free(t->shared.pool);
  ern_trainer_speech_free(&t->speech, t->shared.context);
  ern_trainer_poses_free(&t->poses);
  ern_trainer_parts_free(&t->parts, t->shared.context);
  ern_release(t->shared.context, t->shared.views);
  ern_release(t->shared.context, t->shared.motion);
  ern_release(t->shared.context, t->state.output);
  ern_model_free(&t->shared.model);
  ern_release(t->shared.context, t);
}
