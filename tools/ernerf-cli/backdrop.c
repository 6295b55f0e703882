/* SPDX-License-Identifier: MIT */
#include "backdrop.h"

#include <stdlib.h>
#include <string.h>

enum { BLACK = 0, WHITE = 255 };

typedef ern_status resize_function(ern_context *context, const ern_image *image, int width, int height,
                                   ern_image *resized);

/* All images of a backdrop come from ern_image_resize or ern_image_read, so that one function frees them: a plain one
 * is a pixel made large. */
static int plain_background(struct backdrop *backdrop, struct session *session, uint8_t level) {
  uint8_t pixel[3] = {level, level, level};
  const ern_image one = {.width = 1, .height = 1, .channels = 3, .data = pixel};
  const ern_status status =
      ern_image_resize(session->context, &one, backdrop->width, backdrop->height, &backdrop->background);
  return status == ERN_OK ? 0 : session_fail(session);
}

static int held(int i, int first, int end) { return (i < first ? first : i < end ? i : end - 1) - first; }

/* `image` has the size of the box: what of it is in the picture, beside it its nearest pixels. */
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

/* *fitted = the image, scaled by `resize` and placed. */
static ern_status fit_image(const struct backdrop *backdrop, ern_context *context, const ern_image *image,
                            resize_function *resize, ern_image *fitted) {
  const int width = backdrop->width, height = backdrop->height;
  const ern_box box = ern_fit_box(image->width, image->height, width, height, backdrop->fit);
  const int wide = box.right - box.left, high = box.bottom - box.top;
  ern_image scaled = {0};
  if (wide == image->width && high == image->height) return place_image(context, image, &box, width, height, fitted);
  if (wide == width && high == height) return resize(context, image, width, height, fitted);
  ern_status status = resize(context, image, wide, high, &scaled);
  if (status == ERN_OK) status = place_image(context, &scaled, &box, width, height, fitted);
  ern_image_free(context, &scaled);
  return status;
}

static int fitted_background(struct backdrop *backdrop, struct session *session, const ern_image *image) {
  const ern_status status = fit_image(backdrop, session->context, image, ern_image_resize, &backdrop->background);
  return status == ERN_OK ? 0 : session_fail(session);
}

int backdrop_open(struct backdrop *backdrop, struct session *session, const char *choice, const ern_clip *clip,
                  int width, int height, ern_fit fit) {
  *backdrop = (struct backdrop){.width = width, .height = height, .fit = fit};
  if (choice == NULL && clip == NULL) return 0;
  if (choice == NULL) return fitted_background(backdrop, session, ern_clip_background(clip));
  if (strcmp(choice, "white") == 0) return plain_background(backdrop, session, WHITE);
  if (strcmp(choice, "black") == 0) return plain_background(backdrop, session, BLACK);
  ern_image image = {0};
  if (ern_image_read(session->context, choice, 3, &image) != ERN_OK) return session_fail(session);
  const int status = fitted_background(backdrop, session, &image);
  ern_image_free(session->context, &image);
  return status;
}

int backdrop_fill(struct backdrop *backdrop, struct session *session) {
  return backdrop->background.data != NULL ? 0 : plain_background(backdrop, session, BLACK);
}

/* ---- torso pictures ---------------------------------------------------------------------------------------------- */

/* Colours are averaged by how much of them is seen, else what is transparent would leave a rim. */
static ern_status resize_rgba(ern_context *context, const ern_image *image, int width, int height, ern_image *resized) {
  const size_t pixels = (size_t)image->width * (size_t)image->height;
  ern_image seen = *image;
  seen.data = malloc(pixels * 4);
  if (seen.data == NULL) return ERN_E_NO_MEMORY;
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

/* *rgba = a frame's picture in the size of the frames, NULL where there is none. ERN_E_NO_MEMORY may come without
 * words.
 */
static ern_status get_torso(struct backdrop *backdrop, ern_context *context, ern_clip *clip, ern_split split,
                            size_t index, const uint8_t **rgba) {
  ern_image torso = {0};
  ern_status status = ern_clip_pixels(clip, split, index, NULL, &torso);
  *rgba = torso.data;
  if (status != ERN_OK || torso.data == NULL || (torso.width == backdrop->width && torso.height == backdrop->height))
    return status;
  ern_image_free(context, &backdrop->resized);
  status = fit_image(backdrop, context, &torso, resize_rgba, &backdrop->resized);
  *rgba = backdrop->resized.data;
  return status;
}

static const char *words_of(ern_context *context, ern_status status) {
  return status == ERN_E_NO_MEMORY ? "no memory for a torso picture" : ern_last_error(context);
}

int backdrop_torso(struct backdrop *backdrop, struct session *session, ern_clip *clip, ern_split split, size_t index,
                   const uint8_t **rgba) {
  const ern_status status = get_torso(backdrop, session->context, clip, split, index, rgba);
  return status == ERN_OK ? 0 : session_fail_with(session, "%s", words_of(session->context, status));
}

/* ---- reading ahead: the reader's thread -------------------------------------------------------------------------- */

static bool read_torso(struct backdrop *backdrop, const struct shot *shot, uint8_t *to) {
  const uint8_t *rgba = NULL;
  const ern_status status = get_torso(backdrop, backdrop->context, backdrop->clip, shot->split, shot->index, &rgba);
  if (status == ERN_OK)
    memcpy(to, rgba, (size_t)backdrop->width * (size_t)backdrop->height * 4);
  else
    backdrop->trouble = strdup(words_of(backdrop->context, status));
  return status == ERN_OK;
}

static void *reader_main(void *argument) {
  struct backdrop *backdrop = argument;
  for (size_t k = 0; k < backdrop->shots->count; k++) {
    const int place = belt_free_place(&backdrop->belt);
    if (place == BELT_OVER) return NULL;
    const double began = session_seconds();
    const bool read = read_torso(backdrop, &backdrop->shots->shot[k], backdrop->torso[place]);
    backdrop->seconds += session_seconds() - began;
    if (!read) break;
    belt_fill(&backdrop->belt);
  }
  belt_end(&backdrop->belt);
  return NULL;
}

int backdrop_read(struct backdrop *backdrop, struct session *session, ern_clip *clip, const struct shots *shots) {
  const size_t bytes = (size_t)backdrop->width * (size_t)backdrop->height * 4; /* at most 2^28 */
  backdrop->context = session->context;
  backdrop->clip = clip;
  backdrop->shots = shots;
  for (size_t i = 0; i < BACKDROP_TORSOS; i++) {
    backdrop->torso[i] = malloc(bytes);
    if (backdrop->torso[i] == NULL) return session_fail_with(session, "no memory for a torso picture");
  }
  belt_make(&backdrop->belt, BACKDROP_TORSOS);
  if (pthread_create(&backdrop->reader, NULL, reader_main, backdrop) != 0) {
    belt_free(&backdrop->belt);
    return session_fail_with(session, "the system refused a thread that reads");
  }
  backdrop->running = true;
  return 0;
}

static void end_reader(struct backdrop *backdrop) {
  if (!backdrop->running) return;
  belt_break(&backdrop->belt);
  pthread_join(backdrop->reader, NULL);
  belt_free(&backdrop->belt);
  backdrop->running = false;
}

int backdrop_next_torso(struct backdrop *backdrop, struct session *session, const uint8_t **rgba) {
  *rgba = NULL;
  if (backdrop->holding) belt_empty(&backdrop->belt);
  const int place = belt_item(&backdrop->belt);
  backdrop->holding = place != BELT_OVER;
  if (place == BELT_OVER) {
    end_reader(backdrop);
    return session_fail_with(session, "%s", backdrop->trouble != NULL ? backdrop->trouble : "no more torso pictures");
  }
  *rgba = backdrop->torso[place];
  return 0;
}

void backdrop_free(struct backdrop *backdrop, struct session *session) {
  end_reader(backdrop);
  ern_image_free(session->context, &backdrop->background);
  ern_image_free(session->context, &backdrop->resized);
  for (size_t i = 0; i < BACKDROP_TORSOS; i++) free(backdrop->torso[i]);
  free(backdrop->trouble);
  *backdrop = (struct backdrop){0};
}
