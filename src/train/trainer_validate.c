/* SPDX-License-Identifier: MIT
 * Validation: renders validation frames with the values that a save would write, and writes a picture of one. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/memory.h"
#include "train/parts/trainer_data.h"
#include "train/trainer.h"

enum { PANELS = 5 }; /* prediction, truth, difference, audio attention, eye attention */

/* Renderer and host memory for validation frames, all of one size. */
struct look {
  ern_renderer *renderer;
  size_t pixels;
  float *rgb, *attention, *eye;
  uint8_t *picture; /* [height][PANELS*width][3] */
};

static void look_free(ern_trainer *t, struct look *look) {
  ern_renderer_free(&look->renderer);
  ern_release(t->shared.context, look->rgb);
  ern_release(t->shared.context, look->attention);
  ern_release(t->shared.context, look->eye);
  ern_release(t->shared.context, look->picture);
  *look = (struct look){0};
}

static ern_status look_make(ern_trainer *t, struct look *look) {
  ern_render_options options = ern_render_options_default();
  ern_status status = ERN_OK;
  *look = (struct look){.pixels = (size_t)t->shared.data.width * (size_t)t->shared.data.height};
  if (strcmp(t->shared.backend->name, "cpu") == 0) options.threads = t->shared.config.threads;
  options.max_steps = t->shared.config.max_steps;
  options.dt_gamma = t->shared.config.dt_gamma;
  options.torso_shrink = t->shared.config.torso_shrink;
  ERN_TRY(ern_renderer_create(&look->renderer, t->shared.backend, t->shared.model, &options));
  ERN_TRY(ERN_NEW(t->shared.context, 3 * look->pixels, &look->rgb));
  ERN_TRY(ERN_NEW(t->shared.context, look->pixels, &look->attention));
  ERN_TRY(ERN_NEW(t->shared.context, look->pixels, &look->eye));
  ERN_TRY(ERN_NEW(t->shared.context, 3 * PANELS * look->pixels, &look->picture));
  return ERN_OK;
fail:
  look_free(t, look);
  return status;
}

static ern_status render(ern_trainer *t, struct look *look, int split, size_t frame, const uint8_t **truth,
                         double *psnr) {
  const uint8_t *torso = NULL;
  struct ern_view view;
  ern_dataset_frame about;
  ern_status status = ERN_OK;
  ERN_TRY(ern_trainer_frame(&t->shared, split, frame, &about));
  ERN_TRY(ern_trainer_pixels(&t->shared, split, frame, truth, &torso));
  ERN_TRY(ern_trainer_view(&t->shared, split, frame, &view));
  ERN_TRY(ern_trainer_windows(&t->speech, split, frame, t->speech.windows));
  ern_frame_input input = {
      .camera = {.focal = view.focal, .cx = view.cx, .cy = view.cy, .width = view.width, .height = view.height},
      .windows = t->speech.windows,
      .window_length = t->shared.data.features->window_length,
      .eye = about.eye,
      .individual = ERN_INDIVIDUAL_MEAN,
      .background = t->shared.data.background,
      .torso = t->shared.data.has_torso && !t->shared.config.torso ? torso : NULL};
  memcpy(input.camera.pose, view.pose, sizeof view.pose);
  if (t->poses != NULL) {
    if (split == 0)
      ern_model_refine(t->shared.model, frame, view.pose);
    else
      ern_model_refine_unseen(t->shared.model, t->poses->speech_row, t->shared.data.frames[0], about.aud_id, view.pose);
    input.head_pose = view.pose;
  }
  const ern_frame_output output = {.rgb = look->rgb, .attention = look->attention, .eye = look->eye};
  ERN_TRY(ern_renderer_frame(look->renderer, &input, &output, NULL));
  const bool dub =
      !t->shared.config.torso && t->shared.config.ray_sampling == ERN_RAY_SAMPLING_DUB && about.dubbed.right > 0;
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
static void draw(const ern_trainer *t, struct look *look, const uint8_t *truth) {
  const size_t width = (size_t)t->shared.data.width;
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
static ern_status answered(ern_trainer *t, ern_status status, const char *hook, const char *before) {
  if (status == ERN_OK || !ern_trainer_error_is(t->shared.context, before)) return status;
  return ern_fail(t->shared.context, status, "train: the hook `%s` answered %s at step %llu", hook,
                  ern_status_name(status), (unsigned long long)t->shared.step);
}

ern_status ern_trainer_validate(ern_trainer *t, const ern_train_hooks *hooks, double *psnr) {
  const int split = t->shared.data.frames[1] > 0 ? 1 : 0;
  const size_t most = t->shared.config.validate_frames > 0 ? (size_t)t->shared.config.validate_frames : SIZE_MAX;
  const size_t all = split == 1 ? t->shared.data.frames[1] : 1, count = all < most ? all : most;
  struct look look = {0};
  ern_status status = ERN_OK;
  char name[40], before[ERN_ERROR_BYTES];
  *psnr = 0;
  ERN_TRY(ern_trainer_download(t, ern_trainer_is_averaged(&t->values) ? t->values.average : t->shared.parameters));
  ern_arena_trim(t->shared.stream); /* a renderer needs memory too; the download has waited for all that ran */
  ERN_TRY(look_make(t, &look));
  for (size_t k = 0; k < count; k++) {
    const uint8_t *truth = NULL;
    const size_t frame = split == 1 ? k * all / count : t->shared.config.data_begin;
    double found = 0;
    ERN_TRY(render(t, &look, split, frame, &truth, &found));
    *psnr += found / (double)count;
    if (k == 0) draw(t, &look, truth);
    if (hooks->validation_frame == NULL) continue;
    ern_error_keep(t->shared.context, before);
    status = hooks->validation_frame(hooks->user, split, frame, look.rgb, truth);
    ERN_TRY(answered(t, status, "validation_frame", before));
  }
  snprintf(name, sizeof name, "val_%06llu.png", (unsigned long long)t->shared.step);
  if (hooks->validation != NULL) {
    ern_error_keep(t->shared.context, before);
    status = hooks->validation(hooks->user, t->shared.step, *psnr, count, look.picture, PANELS * t->shared.data.width,
                               t->shared.data.height, name);
    status = answered(t, status, "validation", before);
  }
fail:
  look_free(t, &look);
  return status;
}
