/* SPDX-License-Identifier: MIT
 * Whole training steps, and densities, implemented by calling the stages: head_step, torso_step and head_density of
 * backends without faster ones of their own. */
#ifndef ERN_TRAIN_STEP_H
#define ERN_TRAIN_STEP_H

#include "core/backend.h"
#include "train/patches_ops.h"
#include "train/step_ops.h"

ern_status ern_head_step_stages(struct ern_stream *stream, struct ern_head_step_args *args);
/* The same, up to the rounding of sums, with the samples of only `at_once` rays in memory at a time; where that is not
 * all rays, all samples are computed twice. On failure dparameters holds part of the gradient. */
ern_status ern_head_step_parts(struct ern_stream *stream, struct ern_head_step_args *args, size_t at_once);
/* Calls the program's loss; writes an error text where it fails without one. */
ern_status ern_fine_loss_compute(ern_context *context, const struct ern_fine_loss *loss, const float *pixel,
                                 const float *truth, int side, double *value, float *dpixel);
/* Value and gradient of the patch loss `p`: `loss` computes them on the host; NULL: the backend does. */
ern_status ern_step_patch_loss(struct ern_stream *stream, const struct ern_fine_loss *loss,
                               struct ern_patch_loss_args *p);
/* The patch loss of a step; with 0 patches where the step has none. */
static inline struct ern_patch_loss_args ern_patches_of_step(const struct ern_head_step_args *args, ern_rows dpixel,
                                                             ern_rows pixel) {
  return (struct ern_patch_loss_args){.dpixel = dpixel,
                                      .pixel = pixel,
                                      .truth = args->truth,
                                      .filter = args->patches.filter,
                                      .weight = args->patches.weight,
                                      .side = args->patches.side,
                                      .patches = args->patches.count};
}
ern_status ern_head_density_stages(struct ern_stream *stream, struct ern_head_density_args *args);
ern_status ern_torso_step_stages(struct ern_stream *stream, struct ern_torso_step_args *args);

#endif
