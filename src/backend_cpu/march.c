/* SPDX-License-Identifier: MIT
 * Slots from pixels to samples and back: rays, march, composite, occupancy, torso, and a tile of rays whole. */
#include "backend_cpu/slots.h"
#include "core/memory.h"
#include "render/stages.h"

enum { RAY_TILE = 1024 /* rays that a lane renders at a time */ };

/* ---- rays and samples -------------------------------------------------------------------------------------------- */

static void rays_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_rays_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->rays(reals(a->dir.span) + r.begin, a->dir.stride, int32s(a->pixel) + r.begin, &a->view,
                     r.end - r.begin);
}
static ern_status rays(struct ern_stream *stream, struct ern_rays_args *a) {
  run(stream, a, ERN_SHARDS, rays_task);
  return ERN_OK;
}

static void march_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_march_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->march(reals(a->t) + r.begin * (size_t)a->settings.max_steps, int32s(a->count) + r.begin,
                      reals(a->dir.span) + r.begin, a->dir.stride, after(reals(a->jitter), r.begin), bytes(a->bits),
                      a->origin, &a->settings, r.end - r.begin);
}
static ern_status march(struct ern_stream *stream, struct ern_march_args *a) {
  run(stream, a, ERN_SHARDS, march_task);
  return ERN_OK;
}

static ern_status scan(struct ern_stream *stream, struct ern_scan_args *a) {
  const int32_t *count = int32s(a->count);
  int32_t *first = int32s(a->first);
  int64_t total = 0;
  for (size_t i = 0; i < a->n; i++) {
    first[i] = (int32_t)total;
    total += count[i];
    if (total > INT32_MAX)
      return ern_fail(stream->backend->context, ERN_E_NO_MEMORY, "march: more than %d samples in one batch", INT32_MAX);
  }
  first[a->n] = (int32_t)total;
  a->total = (size_t)total;
  return ERN_OK;
}

static void samples_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_samples_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->samples(reals(a->x.span), a->x.stride, reals(a->dt), reals(a->depth), int32s(a->ray),
                        reals(a->t) + r.begin * (size_t)a->settings.max_steps, int32s(a->first) + r.begin,
                        reals(a->dir.span) + r.begin, a->dir.stride, a->origin, &a->settings, r.begin, r.end - r.begin);
}
static ern_status samples(struct ern_stream *stream, struct ern_samples_args *a) {
  run(stream, a, ERN_SHARDS, samples_task);
  return ERN_OK;
}

/* ---- composite --------------------------------------------------------------------------------------------------- */

static struct ern_composite_view composite_view(const struct ern_composite_args *a, size_t begin) {
  return (struct ern_composite_view){.pixel = after(reals(a->pixel.span), begin),
                                     .colour = after(reals(a->colour.span), begin),
                                     .opacity = after(reals(a->opacity), begin),
                                     .depth = after(reals(a->depth), begin),
                                     .attention = after(reals(a->attention), begin),
                                     .eye = after(reals(a->eye), begin),
                                     .uncertainty = after(reals(a->uncertainty), begin),
                                     .first = int32s(a->first) + begin,
                                     .sigma = reals(a->sigma),
                                     .dt = reals(a->dt),
                                     .sample_depth = reals(a->sample_depth),
                                     .sample_attention = reals(a->sample_attention),
                                     .sample_eye = reals(a->sample_eye),
                                     .sample_uncertainty = reals(a->sample_uncertainty),
                                     .rgb = reals(a->rgb.span),
                                     .background = after(reals(a->background.span), begin),
                                     .ray_stride = a->background.stride,
                                     .rgb_stride = a->rgb.stride,
                                     .transmittance_stop = a->transmittance_stop};
}
static void composite_fwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_composite_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  const struct ern_composite_view view = composite_view(a, r.begin);
  job->kernels->composite_fwd(&view, r.end - r.begin);
}
static ern_status composite_fwd(struct ern_stream *stream, struct ern_composite_args *a) {
  run(stream, a, ERN_SHARDS, composite_fwd_task);
  return ERN_OK;
}
static void composite_bwd_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_composite_bwd_args *a = job->args;
  const struct range r = shard(a->forward.n, 64, k);
  const struct ern_composite_bwd_view view = {.dsigma = reals(a->dsigma),
                                              .drgb = reals(a->drgb.span),
                                              .dsample_attention = reals(a->dsample_attention),
                                              .dsample_eye = reals(a->dsample_eye),
                                              .dsample_uncertainty = reals(a->dsample_uncertainty),
                                              .dpixel = after(reals(a->dpixel.span), r.begin),
                                              .dopacity = after(reals(a->dopacity), r.begin),
                                              .dattention = after(reals(a->dattention), r.begin),
                                              .deye = after(reals(a->deye), r.begin),
                                              .duncertainty = after(reals(a->duncertainty), r.begin),
                                              .forward = composite_view(&a->forward, r.begin)};
  job->kernels->composite_bwd(&view, r.end - r.begin);
}
static ern_status composite_bwd(struct ern_stream *stream, struct ern_composite_bwd_args *a) {
  run(stream, a, ERN_SHARDS, composite_bwd_task);
  return ERN_OK;
}

/* ---- occupancy ----------------------------------------------------------------------------------------------------
 */

static void occupancy_mark_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_occupancy_mark_args *a = job->args;
  const struct range r = shard(ERN_OCCUPANCY_CELLS, 64, k);
  job->kernels->occupancy_mark(reals(a->grid), a->views, a->view_count, a->bound, (uint32_t)r.begin, (uint32_t)r.end);
}
static ern_status occupancy_mark(struct ern_stream *stream, struct ern_occupancy_mark_args *a) {
  run(stream, a, ERN_SHARDS, occupancy_mark_task);
  return ERN_OK;
}
static ern_status occupancy_list(struct ern_stream *stream, struct ern_occupancy_list_args *a) {
  a->count = kernels_of(stream)->occupancy_list(int32s(a->cells), reals(a->grid));
  return ERN_OK;
}
static void occupancy_points_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_occupancy_points_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->occupancy_points(reals(a->x.span) + r.begin, a->x.stride, int32s(a->cells) + r.begin, a->bound, a->seed,
                                 a->step, r.end - r.begin);
}
static ern_status occupancy_points(struct ern_stream *stream, struct ern_occupancy_points_args *a) {
  run(stream, a, ERN_SHARDS, occupancy_points_task);
  return ERN_OK;
}
static ern_status occupancy_scatter(struct ern_stream *stream, struct ern_occupancy_scatter_args *a) {
  (void)stream;
  ern_real *fresh = reals(a->fresh);
  const int32_t *cells = int32s(a->cells);
  const ern_real *sigma = reals(a->sigma);
  for (size_t i = 0; i < a->n; i++) fresh[cells[i]] = sigma[i];
  return ERN_OK;
}

struct occupancy_job {
  const struct ern_cpu_kernels *kernels;
  const struct ern_occupancy_update_args *args;
  double sum[ERN_SHARDS];
  float threshold;
};
static void occupancy_update_task(void *user, size_t k, int lane) {
  (void)lane;
  struct occupancy_job *job = user;
  const struct range r = shard(ERN_OCCUPANCY_CELLS, 64, k);
  job->kernels->occupancy_update(reals(job->args->grid), &job->sum[k], reals(job->args->fresh), job->args->decay,
                                 (uint32_t)r.begin, (uint32_t)r.end);
}
static void occupancy_pack_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct occupancy_job *job = user;
  const struct range r = shard(ERN_OCCUPANCY_BYTES, 64, k);
  job->kernels->occupancy_pack(bytes(job->args->bits), reals(job->args->grid), job->threshold, (uint32_t)r.begin,
                               (uint32_t)r.end);
}
static ern_status occupancy_update(struct ern_stream *stream, struct ern_occupancy_update_args *a) {
  struct occupancy_job job = {.kernels = kernels_of(stream), .args = a};
  ern_pool_run(pool_of(stream), ERN_SHARDS, occupancy_update_task, &job);
  double sum = 0;
  for (int k = 0; k < ERN_SHARDS; k++) sum += job.sum[k];
  a->mean = sum / ERN_OCCUPANCY_CELLS;
  job.threshold = a->mean < (double)a->limit ? (float)a->mean : a->limit;
  ern_pool_run(pool_of(stream), ERN_SHARDS, occupancy_pack_task, &job);
  return ERN_OK;
}

/* ---- torso ------------------------------------------------------------------------------------------------------- */

static ern_status torso_pose_fwd(struct ern_stream *stream, struct ern_torso_pose_args *a) {
  kernels_of(stream)->torso_pose_fwd(reals(a->k), reals(a->anchors), reals(a->gamma), a->pose);
  return ERN_OK;
}
static ern_status torso_pose_bwd(struct ern_stream *stream, struct ern_torso_pose_bwd_args *a) {
  kernels_of(stream)->torso_pose_bwd(reals(a->danchors), reals(a->dgamma), reals(a->dk), reals(a->forward.anchors),
                                     reals(a->forward.gamma), a->forward.pose);
  return ERN_OK;
}
static ern_status torso_coords(struct ern_stream *stream, struct ern_torso_coords_args *a) {
  kernels_of(stream)->torso_coords(reals(a->q.span), a->q.stride, int32s(a->pixel), a->width, a->height, a->shrink,
                                   a->n);
  return ERN_OK;
}
static ern_status torso_select(struct ern_stream *stream, struct ern_torso_select_args *a) {
  a->count = kernels_of(stream)->torso_select(int32s(a->index), int32s(a->selected), int32s(a->pixel), reals(a->grid),
                                              a->threshold, a->width, a->height, a->n);
  return ERN_OK;
}
static ern_status torso_deform_fwd(struct ern_stream *stream, struct ern_torso_deform_args *a) {
  kernels_of(stream)->torso_deform_fwd(reals(a->x.span), reals(a->q.span), reals(a->d.span), a->x.stride, a->n);
  return ERN_OK;
}
static ern_status torso_deform_bwd(struct ern_stream *stream, struct ern_torso_deform_bwd_args *a) {
  kernels_of(stream)->torso_deform_bwd(reals(a->dd.span), reals(a->dx.span), reals(a->forward.q.span),
                                       reals(a->forward.d.span), a->dd.stride, a->forward.n);
  return ERN_OK;
}
static ern_status torso_composite_fwd(struct ern_stream *stream, struct ern_torso_composite_args *a) {
  ern_real *pixel = reals(a->pixel.span);
  const ern_real *background = reals(a->background.span);
  for (size_t c = 0; c < 3 && pixel != background; c++)
    memcpy(pixel + c * a->pixel.stride, background + c * a->background.stride, a->rays * sizeof *pixel);
  if (a->opacity.buffer != NULL) memset(reals(a->opacity), 0, a->rays * sizeof *pixel);
  kernels_of(stream)->torso_composite_fwd(pixel, reals(a->opacity), reals(a->layer.span), a->layer.stride,
                                          int32s(a->index), background, a->background.stride, a->n);
  return ERN_OK;
}
static ern_status torso_composite_bwd(struct ern_stream *stream, struct ern_torso_composite_bwd_args *a) {
  kernels_of(stream)->torso_composite_bwd(
      reals(a->dlayer.span), a->dlayer.stride, reals(a->dpixel.span), reals(a->forward.layer.span),
      int32s(a->forward.index), reals(a->forward.background.span), a->forward.background.stride, a->forward.n);
  return ERN_OK;
}
static ern_status torso_points(struct ern_stream *stream, struct ern_torso_points_args *a) {
  kernels_of(stream)->torso_points(reals(a->q.span), a->q.stride, a->shrink, a->seed, a->step);
  return ERN_OK;
}
static ern_status torso_update(struct ern_stream *stream, struct ern_torso_update_args *a) {
  a->mean = kernels_of(stream)->torso_update(reals(a->grid), reals(a->alpha), a->decay);
  return ERN_OK;
}

/* ---- fused ------------------------------------------------------------------------------------------------------- */

struct render_job {
  struct ern_cpu_stream *stream;
  const struct ern_render_rays_args *args;
  ern_status *status; /* by tile */
};

static ern_span part(ern_span span, size_t begin, size_t count) {
  return span.buffer != NULL ? ern_span_part(span, begin, count) : span;
}
static ern_rows rows_from(ern_rows rows, size_t begin) {
  if (rows.span.buffer != NULL) rows.span = ern_span_part(rows.span, begin, rows.span.count - begin);
  return rows;
}

/* A tile of rays through all stages on the lane's own serial stream: its samples stay in that core's cache. */
static void render_rays_task(void *user, size_t tile, int lane) {
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
  job->status[tile] = ern_render_rays_stages(&job->stream->lane[lane]->base, &a);
}

/* The stages read the parameters as they are. */
static ern_status render_prepare(struct ern_stream *stream, struct ern_render_prepare_args *a) {
  (void)stream;
  (void)a;
  return ERN_OK;
}

static ern_status render_rays(struct ern_stream *stream, struct ern_render_rays_args *a) {
  struct ern_cpu_stream *cpu = (struct ern_cpu_stream *)stream;
  if (cpu->lane == NULL) return ern_render_rays_stages(stream, a);
  const size_t tiles = (a->n + RAY_TILE - 1) / RAY_TILE;
  void *room = NULL;
  ern_status status = ern_allocate(stream->backend->context, tiles, sizeof(ern_status), &room);
  if (status != ERN_OK) return status;
  struct render_job job = {.stream = cpu, .args = a, .status = room};
  ern_pool_run(cpu->pool, tiles, render_rays_task, &job);
  for (size_t t = 0; t < tiles && status == ERN_OK; t++) status = job.status[t];
  ern_release(stream->backend->context, room);
  return status;
}

void ERN_REF(ern_cpu_fill_render)(struct ern_backend *backend) {
  backend->rays = rays;
  backend->march = march;
  backend->scan = scan;
  backend->samples = samples;
  backend->composite_fwd = composite_fwd;
  backend->composite_bwd = composite_bwd;
  backend->occupancy_mark = occupancy_mark;
  backend->occupancy_list = occupancy_list;
  backend->occupancy_points = occupancy_points;
  backend->occupancy_scatter = occupancy_scatter;
  backend->occupancy_update = occupancy_update;
  backend->torso_pose_fwd = torso_pose_fwd;
  backend->torso_pose_bwd = torso_pose_bwd;
  backend->torso_coords = torso_coords;
  backend->torso_select = torso_select;
  backend->torso_deform_fwd = torso_deform_fwd;
  backend->torso_deform_bwd = torso_deform_bwd;
  backend->torso_composite_fwd = torso_composite_fwd;
  backend->torso_composite_bwd = torso_composite_bwd;
  backend->torso_points = torso_points;
  backend->torso_update = torso_update;
  backend->render_prepare = render_prepare;
  backend->render_rays = render_rays;
  backend->render_torso = ern_render_torso_stages;
}
