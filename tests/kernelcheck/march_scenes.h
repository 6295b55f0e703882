/* SPDX-License-Identifier: MIT
 * Scenes for the tests of ray marching: cameras, rays, and occupied cells of all kinds. */
#ifndef ERN_TESTS_MARCH_SCENES_H
#define ERN_TESTS_MARCH_SCENES_H

#include "harness.h"

#include "render/morton.h"
#include "render/render_ops.h"

static const size_t sizes[] = {1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 100, 403};
enum { SIZES = sizeof sizes / sizeof *sizes, MOST = 403, SIDE = ERN_OCCUPANCY_SIDE };

static inline uint32_t word_at(uint64_t seed, size_t at) { return words_at(seed, 1, at).word[0]; }

/* Pixels anywhere, at the ends of rows (where a rounded quotient may be one too large), and 0; a camera, sometimes with
 * an extreme value in it. */
static inline void aim_camera(struct ern_view *view, int32_t pixel[MOST], int width, uint64_t seed) {
  static const float odd[] = {0, -0.0f, 1e-40f, 1e30f, -1e30f, INFINITY, NAN, 3};
  *view = (struct ern_view){.focal = 300 * (1 + random_at(seed, 1, 0.9f)),
                            .cx = random_at(seed, 2, 400),
                            .cy = random_at(seed, 3, 400),
                            .width = width,
                            .height = 450};
  for (size_t i = 0; i < 16; i++) view->pose[i] = random_at(seed, 10 + i, 1);
  if (seed % 4 == 1) view->pose[seed % 11] = odd[seed / 4 % 8];
  if (seed % 4 == 2) view->focal = odd[seed / 4 % 8];
  if (seed % 4 == 3) view->cx = odd[seed / 4 % 8], view->cy = odd[seed / 5 % 8];
  for (size_t i = 0; i < MOST; i++) {
    const uint32_t any = word_at(seed, i) >> 1, rows = any % 9;
    pixel[i] = i % 3 == 0 ? (int32_t)any : i % 3 == 1 ? (int32_t)(any % 202500) : 0;
    const int64_t line = INT32_MAX / width - (int64_t)(i % 2 ? rows : 0), border = line * width - (int64_t)(i / 2 % 2);
    if (i % 3 == 2 && border >= 0) pixel[i] = (int32_t)border;
  }
}
static const int widths[] = {1, 2, 3, 7, 64, 450, 513, 46341, 16777217, INT32_MAX};
enum { WIDTHS = sizeof widths / sizeof *widths };

struct scene {
  uint8_t bits[ERN_OCCUPANCY_BYTES];
  float origin[3];
  size_t n;
  float dir[3 * MOST], jitter[MOST], not_before[MOST]; /* rows of MOST */
};

static inline void fill_bits(uint8_t *bits, uint32_t per_mille, uint64_t seed) {
  memset(bits, 0, ERN_OCCUPANCY_BYTES);
  for (uint32_t c = 0; c < ERN_OCCUPANCY_CELLS; c++) {
    if (word_at(seed, c) % 1000 < per_mille) bits[c >> 3] |= (uint8_t)(1u << (c & 7));
  }
}

/* Cells whose distance from the shell of an ellipsoid is below `thick`, in units of its half axes: like a head's. */
static inline void fill_shell(uint8_t *bits, const float centre[3], const float half[3], float thick) {
  memset(bits, 0, ERN_OCCUPANCY_BYTES);
  for (uint32_t x = 0; x < SIDE; x++) {
    for (uint32_t y = 0; y < SIDE; y++) {
      for (uint32_t z = 0; z < SIDE; z++) {
        const uint32_t cell[3] = {x, y, z}, number = ern_morton(x, y, z);
        double square = 0;
        for (int a = 0; a < 3; a++) square += pow((((double)cell[a] + 0.5) / 64 - 1 - centre[a]) / half[a], 2);
        if (fabs(sqrt(square) - 1) < thick) bits[number >> 3] |= (uint8_t)(1u << (number & 7));
      }
    }
  }
}

static const struct ern_march_settings settings_list[] = {
    {1, 16, 1 / 256.0f, 0.05f}, {1, 1, 1 / 256.0f, 0.05f}, {1, 1024, 0, 0.05f}, {1, 1024, 1 / 256.0f, 0.05f},
    {1, 200, 1 / 256.0f, 0.2f}, {1, 1024, 1, 0},           {2, 16, 0, 0.05f},   {0.7f, 40, 1 / 256.0f, 0.05f},
    {3, 300, 0.5f, 0.05f},      {1, 16, -1, -1},           {1, 16, NAN, NAN},   {1, 500, 1 / 256.0f, 1},
};
enum { SETTINGS = sizeof settings_list / sizeof *settings_list };

/* Directions of all kinds: unit vectors into the box and past it, along an axis, within a plane, the diagonal, not
 * normalised. */
static inline void aim(struct scene *scene, float bound, uint64_t seed) {
  static const float zero[2] = {0.0f, -0.0f};
  for (size_t r = 0; r < MOST; r++) {
    const uint32_t kind = word_at(seed, r) % 16;
    float d[3], length = 0;
    for (size_t a = 0; a < 3; a++) {
      d[a] = random_at(seed, 3 * r + a, 0.9f * bound) - scene->origin[a];
      if (kind == 0) d[a] = a == r % 3 ? (r % 2 ? 1.0f : -1.0f) : zero[r / 3 % 2];
      if (kind == 1) d[a] = a == r % 3 ? zero[r / 2 % 2] : d[a];
      if (kind == 2) d[a] = r % 8 >> a & 1 ? 1.0f : -1.0f; /* the whole way through a cell, from edge to edge */
      if (kind == 3) d[a] = random_at(seed, 3 * r + a, 1);
      length += d[a] * d[a];
    }
    const float scale = kind == 4 ? 1 : kind == 5 ? 0.01f : 1 / sqrtf(length);
    for (size_t a = 0; a < 3; a++) scene->dir[a * MOST + r] = d[a] * scale;
    scene->jitter[r] = r % 5 == 0 ? 0 : ern_uniform(word_at(seed + 1, r));
    scene->not_before[r] = r % 7 == 0 ? -INFINITY : r % 7 == 1 ? INFINITY : 3 * ern_uniform(word_at(seed + 2, r));
  }
}

/* Origins outside and inside the box, on a face, on the border of cells, far away. */
static const float origins[][3] = {{0.1f, 3.3f, -0.2f}, {0.2f, -0.1f, 0.3f}, {0, 0, 0},          {0.25f, 0.5f, -0.125f},
                                   {-4, 0.1f, 0.2f},    {1, 0.5f, 1},        {-0.0f, 2, 1e-20f}, {30, 400, -50}};
enum { ORIGINS = sizeof origins / sizeof *origins };

/* Extreme values in every place: near and at the limits of floats, and NaN. */
static inline void aim_oddly(struct scene *scene, uint64_t seed) {
  static const float value[] = {0,      -0.0f, 1,        -1,        1e-30f, -1e-30f,    1e-6f,       1e-40f, 1e30f,
                                -1e30f, 1e7f,  INFINITY, -INFINITY, NAN,    0.5773503f, -0.5773503f, 3e38f,  1e-44f};
  enum { VALUES = sizeof value / sizeof *value };
  for (size_t a = 0; a < 3; a++) {
    scene->origin[a] = seed % 3 == 0 ? value[word_at(seed, a) % VALUES] : 0.1f * (float)(a + 1);
    for (size_t r = 0; r < MOST; r++) scene->dir[a * MOST + r] = value[word_at(seed, 3 + 3 * r + a) % VALUES];
  }
  for (size_t r = 0; r < MOST; r++) {
    scene->jitter[r] = value[word_at(seed + 99, r) % VALUES];
    scene->not_before[r] = value[word_at(seed + 98, r) % VALUES];
  }
}
static const struct ern_march_settings odd_settings[] = {
    {1, 16, 1 / 256.0f, 0.05f}, {1, ERN_MAX_STEPS, 0, 0}, {10, 300, 0, 0.05f},
    {1, 7, 1e30f, 1e30f},       {-1, 16, 0, 0.05f},       {0, 16, 0, 0.05f},
    {NAN, 16, 0, 0.05f},        {1e-30f, 16, 0, 0.05f},   {1, 100, 1 / 256.0f, -INFINITY},
    {1, 16, INFINITY, 1e6f}};
enum { ODD = sizeof odd_settings / sizeof *odd_settings };

#endif
