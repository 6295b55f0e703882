/* SPDX-License-Identifier: MIT
 * The static background of the synthetic clip. */
#include "lab/synth/synth_parts.h"

enum { STREAM_ROOM = 51, STREAM_CLUTTER = 52 };

static void put_light(float pixel[4], struct vec3 light) {
  pixel[0] = synth_encode(light.x);
  pixel[1] = synth_encode(light.y);
  pixel[2] = synth_encode(light.z);
  pixel[3] = 1.0f;
}

/* A box with soft edges: 1 inside. */
static float soft_box(float x, float y, float left, float top, float right, float bottom, float blur) {
  return smoothf(left - blur, left + blur, x) * smoothf(right + blur, right - blur, x) *
         smoothf(top - blur, top + blur, y) * smoothf(bottom + blur, bottom - blur, y);
}

static void draw_books(const struct ern_synth_person *person, uint64_t seed, int size, float (*pixels)[4]) {
  enum { BOOKS = 9 };
  for (int j = 0; j < size; ++j)
    for (int i = 0; i < size; ++i) {
      const float x = ((float)i + 0.5f) / (float)size, y = ((float)j + 0.5f) / (float)size;
      struct vec3 c = vec3_scale(person->wall, 1.05f - 0.45f * y - 0.25f * (x - 0.3f) * (x - 0.3f));
      /* daylight through a window at the left, crossed by its bars */
      const float pane = soft_box(x, y, -0.10f, 0.06f, 0.235f, 0.62f, 0.025f);
      const float bars =
          maxf(soft_box(x, y, 0.07f, 0.0f, 0.09f, 0.7f, 0.014f), soft_box(x, y, -0.1f, 0.32f, 0.3f, 0.335f, 0.014f));
      const struct vec3 day =
          vec3_mix(vec3_of(0.80f, 0.88f, 0.98f), vec3_of(0.42f, 0.55f, 0.40f), smoothf(0.30f, 0.62f, y));
      c = vec3_mix(c, vec3_mix(day, vec3_of(0.62f, 0.60f, 0.56f), 0.7f * bars), pane);
      /* a shelf with books at the right */
      for (int shelf = 0; shelf < 2; ++shelf) {
        const float board = 0.36f + 0.30f * (float)shelf;
        c = vec3_mix(c, vec3_of(0.16f, 0.10f, 0.06f), soft_box(x, y, 0.76f, board, 1.1f, board + 0.022f, 0.012f));
        for (int book = 0; book < BOOKS; ++book) {
          const uint64_t at = (uint64_t)(shelf * BOOKS + book);
          const float left = 0.775f + 0.027f * (float)book;
          const float top = board - (float)synth_uniform(seed, STREAM_ROOM, 4 * at, 0.10, 0.19);
          const struct vec3 cover = vec3_of((float)synth_uniform(seed, STREAM_ROOM, 4 * at + 1, 0.05, 0.45),
                                            (float)synth_uniform(seed, STREAM_ROOM, 4 * at + 2, 0.05, 0.32),
                                            (float)synth_uniform(seed, STREAM_ROOM, 4 * at + 3, 0.05, 0.35));
          c = vec3_mix(c, cover, soft_box(x, y, left, top, left + 0.025f, board, 0.011f));
        }
      }
      /* a lamp's glow */
      const float dx = x - 0.70f, dy = y - 0.12f, glow = expf(-(dx * dx + dy * dy) / 0.020f);
      c = vec3_along(c, 0.45f * glow, person->lamp);
      put_light(pixels[(size_t)j * (size_t)size + (size_t)i], c);
    }
}

/* One colour, lighter towards the upper left. */
static void draw_plain(const struct ern_synth_person *person, int size, float (*pixels)[4]) {
  for (int j = 0; j < size; ++j)
    for (int i = 0; i < size; ++i) {
      const float x = ((float)i + 0.5f) / (float)size, y = ((float)j + 0.5f) / (float)size;
      put_light(pixels[(size_t)j * (size_t)size + (size_t)i], vec3_scale(person->wall, 1.15f - 0.30f * y - 0.12f * x));
    }
}

/* An object of the cluttered background: a rectangle or an ellipse, striped or not. Lengths in sides of the picture. */
struct thing {
  float x, y, half_width, half_height;
  bool round;
  float stripes; /* a side; 0: none */
  struct vec3 colour, other;
};

/* Every third object has the colour of the person's skin; of the others, every fourth has that of the hair. */
static struct thing make_thing(const struct ern_synth_person *person, uint64_t seed, uint64_t index) {
  float r[12];
  for (uint64_t k = 0; k < 12; ++k) r[k] = (float)synth_uniform(seed, STREAM_CLUTTER, 12 * index + k, 0.0, 1.0);
  struct thing t = {.x = r[0], .y = r[1], .half_width = 0.008f + 0.040f * r[2] * r[2]};
  t.half_height = 0.008f + 0.040f * r[3] * r[3];
  t.round = r[4] < 0.5f;
  t.stripes = r[5] < 0.35f ? 40.0f + 80.0f * r[6] : 0.0f;
  t.colour = vec3_of(0.02f + 0.8f * r[7] * r[7], 0.02f + 0.8f * r[8] * r[8], 0.02f + 0.8f * r[9] * r[9]);
  if (index % 3 == 0) t.colour = vec3_scale(person->skin, 0.7f + 0.6f * r[10]);
  if (index % 3 != 0 && index % 4 == 0) t.colour = vec3_scale(person->hair, 0.6f + 0.8f * r[10]);
  t.other = vec3_scale(t.colour, r[11] < 0.5f ? 0.35f : 2.0f);
  return t;
}

/* Draws the object over the pixels in its box. `blur`: width of its edge. */
static void draw_thing(const struct thing *t, int size, float blur, float (*pixels)[4]) {
  const float side = (float)size;
  const int left = (int)clampf((t->x - t->half_width - blur) * side, 0.0f, side);
  const int right = (int)clampf((t->x + t->half_width + blur) * side + 1.0f, 0.0f, side);
  const int top = (int)clampf((t->y - t->half_height - blur) * side, 0.0f, side);
  const int bottom = (int)clampf((t->y + t->half_height + blur) * side + 1.0f, 0.0f, side);
  for (int j = top; j < bottom; ++j)
    for (int i = left; i < right; ++i) {
      const float dx = ((float)i + 0.5f) / side - t->x, dy = ((float)j + 0.5f) / side - t->y;
      const float u = fabsf(dx) / t->half_width, v = fabsf(dy) / t->half_height;
      const float past = (t->round ? sqrtf(u * u + v * v) : maxf(u, v)) - 1.0f; /* in half widths */
      const float cover = smoothf(blur, -blur, past * minf(t->half_width, t->half_height));
      const bool other = t->stripes > 0.0f && sinf(6.2832f * t->stripes * (dx + dy)) > 0.0f;
      float light[4], *pixel = pixels[(size_t)j * (size_t)size + (size_t)i];
      put_light(light, other ? t->other : t->colour);
      for (int c = 0; c < 3; ++c) pixel[c] = mixf(pixel[c], light[c], cover);
    }
}

static void draw_clutter(const struct ern_synth_person *person, uint64_t seed, int size, float (*pixels)[4]) {
  enum { THINGS = 1500 };
  draw_plain(person, size, pixels);
  for (uint64_t k = 0; k < THINGS; ++k) {
    const struct thing thing = make_thing(person, seed, k);
    draw_thing(&thing, size, 0.0025f, pixels);
  }
}

void ern_synth_room_draw(const struct ern_synth_person *person, uint64_t seed, enum ern_synth_room room, int size,
                         float (*pixels)[4]) {
  switch (room) {
    case ERN_SYNTH_BOOKS: draw_books(person, seed, size, pixels); break;
    case ERN_SYNTH_PLAIN: draw_plain(person, size, pixels); break;
    case ERN_SYNTH_CLUTTERED: draw_clutter(person, seed, size, pixels); break;
  }
}
