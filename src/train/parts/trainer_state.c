/* SPDX-License-Identifier: MIT
 * Writes and reads the state for a resume: weights, second moments, average, density grid, step. */
#include "train/parts/trainer_state.h"
#include "train/parts/trainer_fade.h"
#include "train/parts/trainer_motion.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "io/file.h"
#include "model/checkpoint.h"
#include "model/kinds.h"
#include "train/parts/trainer_model.h"
#include "train/state_about.h"

ern_status ern_trainer_download(struct ern_trainer_state *state, ern_span from) {
  struct ern_training *t = state->training;
  ern_model *model = t->model;
  ern_status status = ERN_OK;
  ERN_TRY(t->backend->download_reals(t->stream, model->block, from, model->field.parameters));
  ERN_TRY(t->backend->download_bytes(t->stream, model->bits, state->occupancy->bits, state->occupancy->bits.count));
  if (model->field.config.torso)
    ERN_TRY(t->backend->download_reals(t->stream, model->torso_grid, state->occupancy->torso_grid,
                                       state->occupancy->torso_grid.count));
  ERN_TRY(ern_trainer_poses_download(state->poses));
  *(t->config.torso ? &model->torso_steps : &model->head_steps) = t->step;
fail:
  return status;
}

/* ---- writing ----------------------------------------------------------------------------------------------------- */

/* Everything of a state file in host memory, and the list of its tensors. */
struct state_tensors {
  float *second_moment, *average, *grid;
  struct ern_model_tensors model;
  struct ern_tensor tensor[3 * ERN_MODEL_TENSORS];
  char name[2 * ERN_MAX_PARAMETERS][ERN_PARAMETER_NAME + 16];
  size_t count, names;
};

static void add_rows(struct state_tensors *s, const struct ern_training *t, const char *prefix, const float *block) {
  for (int r = 0; r < t->model->table.rows; r++) {
    const struct ern_parameter *row = &t->model->table.row[r];
    if (row->torso != t->config.torso) continue;
    char *name = s->name[s->names++];
    snprintf(name, sizeof s->name[0], "%s%s", prefix, row->name);
    s->tensor[s->count++] = (struct ern_tensor){.name = name,
                                                .dtype = ERN_F32,
                                                .dims = row->dims,
                                                .shape = {row->shape[0], row->shape[1], row->shape[2]},
                                                .count = row->count,
                                                .data = block + row->at};
  }
}

static void add_poses(struct state_tensors *s, const struct ern_trainer_poses *poses) {
  if (poses == NULL) return;
  const size_t frames = poses->training->data.frames[0];
  s->tensor[s->count++] = (struct ern_tensor){.name = "state.camera",
                                              .dtype = ERN_F32,
                                              .dims = 2,
                                              .shape = {frames, ERN_POSE_PARAMETERS},
                                              .count = frames * ERN_POSE_PARAMETERS,
                                              .data = poses->row};
  s->tensor[s->count++] = (struct ern_tensor){
      .name = "state.camera_moment", .dtype = ERN_F32, .dims = 1, .shape = {2}, .count = 2, .data = poses->mean_square};
}

static ern_status read_state(struct ern_trainer_state *state, struct state_tensors *s) {
  struct ern_training *t = state->training;
  const size_t n = t->model->field.parameters;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(t->context, n, &s->second_moment));
  ERN_TRY(t->backend->download_reals(t->stream, s->second_moment, state->values->second_moment, n));
  ERN_TRY(ERN_NEW(t->context, n, &s->average));
  ERN_TRY(t->backend->download_reals(t->stream, s->average, state->values->average, n));
  if (!t->config.torso) {
    ERN_TRY(ERN_NEW(t->context, ERN_OCCUPANCY_CELLS, &s->grid));
    ERN_TRY(t->backend->download_reals(t->stream, s->grid, state->occupancy->grid, ERN_OCCUPANCY_CELLS));
  }
  ern_model_tensors(t->model, &s->model);
  memcpy(s->tensor, s->model.tensor, s->model.count * sizeof s->tensor[0]);
  s->count = s->model.count;
  add_rows(s, t, "state.moment.", s->second_moment);
  add_rows(s, t, "state.average.", s->average);
  if (s->grid != NULL)
    s->tensor[s->count++] = (struct ern_tensor){.name = "state.density_grid",
                                                .dtype = ERN_F32,
                                                .dims = 1,
                                                .shape = {ERN_OCCUPANCY_CELLS},
                                                .count = ERN_OCCUPANCY_CELLS,
                                                .data = s->grid};
  add_poses(s, state->poses);
fail:
  return status;
}

/* The configuration has what the training made of it. */
static void describe(const struct ern_trainer_state *state, struct ern_state_about *about) {
  const struct ern_training *t = state->training;
  *about = (struct ern_state_about){.torso = t->config.torso,
                                    .step = t->step,
                                    .ema_updates = state->values->ema_updates,
                                    .seconds = t->seconds + t->pending_seconds,
                                    .has_settings = true,
                                    .config = t->config,
                                    .layer = t->data.has_torso,
                                    .beside = t->beside,
                                    .fine_from = state->fine->from,
                                    .fine_value = state->fine->value,
                                    .pruned = state->occupancy->pruned};
  about->config.precision = t->bf16 ? ERN_PRECISION_BF16 : ERN_PRECISION_FP32;
  about->config.refine_poses = state->poses != NULL;
  memcpy(about->features, t->features, sizeof about->features);
  memcpy(about->fingerprint, t->fingerprint, sizeof about->fingerprint);
  snprintf(about->fine_loss, sizeof about->fine_loss, "%s", ern_trainer_fine_name(t));
}

static ern_status move(ern_context *context, const char *from, const char *to) {
  if (rename(from, to) == 0) return ERN_OK;
  return ern_fail(context, ERN_E_IO, "%s: cannot become %s: %s", from, to, strerror(errno));
}

static ern_status write_next(struct ern_trainer_state *state) {
  struct ern_training *t = state->training;
  struct state_tensors *s = NULL;
  struct ern_state_about about;
  char *model_text = NULL, *state_text = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(t->context, 1, &s));
  ERN_TRY(read_state(state, s));
  ERN_TRY(ern_model_metadata(t->model, &model_text));
  describe(state, &about);
  ERN_TRY(ern_state_about_text(t->context, &about, &state_text));
  const struct ern_metadata metadata[] = {{"format", "ernerf"}, {"ernerf", model_text}, {"ernerf.state", state_text}};
  ERN_TRY(ern_safetensors_write(t->context, state->run.next, s->tensor, s->count, metadata, 3, ERN_EXISTING_REPLACE));
fail:
  if (s != NULL) {
    ern_release(t->context, s->second_moment);
    ern_release(t->context, s->average);
    ern_release(t->context, s->grid);
  }
  ern_release(t->context, s);
  ern_release(t->context, model_text);
  ern_release(t->context, state_text);
  return status;
}

/* After a divergence the oldest state is kept permanently: it is from before the divergence, the newer one perhaps
 * not. */
static ern_status keep_good(struct ern_trainer_state *state) {
  struct ern_training *t = state->training;
  const char *oldest = access(state->run.previous, F_OK) == 0 ? state->run.previous : state->run.state;
  if (state->diverged && access(oldest, F_OK) == 0) {
    const ern_status status = move(t->context, oldest, state->run.good);
    if (status != ERN_OK) return status;
  }
  state->diverged = false;
  return ERN_OK;
}

/* Gives the new state the permissions of the last one: makes an empty file with them, which the writer replaces. True:
 * it was made. */
static bool keep_rights(const struct ern_run_folder *run) {
  struct stat about;
  if (stat(run->state, &about) != 0 || (about.st_mode & 044) == 044) return false; /* everybody may read it */
  const int made = open(run->next, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (made < 0) return false;
  const bool group = fchown(made, (uid_t)-1, about.st_gid) == 0;
  (void)fchmod(made, about.st_mode & (group ? 0777 : 0707));
  close(made);
  return true;
}

/* The new state is completely written under its own name before any file is renamed; a resume takes the newest intact
 * file of the three names. The log is written first: it can be truncated to match the state, but not reconstructed. A
 * new training holds its log back until its state exists, as the log would otherwise accompany the earlier training's
 * state. */
static ern_status write_state(struct ern_trainer_state *state) {
  struct ern_training *t = state->training;
  ern_status status = ERN_OK;
  if (!state->run.fresh) ERN_TRY(ern_run_folder_flush(t->context, &state->run));
  const bool made = keep_rights(&state->run);
  status = write_next(state);
  if (status != ERN_OK && made) (void)unlink(state->run.next);
  if (status != ERN_OK) return status;
  if (state->run.fresh) {
    ern_run_folder_clear(&state->run);
    state->run.fresh = false;
    ERN_TRY(ern_run_folder_flush(t->context, &state->run));
  }
  ERN_TRY(keep_good(state));
  if (access(state->run.state, F_OK) == 0 && !state->run.damaged)
    ERN_TRY(move(t->context, state->run.state, state->run.previous));
  ERN_TRY(move(t->context, state->run.next, state->run.state));
  state->run.damaged = false;
  state->saved = t->step;
fail:
  return status;
}

ern_status ern_trainer_state_save(struct ern_trainer_state *state) {
  struct ern_training *t = state->training;
  ern_status status = ERN_OK;
  if (state->output == NULL) return ern_fail(t->context, ERN_E_STATE, "save: this training has no output file");
  ERN_TRY(ern_run_folder_check_held(t->context, &state->run));
  ERN_TRY(ern_trainer_download(state, t->parameters));
  ERN_TRY(write_state(state));
  if (ern_trainer_is_averaged(state->values))
    ERN_TRY(ern_trainer_download(state, state->values->average));
  else if (t->config.ema)
    ern_log(t->context, ERN_LOG_INFO,
            "%s: step %llu: the weights as they are, not their average: the average has seen %llu updates of the %d it "
            "needs",
            state->output, (unsigned long long)t->step, (unsigned long long)state->values->ema_updates,
            ERN_LEAST_EMA_UPDATES);
  ERN_TRY(ern_model_write(t->model, state->output, state->run.keep ? ERN_EXISTING_KEEP : ERN_EXISTING_REPLACE));
  state->run.keep = false;
fail:
  return status;
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

/* codes: compares the number of individual codes too. */
static ern_status check_config(const struct ern_training *t, const ern_model *found, const char *path, bool codes) {
  const struct ern_model_config *a = &found->field.config, *b = &t->model->field.config;
  const struct {
    const char *name;
    double found, expected;
  } fields[] = {{"levels", a->levels, b->levels},
                {"feature width", a->feature_width, b->feature_width},
                {"window length", a->window_length > 0 ? a->window_length : b->window_length, b->window_length},
                {"eye branch", a->eye, b->eye},
                {"view dependence", !a->no_view, !b->no_view},
                {"torso", a->torso, b->torso},
                {"torso gamma", a->torso_gamma, b->torso_gamma},
                {"individual codes", codes ? a->codes : a->codes > 0, codes ? b->codes : b->codes > 0},
                {"bound", (double)a->bound, (double)b->bound}};
  for (int k = 0; k < ERN_KINDS; k++) {
    const char *is = ern_kind_of(a, (ern_kind)k), *expected = ern_kind_of(b, (ern_kind)k);
    if (strcmp(is, expected) != 0)
      return ern_fail(t->context, ERN_E_MISMATCH, "%s: %s is %s, this training expects %s", path,
                      ern_kind_field((ern_kind)k), is, expected);
  }
  for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
    if (fields[i].found != fields[i].expected)
      return ern_fail(t->context, ERN_E_MISMATCH, "%s: %s is %g, this training expects %g", path, fields[i].name,
                      fields[i].found, fields[i].expected);
  return ERN_OK;
}

/* A row's values from a tensor of its shape; of individual codes the first ones of those that the file has, the others
 * staying as they are. */
static ern_status take_row(ern_context *context, const struct ern_tensor_file *file, const char *path, const char *name,
                           const struct ern_parameter *row, float *out) {
  const struct ern_tensor *tensor = ern_tensor_file_find(file, name);
  const bool codes = strncmp(row->name, "individual_codes", 16) == 0;
  if (!codes || tensor == NULL || tensor->dims != 2 || tensor->shape[0] == row->shape[0])
    return ern_tensor_take(context, file, path, name, row->dims, row->shape, out);
  float *values = NULL;
  ern_status status = ERN_NEW(context, tensor->count, &values);
  if (status != ERN_OK) return status;
  status = ern_tensor_take(context, file, path, name, 2, (size_t[]){tensor->shape[0], row->shape[1]}, values);
  if (status == ERN_OK) memcpy(out, values, (tensor->count < row->count ? tensor->count : row->count) * sizeof(float));
  ern_release(context, values);
  return status;
}

/* Loads the rows that this training changes from the tensors with a prefix, and uploads them to the backend. `missing`
 * (a block, or NULL: zeros) gives the values of the other rows, of tensors without a gradient so far, for which
 * PyTorch's optimizer keeps nothing, and of an average that was not saved. */
static ern_status take_rows(const struct ern_training *t, const struct ern_tensor_file *file, const char *path,
                            const char *prefix, const float *missing, ern_span to) {
  const bool torch = ern_tensor_file_metadata(file, "torch") != NULL;
  float *block = NULL;
  ern_status status = ERN_NEW(t->context, t->model->field.parameters, &block);
  if (status != ERN_OK) return status;
  if (missing != NULL) memcpy(block, missing, t->model->field.parameters * sizeof(float));
  for (int r = 0; r < t->model->table.rows; r++) {
    const struct ern_parameter *row = &t->model->table.row[r];
    char name[ERN_PARAMETER_NAME + 16];
    if (row->torso != t->config.torso) continue;
    snprintf(name, sizeof name, "%s%s", prefix, row->name);
    if (torch && ern_tensor_file_find(file, name) == NULL) continue;
    ERN_TRY(take_row(t->context, file, path, name, row, block + row->at));
  }
  status = t->backend->upload_reals(t->stream, to, block, t->model->field.parameters);
fail:
  ern_release(t->context, block);
  return status;
}

/* Values and occupancy of `model` become the training's. */
static ern_status upload_model(struct ern_trainer_state *state, const ern_model *model) {
  struct ern_training *t = state->training;
  ern_status status = ERN_OK;
  ERN_TRY(t->backend->upload_reals(t->stream, t->parameters, model->block, model->field.parameters));
  ERN_TRY(t->backend->upload_bytes(t->stream, state->occupancy->bits, model->bits, state->occupancy->bits.count));
  if (model->field.config.torso) {
    double sum = 0;
    for (size_t i = 0; i < state->occupancy->torso_grid.count; i++) sum += (double)model->torso_grid[i];
    state->occupancy->torso_mean = sum / (double)state->occupancy->torso_grid.count;
    ERN_TRY(t->backend->upload_reals(t->stream, state->occupancy->torso_grid, model->torso_grid,
                                     state->occupancy->torso_grid.count));
  }
  t->model->head_steps = model->head_steps;
  t->model->torso_steps = model->torso_steps;
fail:
  return status;
}

static ern_status take_state(struct ern_trainer_state *state, const struct ern_tensor_file *file, const char *path,
                             const struct ern_state_about *about, const ern_model *model) {
  struct ern_training *t = state->training;
  float *grid = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(upload_model(state, model));
  ERN_TRY(take_rows(t, file, path, "state.moment.", NULL, state->values->second_moment));
  ERN_TRY(take_rows(t, file, path, "state.average.", model->block, state->values->average));
  if (!t->config.torso) {
    ERN_TRY(ERN_NEW(t->context, ERN_OCCUPANCY_CELLS, &grid));
    const bool own = ern_tensor_file_find(file, "state.density_grid") != NULL;
    ERN_TRY(ern_tensor_take(t->context, file, path, own ? "state.density_grid" : "density_grid", own ? 1 : 2,
                            own ? (size_t[]){ERN_OCCUPANCY_CELLS} : (size_t[]){1, ERN_OCCUPANCY_CELLS}, grid));
    ERN_TRY(t->backend->upload_reals(t->stream, state->occupancy->grid, grid, ERN_OCCUPANCY_CELLS));
    ERN_TRY(ern_trainer_list(state->occupancy));
  }
  if (state->poses != NULL && !ern_trainer_is_foreign(t, model) && ern_tensor_file_find(file, "state.camera") != NULL) {
    const size_t shape[2] = {t->data.frames[0], ERN_POSE_PARAMETERS}, two = 2;
    ERN_TRY(ern_tensor_take(t->context, file, path, "state.camera", 2, shape, state->poses->row));
    ERN_TRY(ern_tensor_take(t->context, file, path, "state.camera_moment", 1, &two, state->poses->mean_square));
  }
  t->step = about->step;
  state->values->ema_updates = about->ema_updates;
  t->seconds = about->seconds;
  t->beside = about->beside;
  if (!about->has_settings)
    ern_log(t->context, ERN_LOG_INFO, "%s: goes on from PyTorch's optimizer, step %llu", path,
            (unsigned long long)about->step);
fail:
  ern_release(t->context, grid);
  return status;
}

/* A candidate of a resume, opened and verified. */
struct candidate {
  const char *path;
  struct ern_tensor_file file;
  ern_model *model;
  struct ern_state_about about;
};

static ern_status open_candidate(ern_context *context, const char *path, struct candidate *c) {
  ern_status status = ERN_OK;
  *c = (struct candidate){.path = path};
  ERN_TRY(ern_safetensors_read(context, path, &c->file));
  const char *text = ern_tensor_file_metadata(&c->file, "ernerf.state");
  if (text == NULL) ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: is no training state", path));
  ERN_TRY(ern_state_about_parse(context, text, path, &c->about));
  ERN_TRY(ern_model_from_file(&c->model, context, &c->file, path));
fail:
  return status;
}

static void close_candidate(ern_context *context, struct candidate *c) {
  ern_tensor_file_free(context, &c->file);
  ern_model_free(&c->model);
}

/* The newest intact state of the folder. Where there is none, its model is NULL and the status is that of a damaged
 * one. warn: of damaged ones. */
static ern_status find_newest(ern_context *context, const struct ern_run_folder *run, bool warn,
                              struct candidate *best) {
  const char *const paths[] = {run->next, run->state, run->previous};
  ern_status damaged = ERN_OK;
  *best = (struct candidate){0};
  for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
    struct candidate c;
    if (access(paths[i], F_OK) != 0) continue;
    const ern_status opened = open_candidate(context, paths[i], &c);
    if (opened == ERN_E_NO_MEMORY) {
      close_candidate(context, &c);
      close_candidate(context, best);
      return opened;
    }
    if (opened != ERN_OK) {
      damaged = opened;
      if (warn) ern_log_error(context, ERN_LOG_WARNING, "");
    }
    const bool newer = opened == ERN_OK && (best->model == NULL || c.about.step > best->about.step);
    close_candidate(context, newer ? best : &c);
    if (newer) *best = c;
  }
  return best->model != NULL ? ERN_OK : damaged;
}

/* Checks that a torso is resumed with the head that it was trained for. A head's individual codes are not compared: the
 * torso does not use them, and a longer clip has more of them. */
static ern_status check_same_head(const struct ern_training *t, const ern_model *found, const char *path) {
  for (int r = 0; t->config.torso && r < t->model->table.rows; r++) {
    const struct ern_parameter *row = &t->model->table.row[r];
    if (row->torso || strcmp(row->name, "individual_codes") == 0) continue;
    if (memcmp(found->block + row->at, t->model->block + row->at, row->count * sizeof(float)) != 0)
      return ern_fail(t->context, ERN_E_MISMATCH,
                      "%s: %s is that of another head, expected the head that this torso was trained for", path,
                      row->name);
  }
  return ERN_OK;
}

ern_status ern_trainer_resume(struct ern_trainer_state *state, bool *resumed) {
  struct ern_training *t = state->training;
  struct candidate best;
  struct ern_state_about here;
  *resumed = false;
  ern_status status = find_newest(t->context, &state->run, true, &best);
  if (best.model == NULL) return status; /* nothing saved yet, or nothing readable */
  if (best.about.torso != t->config.torso)
    ERN_TRY(ern_fail(t->context, ERN_E_MISMATCH, "%s: is the state of a %s training, expected a %s one", best.path,
                     best.about.torso ? "torso" : "head", t->config.torso ? "torso" : "head"));
  if (strcmp(best.model->clip, t->identity) != 0)
    ERN_TRY(ern_fail(
        t->context, ERN_E_MISMATCH,
        "%s: is the state of another clip (%.12s..., this one is %.12s...); expected the clip that it began with, "
        "another output, or to overwrite it",
        best.path, best.model->clip, t->identity));
  ERN_TRY(check_config(t, best.model, best.path, true));
  ERN_TRY(check_same_head(t, best.model, best.path));
  if (t->config.precision == ERN_PRECISION_DEFAULT && best.about.has_settings)
    ERN_TRY(ern_trainer_choose_precision(t, best.path, best.about.config.precision));
  describe(state, &here);
  ERN_TRY(ern_state_about_check(t, best.path, &best.about, &here, &best.model->view));
  ERN_TRY(ern_trainer_motion_follow(t, best.model, best.path, true));
  ern_trainer_fade_follow(t, best.model, best.path);
  ERN_TRY(take_state(state, &best.file, best.path, &best.about, best.model));
  ern_trainer_keep_consent(t, best.model);
  state->fine->from = best.about.fine_from;
  if (best.about.config.patch_size == t->config.patch_size) state->fine->value = best.about.fine_value;
  state->occupancy->pruned = best.about.pruned;
  ERN_TRY(ern_run_folder_trim(t->context, &state->run, t->step));
  state->run.fresh = false;
  state->run.damaged = best.path == state->run.previous && access(state->run.state, F_OK) == 0;
  state->saved = t->step;
  *resumed = true;
fail:
  close_candidate(t->context, &best);
  return status;
}

ern_status ern_train_state_describe_sized(ern_context *context, const char *output, ern_train_state *state,
                                          size_t state_bytes, ern_model_info *model, size_t model_bytes) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, output);
  ERN_NEED(context, state);
  ERN_NEED(context, model);
  struct ern_run_folder run;
  struct candidate best = {0};
  ern_status status = ERN_OK;
  ERN_TRY(ern_run_folder_name(context, output, &run));
  ERN_TRY(find_newest(context, &run, false, &best));
  if (best.model == NULL) ERN_TRY(ern_fail(context, ERN_E_MISSING, "%s: holds no state of a training", run.folder));
  const struct ern_state_about *about = &best.about;
  ern_train_config *c = &best.about.config;
  if (about->fine_from < c->iters) c->fine_steps = c->iters - about->fine_from;
  ern_train_state own = {.torso = about->torso,
                         .step = about->step,
                         .seed = c->seed,
                         .rays = about->has_settings ? c->rays : 0,
                         .has_settings = about->has_settings,
                         .iters = c->iters,
                         .lr = c->lr,
                         .lr_net = c->lr_net,
                         .lr_att = c->lr_att,
                         .refresh_every = c->refresh_every,
                         .ema_every = c->ema_every,
                         .data_begin = c->data_begin,
                         .data_end = c->data_end,
                         .torso_layer = about->layer,
                         .ema = c->ema,
                         .precision = c->precision,
                         .ray_sampling = c->ray_sampling,
                         .budget = c->seconds,
                         .seconds = about->seconds,
                         .refine_poses = c->refine_poses,
                         .torso_gamma = c->torso_gamma,
                         .torso_random_background = c->torso_random_background,
                         .frames_per_step = c->frames_per_step,
                         .fine_steps = c->fine_steps,
                         .patch_size = about->fine_from != UINT64_MAX ? c->patch_size : 0,
                         .fine_weight = c->fine_weight,
                         .fine_lips_weight = c->fine_lips_weight,
                         .fine_share = c->fine_share,
                         .prune_share = c->prune_share,
                         .step_parts = c->step_parts,
                         .head_random_background = c->head_random_background,
                         .config = *c};
  memcpy(own.fine_loss, about->fine_loss, sizeof own.fine_loss);
  ern_struct_copy_out(state, state_bytes, &own, sizeof own);
  ern_model_describe_sized(best.model, model, model_bytes);
fail:
  close_candidate(context, &best);
  ern_run_folder_close(context, &run);
  return status;
}

/* Converts *model to this training's shape: additional individual codes get the initial values of a new training. A
 * torso keeps the head that it was given. */
static ern_status take_over(const struct ern_training *t, const char *path, ern_model **model) {
  ern_model *made = NULL;
  const ern_status status = ern_model_make(&made, t->context, &t->model->field.config);
  if (status != ERN_OK) return status;
  memcpy(made->block, t->model->block, t->model->field.parameters * sizeof(float));
  memcpy(made->bits, t->model->bits, ERN_OCCUPANCY_BYTES);
  memcpy(made->clip, (*model)->clip, sizeof made->clip);
  made->head_steps = t->model->head_steps;
  if (t->config.head == NULL) ern_trainer_copy_rows(made, *model, false);
  if (t->config.torso) ern_trainer_copy_rows(made, *model, true);
  ern_trainer_log_codes(t, path, (*model)->field.config.codes);
  ern_model_free(model);
  *model = made;
  return ERN_OK;
}

ern_status ern_trainer_take_file(struct ern_trainer_state *state, const char *path) {
  struct ern_training *t = state->training;
  struct candidate c = {.path = path};
  ern_status status = ERN_OK;
  ERN_TRY(ern_checkpoint_read(t->context, path, &c.file));
  ERN_TRY(ern_model_from_file(&c.model, t->context, &c.file, path));
  ERN_TRY(check_config(t, c.model, path, false));
  const bool foreign = ern_trainer_is_foreign(t, c.model);
  if (!foreign) ERN_TRY(ern_trainer_poses_take(state->poses, c.model));
  ern_trainer_keep_consent(t, c.model);
  if (c.model->cameras > 0 && (foreign || state->poses == NULL))
    ern_log(t->context, ERN_LOG_WARNING, "%s: its pose corrections are %s", path,
            foreign ? "of the frames of another clip, and are left out" : "not trained on, nor applied while training");
  ERN_TRY(ern_trainer_check_view(t, path, &c.model->view, c.model->field.config.torso, false));
  if (t->config.torso && t->model->cameras == 0 && !foreign) ERN_TRY(ern_trainer_copy_camera(t->model, c.model));
  ERN_TRY(ern_trainer_motion_follow(t, c.model, path, false));
  if (t->config.head == NULL) ern_trainer_fade_follow(t, c.model, path);
  ERN_TRY(take_over(t, path, &c.model));
  const char *text = ern_tensor_file_metadata(&c.file, "ernerf.state");
  if (text != NULL) {
    ERN_TRY(ern_state_about_parse(t->context, text, path, &c.about));
    if (c.about.torso != t->config.torso)
      ERN_TRY(ern_fail(t->context, ERN_E_MISMATCH, "%s: is the state of a %s training", path,
                       c.about.torso ? "torso" : "head"));
    ERN_TRY(take_state(state, &c.file, path, &c.about, c.model));
  } else {
    ERN_TRY(upload_model(state, c.model));
    ERN_TRY(t->backend->copy(t->stream, state->values->average, t->parameters, t->model->field.parameters));
    *(t->config.torso ? &t->model->torso_steps : &t->model->head_steps) = 0;
  }
  if (t->config.seconds > 0 && t->seconds + t->beside >= t->config.seconds)
    ERN_TRY(ern_fail(t->context, ERN_E_STATE,
                     "%s: has been trained for %.1f s already, expected less than the %.1f s of this training", path,
                     t->seconds + t->beside, t->config.seconds));
  if (!(t->config.seconds > 0) && t->step >= t->config.iters)
    ERN_TRY(ern_fail(t->context, ERN_E_STATE, "%s: is already at step %llu, expected below the %llu of --iters", path,
                     (unsigned long long)t->step, (unsigned long long)t->config.iters));
fail:
  close_candidate(t->context, &c);
  return status;
}
