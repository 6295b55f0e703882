/* SPDX-License-Identifier: MIT */
#include "session/background.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

enum { BLACK = 0, WHITE = 255 };

typedef ern_status resize_function(ern_context *context, const ern_image *image, int width, int height,
                                   ern_image *resized);

/* All images of a background come from ern_image_resize or ern_image_read, so that one function frees them: a plain
 * colour is one pixel, scaled up. */
static int plain_background(struct background *background, struct session *session, uint8_t level) {
  uint8_t pixel[3] = {level, level, level};
  const ern_image one = {.width = 1, .height = 1, .channels = 3, .data = pixel};
  const ern_status status =
      ern_image_resize(session->context, &one, background->width, background->height, &background->image);
  return status == ERN_OK ? 0 : session_fail(session);
}

static int held(int i, int first, int end) { return (i < first ? first : i < end ? i : end - 1) - first; }

/* `image` has the size of the box. Copies the part inside the picture; outside the box repeats the nearest pixels. */
static ern_status place_image(ern_context *context, const ern_image *image, const ern_box *box, int width, int height,
                              ern_image *placed) {
  uint8_t one[4] = {0};
  const size_t channels = (size_t)image->channels;
  const ern_image pixel = {.width = 1, .height = 1, .channels = image->channels, .data = one};
  const ern_status status = ern_image_resize(context, &pixel, width, height, placed);
  if (status != ERN_OK) return status;
  uint8_t *to = placed->data;
  for (int row = 0; row < height; row++) {
    const size_t line = (size_t)held(row, box->top, box->bottom) * (size_t)image->width;
    for (int column = 0; column < width; column++, to += channels)
      memcpy(to, image->data + channels * (line + (size_t)held(column, box->left, box->right)), channels);
  }
  return ERN_OK;
}

/* *fitted = the visible part of the image, scaled by `resize`, for a box that exceeds the size limit of images. The
 * part is cut at whole pixels of the image. */
static ern_status cut_image(ern_context *context, const ern_image *image, const ern_box *box, int width, int height,
                            resize_function *resize, ern_image *fitted) {
  const double across = (double)image->width / (box->right - box->left);
  const double down = (double)image->height / (box->bottom - box->top);
  ern_box part = {.left = (int)(-box->left * across),
                  .top = (int)(-box->top * down),
                  .right = (int)ceil((width - box->left) * across),
                  .bottom = (int)ceil((height - box->top) * down)};
  if (part.right > image->width) part.right = image->width;
  if (part.bottom > image->height) part.bottom = image->height;
  const ern_box whole = {.right = part.right - part.left, .bottom = part.bottom - part.top};
  const size_t channels = (size_t)image->channels;
  const ern_image from = {
      .width = image->width,
      .height = image->height,
      .channels = image->channels,
      .data = image->data + channels * ((size_t)part.top * (size_t)image->width + (size_t)part.left)};
  ern_image cut = {0};
  ern_status status = place_image(context, &from, &whole, whole.right, whole.bottom, &cut);
  if (status == ERN_OK) status = resize(context, &cut, width, height, fitted);
  ern_image_free(context, &cut);
  return status;
}

/* *fitted = the image, scaled by `resize` and placed. */
static ern_status fit_image(const struct background *background, ern_context *context, const ern_image *image,
                            resize_function *resize, ern_image *fitted) {
  const int width = background->width, height = background->height;
  const ern_box box = ern_fit_box(image->width, image->height, width, height, background->fit);
  const int wide = box.right - box.left, high = box.bottom - box.top;
  ern_image scaled = {0};
  if (wide == image->width && high == image->height) return place_image(context, image, &box, width, height, fitted);
  if (wide == width && high == height) return resize(context, image, width, height, fitted);
  if (wide > ERN_IMAGE_MAX_SIDE || high > ERN_IMAGE_MAX_SIDE)
    return cut_image(context, image, &box, width, height, resize, fitted);
  ern_status status = resize(context, image, wide, high, &scaled);
  if (status == ERN_OK) status = place_image(context, &scaled, &box, width, height, fitted);
  ern_image_free(context, &scaled);
  return status;
}

static int fitted_background(struct background *background, struct session *session, const ern_image *image) {
  const ern_status status = fit_image(background, session->context, image, ern_image_resize, &background->image);
  return status == ERN_OK ? 0 : session_fail(session);
}

static resize_function resize_rgba;

static bool is_opaque(const ern_image *rgba) {
  const size_t pixels = (size_t)rgba->width * (size_t)rgba->height;
  for (size_t i = 0; i < pixels; i++)
    if (rgba->data[4 * i + 3] != 255) return false;
  return true;
}

/* Composites the picture over the clip's background, or over black without a clip: alpha c + (1 - alpha) under. */
static int layered_background(struct background *background, struct session *session, const char *name,
                              const ern_image *rgba, const ern_clip *clip) {
  ern_image layer = {0};
  session_warn(session, "%s: is transparent in places: they show %s", name,
               clip != NULL ? "the clip's background" : "black");
  const ern_status fitted = fit_image(background, session->context, rgba, resize_rgba, &layer);
  if (fitted == ERN_E_NO_MEMORY) return session_fail_with(session, "%s: no memory to resize it", name);
  if (fitted != ERN_OK) return session_fail(session);
  const int status = clip != NULL ? fitted_background(background, session, ern_clip_background(clip))
                                  : plain_background(background, session, BLACK);
  const size_t pixels = (size_t)background->width * (size_t)background->height;
  for (size_t i = 0; status == 0 && i < pixels; i++) {
    const uint8_t *from = layer.data + 4 * i;
    uint8_t *to = background->image.data + 3 * i;
    for (int c = 0; c < 3; c++) to[c] = (uint8_t)((from[c] * from[3] + to[c] * (255 - from[3]) + 127) / 255);
  }
  ern_image_free(session->context, &layer);
  return status;
}

int background_open(struct background *background, struct session *session, const char *choice, const ern_clip *clip,
                    int width, int height, ern_fit fit) {
  *background = (struct background){.width = width, .height = height, .fit = fit};
  if (choice == NULL && clip == NULL) return 0;
  if (choice == NULL) return fitted_background(background, session, ern_clip_background(clip));
  if (strcmp(choice, "white") == 0) return plain_background(background, session, WHITE);
  if (strcmp(choice, "black") == 0) return plain_background(background, session, BLACK);
  ern_image image = {0};
  if (ern_image_read(session->context, choice, 4, &image) != ERN_OK) return session_fail(session);
  if (!is_opaque(&image)) {
    const int status = layered_background(background, session, choice, &image, clip);
    ern_image_free(session->context, &image);
    return status;
  }
  ern_image_free(session->context, &image);
  if (ern_image_read(session->context, choice, 3, &image) != ERN_OK) return session_fail(session);
  const int status = fitted_background(background, session, &image);
  ern_image_free(session->context, &image);
  return status;
}

int background_fill(struct background *background, struct session *session) {
  return background->image.data != NULL ? 0 : plain_background(background, session, BLACK);
}

/* ---- torso pictures ---------------------------------------------------------------------------------------------- */

/* Averages colours weighted by alpha; otherwise transparent pixels would leave a fringe. */
static ern_status resize_rgba(ern_context *context, const ern_image *image, int width, int height, ern_image *resized) {
  const size_t pixels = (size_t)image->width * (size_t)image->height;
  ern_image seen = *image;
  seen.data = malloc(pixels * 4);
  if (seen.data == NULL) return ERN_E_NO_MEMORY; /* without an error message */
  for (size_t i = 0; i < pixels; i++) {
    const uint8_t *from = image->data + 4 * i;
    for (int c = 0; c < 3; c++) seen.data[4 * i + (size_t)c] = (uint8_t)((from[c] * from[3] + 127) / 255);
    seen.data[4 * i + 3] = from[3];
  }
  const ern_status status = ern_image_resize(context, &seen, width, height, resized);
  free(seen.data);
  if (status != ERN_OK) return status;
  const size_t new_pixels = (size_t)width * (size_t)height;
  for (size_t i = 0; i < new_pixels; i++) {
    uint8_t *pixel = resized->data + 4 * i;
    const int alpha = pixel[3];
    for (int c = 0; c < 3 && alpha > 0; c++) {
      const int colour = (pixel[c] * 255 + alpha / 2) / alpha;
      pixel[c] = (uint8_t)(colour < 255 ? colour : 255);
    }
  }
  return ERN_OK;
}

/* *rgba = a frame's picture in the size of the frames, NULL where there is none. ERN_E_NO_MEMORY may come without an
 * error message. */
static ern_status get_torso(struct background *background, ern_context *context, ern_clip *clip, ern_split split,
                            size_t index, const uint8_t **rgba) {
  ern_image torso = {0};
  ern_status status = ern_clip_pixels(clip, split, index, NULL, &torso);
  *rgba = torso.data;
  if (status != ERN_OK || torso.data == NULL ||
      (torso.width == background->width && torso.height == background->height))
    return status;
  ern_image_free(context, &background->resized);
  status = fit_image(background, context, &torso, resize_rgba, &background->resized);
  *rgba = background->resized.data;
  return status;
}

static const char *words_of(ern_context *context, ern_status status) {
  return status == ERN_E_NO_MEMORY ? "no memory for a torso picture" : ern_last_error(context);
}

int background_torso(struct background *background, struct session *session, ern_clip *clip, ern_split split,
                     size_t index, const uint8_t **rgba) {
  const ern_status status = get_torso(background, session->context, clip, split, index, rgba);
  return status == ERN_OK ? 0 : session_fail_with(session, "%s", words_of(session->context, status));
}

/* ---- reading ahead: the readers' threads ------------------------------------------------------------------------- */

static ern_status read_torso(const struct background *background, const struct source_frame *source_frame,
                             ern_image *torso) {
  ern_status status = ern_clip_torso(background->clip, source_frame->split, source_frame->index, torso);
  if (status != ERN_OK || (torso->width == background->width && torso->height == background->height)) return status;
  ern_image stored = *torso;
  *torso = (ern_image){0};
  status = fit_image(background, background->context, &stored, resize_rgba, torso);
  ern_image_free(background->context, &stored);
  return status;
}

/* The number of the next frame to read, once a place is free; at the end or when stopped, the number of frames. */
static size_t begin_frame(struct background *background) {
  const size_t count = background->frame_source->count;
  pthread_mutex_lock(&background->mutex);
  while (!background->stopped && background->begun < count &&
         background->begun - background->released == background->places)
    pthread_cond_wait(&background->moved, &background->mutex);
  const size_t k = background->stopped ? count : background->begun;
  background->begun += k < count;
  pthread_mutex_unlock(&background->mutex);
  return k;
}

static void *reader_main(void *argument) {
  struct background *background = argument;
  for (size_t k; (k = begin_frame(background)) < background->frame_source->count;) {
    struct background_torso *torso = &background->torso[k % background->places];
    const double began = session_seconds();
    const ern_status status = read_torso(background, &background->frame_source->source_frame[k], &torso->image);
    const double seconds = session_seconds() - began;
    pthread_mutex_lock(&background->mutex);
    torso->state = status == ERN_OK ? TORSO_READ : TORSO_FAILED;
    background->seconds += seconds;
    pthread_cond_broadcast(&background->moved);
    pthread_mutex_unlock(&background->mutex);
  }
  return NULL;
}

/* Decoding a picture takes longer than a GPU draws the frame. Drawing and encoding need the other cores. */
static size_t readers_of(int cores) {
  const int readers = cores < 2 ? 1 : 2 + cores / 4;
  return readers < BACKGROUND_READERS ? (size_t)readers : BACKGROUND_READERS;
}

int background_read(struct background *background, struct session *session, ern_clip *clip,
                    const struct frame_source *frame_source) {
  const size_t readers = readers_of(session->backend_info.threads);
  background->context = session->context;
  background->clip = clip;
  background->frame_source = frame_source;
  background->places = readers + BACKGROUND_WAITING;
  pthread_mutex_init(&background->mutex, NULL); /* neither fails on Linux */
  pthread_cond_init(&background->moved, NULL);
  while (background->readers < readers &&
         pthread_create(&background->reader[background->readers], NULL, reader_main, background) == 0)
    background->readers++;
  return background->readers > 0 ? 0 : session_fail_with(session, "the system refused a thread that reads");
}

static void end_readers(struct background *background) {
  pthread_mutex_lock(&background->mutex);
  background->stopped = true;
  pthread_cond_broadcast(&background->moved);
  pthread_mutex_unlock(&background->mutex);
  for (; background->readers > 0; background->readers--)
    pthread_join(background->reader[background->readers - 1], NULL);
}

/* A picture that a reader failed to read is read again here, after the readers' end: the error text is then that of
 * this frame, whichever of them failed last. */
int background_next_torso(struct background *background, struct session *session, const uint8_t **rgba) {
  const size_t k = background->taken++;
  struct background_torso *torso = &background->torso[k % background->places];
  pthread_mutex_lock(&background->mutex);
  while (torso->state == TORSO_EMPTY && !background->stopped) pthread_cond_wait(&background->moved, &background->mutex);
  const bool read = torso->state == TORSO_READ;
  pthread_mutex_unlock(&background->mutex);
  if (!read) {
    end_readers(background);
    const ern_status status = read_torso(background, &background->frame_source->source_frame[k], &torso->image);
    if (status != ERN_OK) return session_fail_with(session, "%s", words_of(session->context, status));
  }
  *rgba = torso->image.data;
  return 0;
}

void background_release_torso(struct background *background) {
  struct background_torso *torso = &background->torso[background->released % background->places];
  ern_image_free(background->context, &torso->image);
  pthread_mutex_lock(&background->mutex);
  torso->state = TORSO_EMPTY;
  background->released++;
  pthread_cond_broadcast(&background->moved);
  pthread_mutex_unlock(&background->mutex);
}

void background_free(struct background *background, struct session *session) {
  if (background->places > 0) {
    end_readers(background);
    for (size_t i = 0; i < background->places; i++) ern_image_free(session->context, &background->torso[i].image);
    pthread_cond_destroy(&background->moved);
    pthread_mutex_destroy(&background->mutex);
  }
  ern_image_free(session->context, &background->image);
  ern_image_free(session->context, &background->resized);
  *background = (struct background){0};
}
