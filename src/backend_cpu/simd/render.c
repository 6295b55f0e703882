/* SPDX-License-Identifier: MIT
 * The fused renderer's tile of rays, for any instruction set (simd/isa.h).
 *
 * A tile has a slot for each of its rays and evaluates the next sample of all of them together. A ray whose
 * transmittance is used up, or that has no sample left, is written out, and its slot is given to the next ray. So tiles
 * stay full until the frame ends, and no sample after a ray's end is computed. */
#include <math.h>

#include "backend_cpu/fused/render_scratch.h"
#include "backend_cpu/fused/render_worker.h"
#include "backend_cpu/simd/encode_tile.h"
#include "backend_cpu/simd/gemm_layers.h"
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_math.h"

/* ---- the field --------------------------------------------------------------------------------------------------- */

/* sum_c (times v_c)^2 of a register of samples */
LANES_INLINE vf squares(const float *v, size_t rows, const float times) {
  vf sum = {0};
  for (size_t c = 0; c < rows; c++) {
    const vf value = vf_load(v + c * TILE) * times;
    sum += value * value;
  }
  return sum;
}

/* norm = |W_v h|: the attention that is reported for the samples */
static void attention_norm(float *norm, float *v, const struct ern_frame_net *net, const float *hidden) {
  tile_outputs(v, net->value, hidden, net->value_rows, tile_rows_padded(net->attention));
  for (size_t k = 0; k < TILE; k += LANES) {
    const vf sum = squares(v + k, net->value_rows, 1);
    vf root = vf_sqrt(sum);
    if (__builtin_expect(vf_squares_leave_float(sum), 0))
      root =
          vf_root_of_any(sum, squares(v + k, net->value_rows, VF_OF_HUGE), squares(v + k, net->value_rows, VF_OF_TINY));
    vf_store(norm + k, root);
  }
}

/* The attention's hidden units times the voice at each sample: v = W h has no bias, so that g v = W (g h). */
static void fade(float *hidden, const float *height, const struct ern_frame_net *net) {
  for (size_t k = 0; net->fades && k < TILE; k += LANES)
    tile_scale(hidden + k, vf_fade(vf_load(height + k), net->fade), net->attention);
}

/* Computes sigma and rgb of a tile from its features. */
static void field_tile(struct render_scratch *s, const struct flight *f, const struct ern_frame_net *net,
                       bool norm_wanted) {
  const size_t features = tile_rows_padded(net->features), density = tile_rows_padded(net->density);
  float *input = tile_inputs(s->input, f->features, net->features);
  float *hidden = input + features * TILE, *eye = hidden + tile_rows_padded(net->attention) * TILE;
  tile_layer(hidden, NULL, net->attention1, input, net->attention, features);
  fade(hidden, f->x[0], net);
  if (net->eye) {
    tile_layer(s->hidden[0], NULL, net->eye1, input, net->eye_hidden, features);
    tile_outputs(s->eye, net->eye2, s->hidden[0], 1, tile_rows_padded(net->eye_hidden));
    for (size_t k = 0; k < TILE; k += LANES) {
      const vf attention = vf_sigmoid(vf_load(s->eye + k));
      vf_store(s->eye + k, attention);
      tile_last_input(eye + k, attention * net->eye_value);
    }
  }
  if (norm_wanted) attention_norm(s->norm, s->hidden[0], net, hidden);
  tile_layer(s->hidden[0], NULL, net->density1, input, net->density,
             features + tile_rows_padded(net->attention) + net->eye);
  tile_layer(s->hidden[1], NULL, net->density2, s->hidden[0], net->density, density);
  tile_outputs(s->sigma, net->sigma, s->hidden[1], 1, density);
  tile_layer(s->hidden[0], f->ray_term, net->colour1, s->hidden[1], net->colour, density);
  tile_outputs(s->rgb, net->colour2, s->hidden[0], 3, tile_rows_padded(net->colour));
  for (size_t k = 0; k < TILE; k += LANES) {
    const vf log_sigma = vf_load(s->sigma + k);
    vf_store(s->sigma + k, vf_exp(vf_select(log_sigma > 80, vf_all(80), log_sigma)));
    for (size_t c = 0; c < 3; c++)
      vf_store(s->rgb + c * TILE + k, 1.002f * vf_sigmoid(vf_load(s->rgb + c * TILE + k)) - 0.001f);
  }
}

/* ---- rays coming in ---------------------------------------------------------------------------------------------- */

/* Marches the next rays of work->order until some have samples. False at the end of the order. */
static bool next_rays(struct render_scratch *s, const struct ern_render_work *work, atomic_size_t *next,
                      struct ern_profile *profile) {
  s->hits = s->taken = s->shared = 0;
  while (s->hits == 0) {
    const size_t begin = atomic_fetch_add(next, s->batch);
    if (begin >= work->count) return false;
    const size_t n = work->count - begin < s->batch ? work->count - begin : s->batch;
    for (size_t i = 0; i < n; i++) s->number[i] = work->pixel_number[work->order[begin + i]];
    const float origin[3] = {work->view.pose[3], work->view.pose[7], work->view.pose[11]};
    work->rays(s->direction, s->batch, s->number, &work->view, n);
    work->march(s->distance, s->count, s->direction, s->batch, NULL, work->not_before + begin, work->bits, origin,
                &work->settings, n);
    for (size_t i = 0; i < n; i++) {
      if (s->count[i] == 0) continue;
      s->hit[s->hits] = (int32_t)i;
      s->ray[s->hits++] = work->order[begin + i];
      if (profile != NULL) profile->count[ERN_PROFILE_MARCHED] += (uint64_t)s->count[i];
    }
    if (profile != NULL) {
      profile->count[ERN_PROFILE_RAYS] += n;
      profile->count[ERN_PROFILE_HITS] += s->hits;
    }
  }
  return true;
}

/* Computes the contribution of direction and individual code to the colour's first layer, for the next rays with
 * samples. */
static void compute_ray_terms(struct render_scratch *s, const struct ern_render_work *work) {
  const struct ern_frame_net *net = work->net;
  const size_t n = s->hits - s->shared < TILE ? s->hits - s->shared : TILE;
  for (size_t r = 0; r < net->colour; r++)
    for (size_t k = 0; k < TILE; k += LANES) vf_store(s->next_term + r * TILE + k, vf_all(net->code[r]));
  if (net->harmonics > 0) {
    float direction[3 * TILE];
    for (size_t axis = 0; axis < 3; axis++)
      for (size_t i = 0; i < TILE; i++)
        direction[axis * TILE + i] = s->direction[axis * s->batch + (size_t)s->hit[s->shared + (i < n ? i : 0)]];
    work->sh(s->harmonics, TILE, direction, TILE, TILE);
    tile_product(s->next_term, s->next_term, net->ray, s->harmonics, net->colour, net->harmonics, TILE_STORE);
  }
  s->shared += n;
}

/* Gives a slot the next ray. False where there is none. */
static bool take_ray(struct render_scratch *s, struct flight *f, size_t slot, const struct ern_render_work *work,
                     atomic_size_t *next, struct ern_profile *profile) {
  if (s->taken == s->hits && !next_rays(s, work, next, profile)) return false;
  if (s->taken == s->shared) compute_ray_terms(s, work);
  const size_t from = (size_t)s->hit[s->taken], max_steps = (size_t)work->settings.max_steps;
  f->ray[slot] = s->ray[s->taken];
  f->left[slot] = s->count[from];
  f->at[slot] = (int32_t)(slot * max_steps);
  memcpy(f->distance + slot * max_steps, s->distance + from * max_steps, (size_t)s->count[from] * sizeof(float));
  for (size_t axis = 0; axis < 3; axis++) f->d[axis][slot] = s->direction[axis * s->batch + from];
  const float *share = s->next_term + s->taken % TILE;
  for (size_t r = 0; r < work->net->colour; r++) f->ray_term[r * TILE + slot] = share[r * TILE];
  f->transmittance[slot] = 1;
  f->opacity[slot] = f->depth[slot] = f->attention[slot] = f->eye[slot] = 0;
  for (size_t c = 0; c < 3; c++) f->colour[c][slot] = 0;
  s->taken++;
  return true;
}

/* ---- a sample of each ray ---------------------------------------------------------------------------------------- */

/* x = clamp(o + t d), dt(t), and the distance at the sample's end */
static void next_samples(struct flight *f, const struct render_scratch *s, const struct ern_render_work *work) {
  const vf bound = vf_all(work->settings.bound);
  for (size_t k = 0; k < TILE; k += LANES) {
    vf t;
    for (size_t l = 0; l < LANES; l++) t[l] = f->distance[f->at[k + l]];
    const vf step = vf_min(vf_max(t * work->settings.dt_gamma, vf_all(s->shortest)), vf_all(s->longest));
    vf_store(f->dt + k, step);
    vf_store(f->end + k, t + step);
    for (size_t axis = 0; axis < 3; axis++) {
      const vf x = vf_multiply_rounded(t, vf_load(f->d[axis] + k)) + work->view.pose[4 * axis + 3];
      vf_store(f->x[axis] + k, vf_min(vf_max(x, -bound), bound));
    }
  }
}

/* w = alpha T, T *= 1 - alpha (paper eq. 1-2) */
static void add_samples(struct flight *f, const struct render_scratch *s, const struct ern_render_work *work) {
  for (size_t k = 0; k < TILE; k += LANES) {
    const vf tau = vf_load(s->sigma + k) * vf_load(f->dt + k), transmittance = vf_load(f->transmittance + k);
    const vf w = -vf_expm1(-tau) * transmittance;
    for (size_t c = 0; c < 3; c++)
      vf_store(f->colour[c] + k, vf_load(f->colour[c] + k) + w * vf_load(s->rgb + c * TILE + k));
    vf_store(f->opacity + k, vf_load(f->opacity + k) + w);
    vf_store(f->depth + k, vf_load(f->depth + k) + w * vf_load(f->end + k));
    if (work->attention != NULL) vf_store(f->attention + k, vf_load(f->attention + k) + vf_load(s->norm + k));
    if (work->eye != NULL) vf_store(f->eye + k, vf_load(f->eye + k) + vf_load(s->eye + k));
    vf_store(f->transmittance + k, transmittance * vf_exp(-tau));
  }
  for (size_t slot = 0; slot < TILE; slot++) f->at[slot] += f->ray[slot] >= 0;
  for (size_t slot = 0; slot < TILE; slot++) f->left[slot]--;
}

/* ---- rays going out ---------------------------------------------------------------------------------------------- */

static void put_ray(const struct flight *f, size_t slot, const struct ern_render_work *work) {
  const size_t ray = (size_t)f->ray[slot];
  const float opacity = f->opacity[slot];
  for (size_t c = 0; c < 3; c++) {
    const float value = f->colour[c][slot] + (1 - opacity) * work->background[c * work->background_stride + ray];
    work->pixel[c * work->pixel_stride + ray] = value < 0 ? 0 : value > 1 ? 1 : value;
    if (work->colour != NULL) work->colour[c * work->colour_stride + ray] = f->colour[c][slot];
  }
  work->opacity[ray] = opacity;
  if (work->depth != NULL) work->depth[ray] = f->depth[slot];
  if (work->attention != NULL) work->attention[ray] = f->attention[slot];
  if (work->eye != NULL) work->eye[ray] = f->eye[slot];
}

/* Marks a slot as empty. It still evaluates a sample of an earlier ray, or zeros; the result is not used. */
static void empty_slot(struct flight *f, size_t slot, const struct ern_render_work *work) {
  f->ray[slot] = -1;
  f->at[slot] = (int32_t)(slot * (size_t)work->settings.max_steps);
  f->left[slot] = INT32_MAX;
  f->transmittance[slot] = 1;
}

/* A bit for each slot whose ray has no transmittance or no sample left. */
static uint64_t slots_done(const struct flight *f, const struct ern_render_work *work) {
  uint64_t done = 0;
  for (size_t k = 0; k < TILE; k += LANES) {
    vi left;
    memcpy(&left, f->left + k, sizeof left);
    const vi spent = (vf_load(f->transmittance + k) < work->transmittance_stop) | (left == 0);
    done |= (uint64_t)vi_bits(spent) << k;
  }
  return done;
}

/* Writes out the finished rays and gives their slots to other rays. */
static void replace_finished_rays(struct render_scratch *s, struct flight *f, const struct ern_render_work *work,
                                  atomic_size_t *next, struct ern_profile *profile) {
  for (uint64_t done = slots_done(f, work); done != 0; done &= done - 1) {
    const size_t slot = (size_t)__builtin_ctzll(done);
    if (f->ray[slot] >= 0) {
      put_ray(f, slot, work);
      s->ended = s->ended || !take_ray(s, f, slot, work, next, profile);
      if (!s->ended) continue;
      f->flying--;
    }
    empty_slot(f, slot, work);
  }
}

static double lap(struct ern_profile *profile, ern_profile_stage stage, double since) {
  if (profile == NULL || !profile->timed) return 0;
  const double now = ern_profile_now();
  profile->seconds[stage] += now - since;
  return now;
}

/* Evaluates a sample of each ray in flight. False where there is none. */
static bool advance(struct render_scratch *s, const struct ern_render_work *work, atomic_size_t *next,
                    struct ern_profile *profile, double *at) {
  struct tile_places places[ERN_FLIGHTS];
  struct flight *flight[ERN_FLIGHTS] = {NULL};
  float *features[ERN_FLIGHTS];
  size_t tiles = 0;
  for (size_t k = 0; k < ERN_FLIGHTS; k++) {
    struct flight *f = &s->flight[k];
    if (f->flying == 0) continue;
    next_samples(f, s, work);
    tile_place(&places[tiles], f->x[0], work->net->bound);
    features[tiles] = f->features;
    flight[tiles++] = f;
    if (profile != NULL) profile->count[ERN_PROFILE_SAMPLES] += f->flying;
    if (profile != NULL) profile->count[ERN_PROFILE_COLOURS] += f->flying;
  }
  *at = lap(profile, ERN_PROFILE_MARCH, *at);
  encode_tiles(features, places, tiles, work->net);
  *at = lap(profile, ERN_PROFILE_ENCODE, *at);
  for (size_t k = 0; k < tiles; k++) {
    field_tile(s, flight[k], work->net, work->attention != NULL);
    *at = lap(profile, ERN_PROFILE_FORWARD, *at);
    add_samples(flight[k], s, work);
    *at = lap(profile, ERN_PROFILE_COMPOSITE, *at);
    replace_finished_rays(s, flight[k], work, next, profile);
    *at = lap(profile, ERN_PROFILE_MARCH, *at);
  }
  return tiles > 0;
}

void ERN_ISA(ern_render_worker)(const struct ern_render_work *work, atomic_size_t *next, void *scratch,
                                struct ern_profile *profile) {
  struct render_scratch *s = ern_render_scratch_make(scratch, work);
  double at = profile != NULL && profile->timed ? ern_profile_now() : 0;
  for (size_t k = 0; k < ERN_FLIGHTS; k++) {
    struct flight *f = &s->flight[k];
    for (size_t slot = 0; slot < TILE; slot++) {
      s->ended = s->ended || !take_ray(s, f, slot, work, next, profile);
      if (s->ended) empty_slot(f, slot, work);
      f->flying += !s->ended;
    }
  }
  while (advance(s, work, next, profile, &at)) {
  }
}
