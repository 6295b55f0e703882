/* SPDX-License-Identifier: MIT
 * The training pictures: the person over the background, and the torso with the part behind the head filled in, after
 * AD-NeRF's preprocessing (numbers are pixels of a 512 x 512 picture). */
#include <math.h>

#include "prepare/layers/layers.h"

enum { TORSO_UP = 9, NECK_UP = 53, NECK_FROM = 4 };

static uint8_t byte_of(float value) { return (uint8_t)lrintf(value < 0 ? 0 : value > 255 ? 255 : value); }

void ern_layer_frame(const uint8_t *rgb, const uint8_t *alpha, const uint8_t *behind, const uint8_t *parts,
                     const uint8_t *background, bool head_only, int side, uint8_t *frame) {
  const size_t pixels = (size_t)side * (size_t)side, width = (size_t)side;
  for (size_t k = 0; k < pixels; k++) {
    float a = (float)alpha[k] / 255;
    bool replaced = alpha[k] == 0;
    if (head_only) { /* the share of the head in the 3 x 3 pixels about this one */
      const size_t x = k % width, y = k / width;
      float head = 0, person = 0;
      for (size_t v = y > 0 ? y - 1 : 0; v <= y + 1 && v < width; v++)
        for (size_t u = x > 0 ? x - 1 : 0; u <= x + 1 && u < width; u++) {
          head += parts[v * width + u] == ERN_PART_HEAD ? 1 : 0;
          person += parts[v * width + u] != ERN_PART_BACKGROUND ? 1 : 0;
        }
      const float share = person > 0 ? head / person : 0;
      replaced = replaced || share == 0;
      a *= share;
      for (size_t i = 0; i < 3; i++) {
        /* at the jaw a pixel is all person; elsewhere it is mixed with the background */
        const float own = (float)rgb[3 * k + i], cut = own * share + (float)background[3 * k + i] * (1 - share);
        const float mixed = own + (1 - a) * ((float)background[3 * k + i] - (float)behind[3 * k + i]);
        frame[3 * k + i] = replaced ? background[3 * k + i] : byte_of(share < 1 ? cut : mixed);
      }
      continue;
    }
    for (size_t i = 0; i < 3; i++) /* C + (1 - a)(new - old background), C = a F + (1 - a) old */
      frame[3 * k + i] =
          replaced
              ? background[3 * k + i]
              : byte_of((float)rgb[3 * k + i] + (1 - a) * ((float)background[3 * k + i] - (float)behind[3 * k + i]));
  }
}

struct torso {
  size_t width;
  const uint8_t *parts;
  uint8_t *rgba, *filled;      /* filled[width][width]: 1 where the head hid it */
  size_t neck_begin, neck_end; /* range of the neck's columns; skin within it may be classified as clothes */
};

/* Whether the head is above that pixel, with at most `gap` pixels of torso between. */
static bool is_below_head(const struct torso *torso, size_t x, size_t y, size_t gap) {
  size_t at = y - 1;
  while (at > 0 && y - 1 - at < gap && torso->parts[at * torso->width + x] == ERN_PART_TORSO) at--;
  return torso->parts[at * torso->width + x] == ERN_PART_HEAD;
}

/* Extends a column of `part` upward behind the head: from `push` pixels below its top for `count` pixels, each 0.98
 * times the one below it; inside the neck as far as the neck reaches. */
static void fill_up(struct torso *torso, enum ern_layer_part part, size_t push, size_t count) {
  const size_t n = torso->width;
  for (size_t x = 0; x < n; x++) {
    size_t top = 1;
    while (top < n && !(torso->parts[top * n + x] == part && is_below_head(torso, x, top, push))) top++;
    if (top >= n) continue;
    size_t from = top;
    while (from - top < push && from + 1 < n && torso->parts[(from + 1) * n + x] == part) from++;
    float shade = 1;
    const size_t high = x >= torso->neck_begin && x < torso->neck_end ? NECK_UP * n / 512 + 1 : count;
    for (size_t i = 1; i <= high && i <= from; i++) {
      const size_t at = (from - i) * n + x;
      if (torso->parts[at] == ERN_PART_BACKGROUND || (part == ERN_PART_TORSO && torso->parts[at] == ERN_PART_NECK))
        break;
      shade *= 0.98F;
      for (size_t c = 0; c < 3; c++)
        torso->rgba[4 * at + c] = byte_of(shade * (float)torso->rgba[4 * (from * n + x) + c]);
      torso->rgba[4 * at + 3] = 255;
      torso->filled[at] = 1;
    }
  }
}

/* Blurs the filled pixels by a 5 x 5 Gaussian over the pixels that the torso covers. */
static void blur_filled(const struct torso *torso, uint8_t *before) {
  static const float tap[5] = {1, 4, 6, 4, 1};
  const size_t n = torso->width;
  for (size_t k = 0; k < 4 * n * n; k++) before[k] = torso->rgba[k];
  for (size_t y = 0; y < n; y++)
    for (size_t x = 0; x < n; x++) {
      if (torso->filled[y * n + x] == 0) continue;
      float sum[3] = {0}, weight = 0;
      for (size_t v = 0; v < 5; v++)
        for (size_t u = 0; u < 5; u++) {
          if (y + v < 2 || x + u < 2 || y + v - 2 >= n || x + u - 2 >= n) continue;
          const uint8_t *from = before + 4 * ((y + v - 2) * n + x + u - 2);
          const float w = tap[u] * tap[v] * (float)from[3];
          for (int c = 0; c < 3; c++) sum[c] += w * (float)from[c];
          weight += w;
        }
      for (size_t c = 0; c < 3; c++) torso->rgba[4 * (y * n + x) + c] = byte_of(sum[c] / weight);
    }
}

ern_status ern_layer_torso(ern_context *context, const uint8_t *rgb, const uint8_t *alpha, const uint8_t *behind,
                           const uint8_t *parts, int side, uint8_t *rgba) {
  ern_status status = ERN_OK;
  const size_t n = (size_t)side;
  struct torso torso = {.width = n, .parts = parts, .rgba = rgba, .neck_begin = n};
  uint8_t *before = NULL;
  ERN_TRY(ERN_NEW(context, n * n, &torso.filled));
  ERN_TRY(ERN_NEW(context, 4 * n * n, &before));
  for (size_t k = 0; k < n * n; k++) {
    if (parts[k] == ERN_PART_NECK) {
      torso.neck_begin = k % n < torso.neck_begin ? k % n : torso.neck_begin;
      torso.neck_end = k % n >= torso.neck_end ? k % n + 1 : torso.neck_end;
    }
    /* The mask's edge is soft: a pixel outside that the person covers by less than half belongs to the part beside it.
     */
    const bool soft =
        parts[k] == ERN_PART_BACKGROUND && alpha[k] > 0 &&
        ((k % n > 0 && parts[k - 1] >= ERN_PART_NECK) || (k % n + 1 < n && parts[k + 1] >= ERN_PART_NECK) ||
         (k + n < n * n && parts[k + n] >= ERN_PART_NECK));
    const bool own = parts[k] >= ERN_PART_NECK || soft;
    const float a = (float)alpha[k] / 255;
    rgba[4 * k + 3] = own ? alpha[k] : 0;
    for (size_t c = 0; c < 3; c++) /* F = (C - (1 - a) B)/a */
      rgba[4 * k + c] = !own           ? 0
                        : alpha[k] < 8 ? rgb[3 * k + c]
                                       : byte_of(((float)rgb[3 * k + c] - (1 - a) * (float)behind[3 * k + c]) / a);
  }
  fill_up(&torso, ERN_PART_TORSO, 0, TORSO_UP * n / 512 + 1);
  fill_up(&torso, ERN_PART_NECK, (NECK_FROM * n + 511) / 512, NECK_UP * n / 512 + 1);
  blur_filled(&torso, before);
fail:
  ern_release(context, torso.filled);
  ern_release(context, before);
  return status;
}
