/* SPDX-License-Identifier: MIT */
#include "backdrop.h"

#include <stdlib.h>
#include <string.h>

enum { BLACK = 0, WHITE = 255 };

/* All images of a backdrop come from ern_image_resize or ern_image_read, so that one function frees them: a plain one
 * is a pixel made large. */
static int plain_background(struct backdrop *backdrop, struct session *session, uint8_t level) {
  uint8_t pixel[3] = {level, level, level};
  const ern_image one = {.width = 1, .height = 1, .channels = 3, .data = pixel};
  const ern_status status =
      ern_image_resize(session->context, &one, backdrop->width, backdrop->height, &backdrop->background);
  return status == ERN_OK ? 0 : session_fail(session);
}

static int fitted_background(struct backdrop *backdrop, struct session *session, const ern_image *image) {
  const ern_status status =
      ern_image_resize(session->context, image, backdrop->width, backdrop->height, &backdrop->background);
  return status == ERN_OK ? 0 : session_fail(session);
}

int backdrop_open(struct backdrop *backdrop, struct session *session, const char *choice, const ern_clip *clip,
                  int width, int height) {
  *backdrop = (struct backdrop){.width = width, .height = height};
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

void backdrop_free(struct backdrop *backdrop, struct session *session) {
  ern_image_free(session->context, &backdrop->background);
  ern_image_free(session->context, &backdrop->torso);
}

/* Colours are averaged by how much of them is seen, else what is transparent would leave a rim. */
static ern_status resize_rgba(struct session *session, const ern_image *image, int width, int height,
                              ern_image *resized) {
  const size_t pixels = (size_t)image->width * (size_t)image->height;
  ern_image seen = *image;
  seen.data = malloc(pixels * 4);
  if (seen.data == NULL) return ERN_E_NO_MEMORY;
  for (size_t i = 0; i < pixels; i++) {
    const uint8_t *from = image->data + 4 * i;
    for (int c = 0; c < 3; c++) seen.data[4 * i + (size_t)c] = (uint8_t)((from[c] * from[3] + 127) / 255);
    seen.data[4 * i + 3] = from[3];
  }
  const ern_status status = ern_image_resize(session->context, &seen, width, height, resized);
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

int backdrop_torso(struct backdrop *backdrop, struct session *session, ern_clip *clip, ern_split split, size_t index,
                   const uint8_t **rgba) {
  ern_image torso = {0};
  *rgba = NULL;
  if (ern_clip_pixels(clip, split, index, NULL, &torso) != ERN_OK) return session_fail(session);
  *rgba = torso.data;
  if (torso.data == NULL || (torso.width == backdrop->width && torso.height == backdrop->height)) return 0;
  ern_image_free(session->context, &backdrop->torso);
  const ern_status status = resize_rgba(session, &torso, backdrop->width, backdrop->height, &backdrop->torso);
  *rgba = backdrop->torso.data;
  if (status == ERN_E_NO_MEMORY) return session_fail_with(session, "no memory for a torso picture");
  return status == ERN_OK ? 0 : session_fail(session);
}
