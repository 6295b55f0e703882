/* SPDX-License-Identifier: MIT */
#include "backend_cpu/fused/render.h"

#include <math.h>
#include <string.h>

#include "backend_cpu/cpu_kernels.h"
#include "core/memory.h"
#include "core/status.h"
#include "render/render_ops.h"
#include "render/stages.h"
#include "render/tile_culling_ops.h"

enum { SIDE = ERN_TILE_SIDE, FILL_RAYS = 4096 /* rays of a task that writes the background */ };

static float *floats(ern_span span) { return span.buffer != NULL ? (float *)span.buffer->memory + span.at : NULL; }

static struct ern_cpu_stream *of(struct ern_stream *stream) { return (struct ern_cpu_stream *)stream; }

static ern_status prepare(struct ern_stream *stream, struct ern_render_prepare_args *a) {
  ern_context *context = stream->backend->context;
  struct ern_cpu_stream *cpu = of(stream);
  ern_frame_net_free(context, cpu->net);
  cpu->net = NULL;
  cpu->net_of = (ern_span){0};
  if (!ern_frame_net_fits(a->field)) return ERN_OK;
  const bool pairs = ((const struct ern_cpu_backend *)stream->backend)->render_pairs;
  const ern_status status = ern_frame_net_make(context, a->field, floats(a->parameters), pairs, &cpu->net);
  if (status == ERN_OK) cpu->net_of = a->parameters;
  return status;
}

/* ---- which rays, and in which order ------------------------------------------------------------------------------ */

/* The rays of the blocks that see an occupied cell, block by block: neighbouring rays read the same cells of the grids.
 */
struct ray_order {
  int32_t *ray;
  float *not_before;
  size_t count;
};

static size_t block_of(int32_t pixel, const struct ern_view *view, size_t across) {
  const size_t row = (size_t)pixel / (size_t)view->width, column = (size_t)pixel % (size_t)view->width;
  return row / SIDE * across + column / SIDE;
}

/* A counting sort by block; `first` has one element more than there are blocks. */
static void sort_rays(struct ray_order *order, const struct ern_render_rays_args *a, const float *nearest,
                      int32_t *block, int32_t *first, size_t blocks) {
  const int32_t *pixel = (const int32_t *)a->pixel_number.buffer->memory + a->pixel_number.at;
  const size_t across = ern_tile_count(a->view.width);
  memset(first, 0, (blocks + 1) * sizeof *first);
  for (size_t i = 0; i < a->n; i++) {
    block[i] = (int32_t)block_of(pixel[i], &a->view, across);
    if (nearest[block[i]] < INFINITY) first[block[i] + 1]++;
  }
  for (size_t b = 0; b < blocks; b++) first[b + 1] += first[b];
  order->count = (size_t)first[blocks];
  for (size_t i = 0; i < a->n; i++) {
    const float distance = nearest[block[i]];
    if (!(distance < INFINITY)) continue;
    const size_t at = (size_t)first[block[i]]++;
    order->ray[at] = (int32_t)i;
    order->not_before[at] = distance;
  }
}

/* Whether the rays are all pixels in order, as in a frame: then no sorting is needed. */
static bool is_picture(const struct ern_render_rays_args *a) {
  const int32_t *pixel = (const int32_t *)a->pixel_number.buffer->memory + a->pixel_number.at;
  if (a->n != (size_t)a->view.width * (size_t)a->view.height) return false;
  int32_t other = 0;
  for (size_t i = 0; i < a->n; i++) other |= pixel[i] ^ (int32_t)i;
  return other == 0;
}

static void order_picture(struct ray_order *order, const struct ern_render_rays_args *a, const float *nearest) {
  const size_t width = (size_t)a->view.width, height = (size_t)a->view.height;
  const uint8_t *wanted = a->wanted.buffer != NULL ? (const uint8_t *)a->wanted.buffer->memory + a->wanted.at : NULL;
  for (size_t top = 0; top < height; top += SIDE) {
    for (size_t left = 0; left < width; left += SIDE) {
      const float distance = *nearest++;
      if (!(distance < INFINITY)) continue;
      for (size_t row = top; row < top + SIDE && row < height; row++) {
        for (size_t column = left; column < left + SIDE && column < width; column++) {
          const size_t ray = row * width + column;
          if (wanted != NULL && wanted[ray] == 0) continue;
          order->ray[order->count] = (int32_t)ray;
          order->not_before[order->count++] = distance;
        }
      }
    }
  }
}

static ern_status make_order(struct ern_stream *stream, const struct ern_render_rays_args *a, const uint8_t *bits,
                             struct ray_order *order) {
  const size_t blocks = ern_tile_count(a->view.width) * ern_tile_count(a->view.height);
  ern_span nearest, first, block, ray, distance;
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, blocks, &nearest));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, a->n, &ray));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, a->n, &distance));
  order->ray = (int32_t *)ray.buffer->memory + ray.at;
  order->not_before = floats(distance);
  ern_tile_culling(floats(nearest), bits, &a->view, a->settings.bound);
  if (is_picture(a)) {
    order_picture(order, a, floats(nearest));
    return ERN_OK;
  }
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, blocks + 1, &first));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, a->n, &block));
  sort_rays(order, a, floats(nearest), (int32_t *)block.buffer->memory + block.at,
            (int32_t *)first.buffer->memory + first.at, blocks);
fail:
  return status;
}

/* ---- the frame --------------------------------------------------------------------------------------------------- */

struct render_job {
  struct ern_render_work work;
  ern_render_worker_kernel *worker;
  atomic_size_t next;
  size_t rays;
  char *scratch;
  size_t scratch_bytes;        /* of one thread */
  struct ern_profile *profile; /* by thread; NULL: not wanted */
};

/* Writes every ray as one without samples (background); rays with samples overwrite it later. */
static void fill_task(void *user, size_t task, int worker) {
  (void)worker;
  const struct ern_render_work *w = &((const struct render_job *)user)->work;
  const size_t rays = ((const struct render_job *)user)->rays, begin = task * FILL_RAYS;
  const size_t n = rays - begin < FILL_RAYS ? rays - begin : FILL_RAYS;
  for (size_t c = 0; c < 3; c++) {
    const float *from = w->background + c * w->background_stride + begin;
    float *to = w->pixel + c * w->pixel_stride + begin;
    for (size_t i = 0; i < n; i++) to[i] = from[i] < 0 ? 0 : from[i] > 1 ? 1 : from[i];
    if (w->colour != NULL) memset(w->colour + c * w->colour_stride + begin, 0, n * sizeof(float));
  }
  float *const zero[] = {w->opacity, w->depth, w->attention, w->eye};
  for (size_t k = 0; k < 4; k++)
    if (zero[k] != NULL) memset(zero[k] + begin, 0, n * sizeof(float));
}

static void worker_task(void *user, size_t task, int worker) {
  (void)worker;
  struct render_job *job = user;
  job->worker(&job->work, &job->next, job->scratch + task * job->scratch_bytes,
              job->profile != NULL ? &job->profile[task] : NULL);
}

static struct ern_render_work work_of(const struct ern_cpu_stream *cpu, const struct ern_render_rays_args *a) {
  const struct ern_cpu_kernels *kernels = ((const struct ern_cpu_backend *)cpu->base.backend)->kernels;
  return (struct ern_render_work){.net = cpu->net,
                                  .rays = kernels->rays,
                                  .march = kernels->march_from,
                                  .sh = kernels->sh_fwd,
                                  .view = a->view,
                                  .settings = a->settings,
                                  .transmittance_stop = a->transmittance_stop,
                                  .bits = (const uint8_t *)a->bits.buffer->memory + a->bits.at,
                                  .pixel_number = (const int32_t *)a->pixel_number.buffer->memory + a->pixel_number.at,
                                  .pixel = floats(a->pixel.span),
                                  .colour = floats(a->colour.span),
                                  .opacity = floats(a->opacity),
                                  .depth = floats(a->depth),
                                  .attention = floats(a->attention),
                                  .eye = cpu->net->eye ? floats(a->eye) : NULL,
                                  .background = floats(a->background.span),
                                  .pixel_stride = a->pixel.stride,
                                  .colour_stride = a->colour.stride,
                                  .background_stride = a->background.stride};
}

static bool prepared_for(const struct ern_cpu_stream *cpu, ern_span parameters) {
  return cpu->net != NULL && cpu->net_of.buffer == parameters.buffer && cpu->net_of.at == parameters.at;
}

static ern_status render_rays(struct ern_stream *stream, struct ern_render_rays_args *a) {
  struct ern_cpu_stream *cpu = of(stream);
  const struct ern_cpu_backend *backend = (const struct ern_cpu_backend *)stream->backend;
  if (cpu->worker == NULL || !prepared_for(cpu, a->parameters)) return backend->render_rays_stages(stream, a);
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const size_t threads = (size_t)ern_pool_threads(cpu->pool);
  struct ray_order order = {0};
  ern_span scratch, profiles;
  ern_status status = ERN_OK;
  const double began = ern_profile_now();
  struct render_job job = {.work = work_of(cpu, a), .worker = backend->render_worker, .rays = a->n};
  ern_frame_net_fold(cpu->net, a->field, floats(a->parameters), floats(a->code), a->eye_value, a->individual);
  ern_pool_run(cpu->pool, (a->n + FILL_RAYS - 1) / FILL_RAYS, fill_task, &job);
  ERN_TRY(make_order(stream, a, job.work.bits, &order));
  job.work.order = order.ray;
  job.work.not_before = order.not_before;
  job.work.count = order.count;
  job.scratch_bytes = ern_render_worker_scratch(&job.work);
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_BYTE, job.scratch_bytes * threads, &scratch));
  job.scratch = (char *)scratch.buffer->memory + scratch.at;
  if (a->profile != NULL) {
    ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_BYTE, threads * sizeof *job.profile, &profiles));
    job.profile = (struct ern_profile *)(void *)((char *)profiles.buffer->memory + profiles.at);
    for (size_t k = 0; k < threads; k++) job.profile[k] = (struct ern_profile){.timed = a->profile->timed};
    if (a->profile->timed) a->profile->seconds[ERN_PROFILE_MARCH] += ern_profile_now() - began;
    a->profile->count[ERN_PROFILE_PIXELS] += a->n;
  }
  ern_pool_run(cpu->pool, threads, worker_task, &job);
  for (size_t k = 0; a->profile != NULL && k < threads; k++) ern_profile_add(a->profile, &job.profile[k]);
fail:
  ern_arena_release(stream, mark);
  return status;
}

void ern_cpu_fuse_render(struct ern_backend *backend) {
  struct ern_cpu_backend *cpu = (struct ern_cpu_backend *)backend;
  cpu->render_rays_stages = backend->render_rays;
  backend->render_prepare = prepare;
  backend->render_rays = render_rays;
}
