/* SPDX-License-Identifier: MIT
 * What a step trains on: a frame, its speech, and random rays of it. */
#include <string.h>

#include "core/rng.h"
#include "core/status.h"
#include "train/trainer.h"

ern_status ern_trainer_view(const ern_trainer *t, int split, size_t frame, struct ern_view *view) {
  ern_dataset_frame about;
  const ern_status status = t->data.frame(t->data.user, split, frame, &about);
  *view = (struct ern_view){.focal = (float)t->data.focal,
                            .cx = (float)t->data.cx,
                            .cy = (float)t->data.cy,
                            .width = t->data.width,
                            .height = t->data.height};
  if (status == ERN_OK) ern_camera_pose(view->pose, about.matrix, t->data.scale);
  return status;
}

size_t ern_trainer_pick(const ern_trainer *t, uint32_t word) {
  return t->config.data_begin + ern_below(word, (uint32_t)(t->config.data_end - t->config.data_begin));
}

/* --audio-pad edge: by row of the feature file; zero: by place in the split, as the public code. */
ern_status ern_trainer_windows(ern_trainer *t, int split, size_t frame, float *host) {
  ern_dataset_frame about;
  ern_status status = t->data.frame(t->data.user, split, frame, &about);
  if (status != ERN_OK) return status;
  if (t->config.audio_pad == ERN_AUDIO_PAD_EDGE) {
    const int64_t last = (int64_t)t->data.features->windows - 1;
    ern_audio_windows(host, t->data.features, about.aud_id < last ? about.aud_id : last, ERN_AUDIO_PAD_EDGE);
    return ERN_OK;
  }
  const size_t size = (size_t)t->data.features->window_length * (size_t)t->data.features->width;
  for (int k = 0; k < ERN_AUDIO_WINDOWS && status == ERN_OK; k++) {
    const int64_t at = (int64_t)frame - 4 + k;
    float *to = host + (size_t)k * size;
    memset(to, 0, size * sizeof *to);
    if (at < 0 || at >= (int64_t)t->data.frames[split]) continue;
    status = t->data.frame(t->data.user, split, (size_t)at, &about);
    const int64_t last = (int64_t)t->data.features->windows - 1, row = about.aud_id < last ? about.aud_id : last;
    memcpy(to, t->data.features->data + (size_t)row * size, size * sizeof *to);
  }
  return status;
}

ern_status ern_trainer_upload_windows(ern_trainer *t, size_t frame, ern_span *windows) {
  const size_t values =
      (size_t)ERN_AUDIO_WINDOWS * (size_t)t->data.features->window_length * (size_t)t->data.features->width;
  ern_status status = ERN_OK;
  ERN_TRY(ern_trainer_windows(t, 0, frame, t->host_windows));
  ERN_TRY(ern_take(t->stream, ERN_ELEMENT_REAL, values, windows));
  ERN_TRY(t->backend->upload_reals(t->stream, *windows, t->host_windows, values));
fail:
  return status;
}

/* Rows of host_rows for ray i: the torso image over the background is what the head is drawn on, and what the torso is
 * to become. */
static void fill_ray(const ern_trainer *t, size_t i, size_t pixel, const uint8_t *truth, const uint8_t *torso,
                     const ern_dataset_frame *about) {
  const size_t rays = (size_t)t->config.rays, width = (size_t)t->data.width;
  const int row = (int)(pixel / width), column = (int)(pixel % width);
  const float alpha = torso != NULL ? (float)torso[4 * pixel + 3] / 255 : 0;
  for (size_t c = 0; c < 3; c++) {
    const float back = (float)t->data.background[3 * pixel + c] / 255;
    const float over = torso != NULL ? (float)torso[4 * pixel + c] / 255 * alpha + back * (1 - alpha) : back;
    t->host_rows[c * rays + i] = t->config.torso ? over : (float)truth[3 * pixel + c] / 255;
    t->host_rows[(3 + c) * rays + i] = t->config.torso ? back : over;
  }
  t->host_rows[6 * rays + i] = about->has_face && row >= about->face.top && row < about->face.bottom &&
                                       column >= about->face.left && column < about->face.right
                                   ? 1
                                   : 0;
}

static ern_status upload(ern_trainer *t, struct ern_batch *batch) {
  const size_t rays = (size_t)t->config.rays;
  struct ern_backend *backend = t->backend;
  ern_status status = ERN_OK;
  ERN_TRY(ern_take(t->stream, ERN_ELEMENT_INT32, rays, &batch->pixel_number));
  ERN_TRY(ern_take(t->stream, ERN_ELEMENT_REAL, rays, &batch->face));
  ERN_TRY(ern_take(t->stream, ERN_ELEMENT_REAL, rays, &batch->jitter));
  ERN_TRY(ern_take_rows(t->stream, 3, rays, &batch->truth));
  ERN_TRY(ern_take_rows(t->stream, 3, rays, &batch->background));
  ERN_TRY(backend->upload_int32(t->stream, batch->pixel_number, t->host_pixels, rays));
  for (int c = 0; c < 3; c++) {
    ERN_TRY(backend->upload_reals(t->stream, ern_span_of_row(batch->truth, c, rays), t->host_rows + (size_t)c * rays,
                                  rays));
    ERN_TRY(backend->upload_reals(t->stream, ern_span_of_row(batch->background, c, rays),
                                  t->host_rows + (size_t)(3 + c) * rays, rays));
  }
  ERN_TRY(backend->upload_reals(t->stream, batch->face, t->host_rows + 6 * rays, rays));
  ERN_TRY(backend->upload_reals(t->stream, batch->jitter, t->host_rows + 7 * rays, rays));
fail:
  return status;
}

ern_status ern_trainer_batch(ern_trainer *t, struct ern_batch *batch) {
  const size_t rays = (size_t)t->config.rays;
  const uint32_t pixels = (uint32_t)t->data.width * (uint32_t)t->data.height;
  const struct ern_random of_frame = ern_random_at(t->config.seed, t->step, 0, ERN_RNG_FRAME);
  const uint8_t *truth = NULL, *torso = NULL;
  ern_dataset_frame about;
  ern_status status = ERN_OK;
  *batch = (struct ern_batch){.frame = ern_trainer_pick(t, of_frame.word[0])};
  ERN_TRY(t->data.frame(t->data.user, 0, batch->frame, &about));
  ERN_TRY(t->data.pixels(t->data.user, 0, batch->frame, &truth, &torso));
  if (!t->data.has_torso) torso = NULL;
  batch->eye = about.eye + 0.1f * (ern_uniform(of_frame.word[1]) - 0.5f);
  for (size_t i = 0; i < rays; i++) {
    const struct ern_random random = ern_random_at(t->config.seed, t->step, (uint32_t)i, ERN_RNG_PIXEL);
    t->host_pixels[i] = (int32_t)ern_below(random.word[0], pixels);
    t->host_rows[7 * rays + i] = ern_uniform(random.word[1]);
    fill_ray(t, i, (size_t)t->host_pixels[i], truth, torso, &about);
  }
  ERN_TRY(upload(t, batch));
  if (!t->config.torso) ERN_TRY(ern_trainer_upload_windows(t, batch->frame, &batch->windows));
fail:
  return status;
}
