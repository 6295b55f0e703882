/* SPDX-License-Identifier: MIT
 * Renders rays from direction to pixel, tile by tile, by the separate stages. */
#include "backend_cpu/slots.h"
#include "core/memory.h"
#include "core/profile.h"
#include "render/render_ops.h"
#include "render/stages.h"

enum { RAY_TILE = 1024 /* rays that a worker renders at a time */ };

struct render_job {
  struct ern_cpu_stream *stream;
  const struct ern_render_rays_args *args;
  ern_status *status;          /* by tile */
  struct ern_profile *profile; /* by tile, NULL: not asked for; tiles are counted at the same time */
};

static ern_span part(ern_span span, size_t begin, size_t count) {
  return span.buffer != NULL ? ern_span_part(span, begin, count) : span;
}
static ern_rows rows_from(ern_rows rows, size_t begin) {
  if (rows.span.buffer != NULL) rows.span = ern_span_part(rows.span, begin, rows.span.count - begin);
  return rows;
}

/* Runs all stages for a tile of rays on the worker's own serial stream, so that its samples stay in that core's cache.
 */
static void render_rays_task(void *user, size_t tile, int worker) {
  const struct render_job *job = user;
  const size_t begin = tile * RAY_TILE, left = job->args->n - begin, n = left < RAY_TILE ? left : RAY_TILE;
  struct ern_render_rays_args a = *job->args;
  a.pixel = rows_from(a.pixel, begin);
  a.colour = rows_from(a.colour, begin);
  a.background = rows_from(a.background, begin);
  a.opacity = part(a.opacity, begin, n);
  a.depth = part(a.depth, begin, n);
  a.attention = part(a.attention, begin, n);
  a.eye = part(a.eye, begin, n);
  a.pixel_number = part(a.pixel_number, begin, n);
  a.n = n;
  if (job->profile != NULL) a.profile = &job->profile[tile];
  job->status[tile] = ern_render_rays_stages(&job->stream->worker[worker]->base, &a);
}

/* No preparation: the stages read the parameters directly. */
ern_status ERN_REF(ern_cpu_render_prepare)(struct ern_stream *stream, struct ern_render_prepare_args *a) {
  (void)stream;
  (void)a;
  return ERN_OK;
}

ern_status ERN_REF(ern_cpu_render_rays)(struct ern_stream *stream, struct ern_render_rays_args *a) {
  struct ern_cpu_stream *cpu = (struct ern_cpu_stream *)stream;
  if (cpu->worker == NULL) return ern_render_rays_stages(stream, a);
  const size_t tiles = (a->n + RAY_TILE - 1) / RAY_TILE;
  struct render_job job = {.stream = cpu, .args = a};
  ern_status status = ERN_NEW(stream->backend->context, tiles, &job.status);
  if (status != ERN_OK) return status;
  if (a->profile != NULL) ERN_TRY(ERN_NEW(stream->backend->context, tiles, &job.profile));
  ern_pool_run(cpu->pool, tiles, render_rays_task, &job);
  for (size_t t = 0; t < tiles && status == ERN_OK; t++) status = job.status[t];
  for (size_t t = 0; t < tiles && job.profile != NULL; t++) ern_profile_add(a->profile, &job.profile[t]);
fail:
  ern_release(stream->backend->context, job.profile);
  ern_release(stream->backend->context, job.status);
  return status;
}
