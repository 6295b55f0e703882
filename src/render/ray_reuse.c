/* SPDX-License-Identifier: MIT
 * Reuse of the previous frame's layers and rays. */
#include "render/ray_reuse.h"

#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/sized.h"
#include "render/picture_ops.h"

enum { PATIENCE = 4 /* frames of a view before its rays are sorted, which takes as long as several frames */ };

void ern_ray_reuse_forget(ern_renderer *r) {
  r->reuse.known = r->reuse.behind.known = false;
  ern_reused_rays_free(r);
}

void ern_ray_reuse_free(ern_renderer *r) {
  ern_ray_reuse_forget(r);
  ern_release(r->context, r->reuse.behind.background);
  ern_release(r->context, r->reuse.behind.torso);
  r->reuse.behind = (struct ern_ray_reuse_background){0};
}

ern_status ern_renderer_reuse_rays(ern_renderer *renderer, const float *windows, int window_length, const float *eyes,
                                   size_t count, float bound) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, renderer);
  if (count > 0) {
    ERN_NEED(renderer->context, windows);
    ERN_NEED(renderer->context, eyes);
  }
  struct ern_ray_reuse *s = &renderer->reuse;
  struct ern_speech_frame *frame = NULL;
  ern_status status = ERN_OK;
  if (!(bound <= 1))
    return ern_fail(renderer->context, ERN_E_ARGUMENT, "render: bound is %g, expected at most 1, or below 0 for off",
                    (double)bound);
  if (bound > 0 && count == 0)
    return ern_fail(renderer->context, ERN_E_ARGUMENT, "render: bound %g needs frames of the speech, found none",
                    (double)bound);
  ern_ray_reuse_free(renderer);
  *s = (struct ern_ray_reuse){.on = bound >= 0, .bound = bound};
  if (!(bound > 0)) return ERN_OK;
  ERN_TRY(ern_renderer_speech_frames(renderer, windows, window_length, eyes, count, &frame));
  for (size_t k = 0; k < count && !renderer->field.config.eye; k++) frame[k].eye = 0;
  ERN_TRY(ern_keyframes_choose(&s->keyframes, renderer->stream, &renderer->field,
                               ern_whole(renderer->parameters, renderer->field.parameters), frame, count));
fail:
  if (status != ERN_OK) s->on = false;
  ern_release(renderer->context, frame);
  return status;
}

void ern_renderer_ray_reuse_work_sized(const ern_renderer *renderer, ern_ray_reuse_work *work, size_t bytes) {
  const ern_ray_reuse_work own = renderer != NULL ? renderer->reuse.work : (ern_ray_reuse_work){0};
  ern_struct_copy_out(work, bytes, &own, sizeof own);
}

/* ---- behind the head --------------------------------------------------------------------------------------------- */

/* Whether *kept is a copy of `bytes`; if not, it becomes one. */
static ern_status same_bytes(ern_renderer *r, uint8_t **kept, const uint8_t *bytes, size_t count, bool *same) {
  ern_status status = ERN_OK;
  if (*kept != NULL && bytes != NULL && memcmp(*kept, bytes, count) == 0) return ERN_OK;
  if (*kept == NULL && bytes == NULL) return ERN_OK;
  *same = false;
  if (bytes == NULL) {
    ern_release(r->context, *kept);
    *kept = NULL;
  } else if (*kept == NULL) {
    status = ERN_NEW(r->context, count, kept);
  }
  if (*kept != NULL) memcpy(*kept, bytes, count);
  return status;
}

ern_status ern_ray_reuse_check_background(ern_renderer *r, const ern_frame_input *input) {
  struct ern_ray_reuse_background *b = &r->reuse.behind;
  bool same = b->known;
  const size_t pixels = r->frame.pixels;
  const bool torso = r->field.config.torso;
  float motion[ERN_MOTION_VALUES];
  ern_status status = ERN_OK;
  if (b->width != input->camera.width || b->height != input->camera.height) {
    ern_release(r->context, b->background);
    ern_release(r->context, b->torso);
    *b = (struct ern_ray_reuse_background){.width = input->camera.width, .height = input->camera.height};
  }
  b->known = false;
  ERN_TRY(same_bytes(r, &b->background, input->background, 3 * pixels, &same));
  ERN_TRY(same_bytes(r, &b->torso, input->torso, 4 * pixels, &same));
  ern_renderer_torso_motion(r, input, motion);
  if (torso &&
      (memcmp(b->motion, motion, sizeof motion) != 0 || memcmp(b->pose, input->camera.pose, sizeof b->pose) != 0 ||
       b->individual != input->individual || memcmp(&b->frame, &input->camera.frame, sizeof b->frame) != 0))
    same = false;
  if (memcmp(&b->frame, &input->camera.frame, sizeof b->frame) != 0) r->reuse.known = false; /* rays outside change */
  memcpy(b->pose, input->camera.pose, sizeof b->pose);
  memcpy(b->motion, motion, sizeof motion);
  b->frame = input->camera.frame;
  b->individual = input->individual;
  b->known = same;
  r->reuse.behind_changed = !same;
fail:
  return status;
}

/* ---- the head ---------------------------------------------------------------------------------------------------- */

static unsigned wanted_of(const struct ern_render_rays_args *all) {
  return (unsigned)(all->depth.buffer != NULL) | (unsigned)(all->attention.buffer != NULL) << 1 |
         (unsigned)(all->eye.buffer != NULL) << 2;
}

/* Whether the kept rows are of this view and have the wanted outputs. */
static bool is_unchanged(const struct ern_ray_reuse *s, const struct ern_render_rays_args *all) {
  return s->known && memcmp(&s->view, &all->view, sizeof s->view) == 0 && s->individual == all->individual &&
         wanted_of(all) == s->wanted;
}

static float eye_of(const ern_renderer *r, const struct ern_render_rays_args *all) {
  return r->field.config.eye ? all->eye_value : 0;
}

static ern_status render_whole(ern_renderer *r, const struct ern_render_rays_args *all) {
  struct ern_ray_reuse *s = &r->reuse;
  struct ern_render_rays_args args = *all;
  s->work.rays += 1;
  s->work.samples += 1;
  return r->backend->render_rays(r->stream, &args);
}

/* Renders the rays that are not steady, and writes them to their pixels. */
static ern_status render_anew(ern_renderer *r, const struct ern_render_rays_args *all, bool over) {
  struct ern_ray_reuse *s = &r->reuse;
  const ern_span list = {s->rays.list, s->rays.steady, s->rays.hits - s->rays.steady};
  const ern_span ray = {s->rays.ray, list.at, list.count};
  struct ern_render_rays_args some;
  ern_rows to[ERN_RAY_REUSE_CHANNELS + 1], from[ERN_RAY_REUSE_CHANNELS + 1];
  ern_status status = ERN_OK;
  if (list.count == 0) return ERN_OK;
  ERN_TRY(ern_ray_reuse_render(r, all, list, ray, &some));
  size_t count = ern_ray_reuse_rows(to, r, all);
  ern_ray_reuse_rows(from, r, &some);
  if (over) {
    to[count] = all->pixel;
    from[count++] = some.pixel;
  }
  for (size_t i = 0; i < count; i++) {
    struct ern_scatter_args scatter = {.to = to[i], .from = from[i], .pixel = list, .n = list.count};
    ERN_TRY(r->backend->scatter(r->stream, &scatter));
  }
  s->work.rays += (double)list.count / (double)s->rays.hits;
  s->work.samples += (double)s->rays.samples / (double)s->rays.all_samples;
fail:
  return status;
}

/* Interpolates the steady rays, and writes them to their pixels. */
static ern_status interpolate(ern_renderer *r, const struct ern_render_rays_args *all, const float *weight) {
  const struct ern_ray_reuse *s = &r->reuse;
  const size_t keyframes = s->keyframes.count;
  ern_rows to[ERN_RAY_REUSE_CHANNELS];
  const size_t channels = ern_ray_reuse_rows(to, r, all);
  struct ern_blend_args blend = {.pixel = {s->rays.list, 0, s->rays.steady}, .n = s->rays.steady};
  ern_status status = ERN_OK;
  if (blend.n == 0) return ERN_OK;
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_REAL, keyframes, &blend.weight));
  ERN_TRY(r->backend->upload_reals(r->stream, blend.weight, weight, keyframes));
  for (size_t c = 0; c < channels; c++) {
    blend.to = to[c].span;
    blend.from = ern_rows_part(s->rays.known_rows, (int)(c * keyframes), (int)keyframes);
    ERN_TRY(r->backend->blend(r->stream, &blend));
  }
fail:
  return status;
}

/* Composites the kept colours over another background. */
static ern_status lay_over(ern_renderer *r, const struct ern_render_rays_args *all) {
  struct ern_overlay_args overlay = {
      .pixel = all->pixel, .colour = all->colour, .opacity = all->opacity, .background = all->background, .n = all->n};
  return r->backend->overlay(r->stream, &overlay);
}

/* Renders a frame with the view of the frame before and other speech. */
static ern_status render_part(ern_renderer *r, const struct ern_render_rays_args *all, bool over, const float *weight) {
  const struct ern_arena_mark mark = ern_arena_mark(r->stream);
  ern_status status = ERN_OK;
  if (!r->reuse.rays.sorted) ERN_TRY(ern_ray_reuse_classify(r, all));
  ERN_TRY(interpolate(r, all, weight));
  if (over) ERN_TRY(lay_over(r, all));
  ERN_TRY(render_anew(r, all, over));
fail:
  ern_arena_release(r->stream, mark);
  return status;
}

ern_status ern_ray_reuse_head(ern_renderer *r, const struct ern_render_rays_args *all, bool over) {
  struct ern_ray_reuse *s = &r->reuse;
  const float eye = eye_of(r, all);
  const bool stands = is_unchanged(s, all), exact = !(s->bound > 0);
  float code[ERN_AUDIO_CODE], weight[ERN_KEYFRAMES] = {0};
  ern_status status = ERN_OK;
  ERN_TRY(r->backend->download_reals(r->stream, code, all->code, ERN_AUDIO_CODE));
  const bool same = memcmp(s->code, code, sizeof code) == 0 && memcmp(&s->eye, &eye, sizeof eye) == 0;
  s->known = false;                                                /* until the frame is complete */
  if (stands && same && (!exact || !over || !s->behind_changed)) { /* compositing again rounds once more */
    if (over && s->behind_changed) ERN_TRY(lay_over(r, all));
  } else if (stands &&
             (exact || (s->full_frames >= PATIENCE && ern_keyframes_weigh(weight, &s->keyframes, code, eye)))) {
    ERN_TRY(render_part(r, all, over, weight));
  } else {
    if (!stands) ern_reused_rays_free(r);
    s->full_frames = stands ? s->full_frames + 1 : 1;
    ERN_TRY(render_whole(r, all));
  }
  memcpy(s->code, code, sizeof code);
  s->eye = eye;
  s->view = all->view;
  s->individual = all->individual;
  s->wanted = wanted_of(all);
  s->known = true;
  s->work.frames++;
fail:
  return status;
}
