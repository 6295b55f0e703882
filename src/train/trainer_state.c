/* SPDX-License-Identifier: MIT
 * Writes and reads the state for a resume: weights, second moments, average, density grid, step. */
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
#include "train/state_about.h"

ern_status ern_trainer_download(ern_trainer *t, ern_span from) {
  ern_model *model = t->shared.model;
  ern_status status = ERN_OK;
  ERN_TRY(t->shared.backend->download_reals(t->shared.stream, model->block, from, model->field.parameters));
  ERN_TRY(t->shared.backend->download_bytes(t->shared.stream, model->bits, t->occupancy.bits, t->occupancy.bits.count));
  if (model->field.config.torso)
    ERN_TRY(t->shared.backend->download_reals(t->shared.stream, model->torso_grid, t->occupancy.torso_grid,
                                              t->occupancy.torso_grid.count));
  ERN_TRY(ern_trainer_poses_download(t->poses));
  *(t->shared.config.torso ? &model->torso_steps : &model->head_steps) = t->shared.step;
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

static void add_rows(struct state_tensors *s, const ern_trainer *t, const char *prefix, const float *block) {
  for (int r = 0; r < t->shared.model->table.rows; r++) {
    const struct ern_parameter *row = &t->shared.model->table.row[r];
    if (row->torso != t->shared.config.torso) continue;
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

static void add_poses(struct state_tensors *s, const ern_trainer *t) {
  const size_t frames = t->shared.data.frames[0];
  if (t->poses == NULL) return;
  s->tensor[s->count++] = (struct ern_tensor){.name = "state.camera",
                                              .dtype = ERN_F32,
                                              .dims = 2,
                                              .shape = {frames, ERN_POSE_PARAMETERS},
                                              .count = frames * ERN_POSE_PARAMETERS,
                                              .data = t->poses->row};
  s->tensor[s->count++] = (struct ern_tensor){.name = "state.camera_moment",
                                              .dtype = ERN_F32,
                                              .dims = 1,
                                              .shape = {2},
                                              .count = 2,
                                              .data = t->poses->mean_square};
}

static ern_status read_state(ern_trainer *t, struct state_tensors *s) {
  const size_t n = t->shared.model->field.parameters;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(t->shared.context, n, &s->second_moment));
  ERN_TRY(t->shared.backend->download_reals(t->shared.stream, s->second_moment, t->values.second_moment, n));
  ERN_TRY(ERN_NEW(t->shared.context, n, &s->average));
  ERN_TRY(t->shared.backend->download_reals(t->shared.stream, s->average, t->values.average, n));
  if (!t->shared.config.torso) {
    ERN_TRY(ERN_NEW(t->shared.context, ERN_OCCUPANCY_CELLS, &s->grid));
    ERN_TRY(t->shared.backend->download_reals(t->shared.stream, s->grid, t->occupancy.grid, ERN_OCCUPANCY_CELLS));
  }
  ern_model_tensors(t->shared.model, &s->model);
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
  add_poses(s, t);
fail:
  return status;
}

static ern_status move(ern_context *context, const char *from, const char *to) {
  if (rename(from, to) == 0) return ERN_OK;
  return ern_fail(context, ERN_E_IO, "%s: cannot become %s: %s", from, to, strerror(errno));
}

static ern_status write_next(ern_trainer *t) {
  struct state_tensors *s = NULL;
  char *model_text = NULL, *state_text = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(t->shared.context, 1, &s));
  ERN_TRY(read_state(t, s));
  ERN_TRY(ern_model_metadata(t->shared.model, &model_text));
  ERN_TRY(ern_state_about_text(t, &state_text));
  const struct ern_metadata metadata[] = {{"format", "ernerf"}, {"ernerf", model_text}, {"ernerf.state", state_text}};
  ERN_TRY(
      ern_safetensors_write(t->shared.context, t->run.next, s->tensor, s->count, metadata, 3, ERN_EXISTING_REPLACE));
fail:
  if (s != NULL) {
    ern_release(t->shared.context, s->second_moment);
    ern_release(t->shared.context, s->average);
    ern_release(t->shared.context, s->grid);
  }
  ern_release(t->shared.context, s);
  ern_release(t->shared.context, model_text);
  ern_release(t->shared.context, state_text);
  return status;
}

/* After a divergence the oldest state is kept permanently: it is from before the divergence, the newer one perhaps
 * not. */
static ern_status keep_good(ern_trainer *t) {
  const char *oldest = access(t->run.previous, F_OK) == 0 ? t->run.previous : t->run.state;
  if (t->diverged && access(oldest, F_OK) == 0) {
    const ern_status status = move(t->shared.context, oldest, t->run.good);
    if (status != ERN_OK) return status;
  }
  t->diverged = false;
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
static ern_status write_state(ern_trainer *t) {
  ern_status status = ERN_OK;
  if (!t->run.fresh) ERN_TRY(ern_run_folder_flush(t->shared.context, &t->run));
  const bool made = keep_rights(&t->run);
  status = write_next(t);
  if (status != ERN_OK && made) (void)unlink(t->run.next);
  if (status != ERN_OK) return status;
  if (t->run.fresh) {
    ern_run_folder_clear(&t->run);
    t->run.fresh = false;
    ERN_TRY(ern_run_folder_flush(t->shared.context, &t->run));
  }
  ERN_TRY(keep_good(t));
  if (access(t->run.state, F_OK) == 0 && !t->run.damaged)
    ERN_TRY(move(t->shared.context, t->run.state, t->run.previous));
  ERN_TRY(move(t->shared.context, t->run.next, t->run.state));
  t->run.damaged = false;
  t->saved = t->shared.step;
fail:
  return status;
}

ern_status ern_trainer_save(ern_trainer *t) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, t);
  ern_status status = ERN_OK;
  if (t->output == NULL) return ern_fail(t->shared.context, ERN_E_STATE, "save: this training has no output file");
  ERN_TRY(ern_run_folder_check_held(t->shared.context, &t->run));
  ERN_TRY(ern_trainer_download(t, t->shared.parameters));
  ERN_TRY(write_state(t));
  if (ern_trainer_is_averaged(&t->values))
    ERN_TRY(ern_trainer_download(t, t->values.average));
  else if (t->shared.config.ema)
    ern_log(t->shared.context, ERN_LOG_INFO,
            "%s: step %llu: the weights as they are, not their average: the average has seen %llu updates of the %d it "
            "needs",
            t->output, (unsigned long long)t->shared.step, (unsigned long long)t->values.ema_updates,
            ERN_LEAST_EMA_UPDATES);
  ERN_TRY(ern_model_write(t->shared.model, t->output, t->run.keep ? ERN_EXISTING_KEEP : ERN_EXISTING_REPLACE));
  t->run.keep = false;
fail:
  return status;
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

/* codes: compares the number of individual codes too. */
static ern_status check_config(ern_trainer *t, const ern_model *found, const char *path, bool codes) {
  const struct ern_model_config *a = &found->field.config, *b = &t->shared.model->field.config;
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
      return ern_fail(t->shared.context, ERN_E_MISMATCH, "%s: %s is %s, this training expects %s", path,
                      ern_kind_field((ern_kind)k), is, expected);
  }
  for (size_t i = 0; i < sizeof fields / sizeof *fields; i++)
    if (fields[i].found != fields[i].expected)
      return ern_fail(t->shared.context, ERN_E_MISMATCH, "%s: %s is %g, this training expects %g", path, fields[i].name,
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
static ern_status take_rows(ern_trainer *t, const struct ern_tensor_file *file, const char *path, const char *prefix,
                            const float *missing, ern_span to) {
  const bool torch = ern_tensor_file_metadata(file, "torch") != NULL;
  float *block = NULL;
  ern_status status = ERN_NEW(t->shared.context, t->shared.model->field.parameters, &block);
  if (status != ERN_OK) return status;
  if (missing != NULL) memcpy(block, missing, t->shared.model->field.parameters * sizeof(float));
  for (int r = 0; r < t->shared.model->table.rows; r++) {
    const struct ern_parameter *row = &t->shared.model->table.row[r];
    char name[ERN_PARAMETER_NAME + 16];
    if (row->torso != t->shared.config.torso) continue;
    snprintf(name, sizeof name, "%s%s", prefix, row->name);
    if (torch && ern_tensor_file_find(file, name) == NULL) continue;
    ERN_TRY(take_row(t->shared.context, file, path, name, row, block + row->at));
  }
  status = t->shared.backend->upload_reals(t->shared.stream, to, block, t->shared.model->field.parameters);
fail:
  ern_release(t->shared.context, block);
  return status;
}

/* Values and occupancy of `model` become the training's. */
static ern_status upload_model(ern_trainer *t, const ern_model *model) {
  ern_status status = ERN_OK;
  ERN_TRY(
      t->shared.backend->upload_reals(t->shared.stream, t->shared.parameters, model->block, model->field.parameters));
  ERN_TRY(t->shared.backend->upload_bytes(t->shared.stream, t->occupancy.bits, model->bits, t->occupancy.bits.count));
  if (model->field.config.torso) {
    double sum = 0;
    for (size_t i = 0; i < t->occupancy.torso_grid.count; i++) sum += (double)model->torso_grid[i];
    t->occupancy.torso_mean = sum / (double)t->occupancy.torso_grid.count;
    ERN_TRY(t->shared.backend->upload_reals(t->shared.stream, t->occupancy.torso_grid, model->torso_grid,
                                            t->occupancy.torso_grid.count));
  }
  t->shared.model->head_steps = model->head_steps;
  t->shared.model->torso_steps = model->torso_steps;
fail:
  return status;
}

static ern_status take_state(ern_trainer *t, const struct ern_tensor_file *file, const char *path,
                             const struct ern_state_about *about, const ern_model *model) {
  float *grid = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(upload_model(t, model));
  ERN_TRY(take_rows(t, file, path, "state.moment.", NULL, t->values.second_moment));
  ERN_TRY(take_rows(t, file, path, "state.average.", model->block, t->values.average));
  if (!t->shared.config.torso) {
    ERN_TRY(ERN_NEW(t->shared.context, ERN_OCCUPANCY_CELLS, &grid));
    const bool own = ern_tensor_file_find(file, "state.density_grid") != NULL;
    ERN_TRY(ern_tensor_take(t->shared.context, file, path, own ? "state.density_grid" : "density_grid", own ? 1 : 2,
                            own ? (size_t[]){ERN_OCCUPANCY_CELLS} : (size_t[]){1, ERN_OCCUPANCY_CELLS}, grid));
    ERN_TRY(t->shared.backend->upload_reals(t->shared.stream, t->occupancy.grid, grid, ERN_OCCUPANCY_CELLS));
    ERN_TRY(ern_trainer_list(&t->occupancy));
  }
  if (t->poses != NULL && !ern_trainer_is_foreign(t, model) && ern_tensor_file_find(file, "state.camera") != NULL) {
    const size_t shape[2] = {t->shared.data.frames[0], ERN_POSE_PARAMETERS}, two = 2;
    ERN_TRY(ern_tensor_take(t->shared.context, file, path, "state.camera", 2, shape, t->poses->row));
    ERN_TRY(ern_tensor_take(t->shared.context, file, path, "state.camera_moment", 1, &two, t->poses->mean_square));
  }
  t->shared.step = about->step;
  t->values.ema_updates = about->ema_updates;
  t->shared.seconds = about->seconds;
  t->shared.beside = about->beside;
  if (!about->said)
    ern_log(t->shared.context, ERN_LOG_INFO, "%s: goes on from PyTorch's optimizer, step %llu", path,
            (unsigned long long)about->step);
fail:
  ern_release(t->shared.context, grid);
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
 * one. tell: warn of damaged ones. */
static ern_status find_newest(ern_context *context, const struct ern_run_folder *run, bool tell,
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
      if (tell) ern_log_error(context, ERN_LOG_WARNING, "");
    }
    const bool newer = opened == ERN_OK && (best->model == NULL || c.about.step > best->about.step);
    close_candidate(context, newer ? best : &c);
    if (newer) *best = c;
  }
  return best->model != NULL ? ERN_OK : damaged;
}

/* Checks that a torso is resumed with the head that it was trained for. A head's individual codes are not compared: the
 * torso does not use them, and a longer clip has more of them. */
static ern_status check_same_head(ern_trainer *t, const ern_model *found, const char *path) {
  for (int r = 0; t->shared.config.torso && r < t->shared.model->table.rows; r++) {
    const struct ern_parameter *row = &t->shared.model->table.row[r];
    if (row->torso || strcmp(row->name, "individual_codes") == 0) continue;
    if (memcmp(found->block + row->at, t->shared.model->block + row->at, row->count * sizeof(float)) != 0)
      return ern_fail(t->shared.context, ERN_E_MISMATCH,
                      "%s: %s is that of another head, expected the head that this torso was trained for", path,
                      row->name);
  }
  return ERN_OK;
}

ern_status ern_trainer_resume(ern_trainer *t, bool *resumed) {
  struct candidate best;
  *resumed = false;
  ern_status status = find_newest(t->shared.context, &t->run, true, &best);
  if (best.model == NULL) return status; /* nothing saved yet, or nothing readable */
  if (best.about.torso != t->shared.config.torso)
    ERN_TRY(ern_fail(t->shared.context, ERN_E_MISMATCH, "%s: is the state of a %s training, expected a %s one",
                     best.path, best.about.torso ? "torso" : "head", t->shared.config.torso ? "torso" : "head"));
  if (strcmp(best.model->clip, t->shared.identity) != 0)
    ERN_TRY(ern_fail(
        t->shared.context, ERN_E_MISMATCH,
        "%s: is the state of another clip (%.12s..., this one is %.12s...); expected the clip that it began with, "
        "another output, or to overwrite it",
        best.path, best.model->clip, t->shared.identity));
  ERN_TRY(check_config(t, best.model, best.path, true));
  ERN_TRY(check_same_head(t, best.model, best.path));
  if (t->shared.config.precision == ERN_PRECISION_DEFAULT && best.about.said)
    ERN_TRY(ern_trainer_choose_precision(t, best.path, best.about.config.precision));
  ERN_TRY(ern_state_about_check(t, best.path, &best.about, &best.model->view));
  ERN_TRY(take_state(t, &best.file, best.path, &best.about, best.model));
  ern_trainer_keep_consent(t, best.model);
  t->fine.from = best.about.fine_from;
  t->occupancy.pruned = best.about.pruned;
  ERN_TRY(ern_run_folder_trim(t->shared.context, &t->run, t->shared.step));
  t->run.fresh = false;
  t->run.damaged = best.path == t->run.previous && access(t->run.state, F_OK) == 0;
  t->saved = t->shared.step;
  *resumed = true;
fail:
  close_candidate(t->shared.context, &best);
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
                         .rays = about->said ? c->rays : 0,
                         .has_settings = about->said,
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
static ern_status take_over(ern_trainer *t, const char *path, ern_model **model) {
  ern_model *made = NULL;
  const ern_status status = ern_model_make(&made, t->shared.context, &t->shared.model->field.config);
  if (status != ERN_OK) return status;
  memcpy(made->block, t->shared.model->block, t->shared.model->field.parameters * sizeof(float));
  memcpy(made->bits, t->shared.model->bits, ERN_OCCUPANCY_BYTES);
  memcpy(made->clip, (*model)->clip, sizeof made->clip);
  made->head_steps = t->shared.model->head_steps;
  if (t->shared.config.head == NULL) ern_trainer_copy_rows(made, *model, false);
  if (t->shared.config.torso) ern_trainer_copy_rows(made, *model, true);
  ern_trainer_log_codes(t, path, (*model)->field.config.codes);
  ern_model_free(model);
  *model = made;
  return ERN_OK;
}

ern_status ern_trainer_take_file(ern_trainer *t, const char *path) {
  struct candidate c = {.path = path};
  ern_status status = ERN_OK;
  ERN_TRY(ern_checkpoint_read(t->shared.context, path, &c.file));
  ERN_TRY(ern_model_from_file(&c.model, t->shared.context, &c.file, path));
  ERN_TRY(check_config(t, c.model, path, false));
  const bool foreign = ern_trainer_is_foreign(t, c.model);
  if (!foreign) ERN_TRY(ern_trainer_poses_take(t->poses, c.model));
  ern_trainer_keep_consent(t, c.model);
  if (c.model->cameras > 0 && (foreign || t->poses == NULL))
    ern_log(t->shared.context, ERN_LOG_WARNING, "%s: its pose corrections are %s", path,
            foreign ? "of the frames of another clip, and are left out" : "not trained on, nor applied while training");
  ERN_TRY(ern_trainer_check_view(t, path, &c.model->view, c.model->field.config.torso, false));
  if (t->shared.config.torso && t->shared.model->cameras == 0 && !foreign)
    ERN_TRY(ern_trainer_copy_camera(t->shared.model, c.model));
  ERN_TRY(take_over(t, path, &c.model));
  const char *text = ern_tensor_file_metadata(&c.file, "ernerf.state");
  if (text != NULL) {
    ERN_TRY(ern_state_about_parse(t->shared.context, text, path, &c.about));
    if (c.about.torso != t->shared.config.torso)
      ERN_TRY(ern_fail(t->shared.context, ERN_E_MISMATCH, "%s: is the state of a %s training", path,
                       c.about.torso ? "torso" : "head"));
    ERN_TRY(take_state(t, &c.file, path, &c.about, c.model));
  } else {
    ERN_TRY(upload_model(t, c.model));
    ERN_TRY(t->shared.backend->copy(t->shared.stream, t->values.average, t->shared.parameters,
                                    t->shared.model->field.parameters));
    *(t->shared.config.torso ? &t->shared.model->torso_steps : &t->shared.model->head_steps) = 0;
  }
  if (t->shared.config.seconds > 0 && t->shared.seconds + t->shared.beside >= t->shared.config.seconds)
    ERN_TRY(ern_fail(t->shared.context, ERN_E_STATE,
                     "%s: has been trained for %.1f s already, expected less than the %.1f s of this training", path,
                     t->shared.seconds + t->shared.beside, t->shared.config.seconds));
  if (!(t->shared.config.seconds > 0) && t->shared.step >= t->shared.config.iters)
    ERN_TRY(ern_fail(t->shared.context, ERN_E_STATE, "%s: is already at step %llu, expected below the %llu of --iters",
                     path, (unsigned long long)t->shared.step, (unsigned long long)t->shared.config.iters));
fail:
  close_candidate(t->shared.context, &c);
  return status;
}
