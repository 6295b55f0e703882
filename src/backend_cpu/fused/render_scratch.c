/* SPDX-License-Identifier: MIT */
#include "backend_cpu/fused/render_scratch.h"

#include <math.h>
#include <string.h>

#include "backend_cpu/fused/pack_pairs.h"

enum {
  LINE = 64,           /* bytes of a cache line */
  BATCH_SAMPLES = 8192 /* most distances of a batch of rays, so that they stay in the cache */
};

static size_t batch_of(const struct ern_render_work *work) {
  const size_t rays = BATCH_SAMPLES / (size_t)work->settings.max_steps / 64 * 64;
  return rays < 64 ? 64 : rays;
}

static size_t most(size_t a, size_t b) { return a > b ? a : b; }

/* Cuts the next `bytes` of memory, aligned to a cache line; memory NULL: only counts them. */
static void *carve(char *memory, size_t *used, size_t bytes) {
  void *at = memory != NULL ? memory + *used : NULL;
  *used += (bytes + LINE - 1) / LINE * LINE;
  return at;
}

static size_t lay_out(struct render_scratch *s, char *memory, const struct ern_render_work *work) {
  const struct ern_frame_net *net = work->net;
  const size_t tile = ERN_MLP_TILE * sizeof(float), steps = (size_t)work->settings.max_steps, batch = batch_of(work);
  const size_t widest = most(most(net->density, net->colour), most(net->eye_hidden, net->value_rows));
  size_t used = 0;
  carve(memory, &used, sizeof *s);
  s->batch = batch;
  for (int k = 0; k < 2; k++) s->hidden[k] = carve(memory, &used, widest * tile);
  if (net->pairs)
    s->input = carve(memory, &used, (ern_pairs(net->features) + ern_pairs(net->attention) + ern_pairs(1)) * tile);
  s->next_term = carve(memory, &used, net->colour * tile);
  for (int k = 0; k < ERN_FLIGHTS; k++) {
    s->flight[k].distance = carve(memory, &used, steps * tile);
    s->flight[k].ray_term = carve(memory, &used, net->colour * tile);
    s->flight[k].features = carve(memory, &used, (net->features + net->attention + 1) * tile);
  }
  s->distance = carve(memory, &used, batch * steps * sizeof(float));
  s->direction = carve(memory, &used, 3 * batch * sizeof(float));
  s->number = carve(memory, &used, batch * sizeof(int32_t));
  s->count = carve(memory, &used, batch * sizeof(int32_t));
  s->hit = carve(memory, &used, batch * sizeof(int32_t));
  s->ray = carve(memory, &used, batch * sizeof(int32_t));
  return used;
}

size_t ern_render_worker_scratch(const struct ern_render_work *work) {
  struct render_scratch none;
  return lay_out(&none, NULL, work);
}

struct render_scratch *ern_render_scratch_make(void *scratch, const struct ern_render_work *work) {
  struct render_scratch *s = scratch;
  memset(scratch, 0, ern_render_worker_scratch(work));
  lay_out(s, scratch, work);
  /* as in render/march_ref.c */
  s->shortest = (float)(2 * sqrt(3.0) / work->settings.max_steps);
  s->longest = (float)(2 * sqrt(3.0) / ERN_OCCUPANCY_SIDE);
  if (s->shortest > s->longest) s->shortest = s->longest;
  return s;
}
