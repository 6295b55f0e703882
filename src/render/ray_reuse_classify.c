/* SPDX-License-Identifier: MIT
 * Sorts the rays of a view that does not change. Rays with samples are rendered at each keyframe of the speech. Where
 * the other keyframes predict each keyframe well, the ray is steady and interpolated from then on; a ray that changes
 * abruptly, such as at an edge of the lips or lids, is not. This test uses the rendered samples with their occlusion,
 * which a map of the cells would not show. */
#include <math.h>
#include <string.h>

#include "render/picture_ops.h"
#include "render/ray_reuse.h"
#include "render/tile_culling_ops.h"

enum {
  MARCHED = 1 << 14,    /* rays marched at once */
  MOST_VALUES = 1 << 26 /* values kept, 256 MiB: a view with more is rendered in full */
};

/* ---- some of the rays -------------------------------------------------------------------------------------------- */

ern_status ern_ray_reuse_render(ern_renderer *r, const struct ern_render_rays_args *all, ern_span list, ern_span ray,
                                struct ern_render_rays_args *some) {
  const size_t n = list.count;
  const ern_span *const from[] = {&all->opacity, &all->depth, &all->attention, &all->eye};
  ern_span *const to[] = {&some->opacity, &some->depth, &some->attention, &some->eye};
  ern_status status = ERN_OK;
  *some = *all;
  some->n = n;
  some->pixel_number = ray;
  ERN_TRY(ern_scratch_take_rows(r->stream, 3, n, &some->pixel));
  if (all->colour.span.buffer != NULL) ERN_TRY(ern_scratch_take_rows(r->stream, 3, n, &some->colour));
  for (size_t k = 0; k < sizeof from / sizeof *from; k++)
    if (from[k]->buffer != NULL) ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_REAL, n, to[k]));
  ERN_TRY(ern_scratch_take_rows(r->stream, 3, n, &some->background)); /* rows of rays have one stride */
  struct ern_gather_args gather = {.to = some->background, .from = all->background, .pixel = list, .n = n};
  ERN_TRY(r->backend->gather(r->stream, &gather));
  status = r->backend->render_rays(r->stream, some);
fail:
  return status;
}

static ern_rows one_row(ern_span span) { return (ern_rows){span, span.count, 1, ERN_PER_SAMPLE}; }

size_t ern_ray_reuse_rows(ern_rows rows[ERN_RAY_REUSE_CHANNELS], const ern_renderer *r,
                          const struct ern_render_rays_args *args) {
  const ern_span wanted[] = {args->opacity, args->depth, args->attention,
                             r->field.config.eye ? args->eye : (ern_span){0}};
  const ern_rows colour = args->colour.span.buffer != NULL ? args->colour : args->pixel;
  size_t count = 0;
  while (count < 3) {
    rows[count] = ern_rows_part(colour, (int)count, 1);
    count++;
  }
  for (size_t k = 0; k < sizeof wanted / sizeof *wanted; k++)
    if (wanted[k].buffer != NULL) rows[count++] = one_row(wanted[k]);
  return count;
}

/* The pixels of a view whose rays have samples. */
struct sorting {
  ern_renderer *r;
  const struct ern_render_rays_args *all;
  int32_t *pixel, *samples; /* [count]: its number, samples of its ray in occupied cells */
  int32_t *ray;             /* [count]: number of the pixel that its ray goes through */
  int32_t *through;         /* [all->n]: all->pixel_number */
  size_t count;
};

static void number_rays(struct sorting *s) {
  for (size_t i = 0; i < s->count; i++) s->ray[i] = s->through[s->pixel[i]];
}

/* ---- marching ---------------------------------------------------------------------------------------------------- */

/* samples[i] = samples of pixel[i]'s ray in the cells of `bits`. */
static ern_status march_some(const struct sorting *s, ern_span bits, const int32_t *pixel, int32_t *samples, size_t n) {
  const struct ern_renderer *r = s->r;
  const struct ern_arena_mark mark = ern_arena_mark(r->stream);
  const struct ern_render_rays_args *all = s->all;
  struct ern_rays_args rays = {.view = all->view, .n = n};
  struct ern_march_args march = {.bits = bits,
                                 .origin = {all->view.pose[3], all->view.pose[7], all->view.pose[11]},
                                 .settings = all->settings,
                                 .n = n};
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_INT32, n, &rays.pixel));
  ERN_TRY(ern_scratch_take_rows(r->stream, 3, n, &rays.dir));
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_INT32, n, &march.count));
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_REAL, n * (size_t)all->settings.max_steps, &march.t));
  ERN_TRY(r->backend->upload_int32(r->stream, rays.pixel, pixel, n));
  ERN_TRY(r->backend->rays(r->stream, &rays));
  march.dir = rays.dir;
  ERN_TRY(r->backend->march(r->stream, &march));
  status = r->backend->download_int32(r->stream, samples, march.count, n);
fail:
  ern_arena_release(r->stream, mark);
  return status;
}

static ern_status march(const struct sorting *s, ern_span bits, int32_t *samples) {
  ern_status status = ERN_OK;
  for (size_t begin = 0; begin < s->count && status == ERN_OK; begin += MARCHED)
    status =
        march_some(s, bits, s->ray + begin, samples + begin, s->count - begin < MARCHED ? s->count - begin : MARCHED);
  return status;
}

/* Finds the pixels whose rays have samples, among those whose block may see an occupied cell. */
static ern_status find_hits(struct sorting *s, const uint8_t *bits) {
  const struct ern_view *view = &s->all->view;
  const size_t across = ern_tile_count(view->width), blocks = across * ern_tile_count(view->height);
  float *nearest = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(s->r->context, blocks, &nearest));
  ern_tile_culling(nearest, bits, view, s->all->settings.bound);
  for (size_t i = 0; i < s->all->n; i++) {
    const size_t through = (size_t)s->through[i], row = through / (size_t)view->width;
    const size_t column = through % (size_t)view->width;
    if (nearest[row / ERN_TILE_SIDE * across + column / ERN_TILE_SIDE] < INFINITY) s->pixel[s->count++] = (int32_t)i;
  }
  number_rays(s);
  ERN_TRY(march(s, s->all->bits, s->samples));
  size_t hits = 0;
  for (size_t i = 0; i < s->count; i++) {
    if (s->samples[i] == 0) continue;
    s->pixel[hits] = s->pixel[i];
    s->samples[hits++] = s->samples[i];
  }
  s->count = hits;
  number_rays(s);
fail:
  ern_release(s->r->context, nearest);
  return status;
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

/* Rows of the hits at each of the keyframes: channel c at keyframe k is row c * keyframes + k. */
struct measured {
  float *value; /* [channels * keyframes][hits] */
  size_t channels, keyframes;
};

static ern_status render_keyframe(const struct sorting *s, struct measured *m, size_t k, ern_span list, ern_span ray,
                                  ern_span code) {
  ern_renderer *r = s->r;
  const struct ern_keyframes *keyframes = &r->reuse.keyframes;
  const struct ern_arena_mark mark = ern_arena_mark(r->stream);
  struct ern_render_rays_args all = *s->all, some;
  ern_rows rows[ERN_RAY_REUSE_CHANNELS];
  ern_status status = ERN_OK;
  all.code = code;
  all.eye_value = keyframes->eye[k];
  ERN_TRY(r->backend->upload_reals(r->stream, code, keyframes->code[k], ERN_AUDIO_CODE));
  ERN_TRY(ern_ray_reuse_render(r, &all, list, ray, &some));
  ern_ray_reuse_rows(rows, r, &some);
  for (size_t c = 0; c < m->channels; c++)
    ERN_TRY(
        r->backend->download_reals(r->stream, m->value + (c * m->keyframes + k) * s->count, rows[c].span, s->count));
fail:
  ern_arena_release(r->stream, mark);
  return status;
}

/* Whether the others predict each keyframe of a ray with an error of at most `most`, over any background. Over black
 * the error of a channel is that of its colour, over white that of colour minus opacity; over others it lies
 * between. */
static bool is_steady(const struct ern_keyframes *keyframes, const struct measured *m, size_t hits, size_t i,
                      float most) {
  float error[4][ERN_KEYFRAMES];
  for (size_t c = 0; c < 4; c++) ern_keyframes_error(error[c], keyframes, m->value + c * m->keyframes * hits + i, hits);
  for (size_t k = 0; k < m->keyframes; k++)
    for (size_t c = 0; c < 3; c++)
      if (!(fabsf(error[c][k]) <= most && fabsf(error[c][k] - error[3][k]) <= most)) return false;
  return true;
}

/* Moves the data of the steady rays to the front; the order within each kind is kept (stable partition). */
static ern_status part_hits(struct sorting *s, struct measured *m, const bool *steady, size_t count) {
  const size_t hits = s->count, rows = m->channels * m->keyframes;
  int32_t *parted = NULL;
  size_t front = 0, back = count;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(s->r->context, hits, &parted));
  for (size_t i = 0; i < hits; i++) parted[steady[i] ? front++ : back++] = s->pixel[i];
  memcpy(s->pixel, parted, hits * sizeof *parted);
  for (size_t row = 0; row < rows; row++) {
    float *value = m->value + row * hits;
    front = 0;
    for (size_t i = 0; i < hits; i++)
      if (steady[i]) value[front++] = value[i];
  }
fail:
  ern_release(s->r->context, parted);
  return status;
}

/* Stores the values of the steady rays at the keyframes. */
static ern_status keep_known(const struct sorting *s, const struct measured *m, struct ern_reused_rays *rays) {
  const ern_renderer *r = s->r;
  const size_t rows = m->channels * m->keyframes, stride = rays->steady;
  ern_status status = ERN_OK;
  if (rays->steady == 0) return ERN_OK;
  ERN_TRY(r->backend->buffer_make(r->backend, ERN_ELEMENT_REAL, rows * stride, &rays->known));
  rays->known_rows = (ern_rows){ern_whole(rays->known, rows * stride), stride, (int)rows, ERN_PER_SAMPLE};
  for (size_t row = 0; row < rows; row++)
    ERN_TRY(r->backend->upload_reals(r->stream, ern_span_of_row(rays->known_rows, (int)row, stride),
                                     m->value + row * s->count, stride));
fail:
  return status;
}

/* Partitions the hits into steady and other rays; rays->samples counts the samples of the others. */
static ern_status part_steady(struct sorting *s, struct measured *m, float most, struct ern_reused_rays *rays) {
  bool *steady = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(s->r->context, s->count, &steady));
  for (size_t i = 0; i < s->count; i++) {
    steady[i] = is_steady(&s->r->reuse.keyframes, m, s->count, i, most);
    rays->steady += steady[i];
    if (steady[i]) rays->samples -= (uint64_t)s->samples[i];
  }
  ERN_TRY(part_hits(s, m, steady, rays->steady));
  status = keep_known(s, m, rays);
fail:
  ern_release(s->r->context, steady);
  return status;
}

/* Bicubic upsampling has weights whose magnitudes sum to 1.25 per axis. A keyframe is predicted from fewer and farther
 * keyframes than a frame is; nevertheless errors of frames reach twice the worst error of a keyframe. So only a share
 * of the bound is used. */
static ern_status measure(struct sorting *s, struct ern_reused_rays *rays) {
  const float share = 0.4f, gain = s->r->options.image_scale < 1 ? 1.25f * 1.25f : 1;
  ern_renderer *r = s->r;
  const struct ern_arena_mark mark = ern_arena_mark(r->stream);
  ern_rows rows[ERN_RAY_REUSE_CHANNELS];
  struct measured m = {.channels = ern_ray_reuse_rows(rows, r, s->all), .keyframes = r->reuse.keyframes.count};
  ern_span list, ray, code;
  ern_status status = ERN_OK;
  if (s->count == 0 || s->count > MOST_VALUES / (m.channels * m.keyframes)) return ERN_OK;
  ERN_TRY(ERN_NEW(r->context, m.channels * m.keyframes * s->count, &m.value));
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_INT32, s->count, &list));
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_INT32, s->count, &ray));
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &code));
  ERN_TRY(r->backend->upload_int32(r->stream, list, s->pixel, s->count));
  ERN_TRY(r->backend->upload_int32(r->stream, ray, s->ray, s->count));
  for (size_t k = 0; k < m.keyframes; k++) ERN_TRY(render_keyframe(s, &m, k, list, ray, code));
  r->reuse.work.rays += (double)m.keyframes;
  r->reuse.work.samples += (double)m.keyframes;
  status = part_steady(s, &m, share / gain * r->reuse.bound, rays);
fail:
  ern_arena_release(r->stream, mark);
  ern_release(r->context, m.value);
  return status;
}

/* ---- sorting ----------------------------------------------------------------------------------------------------- */

void ern_reused_rays_free(ern_renderer *r) {
  r->backend->buffer_free(r->backend, r->reuse.rays.list);
  r->backend->buffer_free(r->backend, r->reuse.rays.ray);
  r->backend->buffer_free(r->backend, r->reuse.rays.known);
  r->reuse.rays = (struct ern_reused_rays){0};
}

static ern_status sort(struct sorting *s, struct ern_reused_rays *rays) {
  ern_renderer *r = s->r;
  uint8_t *bits = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(r->context, ERN_OCCUPANCY_BYTES, &bits));
  ERN_TRY(r->backend->download_bytes(r->stream, bits, s->all->bits, ERN_OCCUPANCY_BYTES));
  ERN_TRY(find_hits(s, bits));
  rays->hits = s->count;
  for (size_t i = 0; i < s->count; i++) rays->all_samples += (uint64_t)s->samples[i];
  rays->samples = rays->all_samples;
  if (r->reuse.bound > 0) ERN_TRY(measure(s, rays));
  number_rays(s);
  ERN_TRY(r->backend->buffer_make(r->backend, ERN_ELEMENT_INT32, s->count > 0 ? s->count : 1, &rays->list));
  ERN_TRY(r->backend->buffer_make(r->backend, ERN_ELEMENT_INT32, s->count > 0 ? s->count : 1, &rays->ray));
  ERN_TRY(r->backend->upload_int32(r->stream, ern_whole(rays->list, s->count), s->pixel, s->count));
  ERN_TRY(r->backend->upload_int32(r->stream, ern_whole(rays->ray, s->count), s->ray, s->count));
  rays->sorted = true;
fail:
  ern_release(r->context, bits);
  return status;
}

ern_status ern_ray_reuse_classify(ern_renderer *r, const struct ern_render_rays_args *all) {
  struct sorting s = {.r = r, .all = all};
  ern_status status = ERN_OK;
  ern_reused_rays_free(r);
  ERN_TRY(ERN_NEW(r->context, all->n, &s.pixel));
  ERN_TRY(ERN_NEW(r->context, all->n, &s.samples));
  ERN_TRY(ERN_NEW(r->context, all->n, &s.ray));
  ERN_TRY(ERN_NEW(r->context, all->n, &s.through));
  ERN_TRY(r->backend->download_int32(r->stream, s.through, all->pixel_number, all->n));
  status = sort(&s, &r->reuse.rays);
fail:
  ern_release(r->context, s.pixel);
  ern_release(r->context, s.samples);
  ern_release(r->context, s.ray);
  ern_release(r->context, s.through);
  if (status != ERN_OK) ern_reused_rays_free(r);
  return status;
}
