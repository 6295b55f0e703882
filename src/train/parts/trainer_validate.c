/* SPDX-License-Identifier: MIT
 * Validation: renders validation frames with the values of the model, and writes a picture of one. */
#include "train/parts/trainer_validate.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/memory.h"
#include "train/parts/trainer_data.h"

enum { PANELS = 5 }; /* prediction, truth, difference, audio attention, eye attention */

/* Renderer and host memory for validation frames, all of one size. */
struct look {
  ern_renderer *renderer;
  size_t pixels;
  float *rgb, *attention, *eye;
  uint8_t *picture; /* [height][PANELS*width][3] */
};

static void look_free(const struct ern_training *t, struct look *look) {
  ern_renderer_free(&look->renderer);
  ern_release(t->context, look->rgb);
  ern_release(t->context, look->attention);
  ern_release(t->context, look->eye);
  ern_release(t->context, look->picture);
  *look = (struct look){0};
}

static ern_status look_make(const struct ern_training *t, struct look *look) {
  ern_render_options options = ern_render_options_default();
  ern_status status = ERN_OK;
  *look = (struct look){.pixels = (size_t)t->data.width * (size_t)t->data.height};
  if (strcmp(t->backend->name, "cpu") == 0) options.threads = t->config.threads;
  options.max_steps = t->config.max_steps;
  options.dt_gamma = t->config.dt_gamma;
  options.torso_shrink = t->config.torso_shrink;
  ERN_TRY(ern_renderer_create(&look->renderer, t->backend, t->model, &options));
  ERN_TRY(ERN_NEW(t->context, 3 * look->pixels, &look->rgb));
  ERN_TRY(ERN_NEW(t->context, look->pixels, &look->attention));
  ERN_TRY(ERN_NEW(t->context, look->pixels, &look->eye));
  ERN_TRY(ERN_NEW(t->context, 3 * PANELS * look->pixels, &look->picture));
  return ERN_OK;
fail:
  look_free(t, look);
  return status;
}

static bool has_pixel(const ern_box *box, const struct ern_view *view) {
  return box->left < box->right && box->top < box->bottom && box->left < view->width && box->top < view->height &&
         box->right > 0 && box->bottom > 0;
}

static ern_status render(const struct ern_trainer_speech *speech, const struct ern_trainer_poses *poses,
                         struct look *look, int split, size_t frame, const uint8_t **truth, double *psnr) {
  const struct ern_training *t = speech->training;
  const uint8_t *torso = NULL;
  struct ern_view view;
  ern_dataset_frame about;
  ern_status status = ERN_OK;
  ERN_TRY(ern_trainer_frame(t, split, frame, &about));
  ERN_TRY(ern_trainer_pixels(t, split, frame, truth, &torso));
  ERN_TRY(ern_trainer_view(t, split, frame, &view));
  ERN_TRY(ern_trainer_windows(speech, split, frame, speech->windows));
  ern_frame_input input = {
      .camera = {.focal = view.focal, .cx = view.cx, .cy = view.cy, .width = view.width, .height = view.height},
      .windows = speech->windows,
      .window_length = t->data.features->window_length,
      .eye = about.eye,
      .individual = ERN_INDIVIDUAL_MEAN,
      .background = t->data.background,
      .torso = t->data.has_torso && !t->config.torso ? torso : NULL,
      .torso_motion = t->data.has_torso_motion ? about.torso_motion : NULL};
  memcpy(input.camera.pose, view.pose, sizeof view.pose);
  if (poses != NULL) {
    if (split == 0)
      ern_model_refine(t->model, frame, view.pose);
    else
      ern_model_refine_unseen(t->model, poses->speech_row, t->data.frames[0], about.aud_id, view.pose);
    input.head_pose = view.pose;
  }
  const ern_frame_output output = {.rgb = look->rgb, .attention = look->attention, .eye = look->eye};
  ERN_TRY(ern_renderer_frame(look->renderer, &input, &output, NULL));
  const bool dub =
      !t->config.torso && t->config.ray_sampling == ERN_RAY_SAMPLING_DUB && has_pixel(&about.dubbed, &view);
  *psnr = ern_psnr(look->rgb, *truth, view.width, view.height, dub ? &about.dubbed : NULL);
fail:
  return status;
}

static uint8_t to_byte(float value) { return (uint8_t)lrintf(fminf(fmaxf(value, 0), 1) * 255); }

static float largest(const float *values, size_t count) {
  float most = 1e-9f;
  for (size_t i = 0; i < count; i++) most = fmaxf(most, values[i]);
  return most;
}

/* Side by side; the difference four times as large, the attentions with their largest value as white. */
static void draw(const struct ern_training *t, struct look *look, const uint8_t *truth) {
  const size_t width = (size_t)t->data.width;
  const float most_attention = largest(look->attention, look->pixels), most_eye = largest(look->eye, look->pixels);
  for (size_t i = 0; i < look->pixels; i++) {
    uint8_t *at = look->picture + 3 * ((i / width) * PANELS * width + i % width);
    for (size_t c = 0; c < 3; c++) {
      const float found = look->rgb[3 * i + c], expected = (float)truth[3 * i + c] / 255;
      at[c] = to_byte(found);
      at[3 * width + c] = truth[3 * i + c];
      at[6 * width + c] = to_byte(4 * fabsf(found - expected));
      at[9 * width + c] = to_byte(look->attention[i] / most_attention);
      at[12 * width + c] = to_byte(look->eye[i] / most_eye);
    }
  }
}

/* Records an error text for a hook that failed without one. `before`: the last error before the hook was called. */
static ern_status answered(const struct ern_training *t, ern_status status, const char *hook, const char *before) {
  if (status == ERN_OK || !ern_trainer_error_is(t->context, before)) return status;
  return ern_fail(t->context, status, "train: the hook `%s` answered %s at step %llu", hook, ern_status_name(status),
                  (unsigned long long)t->step);
}

ern_status ern_trainer_validate(const struct ern_trainer_speech *speech, const struct ern_trainer_poses *poses,
                                const ern_train_hooks *hooks, double *psnr) {
  const struct ern_training *t = speech->training;
  const int split = t->data.frames[1] > 0 ? 1 : 0;
  const size_t most = t->config.validate_frames > 0 ? (size_t)t->config.validate_frames : SIZE_MAX;
  const size_t all = split == 1 ? t->data.frames[1] : 1, count = all < most ? all : most;
  struct look look = {0};
  ern_status status = ERN_OK;
  char name[40], before[ERN_ERROR_BYTES];
  *psnr = 0;
  ERN_TRY(look_make(t, &look));
  for (size_t k = 0; k < count; k++) {
    const uint8_t *truth = NULL;
    const size_t frame = split == 1 ? k * all / count : t->config.data_begin;
    double found = 0;
    ERN_TRY(render(speech, poses, &look, split, frame, &truth, &found));
    *psnr += found / (double)count;
    if (k == 0) draw(t, &look, truth);
    if (hooks->validation_frame == NULL) continue;
    ern_error_keep(t->context, before);
    status = hooks->validation_frame(hooks->user, split, frame, look.rgb, truth);
    ERN_TRY(answered(t, status, "validation_frame", before));
  }
  snprintf(name, sizeof name, "val_%06llu.png", (unsigned long long)t->step);
  if (hooks->validation != NULL) {
    ern_error_keep(t->context, before);
    status = hooks->validation(hooks->user, t->step, *psnr, count, look.picture, PANELS * t->data.width, t->data.height,
                               name);
    status = answered(t, status, "validation", before);
  }
fail:
  look_free(t, &look);
  return status;
}
