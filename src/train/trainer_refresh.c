/* SPDX-License-Identifier: MIT
 * The occupancy grids of head and torso during training (docs/maths.md, Occupancy). */
#include <math.h>

#include "core/rng.h"
#include "core/status.h"
#include "model/torso.h"
#include "model/torso_ops.h"
#include "render/occupancy_ops.h"
#include "render/render_ops.h"
#include "train/step_ops.h"
#include "train/trainer.h"

static const float occupancy_decay = 0.95f; /* of a cell's density: a refresh as published, else 16 steps */
enum {
  CHUNK = ERN_REFRESH_CHUNK,
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
static struct schedule schedule_of(const ern_trainer *t) {
  const bool first = t->shared.step < ERN_REFRESH_WARM_UP;
  if (t->shared.config.refresh_every > 0) return (struct schedule){t->shared.config.refresh_every, 1};
  struct schedule made = {ERN_REFRESH_EVERY, first ? 1 : SHARES};
  while (made.every < (first ? WARM_UP_EVERY : MOST_EVERY) && made.every * (uint64_t)t->shared.config.rays < NEAR_RAYS)
    made.every *= 2;
  return made;
}

uint64_t ern_trainer_refresh_every(const ern_trainer *t) { return schedule_of(t).every; }

static struct ern_occupancy_decay decay_of(const ern_trainer *t) {
  const struct schedule schedule = schedule_of(t);
  struct ern_occupancy_decay made = {.near = occupancy_decay};
  if (t->shared.config.refresh_every == 0) made.near = powf(occupancy_decay, (float)schedule.every / ERN_REFRESH_EVERY);
  made.far = powf(made.near, (float)schedule.shares);
  made.turn.mask = schedule.shares - 1;
  made.turn.turn = (uint32_t)(t->shared.step / schedule.every) & made.turn.mask;
  return made;
}

ern_status ern_trainer_mark(ern_trainer *t) {
  struct ern_occupancy_mark_args mark = {.grid = t->grid,
                                         .views = t->shared.views,
                                         .view_count = t->shared.data.frames[0],
                                         .bound = t->shared.config.bound};
  return t->shared.backend->occupancy_mark(t->shared.stream, &mark);
}

ern_status ern_trainer_list(ern_trainer *t) {
  struct ern_occupancy_list_args list = {.cells = t->cells, .grid = t->grid, .bits = t->bits};
  const ern_status status = t->shared.backend->occupancy_list(t->shared.stream, &list);
  t->cell_count = list.count;
  return status;
}

/* Density of cells [begin, begin + n) of the list, with the frame's speech and eye, into t->fresh. Each of several
 * processes that train together evaluates a share. */
static ern_status look_at(ern_trainer *t, ern_span code, float eye, size_t begin, size_t n) {
  const struct ern_arena_mark mark = ern_arena_mark(t->shared.stream);
  const size_t rank = (size_t)t->shared.communicator.rank, size = (size_t)t->shared.communicator.size;
  const size_t first = n * rank / size, own = n * (rank + 1) / size - first;
  const ern_span cells = ern_span_part(t->cells, begin, n);
  ern_span sigma;
  ern_rows x;
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take_rows(t->shared.stream, 3, own, &x));
  ERN_TRY(ern_scratch_take(t->shared.stream, ERN_ELEMENT_REAL, n, &sigma));
  struct ern_occupancy_points_args points = {.x = x,
                                             .cells = ern_span_part(cells, first, own),
                                             .bound = t->shared.config.bound,
                                             .seed = t->shared.config.seed,
                                             .step = t->shared.step,
                                             .n = own};
  ERN_TRY(t->shared.backend->occupancy_points(t->shared.stream, &points));
  struct ern_head_density_args density = {.sigma = ern_span_part(sigma, first, own),
                                          .x = x,
                                          .parameters = t->shared.parameters,
                                          .field = &t->shared.model->field,
                                          .code = code,
                                          .eye_value = eye,
                                          .bf16 = t->shared.bf16,
                                          .n = own};
  ERN_TRY(t->shared.backend->head_density(t->shared.stream, &density));
  ERN_TRY(ern_trainer_gather(t, sigma, n));
  struct ern_occupancy_scatter_args scatter = {.fresh = t->fresh, .cells = cells, .sigma = sigma, .n = n};
  ERN_TRY(t->shared.backend->occupancy_scatter(t->shared.stream, &scatter));
fail:
  ern_arena_release(t->shared.stream, mark);
  return status;
}

/* Lists the cells that are due, and clears t->fresh: values of other cells are from an earlier refresh and no longer
 * valid. */
static ern_status list_due(ern_trainer *t, struct ern_occupancy_turn turn) {
  struct ern_occupancy_list_args list = {.cells = t->cells, .grid = t->grid, .bits = t->bits, .turn = turn};
  if (turn.mask == 0) return ERN_OK; /* all cells: the list has them already */
  const ern_status status = t->shared.backend->occupancy_list(t->shared.stream, &list);
  t->cell_count = list.count;
  return status == ERN_OK ? t->shared.backend->zero(t->shared.stream, t->fresh) : status;
}

static ern_status refresh_head(ern_trainer *t, size_t frame) {
  const struct ern_arena_mark mark = ern_arena_mark(t->shared.stream);
  const struct ern_occupancy_decay decay = decay_of(t);
  ern_dataset_frame about;
  ern_span code;
  ern_status status = ERN_OK;
  ERN_TRY(ern_trainer_frame(&t->shared, 0, frame, &about));
  ERN_TRY(ern_trainer_audio_code(&t->speech, frame, &code));
  ERN_TRY(list_due(t, decay.turn));
  for (size_t begin = 0; begin < t->cell_count; begin += CHUNK)
    ERN_TRY(look_at(t, code, about.eye, begin, t->cell_count - begin < CHUNK ? t->cell_count - begin : CHUNK));
  struct ern_occupancy_update_args update = {
      .grid = t->grid, .bits = t->bits, .fresh = t->fresh, .decay = decay, .limit = 10};
  ERN_TRY(t->shared.backend->occupancy_update(t->shared.stream, &update));
fail:
  ern_arena_release(t->shared.stream, mark);
  return status;
}

static ern_status refresh_torso(ern_trainer *t, size_t frame) {
  const struct ern_arena_mark mark = ern_arena_mark(t->shared.stream);
  const struct ern_torso_inputs in = {&t->shared.model->field, t->shared.parameters, t->shared.views[frame].pose,
                                      ern_trainer_code(t, frame)};
  struct ern_torso_batch batch;
  ern_status status = ERN_OK;
  ERN_TRY(ern_torso_batch_take(t->shared.stream, &t->shared.model->field, ERN_TORSO_CELLS, &batch));
  struct ern_torso_points_args points = {
      .q = batch.q, .shrink = t->shared.config.torso_shrink, .seed = t->shared.config.seed, .step = t->shared.step};
  ERN_TRY(t->shared.backend->torso_points(t->shared.stream, &points));
  ERN_TRY(ern_torso_fwd(t->shared.stream, &in, &batch));
  struct ern_torso_update_args update = {
      .grid = t->torso_grid, .alpha = ern_span_of_row(batch.layer, 0, ERN_TORSO_CELLS), .decay = decay_of(t).near};
  ERN_TRY(t->shared.backend->torso_update(t->shared.stream, &update));
  t->torso_mean = update.mean;
fail:
  ern_arena_release(t->shared.stream, mark);
  return status;
}

ern_status ern_trainer_refresh(ern_trainer *t) {
  const size_t frame = ern_trainer_random_frame(
      &t->shared, ern_random_at(t->shared.config.seed, t->shared.step, 0, ERN_RNG_REFRESH_FRAME).word[0]);
  return t->shared.config.torso ? refresh_torso(t, frame) : refresh_head(t, frame);
}

ern_status ern_trainer_occupancy(ern_trainer *t) {
  if (t->pruned) return ERN_OK;
  if (ern_trainer_prune_due(t)) return ern_trainer_prune(t);
  return t->shared.step % schedule_of(t).every == 0 ? ern_trainer_refresh(t) : ERN_OK;
}
