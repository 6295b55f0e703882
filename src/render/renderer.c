/* SPDX-License-Identifier: MIT
 * A renderer: renders frames of a model on a backend, with a stream of its own. */
#include "render/ray_reuse.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "core/floats.h"
#include "core/sized.h"
#include "model/torso_ops.h"
#include "render/frame_input.h"
#include "render/occupancy_prune.h"
#include "render/picture_ops.h"

/* Takes from the model the settings that the options leave open. */
static void take_from_model(ern_render_options *o, const struct ern_view_settings *view) {
  if (o->max_steps == 0) o->max_steps = view->max_steps;
  if (o->dt_gamma < 0) o->dt_gamma = view->dt_gamma;
  if (o->torso_shrink == 0) o->torso_shrink = view->torso_shrink;
}

enum { MEANS = ERN_CODE_WIDTH + ERN_TORSO_CODE_WIDTH };

/* Means of the columns of `codes`, [rows][width], over the rows that are not all 0. Rows of zeros pad a PyTorch file to
 * the public program's number of rows. */
static void mean_of_rows(const float *codes, size_t rows, size_t width, float *mean) {
  double sum[ERN_TORSO_CODE_WIDTH] = {0};
  size_t count = 0;
  for (size_t r = 0; r < rows; r++) {
    bool own = false;
    for (size_t c = 0; c < width; c++) own |= codes[r * width + c] != 0;
    for (size_t c = 0; c < width; c++) sum[c] += (double)codes[r * width + c];
    count += own;
  }
  for (size_t c = 0; c < width; c++) mean[c] = count > 0 ? (float)(sum[c] / (double)count) : 0;
}

static ern_status upload_means(ern_renderer *r) {
  const struct ern_field *field = &r->field;
  const size_t rows = (size_t)field->config.codes;
  float means[MEANS] = {0};
  if (rows > 0) mean_of_rows(r->model->block + field->codes, rows, ERN_CODE_WIDTH, means);
  if (rows > 0 && field->config.torso)
    mean_of_rows(r->model->block + field->torso_codes, rows, ERN_TORSO_CODE_WIDTH, means + ERN_CODE_WIDTH);
  const ern_span behind = {r->parameters, field->parameters, MEANS};
  return r->backend->upload_reals(r->stream, behind, means, MEANS);
}

static void choose_codes(ern_renderer *r, size_t individual) {
  const struct ern_field *own = &r->model->field;
  const bool mean = individual == ERN_INDIVIDUAL_MEAN;
  r->individual = mean ? 0 : individual;
  r->field.codes = mean ? own->parameters : own->codes;
  r->field.torso_codes = mean ? own->parameters + ERN_CODE_WIDTH : own->torso_codes;
}

static ern_status upload_model(ern_renderer *r) {
  struct ern_backend *backend = r->backend;
  const ern_model *model = r->model;
  ern_status status = ERN_OK;
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, r->field.parameters + MEANS, &r->parameters));
  ERN_TRY(upload_means(r));
  ERN_TRY(backend->upload_reals(r->stream, ern_whole(r->parameters, r->field.parameters), model->block,
                                r->field.parameters));
  struct ern_render_prepare_args prepare = {ern_whole(r->parameters, r->field.parameters), &r->field};
  ERN_TRY(backend->render_prepare(r->stream, &prepare));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &r->bits));
  ERN_TRY(backend->upload_bytes(r->stream, ern_whole(r->bits, ERN_OCCUPANCY_BYTES), model->bits, ERN_OCCUPANCY_BYTES));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &r->code));
  for (int i = 0; i < 2; i++)
    ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, AUDIO_CODE_VALUES, &r->audio_code.codes[i]));
  if (r->field.config.torso) {
    double sum = 0;
    for (size_t i = 0; i < ERN_TORSO_CELLS; i++) sum += (double)model->torso_grid[i];
    r->torso_threshold = fminf(0.01f, (float)(sum / ERN_TORSO_CELLS));
    ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, ERN_TORSO_CELLS, &r->torso_grid));
    ERN_TRY(backend->upload_reals(r->stream, ern_whole(r->torso_grid, ERN_TORSO_CELLS), model->torso_grid,
                                  ERN_TORSO_CELLS));
  }
fail:
  return status;
}

ern_status ern_renderer_create(ern_renderer **renderer, ern_backend *backend, const ern_model *model,
                               const ern_render_options *options) {
  ERN_PLAIN_FLOATS;
  if (renderer != NULL) *renderer = NULL;
  ERN_NEED(NULL, backend);
  ern_context *context = backend->context;
  ERN_NEED(context, renderer);
  ERN_NEED(context, model);
  ern_render_options chosen = ern_render_options_default();
  ern_renderer *made = NULL;
  ern_status status = ERN_OK;
  if (options != NULL) ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_render_options, &chosen, options));
  ERN_TRY(ern_render_settings_check(context, &chosen));
  take_from_model(&chosen, &model->view);
  if (chosen.threads > 0 && strcmp(backend->name, "cpu") != 0)
    ern_log(context, ERN_LOG_WARNING, "render: threads is %d, which the backend %s has no use for: its driver decides",
            chosen.threads, backend->name);
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  made->backend = backend;
  made->model = model;
  made->field = model->field;
  if (chosen.no_torso) made->field.config.torso = false;
  made->options = chosen;
  ERN_TRY(backend->stream_make(backend, chosen.threads, &made->stream));
  ERN_TRY(upload_model(made));
  *renderer = made;
  return ERN_OK;
fail:
  ern_renderer_free(&made);
  return status;
}

static void free_buffers(ern_renderer *r) {
  for (int i = 0; i < BUFFERS; i++) {
    r->backend->buffer_free(r->backend, r->buffer[i]);
    r->buffer[i] = NULL;
  }
  r->frame = (struct frame){0};
  ern_ray_reuse_forget(r);
}

void ern_renderer_free(ern_renderer **renderer) {
  if (renderer == NULL || *renderer == NULL) return;
  ern_renderer *r = *renderer;
  *renderer = NULL;
  r->backend->buffer_free(r->backend, r->parameters);
  r->backend->buffer_free(r->backend, r->bits);
  r->backend->buffer_free(r->backend, r->torso_grid);
  r->backend->buffer_free(r->backend, r->code);
  for (int i = 0; i < 2; i++) r->backend->buffer_free(r->backend, r->audio_code.codes[i]);
  ern_release(r->context, r->audio_code.windows);
  free_buffers(r);
  ern_ray_reuse_free(r);
  r->backend->stream_free(r->stream);
  ern_release(r->context, r);
}

ern_status ern_renderer_prune_occupancy(ern_renderer *renderer, const float *windows, int window_length,
                                        const float *eyes, size_t count, float density) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, renderer);
  ern_context *context = renderer->context;
  if (count > 0) {
    ERN_NEED(context, windows);
    ERN_NEED(context, eyes);
  }
  struct ern_speech_frame *frame = NULL;
  uint8_t *bits = NULL;
  ern_status status = ERN_OK;
  if (!(density >= 0) || !isfinite(density))
    ERN_TRY(
        ern_fail(context, ERN_E_ARGUMENT, "render: density to leave out is %g, expected 0 or more", (double)density));
  ERN_TRY(ern_renderer_speech_frames(renderer, windows, window_length, eyes, count, &frame));
  ERN_TRY(ERN_NEW(context, ERN_OCCUPANCY_BYTES, &bits));
  memcpy(bits, renderer->model->bits, ERN_OCCUPANCY_BYTES);
  if (density > 0 && count > 0)
    ERN_TRY(ern_occupancy_prune(renderer->stream, &renderer->field,
                                ern_whole(renderer->parameters, renderer->field.parameters), frame, count, density,
                                bits));
  ern_ray_reuse_forget(renderer);
  status = renderer->backend->upload_bytes(renderer->stream, ern_whole(renderer->bits, ERN_OCCUPANCY_BYTES), bits,
                                           ERN_OCCUPANCY_BYTES);
fail:
  ern_release(context, frame);
  ern_release(context, bits);
  return status;
}

ern_status ern_renderer_accepts(const ern_renderer *renderer, const ern_features *features, const char *name) {
  ERN_NEED(NULL, renderer);
  ERN_NEED(renderer->context, features);
  ERN_NEED(renderer->context, name);
  const int width = renderer->field.config.feature_width;
  const ern_status status = ern_features_check(renderer->context, name, features);
  if (status != ERN_OK) return status;
  if (features->width == width)
    return ern_window_length_check(renderer->context, &renderer->field, name, features->window_length);
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

static ern_status number_pixels(ern_renderer *r, struct frame *f) {
  int32_t *number = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ern_renderer_buffer(r, NUMBER, ERN_ELEMENT_INT32, f->pixels, &f->number));
  ERN_TRY(ERN_NEW(r->context, f->pixels, &number));
  for (size_t i = 0; i < f->pixels; i++) number[i] = (int32_t)i;
  status = r->backend->upload_int32(r->stream, f->number, number, f->pixels);
fail:
  ern_release(r->context, number);
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
  free_buffers(r);
  f->pixels = pixels;
  ERN_TRY(number_pixels(r, f));
  ERN_TRY(ern_renderer_buffer(r, PLANES, ERN_ELEMENT_REAL, 8 * stride, &planes));
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    const size_t count = (size_t)widths[i] * stride;
    *rows[i] = (ern_rows){ern_span_part(planes, at, count), stride, widths[i], ERN_PER_SAMPLE};
    at += count;
  }
  f->layer = (ern_rows){ern_span_part(planes, 4 * stride, 4 * stride), stride, 4, ERN_PER_SAMPLE};
  return ERN_OK;
fail:
  free_buffers(r);
  return status;
}

/* Takes the optional outputs. Without an eye branch the eye buffer stays zero. */
static ern_status take_wanted(ern_renderer *r, const ern_frame_output *output) {
  struct frame *f = &r->frame;
  const struct {
    ern_rows *rows;
    enum buffer buffer;
    bool wanted;
  } values[] = {{&f->depth, DEPTH, output->depth != NULL},
                {&f->attention, ATTENTION, output->attention != NULL},
                {&f->eye, EYE, output->eye != NULL}};
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
    *values[i].rows = (ern_rows){.stride = f->opacity.stride, .rows = 1, .per = ERN_PER_SAMPLE};
    if (values[i].wanted)
      ERN_TRY(ern_renderer_buffer(r, values[i].buffer, ERN_ELEMENT_REAL, f->opacity.stride, &values[i].rows->span));
  }
fail:
  return status;
}

/* ---- read-back --------------------------------------------------------------------------------------------------- */

/* Checks that the outputs are finite: a NaN would become a black pixel in bytes, and callers use the other outputs as
 * pictures. The padding between the rows of the picture is zero. */
static ern_status check_outputs(ern_renderer *r, const struct frame *f) {
  const struct {
    const char *name;
    ern_span values;
    size_t count;
  } outputs[] = {{"picture", f->pixel.span, f->pixel.span.count},
                 {"depth", f->depth.span, f->pixels}, /* from here on only where wanted */
                 {"attention map", f->attention.span, f->pixels},
                 {"eye attention map", f->eye.span, f->pixels}};
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof outputs / sizeof *outputs && status == ERN_OK; i++) {
    struct ern_finite_args args = {.values = outputs[i].values, .n = outputs[i].count, .finite = true};
    if (args.values.buffer != NULL) status = r->backend->finite(r->stream, &args);
    if (status == ERN_OK && !args.finite)
      status = ern_fail(r->context, ERN_E_NONFINITE,
                        "render: the %s is not finite: values of the model, the speech or the pose are too large",
                        outputs[i].name);
  }
  return status;
}

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
  if (out->rgba != NULL) ERN_TRY(ern_renderer_buffer(r, RGBA, ERN_ELEMENT_BYTE, 4 * n, &args.rgba));
  if (out->rgb != NULL) ERN_TRY(ern_renderer_buffer(r, RGB, ERN_ELEMENT_REAL, 3 * n, &args.rgb));
  if (out->alpha != NULL) ERN_TRY(ern_renderer_buffer(r, ALPHA, ERN_ELEMENT_REAL, n, &args.alpha));
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
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, renderer);
  ERN_NEED(renderer->context, windows);
  ERN_NEED(renderer->context, code);
  const struct ern_arena_mark mark = ern_arena_mark(renderer->stream);
  const ern_frame_input input = {.windows = windows, .window_length = window_length};
  ern_status status = ERN_OK;
  ERN_TRY(ern_frame_windows_check(renderer->context, &renderer->field, &input));
  ERN_TRY(ern_renderer_encode_windows(renderer, &input));
  ERN_TRY(renderer->backend->download_reals(renderer->stream, code, ern_whole(renderer->code, ERN_AUDIO_CODE),
                                            ERN_AUDIO_CODE));
fail:
  ern_arena_release(renderer->stream, mark);
  return status;
}

ern_status ern_renderer_skip(ern_renderer *renderer, const float *windows, int window_length) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, renderer);
  ERN_NEED(renderer->context, windows);
  const struct ern_arena_mark mark = ern_arena_mark(renderer->stream);
  const ern_frame_input input = {.windows = windows, .window_length = window_length};
  ern_status status = ERN_OK;
  ERN_TRY(ern_frame_windows_check(renderer->context, &renderer->field, &input));
  if (renderer->options.smooth_lips) status = ern_renderer_encode_audio(renderer, &input);
fail:
  ern_arena_release(renderer->stream, mark);
  return status;
}

/* at[number] = the host's time now. A device has only queued the work by now: read_times then takes its own times. */
static ern_status end_stage(ern_renderer *r, bool timed, double at[ERN_MARKS], int number) {
  at[number] = milliseconds();
  return timed ? r->backend->mark(r->stream, number) : ERN_OK;
}

static ern_status read_times(ern_renderer *r, double at[ERN_MARKS], ern_frame_times *times) {
  const uint64_t *count = r->profile.count;
  const double samples = count[ERN_PROFILE_PIXELS] > 0 ? (double)count[ERN_PROFILE_SAMPLES] : NAN;
  const ern_status status = r->backend->marks_read(r->stream, at, ERN_MARKS);
  *times = (ern_frame_times){at[1] - at[0], at[2] - at[1], at[3] - at[2], at[4] - at[3], samples};
  return status;
}

/* times may be NULL. */
static ern_status draw_frame(ern_renderer *renderer, const ern_frame_input *input, const ern_frame_output *output,
                             ern_frame_times *times) {
  const struct ern_arena_mark mark = ern_arena_mark(renderer->stream);
  const bool timed = times != NULL;
  double at[ERN_MARKS];
  struct frame *frame = &renderer->frame;
  ern_status status = ERN_OK;
  ERN_TRY(ern_frame_input_check(renderer->context, &renderer->field, input));
  ERN_TRY(end_stage(renderer, timed, at, 0));
  choose_codes(renderer, input->individual);
  ERN_TRY(size_frame(renderer, (size_t)input->camera.width * (size_t)input->camera.height));
  ERN_TRY(take_wanted(renderer, output));
  ERN_TRY(ern_renderer_encode_audio(renderer, input));
  ERN_TRY(end_stage(renderer, timed, at, 1));
  ERN_TRY(ern_renderer_background_layers(renderer, input));
  ERN_TRY(end_stage(renderer, timed, at, 2));
  renderer->profile = (struct ern_profile){.timed = false};
  ERN_TRY(ern_renderer_head(renderer, input));
  ERN_TRY(end_stage(renderer, timed, at, 3));
  ERN_TRY(check_outputs(renderer, frame));
  ERN_TRY(read_back(renderer, frame, output, input->background != NULL));
  ERN_TRY(end_stage(renderer, timed, at, 4));
  if (timed) status = read_times(renderer, at, times);
fail:
  ern_arena_release(renderer->stream, mark);
  return status;
}

ern_status ern_renderer_frame_sized(ern_renderer *renderer, const ern_frame_input *input, size_t input_bytes,
                                    const ern_frame_output *output, size_t output_bytes, ern_frame_times *times,
                                    size_t times_bytes) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, renderer);
  ERN_NEED(renderer->context, input);
  ERN_NEED(renderer->context, output);
  ern_frame_input in = {0};
  ern_frame_output out = {0};
  ern_frame_times took = {0};
  ern_status status = ERN_OK;
  ERN_TRY(ERN_COPY_IN(renderer->context, ern_frame_input, &in, input, input_bytes));
  ERN_TRY(ERN_COPY_IN(renderer->context, ern_frame_output, &out, output, output_bytes));
  ERN_TRY(draw_frame(renderer, &in, &out, times != NULL ? &took : NULL));
  ern_struct_copy_out(times, times_bytes, &took, sizeof took);
fail:
  return status;
}
