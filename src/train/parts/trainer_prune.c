/* SPDX-License-Identifier: MIT
 * Finds the occupied cells that a head's pictures need (docs/maths.md, Occupancy): over the rays of training frames,
 * those with a sample whose weight is at least a certain share of the largest weight in its ray. Where the clip tells
 * which pixels are the head, their rays count alone, and a cell that is seen over twice as much beside the head as in
 * it is not needed: what no recorded head supports does not fly about it. */
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

/* Found by experiment (docs/results.md). */
static const double prune_from = 0.85; /* of the coarse steps */
static const float most_beside = 2;    /* a cell's weight beside the head, of that in the head */
enum {
  FRAMES = 32,    /* training frames used, evenly spaced */
  STRIDE = 3,     /* every STRIDE-th pixel of a frame is used, in row order */
  CHUNK = 1 << 14 /* rays at once: limits the memory of their samples */
};

/* By cell of the occupancy grid. */
struct support {
  bool *needed;         /* by a ray of a pixel that may be the head's */
  float *head, *beside; /* sums of the weights of its samples, in such rays and in the others */
};

/* A chunk of rays in host memory. */
struct samples {
  const uint8_t *head;      /* of the frame, as of ern_dataset.head; NULL: any pixel may be the head's */
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

/* *head NULL also where the frame shows none, and where the opacity beside the head is not trained to be 0. */
static ern_status find_head(const struct ern_training *t, size_t frame, const uint8_t **head) {
  const size_t pixels = (size_t)t->data.width * (size_t)t->data.height;
  *head = NULL;
  const ern_status status = t->config.head_random_background ? ern_trainer_head(t, frame, head) : ERN_OK;
  size_t at = 0;
  while (*head != NULL && at < pixels && (*head)[at] == 0) at++;
  if (at == pixels) *head = NULL;
  return status;
}

static uint32_t cell_of(const struct samples *s, size_t i, float bound) {
  uint32_t cell[3];
  for (size_t axis = 0; axis < 3; axis++) {
    const float at = 0.5f * (s->x[axis][i] / bound + 1) * ERN_OCCUPANCY_SIDE, last = ERN_OCCUPANCY_SIDE - 1;
    cell[axis] = at > 0 ? (uint32_t)(at < last ? at : last) : 0; /* NaN: 0 */
  }
  return ern_morton(cell[0], cell[1], cell[2]);
}

/* support->needed[c] is set where a sample of the cell has w = alpha T (docs/maths.md, Compositing) of at least `share`
 * of the largest in its ray, and of at least 0.003. A share, so that samples stay in silhouettes, whose rays absorb
 * little, and in a head that is still diffuse, where no sample absorbs much. */
static void weigh(const struct ern_training *t, struct samples *s, size_t rays, float share,
                  const struct support *support) {
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
    const bool beside = s->head != NULL && s->head[s->pixel[r]] == 0;
    for (size_t i = begin; i < end; i++) {
      const uint32_t cell = cell_of(s, i, t->config.bound);
      (beside ? support->beside : support->head)[cell] += s->sigma[i];
      if (!beside && !(s->sigma[i] < least)) support->needed[cell] = true; /* NaN: needed */
    }
  }
}

static ern_status look_at(const struct ern_trainer_occupancy *o, const struct ern_view *view,
                          struct ern_head_density_args density, struct samples *s, size_t rays,
                          const struct support *support) {
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
  weigh(t, s, rays, t->config.prune_share, support);
fail:
  ern_arena_release(t->stream, mark);
  return status;
}

static ern_status look_at_frame(const struct ern_trainer_occupancy *o, const struct ern_trainer_poses *poses, size_t k,
                                size_t frame, struct samples *s, const struct support *support) {
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
  ERN_TRY(find_head(t, frame, &s->head));
  for (size_t begin = 0; (rays = rays_of(t, k, begin, s)) > 0; begin += rays)
    ERN_TRY(look_at(o, &view, density, s, rays, support));
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
  struct support support = {NULL, NULL, NULL};
  uint8_t *bits = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(samples_make(t, &s));
  ERN_TRY(ERN_NEW(t->context, ERN_OCCUPANCY_CELLS, &support.needed));
  ERN_TRY(ERN_NEW(t->context, 2 * ERN_OCCUPANCY_CELLS, &support.head));
  support.beside = support.head + ERN_OCCUPANCY_CELLS;
  ERN_TRY(ERN_NEW(t->context, ERN_OCCUPANCY_BYTES, &bits));
  for (size_t k = 0; k < count; k++) ERN_TRY(look_at_frame(o, poses, k, begin + k * all / count, &s, &support));
  ERN_TRY(t->backend->download_bytes(t->stream, bits, o->bits, o->bits.count));
  for (uint32_t cell = 0; cell < ERN_OCCUPANCY_CELLS; cell++)
    if (!support.needed[cell] || support.beside[cell] > most_beside * support.head[cell])
      bits[cell >> 3] &= (uint8_t) ~(1u << (cell & 7));
  ERN_TRY(t->backend->upload_bytes(t->stream, o->bits, bits, o->bits.count));
  ERN_TRY(t->backend->synchronize(t->stream));
  o->pruned = true;
fail:
  ern_release(t->context, bits);
  ern_release(t->context, support.head);
  ern_release(t->context, support.needed);
  ern_release(t->context, s.sigma);
  ern_release(t->context, s.pixel);
  return status;
}
