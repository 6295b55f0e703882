/* SPDX-License-Identifier: MIT
 * Finds the occupied cells that a head's pictures need (docs/maths.md, Occupancy): over the rays of training frames,
 * those with a sample whose weight is at least a certain share of the largest weight in its ray. */
#include "train/parts/trainer_prune.h"

#include <math.h>

#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "render/morton.h"
#include "render/render_ops.h"
#include "render/stages.h"
#include "train/parts/trainer_data.h"
#include "train/step_ops.h"

static const double prune_from = 0.85; /* of the coarse steps, found by experiment (docs/results.md) */
enum {
  FRAMES = 32,    /* training frames used, evenly spaced */
  STRIDE = 3,     /* every STRIDE-th pixel of a frame is used, in row order */
  CHUNK = 1 << 14 /* rays at once: limits the memory of their samples */
};

/* A chunk of rays in host memory. */
struct samples {
  int32_t *pixel;           /* [CHUNK] */
  int32_t *first;           /* [CHUNK + 1] */
  float *jitter;            /* [CHUNK] */
  float *sigma, *dt, *x[3]; /* [CHUNK * max_steps] each, x: of the cube [-bound, bound]^3 */
};

static ern_status samples_make(const struct ern_training *t, struct samples *s) {
  const size_t most = (size_t)CHUNK * (size_t)t->config.max_steps; /* max_steps <= 1024 */
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(t->context, 2 * CHUNK + 1, &s->pixel));
  s->first = s->pixel + CHUNK;
  ERN_TRY(ERN_NEW(t->context, 5 * most + CHUNK, &s->sigma));
  s->jitter = s->sigma + 5 * most;
  s->dt = s->sigma + most;
  for (size_t axis = 0; axis < 3; axis++) s->x[axis] = s->sigma + (2 + axis) * most;
fail:
  return status;
}

/* Takes the next pixels of a frame, from number `begin` on; returns how many. Their starts are jittered within a step,
 * as in training: without jitter, rays would miss cells that rays of another pose meet first. */
static size_t rays_of(const struct ern_training *t, size_t k, size_t begin, const struct samples *s) {
  const size_t pixels = (size_t)t->data.width * (size_t)t->data.height;
  size_t count = 0;
  for (size_t at = STRIDE * begin + k % STRIDE; at < pixels && count < CHUNK; at += STRIDE) {
    s->jitter[count] = ern_uniform(ern_random_at(t->config.seed, k, (uint32_t)at, ERN_RNG_PRUNE).word[0]);
    s->pixel[count++] = (int32_t)at;
  }
  return count;
}

static uint32_t cell_of(const struct samples *s, size_t i, float bound) {
  uint32_t cell[3];
  for (size_t axis = 0; axis < 3; axis++) {
    const float at = 0.5f * (s->x[axis][i] / bound + 1) * ERN_OCCUPANCY_SIDE, last = ERN_OCCUPANCY_SIDE - 1;
    cell[axis] = at > 0 ? (uint32_t)(at < last ? at : last) : 0; /* NaN: 0 */
  }
  return ern_morton(cell[0], cell[1], cell[2]);
}

/* needed[c] is set where a sample of the cell has w = alpha T (docs/maths.md, Compositing) of at least `share` of the
 * largest in its ray, and of at least 0.003. A share, so that samples stay in silhouettes, whose rays absorb little,
 * and in a head that is still diffuse, where no sample absorbs much. */
static void weigh(const struct ern_training *t, struct samples *s, size_t rays, float share, bool *needed) {
  const float least_weight = 0.003f; /* less than a step of 8 bits */
  for (size_t r = 0; r < rays; r++) {
    const size_t begin = (size_t)s->first[r], end = (size_t)s->first[r + 1];
    float transmittance = 1, most = 0;
    for (size_t i = begin; i < end; i++) {
      const float left = expf(-s->sigma[i] * s->dt[i]);
      s->sigma[i] = (1 - left) * transmittance; /* sigma holds the weight from here on */
      most = fmaxf(most, s->sigma[i]);
      transmittance *= left;
    }
    const float least = fmaxf(share * most, least_weight);
    for (size_t i = begin; i < end; i++)
      if (!(s->sigma[i] < least)) needed[cell_of(s, i, t->config.bound)] = true; /* NaN: needed */
  }
}

static ern_status look_at(const struct ern_trainer_occupancy *o, const struct ern_view *view,
                          struct ern_head_density_args density, struct samples *s, size_t rays, bool *needed) {
  const struct ern_training *t = o->training;
  const struct ern_arena_mark mark = ern_arena_mark(t->stream);
  const struct ern_march_settings march = ern_trainer_march(t);
  struct ern_backend *backend = t->backend;
  struct ern_marched marched;
  ern_span pixel, jitter;
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take(t->stream, ERN_ELEMENT_INT32, rays, &pixel));
  ERN_TRY(backend->upload_int32(t->stream, pixel, s->pixel, rays));
  ERN_TRY(ern_scratch_take(t->stream, ERN_ELEMENT_REAL, rays, &jitter));
  ERN_TRY(backend->upload_reals(t->stream, jitter, s->jitter, rays));
  ERN_TRY(ern_march_rays(t->stream, pixel, view, jitter, o->bits, &march, rays, &marched));
  ERN_TRY(ern_scratch_take(t->stream, ERN_ELEMENT_REAL, marched.total, &density.sigma));
  density.x = marched.x;
  density.n = marched.total;
  ERN_TRY(backend->head_density(t->stream, &density));
  ERN_TRY(backend->download_int32(t->stream, s->first, marched.first, rays + 1));
  ERN_TRY(backend->download_reals(t->stream, s->sigma, density.sigma, marched.total));
  ERN_TRY(backend->download_reals(t->stream, s->dt, marched.dt, marched.total));
  for (int axis = 0; axis < 3; axis++)
    ERN_TRY(
        backend->download_reals(t->stream, s->x[axis], ern_span_of_row(marched.x, axis, marched.total), marched.total));
  weigh(t, s, rays, t->config.prune_share, needed);
fail:
  ern_arena_release(t->stream, mark);
  return status;
}

static ern_status look_at_frame(const struct ern_trainer_occupancy *o, const struct ern_trainer_poses *poses, size_t k,
                                size_t frame, struct samples *s, bool *needed) {
  const struct ern_training *t = o->training;
  const struct ern_arena_mark mark = ern_arena_mark(t->stream);
  const struct ern_view view = poses != NULL ? ern_trainer_poses_view(poses, frame) : t->views[frame];
  ern_dataset_frame about;
  ern_span code;
  ern_status status = ERN_OK;
  ERN_TRY(ern_trainer_frame(t, 0, frame, &about));
  ERN_TRY(ern_trainer_audio_code(o->speech, frame, &code));
  const struct ern_head_density_args density = {
      .parameters = t->parameters, .field = &t->model->field, .code = code, .eye_value = about.eye};
  size_t rays;
  for (size_t begin = 0; (rays = rays_of(t, k, begin, s)) > 0; begin += rays)
    ERN_TRY(look_at(o, &view, density, s, rays, needed));
fail:
  ern_arena_release(t->stream, mark);
  return status;
}

bool ern_trainer_prune_due(const struct ern_trainer_fine *fine) {
  const struct ern_training *t = fine->training;
  const bool last_part = (double)t->step >= prune_from * (double)ern_trainer_coarse_steps(fine);
  return !t->config.torso && t->config.prune_share > 0 && t->step > 0 && last_part;
}

ern_status ern_trainer_prune(struct ern_trainer_occupancy *o, const struct ern_trainer_poses *poses) {
  const struct ern_training *t = o->training;
  const size_t begin = t->config.data_begin, all = t->config.data_end - begin, count = all < FRAMES ? all : FRAMES;
  struct samples s = {0};
  bool *needed = NULL;
  uint8_t *bits = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(samples_make(t, &s));
  ERN_TRY(ERN_NEW(t->context, ERN_OCCUPANCY_CELLS, &needed));
  ERN_TRY(ERN_NEW(t->context, ERN_OCCUPANCY_BYTES, &bits));
  for (size_t k = 0; k < count; k++) ERN_TRY(look_at_frame(o, poses, k, begin + k * all / count, &s, needed));
  ERN_TRY(t->backend->download_bytes(t->stream, bits, o->bits, o->bits.count));
  for (uint32_t cell = 0; cell < ERN_OCCUPANCY_CELLS; cell++)
    if (!needed[cell]) bits[cell >> 3] &= (uint8_t) ~(1u << (cell & 7));
  ERN_TRY(t->backend->upload_bytes(t->stream, o->bits, bits, o->bits.count));
  ERN_TRY(t->backend->synchronize(t->stream));
  o->pruned = true;
fail:
  ern_release(t->context, bits);
  ern_release(t->context, needed);
  ern_release(t->context, s.sigma);
  ern_release(t->context, s.pixel);
  return status;
}
