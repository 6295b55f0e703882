/* SPDX-License-Identifier: MIT
 * A trainer on the scene: one training frame, learning rates of 0, the scene's model in place of initial values. */
#include <string.h>

#include "core/memory.h"
#include "core/status.h"
#include "lab/bench/bench_shared.h"
#include "model/torso_ops.h"
#include "train/trainer.h"

/* Matrix of a transforms file from a pose; the inverse of ern_camera_pose, exact for a scale of 4. */
static void matrix_of(float matrix[16], const float pose[16], float scale) {
  static const int row[3] = {1, 2, 0};
  for (int r = 0; r < 3; r++) {
    float *to = matrix + 4 * row[r];
    to[0] = pose[4 * r];
    to[1] = -pose[4 * r + 1];
    to[2] = -pose[4 * r + 2];
    to[3] = pose[4 * r + 3] / scale;
  }
  memcpy(matrix + 12, (const float[]){0, 0, 0, 1}, 4 * sizeof(float));
}

static ern_status give_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const struct ern_bench_data *data = user;
  (void)split;
  (void)index;
  *frame = (ern_dataset_frame){
      .aud_id = ERN_AUDIO_WINDOWS / 2, .eye = data->scene->frame.eye, .has_face = true, .face = data->scene->face};
  memcpy(frame->matrix, data->matrix, sizeof frame->matrix);
  return ERN_OK;
}

static ern_status give_pixels(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso) {
  const struct ern_bench_data *data = user;
  (void)split;
  (void)index;
  *truth = data->scene->truth;
  *torso = data->scene->frame.torso;
  return ERN_OK;
}

ern_status ern_bench_trainer_restore(struct ern_trainer *t, const struct ern_bench_scene *scene) {
  const struct ern_model *model = scene->model;
  ern_status status =
      t->shared.backend->upload_bytes(t->shared.stream, t->occupancy.bits, model->bits, ERN_OCCUPANCY_BYTES);
  if (status == ERN_OK && t->shared.config.torso && model->torso_grid != NULL) {
    double sum = 0;
    for (size_t i = 0; i < ERN_TORSO_CELLS; i++) sum += (double)model->torso_grid[i];
    t->occupancy.torso_mean = sum / ERN_TORSO_CELLS;
    status =
        t->shared.backend->upload_reals(t->shared.stream, t->occupancy.torso_grid, model->torso_grid, ERN_TORSO_CELLS);
  }
  return status;
}

/* Fills the density grid with values so large that a refresh, which multiplies by 0.95, never empties it. Cells that
 * the camera does not see keep their mark. */
static ern_status fill_grid(struct ern_trainer *t, const uint8_t *bits) {
  float *grid = NULL;
  ern_status status = ERN_OK;
  if (t->shared.config.torso) return ERN_OK;
  ERN_TRY(ERN_NEW(t->shared.context, ERN_OCCUPANCY_CELLS, &grid));
  ERN_TRY(t->shared.backend->download_reals(t->shared.stream, grid, t->occupancy.grid, ERN_OCCUPANCY_CELLS));
  for (size_t c = 0; c < ERN_OCCUPANCY_CELLS; c++)
    if (bits[c / 8] >> c % 8 & 1 && grid[c] >= 0) grid[c] = 1e30f;
  status = t->shared.backend->upload_reals(t->shared.stream, t->occupancy.grid, grid, ERN_OCCUPANCY_CELLS);
fail:
  ern_release(t->shared.context, grid);
  return status;
}

/* Copies the scene's values by name: the trainer of a head alone has another layout, without the torso's rows. */
static ern_status take_values(struct ern_trainer *t, const struct ern_bench_scene *scene) {
  const struct ern_model *model = scene->model;
  for (int r = 0; r < t->shared.model->table.rows; r++) {
    const struct ern_parameter *row = &t->shared.model->table.row[r],
                               *from = ern_parameters_find(&model->table, row->name);
    if (from == NULL || from->count < row->count)
      return ern_fail(t->shared.context, ERN_E_MISMATCH, "bench: the model has no %s", row->name);
    memcpy(t->shared.model->block + row->at, model->block + from->at, row->count * sizeof(float));
  }
  ern_status status = t->shared.backend->upload_reals(t->shared.stream, t->shared.parameters, t->shared.model->block,
                                                      t->shared.model->field.parameters);
  if (status == ERN_OK) status = fill_grid(t, model->bits);
  if (status == ERN_OK) status = ern_bench_trainer_restore(t, scene);
  return status;
}

ern_status ern_bench_trainer_make(struct ern_trainer **trainer, struct ern_bench_data *data,
                                  struct ern_backend *backend, const struct ern_bench_scene *scene, bool torso,
                                  int rays, int threads, uint64_t seed) {
  const struct ern_field *field = &scene->model->field;
  const ern_camera *camera = &scene->frame.camera;
  ern_train_config config = ern_train_config_default();
  union {
    const float *read;
    float *features; /* the trainer only reads them */
  } windows = {.read = scene->frame.windows};
  data->scene = scene;
  data->features =
      (ern_features){windows.features, ERN_AUDIO_WINDOWS, scene->frame.window_length, field->config.feature_width};
  const struct ern_view view = ern_bench_view(scene);
  matrix_of(data->matrix, view.pose, scene->model->view.scale);
  config.torso = torso;
  config.head = torso ? scene->model : NULL;
  config.rays = rays;
  config.precision = ERN_PRECISION_AUTO;
  config.levels = field->config.levels;
  config.no_view = !torso && field->config.no_view;
  config.seed = seed;
  config.threads = threads;
  config.lr = config.lr_net = config.lr_att = 0;
  config.codes = field->config.codes > 0 ? field->config.codes : 0;
  config.torso_gamma = field->config.torso_gamma;
  config.bound = field->config.bound;
  config.max_steps = scene->model->view.max_steps;
  config.dt_gamma = scene->model->view.dt_gamma;
  config.torso_shrink = scene->model->view.torso_shrink;
  config.audio_pad = scene->model->view.audio_pad;
  config.force = true;
  const ern_dataset dataset = {.user = data,
                               .frames = {1, 0},
                               .focal = (double)camera->focal,
                               .cx = (double)camera->cx,
                               .cy = (double)camera->cy,
                               .width = camera->width,
                               .height = camera->height,
                               .scale = scene->model->view.scale,
                               .has_eye = field->config.eye,
                               .has_torso = torso || scene->frame.torso != NULL,
                               .features = &data->features,
                               .background = scene->frame.background,
                               .identity = scene->model->clip,
                               .frame = give_frame,
                               .pixels = give_pixels};
  ern_status status = ern_trainer_create(trainer, backend, &dataset, &config);
  if (status == ERN_OK) status = take_values(*trainer, scene);
  if (status != ERN_OK) ern_trainer_free(trainer);
  return status;
}
