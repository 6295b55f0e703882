/* SPDX-License-Identifier: MIT
 * Checks that all values that a trainer keeps from step to step are finite, and names those that are not. */
#include <inttypes.h>
#include <math.h>

#include "core/floats.h"
#include "render/picture_ops.h"
#include "train/trainer.h"

static ern_status look(ern_trainer *t, ern_span values, bool *finite) {
  struct ern_finite_args args = {.values = values, .n = values.count};
  const ern_status status = values.count > 0 ? t->shared.backend->finite(t->shared.stream, &args) : ERN_OK;
  *finite = values.count == 0 || args.finite;
  return status;
}

/* A block with the parameters' layout. */
static ern_status check_rows(ern_trainer *t, ern_span block, const char *what) {
  bool finite = false;
  ern_status status = look(t, block, &finite);
  for (int r = 0; r < t->shared.model->table.rows && status == ERN_OK && !finite; r++) {
    const struct ern_parameter *row = &t->shared.model->table.row[r];
    status = look(t, ern_span_part(block, row->at, row->count), &finite);
    if (status == ERN_OK && !finite)
      return ern_fail(t->shared.context, ERN_E_NONFINITE, "after step %" PRIu64 ": the %s of %s is not finite",
                      t->shared.step, what, row->name);
    finite = false;
  }
  return status;
}

static ern_status check_grid(ern_trainer *t, ern_span grid, const char *what) {
  bool finite = false;
  const ern_status status = look(t, grid, &finite);
  if (status != ERN_OK || finite) return status;
  return ern_fail(t->shared.context, ERN_E_NONFINITE, "after step %" PRIu64 ": the %s is not finite", t->shared.step,
                  what);
}

ern_status ern_trainer_check(ern_trainer *t) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, t);
  ern_status status = ERN_OK;
  ERN_TRY(check_rows(t, t->shared.parameters, "value"));
  ERN_TRY(check_rows(t, t->values.gradient, "gradient"));
  ERN_TRY(check_rows(t, t->values.second_moment, "optimizer's second moment"));
  ERN_TRY(check_rows(t, t->values.average, "moving average"));
  ERN_TRY(check_grid(t, t->occupancy.grid, "density of the occupancy grid"));
  if (t->shared.config.torso) ERN_TRY(check_grid(t, t->occupancy.torso_grid, "opacity of the torso's grid"));
  if (!isfinite(t->occupancy.torso_mean))
    ERN_TRY(ern_fail(t->shared.context, ERN_E_NONFINITE, "after step %" PRIu64 ": the torso's mean opacity is %g",
                     t->shared.step, t->occupancy.torso_mean));
fail:
  return status;
}
