/* SPDX-License-Identifier: MIT
 * The occupancy grids of head and torso during training (docs/maths.md, Occupancy). */
#include "train/parts/trainer_refresh.h"

#include <math.h>
#include <string.h>

#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "model/torso.h"
#include "model/torso_ops.h"
#include "render/occupancy_ops.h"
#include "render/render_ops.h"
#include "train/parts/trainer_data.h"
#include "train/parts/trainer_processes.h"
#include "train/step_ops.h"

static const float occupancy_decay = 0.95f; /* of a cell's density: a refresh as published, else 16 steps */
enum {
  CHUNK = 1 << 18,     /* cells evaluated at once: limits the memory of their points */
  NEAR_RAYS = 1 << 17, /* rays between two updates of a block with an occupied cell, */
  MOST_EVERY = 128,    /* but at most this many steps, */
  WARM_UP_EVERY = 64,  /* and at most this many during the warm-up */
  SHARES = 16          /* refreshes in which every block without one is updated once; a power of 2 */
};

/* refresh_every 0: the cost of refreshes is proportional to the rays, and the decay to the steps, as learning is. */
struct schedule {
  uint64_t every; /* steps between refreshes */
  uint32_t shares;
};

/* The schedule at the next step. During the warm-up no space is known to be empty, and all cells are updated. */
static struct schedule schedule_of(const struct ern_training *t) {
  const bool first = t->step < ERN_REFRESH_WARM_UP;
  if (t->config.refresh_every > 0) return (struct schedule){t->config.refresh_every, 1};
  struct schedule made = {ERN_REFRESH_EVERY, first ? 1 : SHARES};
  while (made.every < (first ? WARM_UP_EVERY : MOST_EVERY) && made.every * (uint64_t)t->config.rays < NEAR_RAYS)
    made.every *= 2;
  return made;
}

uint64_t ern_trainer_refresh_every(const struct ern_training *t) { return schedule_of(t).every; }

static struct ern_occupancy_decay decay_of(const struct ern_training *t) {
  const struct schedule schedule = schedule_of(t);
  struct ern_occupancy_decay made = {.near = occupancy_decay};
  if (t->config.refresh_every == 0) made.near = powf(occupancy_decay, (float)schedule.every / ERN_REFRESH_EVERY);
  made.far = powf(made.near, (float)schedule.shares);
  made.turn.mask = schedule.shares - 1;
  made.turn.turn = (uint32_t)(t->step / schedule.every) & made.turn.mask;
  return made;
}

ern_status ern_trainer_occupancy_make(struct ern_trainer_occupancy *o, const struct ern_training *t,
                                      const struct ern_trainer_speech *speech) {
  const size_t cells = t->config.torso ? 0 : ERN_OCCUPANCY_CELLS;
  struct ern_backend *backend = t->backend;
  ern_status status = ERN_OK;
  *o = (struct ern_trainer_occupancy){.training = t, .speech = speech};
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, ERN_TORSO_CELLS + 2 * cells, &o->reals));
  o->torso_grid = (ern_span){o->reals, 0, ERN_TORSO_CELLS};
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &o->bits_buffer));
  o->bits = (ern_span){o->bits_buffer, 0, ERN_OCCUPANCY_BYTES};
  if (cells == 0) return ERN_OK;
  o->grid = (ern_span){o->reals, ERN_TORSO_CELLS, cells};
  o->fresh = (ern_span){o->reals, ERN_TORSO_CELLS + cells, cells};
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_INT32, cells, &o->cells_buffer));
  o->cells = (ern_span){o->cells_buffer, 0, cells};
  if (t->communicator.size > 1) ERN_TRY(ERN_NEW(t->context, CHUNK, &o->gathered));
fail:
  return status;
}

void ern_trainer_occupancy_free(struct ern_trainer_occupancy *o, struct ern_backend *backend) {
  backend->buffer_free(backend, o->reals);
  backend->buffer_free(backend, o->bits_buffer);
  backend->buffer_free(backend, o->cells_buffer);
  ern_release(backend->context, o->gathered);
}

ern_status ern_trainer_mark(struct ern_trainer_occupancy *o) {
  const struct ern_training *t = o->training;
  struct ern_occupancy_mark_args mark = {
      .grid = o->grid, .views = t->views, .view_count = t->data.frames[0], .bound = t->config.bound};
  return t->backend->occupancy_mark(t->stream, &mark);
}

ern_status ern_trainer_list(struct ern_trainer_occupancy *o) {
  const struct ern_training *t = o->training;
  struct ern_occupancy_list_args list = {.cells = o->cells, .grid = o->grid, .bits = o->bits};
  const ern_status status = t->backend->occupancy_list(t->stream, &list);
  o->cell_count = list.count;
  return status;
}

/* Density of cells [begin, begin + n) of the list, with the frame's speech and eye, into o->fresh. Each of several
 * processes that train together evaluates a share. */
static ern_status look_at(struct ern_trainer_occupancy *o, ern_span code, float eye, size_t begin, size_t n) {
  const struct ern_training *t = o->training;
  const struct ern_arena_mark mark = ern_arena_mark(t->stream);
  const size_t rank = (size_t)t->communicator.rank, size = (size_t)t->communicator.size;
  const size_t first = n * rank / size, own = n * (rank + 1) / size - first;
  const ern_span cells = ern_span_part(o->cells, begin, n);
  ern_span sigma;
  ern_rows x;
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take_rows(t->stream, 3, own, &x));
  ERN_TRY(ern_scratch_take(t->stream, ERN_ELEMENT_REAL, n, &sigma));
  struct ern_occupancy_points_args points = {.x = x,
                                             .cells = ern_span_part(cells, first, own),
                                             .bound = t->config.bound,
                                             .seed = t->config.seed,
                                             .step = t->step,
                                             .n = own};
  ERN_TRY(t->backend->occupancy_points(t->stream, &points));
  struct ern_head_density_args density = {.sigma = ern_span_part(sigma, first, own),
                                          .x = x,
                                          .parameters = t->parameters,
                                          .field = &t->model->field,
                                          .code = code,
                                          .eye_value = eye,
                                          .bf16 = t->bf16,
                                          .n = own};
  ERN_TRY(t->backend->head_density(t->stream, &density));
  ERN_TRY(ern_trainer_gather(t, sigma, n, o->gathered));
  struct ern_occupancy_scatter_args scatter = {.fresh = o->fresh, .cells = cells, .sigma = sigma, .n = n};
  ERN_TRY(t->backend->occupancy_scatter(t->stream, &scatter));
fail:
  ern_arena_release(t->stream, mark);
  return status;
}

/* Lists the cells that are due, and clears o->fresh: values of other cells are from an earlier refresh and no longer
 * valid. */
static ern_status list_due(struct ern_trainer_occupancy *o, struct ern_occupancy_turn turn) {
  const struct ern_training *t = o->training;
  struct ern_occupancy_list_args list = {.cells = o->cells, .grid = o->grid, .bits = o->bits, .turn = turn};
  if (turn.mask == 0) return ERN_OK; /* all cells: the list has them already */
  const ern_status status = t->backend->occupancy_list(t->stream, &list);
  o->cell_count = list.count;
  return status == ERN_OK ? t->backend->zero(t->stream, o->fresh) : status;
}

static ern_status refresh_head(struct ern_trainer_occupancy *o, size_t frame) {
  const struct ern_training *t = o->training;
  const struct ern_arena_mark mark = ern_arena_mark(t->stream);
  const struct ern_occupancy_decay decay = decay_of(t);
  ern_dataset_frame about;
  ern_span code;
  ern_status status = ERN_OK;
  ERN_TRY(ern_trainer_frame(t, 0, frame, &about));
  ERN_TRY(ern_trainer_audio_code(o->speech, frame, &code));
  ERN_TRY(list_due(o, decay.turn));
  for (size_t begin = 0; begin < o->cell_count; begin += CHUNK)
    ERN_TRY(look_at(o, code, about.eye, begin, o->cell_count - begin < CHUNK ? o->cell_count - begin : CHUNK));
  struct ern_occupancy_update_args update = {
      .grid = o->grid, .bits = o->bits, .fresh = o->fresh, .decay = decay, .limit = 10};
  ERN_TRY(t->backend->occupancy_update(t->stream, &update));
fail:
  ern_arena_release(t->stream, mark);
  return status;
}

static ern_status refresh_torso(struct ern_trainer_occupancy *o, size_t frame) {
  const struct ern_training *t = o->training;
  const struct ern_arena_mark mark = ern_arena_mark(t->stream);
  const struct ern_torso_inputs in = {.field = &t->model->field,
                                      .parameters = t->parameters,
                                      .pose = t->views[frame].pose,
                                      .individual = ern_trainer_code(t, frame),
                                      .motion = t->motion[frame],
                                      .shrink = t->config.torso_shrink};
  struct ern_torso_batch batch;
  ern_status status = ERN_OK;
  ERN_TRY(ern_torso_batch_take(t->stream, &t->model->field, ERN_TORSO_CELLS, &batch));
  struct ern_torso_points_args points = {
      .q = batch.q, .shrink = t->config.torso_shrink, .seed = t->config.seed, .step = t->step};
  ERN_TRY(t->backend->torso_points(t->stream, &points));
  ERN_TRY(ern_torso_fwd(t->stream, &in, &batch));
  struct ern_torso_update_args update = {
      .grid = o->torso_grid, .alpha = ern_span_of_row(batch.layer, 0, ERN_TORSO_CELLS), .decay = decay_of(t).near};
  ERN_TRY(t->backend->torso_update(t->stream, &update));
  o->torso_mean = update.mean;
fail:
  ern_arena_release(t->stream, mark);
  return status;
}

ern_status ern_trainer_refresh(struct ern_trainer_occupancy *o) {
  const struct ern_training *t = o->training;
  const size_t frame =
      ern_trainer_random_frame(t, ern_random_at(t->config.seed, t->step, 0, ERN_RNG_REFRESH_FRAME).word[0]);
  return t->config.torso ? refresh_torso(o, frame) : refresh_head(o, frame);
}
