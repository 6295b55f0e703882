/* SPDX-License-Identifier: MIT
 * The fine stage of a head's training: when it begins, and where its patches lie; what a step of either stage consists
 * of. */
#include "train/parts/trainer_fine.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "train/parts/trainer_processes.h"
#include "train/patch_filter.h"
#include "train/step.h"

static size_t patch_rays(const struct ern_training *t) {
  return (size_t)t->config.patch_size * (size_t)t->config.patch_size;
}

/* Patches of a step of the fine stage: at least one, so it may have more rays than a coarse step. */
static size_t patches_of_step(const struct ern_training *t) {
  const size_t patches = (size_t)t->config.rays / patch_rays(t);
  return patches > 0 ? patches : 1;
}

/* Checks the requirements of a fine stage. */
static ern_status check(const struct ern_training *t) {
  const ern_train_config *c = &t->config;
  const int side = c->patch_size, width = t->data.width, height = t->data.height;
  if (c->torso) return ern_fail(t->context, ERN_E_ARGUMENT, "train: the fine stage is of a head, and this is a torso");
  if (c->seconds > 0 && c->fine_steps > 0)
    return ern_fail(t->context, ERN_E_ARGUMENT,
                    "train: fine_steps is %" PRIu64 ", expected 0 with `seconds`, of which fine_share says how much",
                    c->fine_steps);
  if (side < ERN_PATCH_UNIT || side > ERN_PATCH_MOST_SIDE || side % ERN_PATCH_UNIT != 0)
    return ern_fail(t->context, ERN_E_ARGUMENT, "train: patch_size is %d, expected 16, 32, 48 or 64", side);
  if (side > width || side > height)
    return ern_fail(t->context, ERN_E_ARGUMENT, "train: patch_size is %d, expected at most the %d x %d of the frames",
                    side, width, height);
  const size_t patches = patches_of_step(t), parts = (size_t)c->step_parts;
  if (patches % parts != 0)
    return ern_fail(t->context, ERN_E_ARGUMENT,
                    "train: step_parts is %zu, expected a number that divides the %zu patches of a step of the fine "
                    "stage",
                    parts, patches);
  return ERN_OK;
}

static ern_status make_filter(struct ern_trainer_fine *f) {
  const struct ern_training *t = f->training;
  const size_t count = ern_patch_filter_count((size_t)t->config.patch_size);
  float *filter = NULL;
  ern_status status = ERN_NEW(t->context, count, &filter);
  if (status != ERN_OK) return status;
  ern_patch_filter(filter, t->config.patch_size);
  ERN_TRY(t->backend->buffer_make(t->backend, ERN_ELEMENT_REAL, count, &f->filter));
  ERN_TRY(t->backend->upload_reals(t->stream, (ern_span){f->filter, 0, count}, filter, count));
  ERN_TRY(t->backend->synchronize(t->stream));
fail:
  ern_release(t->context, filter);
  return status;
}

ern_status ern_trainer_fine_take(struct ern_trainer_fine *f, struct ern_training *t) {
  const ern_fine_loss *given = t->config.fine_loss;
  *f = (struct ern_trainer_fine){.training = t, .from = UINT64_MAX, .value = NAN};
  if (given == NULL) return ERN_OK;
  if (given->compute == NULL || given->name == NULL || given->name[0] == 0 || strlen(given->name) >= sizeof f->name)
    return ern_fail(t->context, ERN_E_ARGUMENT, "train: fine_loss has no function, or no name of 1 to %zu bytes",
                    sizeof f->name - 1);
  memcpy(f->name, given->name, strlen(given->name) + 1);
  f->loss = *given;
  f->loss.name = f->name;
  t->config.fine_loss = &f->loss;
  return ERN_OK;
}

/* Values of the loss that differ by more than rounding are those of other weights. */
static ern_status compare_loss(const struct ern_trainer_fine *f, double value) {
  const struct ern_training *t = f->training;
  double first = value;
  if (!isnan(f->value) && !(fabs(value - f->value) <= 1e-3 * fabs(f->value)))
    return ern_fail(t->context, ERN_E_MISMATCH,
                    "%s: the state's fine_loss \"%s\" had %g for a made-up patch; it has %g now, expected the same: "
                    "other weights?",
                    t->config.output, f->name, f->value, value);
  if (t->communicator.size <= 1) return ERN_OK;
  const ern_status status = ern_trainer_broadcast(t, &first, sizeof first);
  if (status != ERN_OK || fabs(value - first) <= 1e-3 * fabs(first)) return status;
  return ern_fail(t->context, ERN_E_MISMATCH,
                  "train: rank %d has a fine_loss \"%s\" of %g for a made-up patch; rank 0 has %g, expected the same: "
                  "other weights?",
                  t->communicator.rank, t->config.fine_loss->name, value, first);
}

/* Calls the loss on a made-up patch, so that its errors are reported before the training, not at its fine stage. */
static ern_status try_loss(struct ern_trainer_fine *f) {
  const struct ern_training *t = f->training;
  const ern_fine_loss *loss = t->config.fine_loss;
  const size_t count = 3 * patch_rays(t);
  float *pixel = NULL, *truth, *dpixel;
  double value = 0;
  if (loss == NULL) return ERN_OK;
  ern_status status = ERN_NEW(t->context, 3 * count, &pixel);
  if (status != ERN_OK) return status;
  truth = pixel + count;
  dpixel = truth + count;
  for (size_t i = 0; i < count; i++) truth[i] = (float)(i % 7) / 6;
  ERN_TRY(ern_fine_loss_compute(t->context, loss, pixel, truth, t->config.patch_size, &value, dpixel));
  ERN_TRY(compare_loss(f, value));
  f->value = value;
fail:
  ern_release(t->context, pixel);
  return status;
}

ern_status ern_trainer_fine_begin(struct ern_trainer_fine *f) {
  const struct ern_training *t = f->training;
  const uint64_t steps = t->config.fine_steps, iters = t->config.iters;
  const bool timed = t->config.seconds > 0 && t->config.fine_share > 0 && !t->config.torso;
  const uint64_t found = f->from; /* in a resumed state */
  f->from = UINT64_MAX;
  if (found < t->step)
    f->from = found;
  else if (steps == ERN_FINE_ALL)
    f->from = t->step;
  else if (steps > iters)
    return ern_fail(t->context, ERN_E_ARGUMENT,
                    "train: fine_steps is %" PRIu64 ", expected at most iters, the number of all steps, %" PRIu64,
                    steps, iters);
  else if (steps > 0)
    f->from = iters - steps;
  if (f->from == UINT64_MAX && !timed) return ERN_OK;
  ern_status status = check(t);
  if (status == ERN_OK) status = try_loss(f);
  return status == ERN_OK ? make_filter(f) : status;
}

uint64_t ern_trainer_coarse_steps(const struct ern_trainer_fine *f) {
  const uint64_t iters = f->training->config.iters;
  if (f->from != UINT64_MAX) return f->from < iters ? f->from : iters;
  return f->filter != NULL ? (uint64_t)((1 - f->training->config.fine_share) * (double)iters) : iters;
}

void ern_trainer_fine_due(struct ern_trainer_fine *f) {
  const uint64_t step = f->training->step;
  if (f->filter != NULL && f->from == UINT64_MAX && step > 0 && step >= ern_trainer_coarse_steps(f)) f->from = step;
}

size_t ern_trainer_step_patches(const struct ern_trainer_fine *f) {
  return ern_trainer_is_fine(f) ? patches_of_step(f->training) : 0;
}

size_t ern_trainer_step_rays(const struct ern_trainer_fine *f) {
  const struct ern_training *t = f->training;
  const size_t patches = ern_trainer_step_patches(f);
  return patches > 0 ? patches * patch_rays(t) : (size_t)t->config.rays;
}

size_t ern_trainer_most_rays(const struct ern_trainer_fine *f) {
  const struct ern_training *t = f->training;
  const size_t rays = (size_t)t->config.rays, fine = f->filter != NULL ? patches_of_step(t) * patch_rays(t) : 0;
  return rays > fine ? rays : fine;
}

size_t ern_trainer_step_frames(const struct ern_trainer_fine *f) {
  const struct ern_training *t = f->training;
  const size_t patches = ern_trainer_step_patches(f), frames = (size_t)t->config.frames_per_step;
  return patches > 0 && patches < frames ? patches : frames;
}

size_t ern_trainer_step_batches(const struct ern_trainer_fine *f) {
  const size_t frames = ern_trainer_step_frames(f), parts = (size_t)f->training->config.step_parts;
  return frames > parts ? frames : parts;
}

size_t ern_trainer_first_batch(const struct ern_trainer_fine *f) {
  return ern_trainer_own_batches(f) * (size_t)f->training->communicator.rank;
}

/* The first row or column of a patch around `middle`, inside `size` pixels. */
static int begin_around(int middle, int side, int size) {
  const int begin = middle - side / 2;
  return begin < 0 ? 0 : begin > size - side ? size - side : begin;
}

/* Patches lie around pixels of the lips in odd steps, and in even ones, of a training for ern_dub_frame, of what that
 * draws; around any pixel without such a box. */
void ern_trainer_place_patches(const struct ern_trainer_fine *f, const ern_dataset_frame *about, size_t first,
                               size_t count, int32_t *pixel) {
  const struct ern_training *t = f->training;
  const bool dub = t->config.ray_sampling == ERN_RAY_SAMPLING_DUB;
  const ern_box *box = t->step % 2 == 1 ? &about->lips : &about->dubbed;
  const int side = t->config.patch_size, width = t->data.width, height = t->data.height;
  const int box_left = box->left > 0 ? box->left : 0, box_right = box->right < width ? box->right : width;
  const int box_top = box->top > 0 ? box->top : 0, box_bottom = box->bottom < height ? box->bottom : height;
  const bool around = (dub || t->step % 2 == 1) && box_left < box_right && box_top < box_bottom;
  for (size_t p = 0; p < count; p++) {
    const struct ern_random random = ern_random_at(t->config.seed, t->step, (uint32_t)(first + p), ERN_RNG_PATCH);
    int left = (int)ern_below(random.word[0], (uint32_t)(width - side + 1));
    int top = (int)ern_below(random.word[1], (uint32_t)(height - side + 1));
    if (around) {
      left = begin_around(box_left + (int)ern_below(random.word[0], (uint32_t)(box_right - box_left)), side, width);
      top = begin_around(box_top + (int)ern_below(random.word[1], (uint32_t)(box_bottom - box_top)), side, height);
    }
    for (int r = 0; r < side; r++)
      for (int c = 0; c < side; c++) *pixel++ = (top + r) * width + left + c;
  }
}
