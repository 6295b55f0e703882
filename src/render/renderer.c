/* SPDX-License-Identifier: MIT
 * A renderer: a model on a backend, a stream of its own, and frames out of it. */
#include <math.h>
#include <string.h>
#include <time.h>

#include "core/memory.h"
#include "model/model.h"
#include "render/stages.h"

#include "ernerf/render.h"

enum { OPTIONS_COOKIE = 0x45524e33, MAX_SIDE = 8192 };

struct ern_renderer {
  ern_context *context;
  struct ern_backend *backend;
  const ern_model *model;
  struct ern_field field; /* the model's; the window length is that of the features at hand */
  ern_render_options options;
  struct ern_stream *stream;
  struct ern_buffer *parameters, *bits, *torso_grid, *code;
  float torso_threshold;
  bool has_last_code;
  float last_code[ERN_AUDIO_CODE];
};

/* What a frame needs on the device while it is rendered. */
struct frame {
  size_t pixels;
  ern_span number;                                        /* int32: all pixels in order */
  ern_rows background, pixel;                             /* [3] per pixel */
  ern_rows torso_opacity, opacity, depth, attention, eye; /* [1] */
};

ern_render_options ern_render_options_default(void) {
  return (ern_render_options){.cookie = OPTIONS_COOKIE,
                              .threads = 0,
                              .max_steps = 16,
                              .dt_gamma = 1.0f / 256,
                              .transmittance_stop = 1e-4f,
                              .torso_shrink = 0.8f,
                              .smooth_lips = false};
}

static ern_status check_options(ern_context *context, const ern_render_options *o) {
  if (o->cookie != OPTIONS_COOKIE)
    return ern_fail(context, ERN_E_ARGUMENT, "render: the options were not made by ern_render_options_default");
  if (o->max_steps < 1 || o->max_steps > ERN_MAX_STEPS)
    return ern_fail(context, ERN_E_ARGUMENT, "render: max_steps is %d, expected 1 to %d", o->max_steps, ERN_MAX_STEPS);
  if (!(o->dt_gamma >= 0 && o->dt_gamma <= 1))
    return ern_fail(context, ERN_E_ARGUMENT, "render: dt_gamma is %g, expected 0 to 1", (double)o->dt_gamma);
  if (!(o->transmittance_stop >= 0 && o->transmittance_stop < 1))
    return ern_fail(context, ERN_E_ARGUMENT, "render: transmittance_stop is %g, expected 0 to 1",
                    (double)o->transmittance_stop);
  if (!(o->torso_shrink > 0 && o->torso_shrink <= 1))
    return ern_fail(context, ERN_E_ARGUMENT, "render: torso_shrink is %g, expected above 0, at most 1",
                    (double)o->torso_shrink);
  return ERN_OK;
}

static ern_span whole(struct ern_buffer *buffer, size_t count) { return (ern_span){buffer, 0, count}; }

static ern_status upload_model(ern_renderer *r) {
  struct ern_backend *backend = r->backend;
  const ern_model *model = r->model;
  ern_status status = ERN_OK;
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, r->field.parameters, &r->parameters));
  ERN_TRY(
      backend->upload_reals(r->stream, whole(r->parameters, r->field.parameters), model->block, r->field.parameters));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &r->bits));
  ERN_TRY(backend->upload_bytes(r->stream, whole(r->bits, ERN_OCCUPANCY_BYTES), model->bits, ERN_OCCUPANCY_BYTES));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &r->code));
  if (r->field.config.torso) {
    double sum = 0;
    for (size_t i = 0; i < ERN_TORSO_CELLS; i++) sum += (double)model->torso_grid[i];
    r->torso_threshold = fminf(0.01f, (float)(sum / ERN_TORSO_CELLS));
    ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, ERN_TORSO_CELLS, &r->torso_grid));
    ERN_TRY(
        backend->upload_reals(r->stream, whole(r->torso_grid, ERN_TORSO_CELLS), model->torso_grid, ERN_TORSO_CELLS));
  }
fail:
  return status;
}

ern_status ern_renderer_create(ern_renderer **renderer, ern_backend *backend, const ern_model *model,
                               const ern_render_options *options) {
  ern_context *context = backend->context;
  const ern_render_options chosen = options != NULL ? *options : ern_render_options_default();
  void *room = NULL;
  ern_renderer *made = NULL;
  ern_status status = ERN_OK;
  *renderer = NULL;
  ERN_TRY(check_options(context, &chosen));
  ERN_TRY(ern_allocate(context, 1, sizeof *made, &room));
  made = room;
  made->context = context;
  made->backend = backend;
  made->model = model;
  made->field = model->field;
  made->options = chosen;
  ERN_TRY(backend->stream_make(backend, chosen.threads, &made->stream));
  ERN_TRY(upload_model(made));
  *renderer = made;
  return ERN_OK;
fail:
  ern_renderer_free(&made);
  return status;
}

void ern_renderer_free(ern_renderer **renderer) {
  if (renderer == NULL || *renderer == NULL) return;
  ern_renderer *r = *renderer;
  *renderer = NULL;
  r->backend->buffer_free(r->backend, r->parameters);
  r->backend->buffer_free(r->backend, r->bits);
  r->backend->buffer_free(r->backend, r->torso_grid);
  r->backend->buffer_free(r->backend, r->code);
  r->backend->stream_free(r->stream);
  ern_release(r->context, r);
}

ern_status ern_renderer_accepts(const ern_renderer *renderer, const ern_features *features, const char *name) {
  const int width = renderer->field.config.feature_width;
  if (features->width == width) return ERN_OK;
  return ern_fail(renderer->context, ERN_E_MISMATCH,
                  "%s: the features are %d wide, expected %d: the model was trained on features of another kind", name,
                  features->width, width);
}

/* ---- a frame ----------------------------------------------------------------------------------------------------- */

static double milliseconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec * 1e3 + (double)now.tv_nsec * 1e-6;
}

/* Determinant of the rotation part: what the torso's inverse needs to be away from 0. */
static double determinant(const float m[16]) {
  const double a = (double)m[0], b = (double)m[1], c = (double)m[2], d = (double)m[4], e = (double)m[5],
               f = (double)m[6], g = (double)m[8], h = (double)m[9], i = (double)m[10];
  return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
}

static ern_status check_input(const ern_renderer *r, const ern_frame_input *input) {
  const ern_camera *camera = &input->camera;
  ern_context *context = r->context;
  if (camera->width < 1 || camera->width > MAX_SIDE || camera->height < 1 || camera->height > MAX_SIDE)
    return ern_fail(context, ERN_E_ARGUMENT, "render: the size is %d x %d, expected 1 to %d a side", camera->width,
                    camera->height, MAX_SIDE);
  if (!(camera->focal > 0) || !isfinite(camera->focal) || !isfinite(camera->cx) || !isfinite(camera->cy))
    return ern_fail(context, ERN_E_ARGUMENT,
                    "render: camera: focal %g, centre %g, %g, expected finite numbers, focal above 0",
                    (double)camera->focal, (double)camera->cx, (double)camera->cy);
  for (int i = 0; i < 16; i++)
    if (!isfinite(camera->pose[i]))
      return ern_fail(context, ERN_E_NONFINITE, "render: pose: value %d is not finite", i);
  if (!(fabs(determinant(camera->pose)) > 1e-6))
    return ern_fail(context, ERN_E_ARGUMENT, "render: pose: its rotation cannot be inverted");
  for (int i = 0; i < 16; i++)
    if (input->head_pose != NULL && !isfinite(input->head_pose[i]))
      return ern_fail(context, ERN_E_NONFINITE, "render: head_pose: value %d is not finite", i);
  if (input->windows == NULL || input->window_length < 1 || input->window_length > 16)
    return ern_fail(context, ERN_E_ARGUMENT, "render: window_length is %d, expected 1 to 16 and windows",
                    input->window_length);
  const size_t values =
      (size_t)ERN_AUDIO_WINDOWS * (size_t)input->window_length * (size_t)r->field.config.feature_width;
  for (size_t i = 0; i < values; i++)
    if (!isfinite(input->windows[i]))
      return ern_fail(context, ERN_E_NONFINITE, "render: speech window: value %zu is not finite", i);
  if (!(input->eye >= 0 && input->eye <= 1))
    return ern_fail(context, ERN_E_ARGUMENT, "render: eye is %g, expected 0 to 1", (double)input->eye);
  if (r->field.config.codes > 0 && input->individual >= (size_t)r->field.config.codes)
    return ern_fail(context, ERN_E_ARGUMENT, "render: individual code %zu, expected 0 to %d", input->individual,
                    r->field.config.codes - 1);
  return ERN_OK;
}

static ern_status take_frame(ern_renderer *r, size_t pixels, struct frame *f) {
  ern_rows *const values[] = {&f->torso_opacity, &f->opacity, &f->depth, &f->attention, &f->eye};
  ern_status status = ERN_OK;
  void *room = NULL;
  f->pixels = pixels;
  ERN_TRY(ern_take(r->stream, ERN_ELEMENT_INT32, pixels, &f->number));
  ERN_TRY(ern_take_rows(r->stream, 3, pixels, &f->background));
  ERN_TRY(ern_take_rows(r->stream, 3, pixels, &f->pixel));
  for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
    ERN_TRY(ern_take_rows(r->stream, 1, pixels, values[i]));
    ERN_TRY(r->backend->zero(r->stream, values[i]->span));
  }
  ERN_TRY(ern_allocate(r->context, pixels, sizeof(int32_t), &room));
  for (size_t i = 0; i < pixels; i++) ((int32_t *)room)[i] = (int32_t)i;
  status = r->backend->upload_int32(r->stream, f->number, room, pixels);
fail:
  ern_release(r->context, room);
  return status;
}

/* The audio code of the frame, smoothed over frames where that is asked for. */
static ern_status audio_code(ern_renderer *r, const ern_frame_input *input) {
  const size_t values =
      (size_t)ERN_AUDIO_WINDOWS * (size_t)input->window_length * (size_t)r->field.config.feature_width;
  const ern_span code = whole(r->code, ERN_AUDIO_CODE);
  struct ern_audio_args args = {
      .code = code, .parameters = whole(r->parameters, r->field.parameters), .net = r->field.audio};
  ern_status status = ERN_OK;
  args.net.window_length = input->window_length;
  ERN_TRY(ern_take(r->stream, ERN_ELEMENT_REAL, values, &args.windows));
  ERN_TRY(r->backend->upload_reals(r->stream, args.windows, input->windows, values));
  ERN_TRY(r->backend->audio_fwd(r->stream, &args));
  if (r->options.smooth_lips) {
    float now[ERN_AUDIO_CODE];
    ERN_TRY(r->backend->download_reals(r->stream, now, code, ERN_AUDIO_CODE));
    for (int c = 0; c < ERN_AUDIO_CODE && r->has_last_code; c++) now[c] = 0.35f * r->last_code[c] + 0.65f * now[c];
    memcpy(r->last_code, now, sizeof now);
    r->has_last_code = true;
    ERN_TRY(r->backend->upload_reals(r->stream, code, now, ERN_AUDIO_CODE));
  }
fail:
  return status;
}

/* The background rows: the caller's background, the caller's torso image over it; premultiplied. */
static ern_status upload_background(ern_renderer *r, const ern_frame_input *input, struct frame *f) {
  void *room = NULL;
  ern_status status = ern_allocate(r->context, 4 * f->pixels, sizeof(float), &room);
  if (status != ERN_OK) return status;
  float *rgb = room, *alpha = rgb + 3 * f->pixels;
  for (size_t i = 0; i < f->pixels; i++) {
    const float a = input->torso != NULL ? (float)input->torso[4 * i + 3] / 255 : 0;
    for (size_t c = 0; c < 3; c++) {
      const float back = input->background != NULL ? (float)input->background[3 * i + c] / 255 : 0;
      const float front = input->torso != NULL ? (float)input->torso[4 * i + c] / 255 : 0;
      rgb[c * f->pixels + i] = front * a + back * (1 - a);
    }
    alpha[i] = a;
  }
  for (int c = 0; c < 3; c++)
    ERN_TRY(r->backend->upload_reals(r->stream, ern_span_of_row(f->background, c, f->pixels),
                                     rgb + (size_t)c * f->pixels, f->pixels));
  ERN_TRY(r->backend->upload_reals(r->stream, f->torso_opacity.span, alpha, f->pixels));
fail:
  ern_release(r->context, room);
  return status;
}

static struct ern_view view_of(const ern_frame_input *input) {
  const ern_camera *camera = &input->camera;
  struct ern_view view = {
      .focal = camera->focal, .cx = camera->cx, .cy = camera->cy, .width = camera->width, .height = camera->height};
  memcpy(view.pose, input->head_pose != NULL ? input->head_pose : camera->pose, sizeof view.pose);
  return view;
}

/* The model's own torso over the background rows, in place. */
static ern_status torso_layer(ern_renderer *r, const ern_frame_input *input, struct frame *f) {
  struct ern_render_torso_args args = {.pixel = f->background,
                                       .opacity = f->torso_opacity.span,
                                       .grid = whole(r->torso_grid, ERN_TORSO_CELLS),
                                       .threshold = r->torso_threshold,
                                       .width = input->camera.width,
                                       .height = input->camera.height,
                                       .shrink = r->options.torso_shrink,
                                       .individual = input->individual,
                                       .parameters = whole(r->parameters, r->field.parameters),
                                       .field = &r->field};
  memcpy(args.pose, input->camera.pose, sizeof args.pose);
  return r->backend->render_torso(r->stream, &args);
}

static ern_status head_layer(ern_renderer *r, const ern_frame_input *input, struct frame *f) {
  struct ern_render_rays_args args = {
      .pixel = f->pixel,
      .opacity = f->opacity.span,
      .depth = f->depth.span,
      .attention = f->attention.span,
      .eye = f->eye.span,
      .pixel_number = f->number,
      .view = view_of(input),
      .background = f->background,
      .bits = whole(r->bits, ERN_OCCUPANCY_BYTES),
      .parameters = whole(r->parameters, r->field.parameters),
      .field = &r->field,
      .code = whole(r->code, ERN_AUDIO_CODE),
      .eye_value = input->eye,
      .individual = input->individual,
      .settings = {r->field.config.bound, r->options.max_steps, r->options.dt_gamma, 0.05f},
      .transmittance_stop = r->options.transmittance_stop,
      .n = f->pixels};
  return r->backend->render_rays(r->stream, &args);
}

/* ---- read-back --------------------------------------------------------------------------------------------------- */

static uint8_t to_byte(float value) { return (uint8_t)lrintf(fminf(fmaxf(value, 0), 1) * 255); }

/* planes: r, g, b, whole alpha, one picture after the other. */
static void fill_pictures(const ern_frame_output *out, const float *planes, size_t pixels, bool opaque) {
  for (size_t i = 0; i < pixels; i++) {
    const float alpha = opaque ? 1 : planes[3 * pixels + i];
    for (size_t c = 0; c < 3; c++) {
      const float value = planes[c * pixels + i];
      if (out->rgb != NULL) out->rgb[3 * i + c] = value;
      if (out->rgba != NULL) out->rgba[4 * i + c] = to_byte(opaque ? value : alpha > 0 ? value / alpha : 0);
    }
    if (out->rgba != NULL) out->rgba[4 * i + 3] = to_byte(alpha);
    if (out->alpha != NULL) out->alpha[i] = alpha;
  }
}

static ern_status read_back(ern_renderer *r, const struct frame *f, const ern_frame_output *out, bool opaque) {
  const struct {
    float *to;
    ern_rows from;
  } values[] = {{out->opacity, f->opacity}, {out->depth, f->depth}, {out->attention, f->attention}, {out->eye, f->eye}};
  const size_t n = f->pixels;
  void *room = NULL;
  ern_status status = ern_allocate(r->context, 5 * n, sizeof(float), &room);
  if (status != ERN_OK) return status;
  float *planes = room, *torso = planes + 4 * n;
  for (int c = 0; c < 3; c++)
    ERN_TRY(r->backend->download_reals(r->stream, planes + (size_t)c * n, ern_span_of_row(f->pixel, c, n), n));
  if (!opaque) {
    ERN_TRY(r->backend->download_reals(r->stream, planes + 3 * n, f->opacity.span, n));
    ERN_TRY(r->backend->download_reals(r->stream, torso, f->torso_opacity.span, n));
    for (size_t i = 0; i < n; i++) planes[3 * n + i] += (1 - planes[3 * n + i]) * torso[i];
  }
  fill_pictures(out, planes, n, opaque);
  for (size_t v = 0; v < sizeof values / sizeof *values; v++)
    if (values[v].to != NULL) ERN_TRY(r->backend->download_reals(r->stream, values[v].to, values[v].from.span, n));
fail:
  ern_release(r->context, room);
  return status;
}

ern_status ern_renderer_frame(ern_renderer *renderer, const ern_frame_input *input, const ern_frame_output *output,
                              ern_frame_times *times) {
  const struct ern_arena_mark mark = ern_arena_mark(renderer->stream);
  double at[5] = {milliseconds()};
  struct frame frame = {0};
  ern_status status = ERN_OK;
  ERN_TRY(check_input(renderer, input));
  ERN_TRY(take_frame(renderer, (size_t)input->camera.width * (size_t)input->camera.height, &frame));
  ERN_TRY(audio_code(renderer, input));
  at[1] = milliseconds();
  ERN_TRY(upload_background(renderer, input, &frame));
  if (renderer->field.config.torso) ERN_TRY(torso_layer(renderer, input, &frame));
  at[2] = milliseconds();
  ERN_TRY(head_layer(renderer, input, &frame));
  at[3] = milliseconds();
  ERN_TRY(read_back(renderer, &frame, output, input->background != NULL));
  at[4] = milliseconds();
  if (times != NULL) *times = (ern_frame_times){at[1] - at[0], at[2] - at[1], at[3] - at[2], at[4] - at[3]};
fail:
  ern_arena_release(renderer->stream, mark);
  return status;
}
