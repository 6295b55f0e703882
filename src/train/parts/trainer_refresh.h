/* SPDX-License-Identifier: MIT
 * The occupancy grids of head and torso during training. Internal. */
#ifndef ERN_TRAIN_TRAINER_REFRESH_H
#define ERN_TRAIN_TRAINER_REFRESH_H

#include "train/parts/trainer_speech.h"

enum {
  ERN_REFRESH_EVERY = 16,   /* steps between occupancy refreshes, as published */
  ERN_REFRESH_WARM_UP = 256 /* steps in which each refresh updates all cells */
};

struct ern_trainer_occupancy {
  const struct ern_training *training;
  const struct ern_trainer_speech *speech;
  struct ern_buffer *reals, *bits_buffer, *cells_buffer;
  ern_span grid, fresh, bits, cells; /* of the head */
  size_t cell_count;                 /* cells that a refresh evaluates */
  bool pruned;                       /* `bits` are pruned, and no longer refreshed */
  ern_span torso_grid;
  double torso_mean;
  float *gathered; /* [cells evaluated at once]; NULL without a communicator */
};

/* Needs ern_trainer_occupancy_free also after an error. */
ERN_NODISCARD ern_status ern_trainer_occupancy_make(struct ern_trainer_occupancy *occupancy,
                                                    const struct ern_training *training,
                                                    const struct ern_trainer_speech *speech);
void ern_trainer_occupancy_free(struct ern_trainer_occupancy *occupancy, struct ern_backend *backend);
/* new training: marks cells that no camera sees */
ERN_NODISCARD ern_status ern_trainer_mark(struct ern_trainer_occupancy *occupancy);
/* lists all cells to evaluate */
ERN_NODISCARD ern_status ern_trainer_list(struct ern_trainer_occupancy *occupancy);
uint64_t ern_trainer_refresh_every(const struct ern_training *training); /* steps between refreshes, at the next step */
ERN_NODISCARD ern_status ern_trainer_refresh(struct ern_trainer_occupancy *occupancy);

#endif
