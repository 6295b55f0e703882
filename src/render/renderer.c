/* SPDX-License-Identifier: MIT
 * A renderer: a model on a backend, a stream of its own, and frames out of it. */
#include <math.h>
#include <string.h>
#include <time.h>

#include "core/memory.h"
#include "model/model.h"
#include "render/frame_input.h"
#include "render/stages.h"
#include "render/thin.h"

#include "ernerf/render.h"

enum { OPTIONS_COOKIE = 0x45524e33, MAX_WINDOW_LENGTH = 16, HEARD_VALUES = ERN_AUDIO_WINDOWS * ERN_AUDIO_CODE };

/* What a frame needs on the device while it is rendered. It stays for the next one of the same size. */
struct frame {
  size_t pixels;
  ern_span number;                                        /* int32: all pixels in order */
  ern_rows background, pixel;                             /* [3] per pixel */
  ern_rows torso_opacity, opacity, depth, attention, eye; /* [1]; the last three zeroed: not wanted */
  ern_rows layer;                                         /* [4]: pixel and opacity */
};

/* Rooms that a frame's spans lie in; those after PLANES are made when a frame first wants them. */
enum room { NUMBER, PLANES, SMALL, DEPTH, ATTENTION, EYE, BACKGROUND_BYTES, TORSO_BYTES, RGBA, RGB, ALPHA, ROOMS };

/* Codes of the windows of the last frame: most of the next one's are among them. */
struct heard {
  struct ern_buffer *codes[2]; /* [8][A]; the second is where they change places */
  float *windows;              /* [8][length][width], on the host */
  int length;                  /* of a window; 0: nothing is known */
};

struct ern_renderer {
  ern_context *context;
  struct ern_backend *backend;
  const ern_model *model;
  struct ern_field field; /* the model's; the window length is that of the features at hand */
  ern_render_options options;
  struct ern_stream *stream;
  struct ern_buffer *parameters, *bits, *torso_grid, *code;
  float torso_threshold;
  struct frame frame;
  struct ern_buffer *room[ROOMS];
  struct heard heard;
  bool has_last_code;
  float last_code[ERN_AUDIO_CODE];
};

ern_render_options ern_render_options_default(void) {
  return (ern_render_options){.cookie = OPTIONS_COOKIE,
                              .threads = 0,
                              .max_steps = 16,
                              .dt_gamma = 1.0f / 256,
                              .transmittance_stop = 1e-4f,
                              .torso_shrink = 0.8f,
                              .smooth_lips = false,
                              .image_scale = 1};
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
  if (!(o->image_scale >= 0.25f && o->image_scale <= 1))
    return ern_fail(context, ERN_E_ARGUMENT, "render: image_scale is %g, expected 0.25 to 1", (double)o->image_scale);
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
  struct ern_render_prepare_args prepare = {whole(r->parameters, r->field.parameters), &r->field};
  ERN_TRY(backend->render_prepare(r->stream, &prepare));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &r->bits));
  ERN_TRY(backend->upload_bytes(r->stream, whole(r->bits, ERN_OCCUPANCY_BYTES), model->bits, ERN_OCCUPANCY_BYTES));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &r->code));
  for (int i = 0; i < 2; i++)
    ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, HEARD_VALUES, &r->heard.codes[i]));
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

static void free_rooms(ern_renderer *r) {
  for (int i = 0; i < ROOMS; i++) {
    r->backend->buffer_free(r->backend, r->room[i]);
    r->room[i] = NULL;
  }
  r->frame = (struct frame){0};
}

void ern_renderer_free(ern_renderer **renderer) {
  if (renderer == NULL || *renderer == NULL) return;
  ern_renderer *r = *renderer;
  *renderer = NULL;
  r->backend->buffer_free(r->backend, r->parameters);
  r->backend->buffer_free(r->backend, r->bits);
  r->backend->buffer_free(r->backend, r->torso_grid);
  r->backend->buffer_free(r->backend, r->code);
  for (int i = 0; i < 2; i++) r->backend->buffer_free(r->backend, r->heard.codes[i]);
  ern_release(r->context, r->heard.windows);
  free_rooms(r);
  r->backend->stream_free(r->stream);
  ern_release(r->context, r);
}

ern_status ern_renderer_skip_thin(ern_renderer *renderer, const float *windows, int window_length, const float *eyes,
                                  size_t count, float density) {
  ern_context *context = renderer->context;
  void *bits = NULL, *room = NULL;
  ern_status status = ERN_OK;
  if (!(density >= 0) || !isfinite(density))
    ERN_TRY(
        ern_fail(context, ERN_E_ARGUMENT, "render: density to leave out is %g, expected 0 or more", (double)density));
  if (window_length < 1 || window_length > 16)
    ERN_TRY(ern_fail(context, ERN_E_ARGUMENT, "render: window_length is %d, expected 1 to 16", window_length));
  const size_t values =
      (size_t)ERN_AUDIO_WINDOWS * (size_t)window_length * (size_t)renderer->field.config.feature_width;
  ERN_TRY(ern_allocate(context, ERN_OCCUPANCY_BYTES, 1, &bits));
  ERN_TRY(ern_allocate(context, count, sizeof(struct ern_thin_speech), &room));
  memcpy(bits, renderer->model->bits, ERN_OCCUPANCY_BYTES);
  struct ern_thin_speech *speech = room;
  for (size_t k = 0; k < count; k++) {
    speech[k] = (struct ern_thin_speech){windows + k * values, window_length, eyes[k]};
    for (size_t i = 0; i < values; i++)
      if (!isfinite(speech[k].windows[i]))
        ERN_TRY(ern_fail(context, ERN_E_NONFINITE, "render: moment %zu of the speech: value %zu is not finite", k, i));
  }
  if (density > 0 && count > 0)
    ERN_TRY(ern_occupancy_thin(renderer->stream, &renderer->field,
                               whole(renderer->parameters, renderer->field.parameters), speech, count, density, bits));
  status = renderer->backend->upload_bytes(renderer->stream, whole(renderer->bits, ERN_OCCUPANCY_BYTES), bits,
                                           ERN_OCCUPANCY_BYTES);
fail:
  ern_release(context, room);
  ern_release(context, bits);
  return status;
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

/* *span = the room, made at its first use. */
static ern_status enter(ern_renderer *r, enum room room, ern_element element, size_t count, ern_span *span) {
  ern_status status = ERN_OK;
  if (r->room[room] == NULL) status = r->backend->buffer_make(r->backend, element, count, &r->room[room]);
  *span = status == ERN_OK ? whole(r->room[room], count) : (ern_span){0};
  return status;
}

static ern_status number_pixels(ern_renderer *r, struct frame *f) {
  void *room = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(enter(r, NUMBER, ERN_ELEMENT_INT32, f->pixels, &f->number));
  ERN_TRY(ern_allocate(r->context, f->pixels, sizeof(int32_t), &room));
  for (size_t i = 0; i < f->pixels; i++) ((int32_t *)room)[i] = (int32_t)i;
  status = r->backend->upload_int32(r->stream, f->number, room, f->pixels);
fail:
  ern_release(r->context, room);
  return status;
}

/* The rows that every frame of this size needs. */
static ern_status size_frame(ern_renderer *r, size_t pixels) {
  static const int widths[] = {3, 1, 3, 1};
  struct frame *f = &r->frame;
  ern_rows *const rows[] = {&f->background, &f->torso_opacity, &f->pixel, &f->opacity};
  const size_t stride = (pixels + 63) / 64 * 64; /* at most 2^26 */
  ern_span planes;
  size_t at = 0;
  ern_status status = ERN_OK;
  if (f->pixels == pixels) return ERN_OK;
  free_rooms(r);
  f->pixels = pixels;
  ERN_TRY(number_pixels(r, f));
  ERN_TRY(enter(r, PLANES, ERN_ELEMENT_REAL, 8 * stride, &planes));
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    const size_t count = (size_t)widths[i] * stride;
    *rows[i] = (ern_rows){ern_span_part(planes, at, count), stride, widths[i], ERN_PER_SAMPLE};
    at += count;
  }
  f->layer = (ern_rows){ern_span_part(planes, 4 * stride, 4 * stride), stride, 4, ERN_PER_SAMPLE};
  return ERN_OK;
fail:
  free_rooms(r);
  return status;
}

/* What only some callers ask for. Without an eye branch nothing is ever written over the zeros of its room. */
static ern_status take_wanted(ern_renderer *r, const ern_frame_output *output) {
  struct frame *f = &r->frame;
  const struct {
    ern_rows *rows;
    enum room room;
    bool wanted;
  } values[] = {{&f->depth, DEPTH, output->depth != NULL},
                {&f->attention, ATTENTION, output->attention != NULL},
                {&f->eye, EYE, output->eye != NULL}};
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
    *values[i].rows = (ern_rows){.stride = f->opacity.stride, .rows = 1, .per = ERN_PER_SAMPLE};
    if (values[i].wanted) ERN_TRY(enter(r, values[i].room, ERN_ELEMENT_REAL, f->opacity.stride, &values[i].rows->span));
  }
fail:
  return status;
}

/* ---- speech ------------------------------------------------------------------------------------------------------ */

/* The codes of windows that the last frame had too go to their new places: bit t of *known for window t. Consecutive
 * frames share seven of eight, each one place earlier. */
static ern_status remember(ern_renderer *r, const ern_frame_input *input, unsigned *known) {
  struct heard *heard = &r->heard;
  const size_t values = (size_t)input->window_length * (size_t)r->field.config.feature_width;
  ern_status status = ERN_OK;
  *known = 0;
  for (size_t t = 0; t < ERN_AUDIO_WINDOWS && heard->length == input->window_length; t++) {
    for (size_t k = 1; k <= ERN_AUDIO_WINDOWS && (*known >> t & 1) == 0; k++) {
      const size_t was = (t + k) % ERN_AUDIO_WINDOWS;
      if (memcmp(input->windows + t * values, heard->windows + was * values, values * sizeof(float)) != 0) continue;
      const ern_span to = {heard->codes[1], t * ERN_AUDIO_CODE, ERN_AUDIO_CODE};
      const ern_span from = {heard->codes[0], was * ERN_AUDIO_CODE, ERN_AUDIO_CODE};
      ERN_TRY(r->backend->copy(r->stream, to, from, ERN_AUDIO_CODE));
      *known |= 1u << t;
    }
  }
  struct ern_buffer *moved = heard->codes[1];
  heard->codes[1] = heard->codes[0];
  heard->codes[0] = moved;
fail:
  heard->length = 0; /* until the frame's own are there */
  return status;
}

static ern_status keep_windows(ern_renderer *r, const ern_frame_input *input) {
  const size_t most = (size_t)ERN_AUDIO_WINDOWS * MAX_WINDOW_LENGTH * (size_t)r->field.config.feature_width;
  const size_t values =
      (size_t)ERN_AUDIO_WINDOWS * (size_t)input->window_length * (size_t)r->field.config.feature_width;
  void *room = r->heard.windows;
  if (room == NULL) {
    const ern_status status = ern_allocate(r->context, most, sizeof(float), &room);
    if (status != ERN_OK) return status;
  }
  r->heard.windows = room;
  memcpy(r->heard.windows, input->windows, values * sizeof(float));
  r->heard.length = input->window_length;
  return ERN_OK;
}

/* r->code = what is heard in the windows. */
static ern_status hear(ern_renderer *r, const ern_frame_input *input) {
  const size_t values =
      (size_t)ERN_AUDIO_WINDOWS * (size_t)input->window_length * (size_t)r->field.config.feature_width;
  const ern_span code = whole(r->code, ERN_AUDIO_CODE);
  struct ern_audio_frame_args args = {
      .audio = {.code = code, .parameters = whole(r->parameters, r->field.parameters), .net = r->field.audio}};
  ern_status status = ERN_OK;
  args.audio.net.window_length = input->window_length;
  ERN_TRY(ern_take(r->stream, ERN_ELEMENT_REAL, values, &args.audio.windows));
  ERN_TRY(r->backend->upload_reals(r->stream, args.audio.windows, input->windows, values));
  ERN_TRY(remember(r, input, &args.known));
  args.codes = whole(r->heard.codes[0], HEARD_VALUES);
  ERN_TRY(r->backend->audio_frame(r->stream, &args));
  ERN_TRY(keep_windows(r, input));
fail:
  return status;
}

/* The audio code of the frame: smoothed over frames where that is asked for, and brought to rest. */
static ern_status audio_code(ern_renderer *r, const ern_frame_input *input) {
  const ern_span code = whole(r->code, ERN_AUDIO_CODE);
  float now[ERN_AUDIO_CODE];
  ern_status status = ERN_OK;
  ERN_TRY(hear(r, input));
  if (!r->options.smooth_lips && !(input->rest > 0)) return ERN_OK;
  ERN_TRY(r->backend->download_reals(r->stream, now, code, ERN_AUDIO_CODE));
  if (r->options.smooth_lips) {
    for (int c = 0; c < ERN_AUDIO_CODE && r->has_last_code; c++) now[c] = 0.35f * r->last_code[c] + 0.65f * now[c];
    memcpy(r->last_code, now, sizeof now);
    r->has_last_code = true;
  }
  for (int c = 0; c < ERN_AUDIO_CODE && input->rest > 0; c++)
    now[c] = (1 - input->rest) * now[c] + input->rest * input->rest_code[c];
  ERN_TRY(r->backend->upload_reals(r->stream, code, now, ERN_AUDIO_CODE));
fail:
  return status;
}

/* ---- layers ------------------------------------------------------------------------------------------------------ */

/* The background rows: the caller's background, the caller's torso image over it; premultiplied. */
static ern_status upload_background(ern_renderer *r, const ern_frame_input *input, struct frame *f) {
  struct ern_backdrop_args args = {.pixel = f->background, .opacity = f->torso_opacity.span, .n = f->pixels};
  ern_status status = ERN_OK;
  if (input->background != NULL) {
    ERN_TRY(enter(r, BACKGROUND_BYTES, ERN_ELEMENT_BYTE, 3 * f->pixels, &args.background));
    ERN_TRY(r->backend->upload_bytes(r->stream, args.background, input->background, 3 * f->pixels));
  }
  if (input->torso != NULL) {
    ERN_TRY(enter(r, TORSO_BYTES, ERN_ELEMENT_BYTE, 4 * f->pixels, &args.torso));
    ERN_TRY(r->backend->upload_bytes(r->stream, args.torso, input->torso, 4 * f->pixels));
  }
  ERN_TRY(r->backend->backdrop(r->stream, &args));
fail:
  return status;
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

static struct ern_view view_of(const ern_frame_input *input) {
  const ern_camera *camera = &input->camera;
  struct ern_view view = {
      .focal = camera->focal, .cx = camera->cx, .cy = camera->cy, .width = camera->width, .height = camera->height};
  memcpy(view.pose, input->head_pose != NULL ? input->head_pose : camera->pose, sizeof view.pose);
  return view;
}

/* The head over the background rows of `to`, as a picture of the view's size. */
static ern_status draw_head(ern_renderer *r, const ern_frame_input *input, const struct ern_view *view,
                            const struct frame *to) {
  struct ern_render_rays_args args = {
      .pixel = to->pixel,
      .opacity = to->opacity.span,
      .depth = to->depth.span,
      .attention = to->attention.span,
      .eye = to->eye.span,
      .pixel_number = to->number,
      .view = *view,
      .background = to->background,
      .bits = whole(r->bits, ERN_OCCUPANCY_BYTES),
      .parameters = whole(r->parameters, r->field.parameters),
      .field = &r->field,
      .code = whole(r->code, ERN_AUDIO_CODE),
      .eye_value = input->eye,
      .individual = input->individual,
      .settings = {r->field.config.bound, r->options.max_steps, r->options.dt_gamma, 0.05f},
      .transmittance_stop = r->options.transmittance_stop,
      .n = to->pixels};
  return r->backend->render_rays(r->stream, &args);
}

/* The same view in fewer pixels: those that cover the picture, and part of the last ones may be beside it. */
static struct ern_view small_view_of(const struct ern_view *view, float ratio) {
  struct ern_view small = *view;
  small.focal *= ratio;
  small.cx *= ratio;
  small.cy *= ratio;
  small.width = (int)ceilf((float)view->width * ratio);
  small.height = (int)ceilf((float)view->height * ratio);
  return small;
}

/* Room for the layer that is drawn small, over nothing: its background stays zeros. */
static ern_status small_frame(ern_renderer *r, const struct frame *f, size_t pixels, struct frame *small) {
  enum { LAYER = 4, BACKGROUND = 3, EXTRAS = 3 };
  const size_t stride = f->opacity.stride; /* the larger one's: the numbers of pixels too are shared */
  const struct {
    ern_rows *rows;
    const ern_rows *wanted;
  } extras[EXTRAS] = {{&small->depth, &f->depth}, {&small->attention, &f->attention}, {&small->eye, &f->eye}};
  ern_span planes;
  const ern_status status = enter(r, SMALL, ERN_ELEMENT_REAL, (LAYER + BACKGROUND + EXTRAS) * stride, &planes);
  const ern_rows all = {planes, stride, LAYER + BACKGROUND + EXTRAS, ERN_PER_SAMPLE};
  *small = (struct frame){.pixels = pixels,
                          .number = ern_span_part(f->number, 0, pixels),
                          .layer = ern_rows_part(all, 0, LAYER),
                          .pixel = ern_rows_part(all, 0, 3),
                          .opacity = ern_rows_part(all, 3, 1),
                          .background = ern_rows_part(all, LAYER, BACKGROUND)};
  for (int i = 0; i < EXTRAS; i++)
    if (extras[i].wanted->span.buffer != NULL) *extras[i].rows = ern_rows_part(all, LAYER + BACKGROUND + i, 1);
  return status;
}

static ern_status enlarge_head(ern_renderer *r, const struct ern_view *view, const struct ern_view *small_view,
                               const struct frame *f, const struct frame *small) {
  const struct {
    ern_rows large, small, background;
  } planes[] = {{f->layer, small->layer, f->background},
                {f->depth, small->depth, {{0}, 0, 0, ERN_PER_SAMPLE}},
                {f->attention, small->attention, {{0}, 0, 0, ERN_PER_SAMPLE}},
                {f->eye, small->eye, {{0}, 0, 0, ERN_PER_SAMPLE}}};
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof planes / sizeof *planes; i++) {
    if (planes[i].large.span.buffer == NULL) continue;
    struct ern_enlarge_args args = {.large = planes[i].large,
                                    .small = planes[i].small,
                                    .background = planes[i].background,
                                    .width = view->width,
                                    .height = view->height,
                                    .small_width = small_view->width,
                                    .small_height = small_view->height,
                                    .ratio = r->options.image_scale};
    ERN_TRY(r->backend->enlarge(r->stream, &args));
  }
fail:
  return status;
}

static ern_status head_layer(ern_renderer *r, const ern_frame_input *input, struct frame *f) {
  const struct ern_view view = view_of(input);
  struct frame small;
  ern_status status = ERN_OK;
  if (r->options.image_scale >= 1) return draw_head(r, input, &view, f);
  const struct ern_view small_view = small_view_of(&view, r->options.image_scale);
  ERN_TRY(small_frame(r, f, (size_t)small_view.width * (size_t)small_view.height, &small));
  ERN_TRY(draw_head(r, input, &small_view, &small));
  ERN_TRY(enlarge_head(r, &view, &small_view, f, &small));
fail:
  return status;
}

/* ---- read-back --------------------------------------------------------------------------------------------------- */

static ern_status read_back(ern_renderer *r, const struct frame *f, const ern_frame_output *out, bool opaque) {
  const struct {
    float *to;
    ern_span from;
  } values[] = {{out->opacity, f->opacity.span},
                {out->depth, f->depth.span},
                {out->attention, f->attention.span},
                {out->eye, f->eye.span}};
  const struct ern_backend *backend = r->backend;
  const size_t n = f->pixels;
  struct ern_picture_args args = {.pixel = f->pixel,
                                  .head = opaque ? (ern_span){0} : f->opacity.span,
                                  .torso = opaque ? (ern_span){0} : f->torso_opacity.span,
                                  .n = n};
  ern_status status = ERN_OK;
  if (out->rgba != NULL) ERN_TRY(enter(r, RGBA, ERN_ELEMENT_BYTE, 4 * n, &args.rgba));
  if (out->rgb != NULL) ERN_TRY(enter(r, RGB, ERN_ELEMENT_REAL, 3 * n, &args.rgb));
  if (out->alpha != NULL) ERN_TRY(enter(r, ALPHA, ERN_ELEMENT_REAL, n, &args.alpha));
  ERN_TRY(backend->picture(r->stream, &args));
  if (out->rgba != NULL) ERN_TRY(backend->download_bytes(r->stream, out->rgba, args.rgba, 4 * n));
  if (out->rgb != NULL) ERN_TRY(backend->download_reals(r->stream, out->rgb, args.rgb, 3 * n));
  if (out->alpha != NULL) ERN_TRY(backend->download_reals(r->stream, out->alpha, args.alpha, n));
  for (size_t v = 0; v < sizeof values / sizeof *values; v++)
    if (values[v].to != NULL) ERN_TRY(backend->download_reals(r->stream, values[v].to, values[v].from, n));
fail:
  return status;
}

ern_status ern_renderer_code(ern_renderer *renderer, const float *windows, int window_length,
                             float code[ERN_AUDIO_CODE]) {
  const struct ern_arena_mark mark = ern_arena_mark(renderer->stream);
  const ern_frame_input input = {.windows = windows, .window_length = window_length};
  ern_status status = ERN_OK;
  ERN_TRY(ern_frame_windows_check(renderer->context, &renderer->field, &input));
  ERN_TRY(hear(renderer, &input));
  ERN_TRY(
      renderer->backend->download_reals(renderer->stream, code, whole(renderer->code, ERN_AUDIO_CODE), ERN_AUDIO_CODE));
fail:
  ern_arena_release(renderer->stream, mark);
  return status;
}

ern_status ern_renderer_frame(ern_renderer *renderer, const ern_frame_input *input, const ern_frame_output *output,
                              ern_frame_times *times) {
  const struct ern_arena_mark mark = ern_arena_mark(renderer->stream);
  double at[5] = {milliseconds()};
  struct frame *frame = &renderer->frame;
  ern_status status = ERN_OK;
  ERN_TRY(ern_frame_input_check(renderer->context, &renderer->field, input));
  ERN_TRY(size_frame(renderer, (size_t)input->camera.width * (size_t)input->camera.height));
  ERN_TRY(take_wanted(renderer, output));
  ERN_TRY(audio_code(renderer, input));
  at[1] = milliseconds();
  ERN_TRY(upload_background(renderer, input, frame));
  if (renderer->field.config.torso) ERN_TRY(torso_layer(renderer, input, frame));
  at[2] = milliseconds();
  ERN_TRY(head_layer(renderer, input, frame));
  at[3] = milliseconds();
  ERN_TRY(read_back(renderer, frame, output, input->background != NULL));
  at[4] = milliseconds();
  if (times != NULL) *times = (ern_frame_times){at[1] - at[0], at[2] - at[1], at[3] - at[2], at[4] - at[3]};
fail:
  ern_arena_release(renderer->stream, mark);
  return status;
}
