/* SPDX-License-Identifier: MIT */
#include "evaluation/syncnet.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/speech.h"
#include "evaluation/sync_cepstra.h"

enum { SPAN = 5, LEFT_OUT = 5, STEPS = 20, HOP = 4, MEDIAN = 13, PADDING = 110, SAMPLES = SYNC_RATE / 25 };
enum { LEAST_FRAMES = 2 * SYNC_SHIFT, LEAST_SIDE = 16, MOST_SIDE = 512, MOST_WIDTH = 8192 };
/* Share of the landmarks' box height that is added above it for the forehead; the public program's crop_scale. */
static const double forehead = 0.25, margin = 0.4;

/* ---- the square ---------------------------------------------------------------------------------------------------
 */

static int by_value(const void *left, const void *right) {
  const double a = *(const double *)left, b = *(const double *)right;
  return a < b ? -1 : a > b;
}

/* Centre and half side of the face's box: x, y, half. */
static void face_of(const ern_clip_frame *frame, double box[3]) {
  double low[2] = {HUGE_VAL, HUGE_VAL}, high[2] = {-HUGE_VAL, -HUGE_VAL};
  for (size_t k = 0; k < 2 * 68; k++) {
    low[k % 2] = fmin(low[k % 2], (double)frame->landmarks[k / 2][k % 2]);
    high[k % 2] = fmax(high[k % 2], (double)frame->landmarks[k / 2][k % 2]);
  }
  low[1] -= forehead * (high[1] - low[1]);
  box[0] = 0.5 * (low[0] + high[0]);
  box[1] = 0.5 * (low[1] + high[1]);
  box[2] = fmax(0.5 * fmax(high[0] - low[0], high[1] - low[1]), 1);
}

struct sync_crop sync_crop_of(const ern_clip_frame *const *frames, size_t count, size_t k) {
  double values[3][MEDIAN], box[3];
  const size_t begin = k > MEDIAN / 2 ? k - MEDIAN / 2 : 0,
               end = k + MEDIAN / 2 + 1 < count ? k + MEDIAN / 2 + 1 : count;
  const size_t n = end - begin;
  for (size_t i = begin; i < end; i++) {
    face_of(frames[i], box);
    for (size_t c = 0; c < 3; c++) values[c][i - begin] = box[c];
  }
  for (size_t c = 0; c < 3; c++) {
    qsort(values[c], n, sizeof values[c][0], by_value);
    box[c] = 0.5 * (values[c][(n - 1) / 2] + values[c][n / 2]);
  }
  return (struct sync_crop){
      .x = box[0] - (1 + margin) * box[2], .y = box[1] - box[2], .side = 2 * (1 + margin) * box[2]};
}

static float pixel_of(const uint8_t *pixels, int channels, int width, int height, int x, int y, int c) {
  if (x < 0 || y < 0 || x >= width || y >= height) return PADDING;
  return (float)pixels[((size_t)y * (size_t)width + (size_t)x) * (size_t)channels + (size_t)c];
}

/* Puts the crop into the last of the five frames: blue, green, red of 0..255, bilinear between pixel centres. */
static void put_frame(const struct syncnet *sync, float *input, struct sync_crop crop, const uint8_t *pixels,
                      int channels, int width, int height) {
  const size_t side = (size_t)sync->side, plane = side * side;
  for (size_t c = 0; c < 3; c++) {
    float *frames = input + c * SPAN * plane, *last = frames + (SPAN - 1) * plane;
    memmove(frames, frames + plane, (SPAN - 1) * plane * sizeof *frames);
    for (size_t i = 0; i < plane; i++) {
      const double x = crop.x + ((double)(i % side) + 0.5) * crop.side / (double)side - 0.5;
      const double y = crop.y + ((double)(i / side) + 0.5) * crop.side / (double)side - 0.5;
      const int left = (int)fmax(fmin(floor(x), 1e6), -1e6), top = (int)fmax(fmin(floor(y), 1e6), -1e6);
      const float across = (float)(x - left), down = (float)(y - top);
      const int from = 2 - (int)c;
      const float high = (1 - across) * pixel_of(pixels, channels, width, height, left, top, from) +
                         across * pixel_of(pixels, channels, width, height, left + 1, top, from);
      const float low = (1 - across) * pixel_of(pixels, channels, width, height, left, top + 1, from) +
                        across * pixel_of(pixels, channels, width, height, left + 1, top + 1, from);
      last[i] = (1 - down) * high + down * low;
    }
  }
}

/* ---- networks -----------------------------------------------------------------------------------------------------
 */

static int open_networks(struct syncnet *sync, struct session *session) {
  int shape[ERN_NETWORK_DIMS] = {0};
  if (ern_network_open(session->context, sync->video_path, &sync->video) != ERN_OK) return session_fail(session);
  int dims = ern_network_input(sync->video, shape);
  if (dims != 5 || shape[0] != 1 || shape[1] != 3 || shape[2] != SPAN || shape[3] != shape[4] ||
      shape[3] < LEAST_SIDE || shape[3] > MOST_SIDE)
    return session_fail_with(
        session,
        "%s: its input has %d sizes, [%d, %d, %d, %d, %d], expected [1, 3, 5, side, side] of %d to "
        "%d a side, such as 224",
        sync->video_path, dims, shape[0], shape[1], shape[2], shape[3], shape[4], (int)LEAST_SIDE, (int)MOST_SIDE);
  sync->side = shape[3];
  if (ern_network_open(session->context, sync->audio_path, &sync->audio) != ERN_OK) return session_fail(session);
  dims = ern_network_input(sync->audio, shape);
  if (dims != 4 || shape[0] != 1 || shape[1] != 1 || shape[2] != SYNC_CEPSTRA || shape[3] != STEPS)
    return session_fail_with(session, "%s: its input has %d sizes, [%d, %d, %d, %d], expected [1, 1, 13, 20]",
                             sync->audio_path, dims, shape[0], shape[1], shape[2], shape[3]);
  return 0;
}

/* Computes the embedding of a window into row `row` of to[windows][width]; the first call allocates all rows. */
static int embed(struct syncnet *sync, struct session *session, ern_network *network, const char *path,
                 const float *input, float **to, size_t row) {
  const float *output = NULL;
  size_t count = 0;
  if (ern_network_run(network, input, &output, &count) != ERN_OK) return session_fail(session);
  if (sync->width == 0) sync->width = count;
  if (count != sync->width || count == 0 || count > MOST_WIDTH)
    return session_fail_with(session,
                             "%s: its first output has %zu numbers, expected as many as the other network's, "
                             "%zu, and %d at most",
                             path, count, sync->width, (int)MOST_WIDTH);
  if (*to == NULL) *to = malloc(sync->windows * count * sizeof **to);
  if (*to == NULL) return session_fail_with(session, "no memory for %zu embeddings", sync->windows);
  memcpy(*to + row * count, output, count * sizeof **to);
  return 0;
}

/* ---- the sound ----------------------------------------------------------------------------------------------------
 */

static int embed_sound(struct syncnet *sync, struct session *session, const double *wave, size_t samples) {
  float input[SYNC_CEPSTRA * STEPS];
  double *rows = sync_cepstra(wave, samples);
  int status = rows != NULL ? 0 : session_fail_with(session, "no memory for the cepstra of the sound");
  for (size_t w = 0; w < sync->windows && status == 0; w++) {
    for (size_t i = 0; i < SYNC_CEPSTRA * STEPS; i++)
      input[i] = (float)rows[(w * HOP + i % STEPS) * SYNC_CEPSTRA + i / STEPS];
    status = embed(sync, session, sync->audio, sync->audio_path, input, &sync->audio_embeddings, w);
  }
  free(rows);
  return status;
}

static int read_sound(struct syncnet *sync, const struct evaluation *evaluation, const char *path) {
  struct session *session = evaluation->session;
  const size_t first = (size_t)evaluation->frame_source.source_frame[0].pose.img_id;
  const size_t samples = evaluation->frame_source.count * SAMPLES, from = first * SAMPLES;
  ern_sound sound = {0};
  if (ern_sound_read(session->context, path, &sound) != ERN_OK) return session_fail(session);
  const size_t channels = (size_t)sound.channels;
  int status = 0;
  double *wave = NULL;
  if (sound.rate != SYNC_RATE)
    status = session_fail_with(session, "%s: has %d samples a second, expected %d, as for SyncNet", path, sound.rate,
                               (int)SYNC_RATE);
  else if (sound.frames < from + samples)
    status = session_fail_with(session, "%s: has %zu samples, expected %zu at least: as long as the frames up to %zu",
                               path, sound.frames, from + samples, first + evaluation->frame_source.count);
  else if ((wave = malloc(samples * sizeof *wave)) == NULL)
    status = session_fail_with(session, "no memory for %zu samples", samples);
  for (size_t i = 0; i < samples && status == 0; i++) {
    double sum = 0;
    for (size_t c = 0; c < channels; c++) sum += (double)sound.data[(from + i) * channels + c];
    wave[i] = sum / (double)channels;
  }
  if (status == 0) status = embed_sound(sync, session, wave, samples);
  free(wave);
  ern_sound_free(session->context, &sound);
  return status;
}

/* ---- frames -------------------------------------------------------------------------------------------------------
 */

/* Computes the frames' crops. Frames must be consecutive and have landmarks. */
static int take_crops(struct syncnet *sync, const struct evaluation *evaluation) {
  const struct frame_source *source = &evaluation->frame_source;
  struct session *session = evaluation->session;
  if (source->count < LEAST_FRAMES)
    return session_fail_with(
        session, "--syncnet-video: %zu frames, expected %d at least, as shifts of %d frames each way are tried",
        source->count, (int)LEAST_FRAMES, (int)SYNC_SHIFT);
  const ern_clip_frame **frames = malloc(source->count * sizeof *frames);
  sync->crops = malloc(source->count * sizeof *sync->crops);
  if (frames == NULL || sync->crops == NULL) {
    free(frames);
    return session_fail_with(session, "no memory for %zu frames", source->count);
  }
  int status = 0;
  for (size_t k = 0; k < source->count && status == 0; k++) {
    const struct source_frame *frame = &source->source_frame[k];
    frames[k] = ern_clip_frame_at(evaluation->clip, frame->split, frame->index);
    if (k > 0 && frame->pose.img_id != source->source_frame[k - 1].pose.img_id + 1)
      status = session_fail_with(session,
                                 "--syncnet-video: frame %" PRId64 " comes after %" PRId64
                                 ", expected frames without a gap; --frames takes a part",
                                 (int64_t)frame->pose.img_id, (int64_t)source->source_frame[k - 1].pose.img_id);
    else if (!frames[k]->has_landmarks || frame->pose.img_id < 0)
      status = session_fail_with(
          session, "--syncnet-video: frame %" PRId64 " has no landmarks, expected the clip's ori_imgs/ID.lms",
          (int64_t)frame->pose.img_id);
  }
  for (size_t k = 0; k < source->count && status == 0; k++) sync->crops[k] = sync_crop_of(frames, source->count, k);
  free(frames);
  return status;
}

int syncnet_open(struct syncnet *sync, const struct evaluation *evaluation, const char *sound) {
  struct session *session = evaluation->session;
  if (sync->video_path == NULL) return 0;
  if (!ern_speech_is_sound(sound))
    return session_fail_with(session, "%s: holds features, expected a sound for --syncnet-audio", sound);
  if (take_crops(sync, evaluation) != 0 || open_networks(sync, session) != 0) return EXIT_FAILURE;
  sync->windows = evaluation->frame_source.count - LEFT_OUT;
  const size_t values = 3 * (size_t)SPAN * (size_t)sync->side * (size_t)sync->side;
  for (int s = 0; s < SYNC_SIDES; s++)
    if ((sync->input[s] = calloc(values, sizeof *sync->input[s])) == NULL)
      return session_fail_with(session, "no memory for %zu values", values);
  return read_sound(sync, evaluation, sound);
}

int syncnet_add(struct syncnet *sync, const struct evaluation *evaluation, size_t k) {
  const struct source_frame *frame = &evaluation->frame_source.source_frame[k];
  const int width = evaluation->info.width, height = evaluation->info.height;
  struct session *session = evaluation->session;
  ern_image truth = {0};
  if (sync->video == NULL) return 0;
  if (!sync->drawn_alone) {
    if (evaluate_truth(evaluation, frame, &truth) != 0) return EXIT_FAILURE;
    put_frame(sync, sync->input[SYNC_TRUE], sync->crops[k], truth.data, 3, width, height);
  }
  put_frame(sync, sync->input[SYNC_DRAWN], sync->crops[k], evaluation->rgba, 4, width, height);
  const size_t row = k + 1 - SPAN;
  if (k + 1 < SPAN || row >= sync->windows) return 0;
  for (int s = 0; s < SYNC_SIDES; s++)
    if ((s == SYNC_DRAWN || !sync->drawn_alone) &&
        embed(sync, session, sync->video, sync->video_path, sync->input[s], &sync->video_embeddings[s], row) != 0)
      return EXIT_FAILURE;
  return 0;
}

void syncnet_finish(struct syncnet *sync) {
  if (sync->video == NULL) return;
  for (int s = 0; s < SYNC_SIDES; s++)
    if (sync->video_embeddings[s] != NULL)
      sync->score[s] = sync_score(sync->video_embeddings[s], sync->audio_embeddings, sync->windows, sync->width);
  sync->known = true;
}

void syncnet_close(struct syncnet *sync) {
  ern_network_free(&sync->video);
  ern_network_free(&sync->audio);
  for (int s = 0; s < SYNC_SIDES; s++) {
    free(sync->input[s]);
    free(sync->video_embeddings[s]);
  }
  free(sync->audio_embeddings);
  free(sync->crops);
  *sync = (struct syncnet){.video_path = NULL};
}
