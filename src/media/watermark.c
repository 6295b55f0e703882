/* SPDX-License-Identifier: MIT
 * Makes the watermark's pattern from a key and adds it to frames. It uses integers only, so that the pattern is the
 * same on every machine. */
#include "media/watermark.h"

#include <stdio.h>
#include <string.h>

#include "core/memory.h"
#include "io/file.h"
#include "media/image.h"

enum { TILE = ERN_WATERMARK_TILE, WAVES = ERN_WATERMARK_WAVES, HIGH = ERN_WATERMARK_HIGH };
enum { ONE = 1 << 14 /* the scale of sines */, GREY = 256 /* the scale of the tile: a step of 8-bit pixels */ };

struct ern_watermark {
  ern_context *context;
  int width, height;
  int8_t *plane; /* [height][width], added to pixels */
};

static int64_t divide_rounded(int64_t a, int64_t by) { return (a >= 0 ? a + by / 2 : a - by / 2) / by; }

/* ---- the code ---------------------------------------------------------------------------------------------------- */

static bool is_wave(int x, int y) {
  const int square = x * x + y * y;
  return (x > 0 || (x == 0 && y > 0)) && square >= ERN_WATERMARK_LOW * ERN_WATERMARK_LOW && square <= HIGH * HIGH;
}

void ern_watermark_list(struct ern_watermark_waves *waves) {
  size_t k = 0;
  for (int x = 0; x <= HIGH; x++) {
    for (int y = -HIGH; y <= HIGH; y++) {
      if (!is_wave(x, y)) continue;
      waves->x[k] = (int16_t)x;
      waves->y[k++] = (int16_t)y;
    }
  }
}

ern_status ern_watermark_code_make(ern_context *context, const char *key, struct ern_watermark_code *code) {
  const size_t bytes = strnlen(key, ERN_WATERMARK_KEY_BYTES);
  if (bytes == 0 || bytes == ERN_WATERMARK_KEY_BYTES)
    return ern_fail(context, ERN_E_ARGUMENT, "watermark: the key has %s bytes, expected 1 to %d",
                    bytes == 0 ? "0" : "too many", ERN_WATERMARK_KEY_BYTES - 1);
  char text[ERN_WATERMARK_KEY_BYTES + 64], hex[65];
  enum { DIGITS = 64 };
  for (size_t k = 0; k < WAVES; k += 2) { /* a hex digit has the bits of two waves */
    const size_t digit = k / 2 % DIGITS;
    if (digit == 0) {
      const int length = snprintf(text, sizeof text, "libernerf watermark 1:%zu:%s", k / 2 / DIGITS, key);
      ern_sha256_hex(text, (size_t)length, hex);
    }
    const int value = hex[digit] <= '9' ? hex[digit] - '0' : hex[digit] - 'a' + 10;
    for (size_t i = 0; i < 2; i++) {
      code->re[k + i] = (int8_t)((value >> (2 * i) & 1) * 2 - 1);
      code->im[k + i] = (int8_t)((value >> (2 * i + 1) & 1) * 2 - 1);
    }
  }
  return ERN_OK;
}

/* ---- the tile ---------------------------------------------------------------------------------------------------- */

/* cosine[i] = ONE cos(2 pi i/TILE), by rotating a unit vector TILE times by 2 pi/TILE; the accumulated error is below
 * 2^-20. */
static void fill_cosines(int32_t cosine[TILE]) {
  const int64_t unit = (int64_t)1 << 30, c = 1073660973, s = 13176464; /* 2^30 times cosine, sine of 2 pi/512 */
  int64_t x = unit, y = 0;
  for (int i = 0; i < TILE; i++) {
    cosine[i] = (int32_t)divide_rounded(x, unit / ONE);
    const int64_t next = divide_rounded(x * c - y * s, unit);
    y = divide_rounded(x * s + y * c, unit);
    x = next;
  }
}

/* The waves of one x, summed along y: row[y] = sum_k (re + i im) e^(2 pi i k y/TILE), times ONE. */
static void sum_rows(const struct ern_watermark_code *code, const struct ern_watermark_waves *waves, size_t begin,
                     size_t end, const int32_t cosine[TILE], int32_t row[TILE][2]) {
  for (int y = 0; y < TILE; y++) {
    int32_t re = 0, im = 0;
    for (size_t k = begin; k < end; k++) {
      const unsigned turn = (unsigned)(waves->y[k] * y) % TILE;
      const int32_t c = cosine[turn], s = cosine[(turn + 3 * TILE / 4) % TILE];
      re += code->re[k] * c - code->im[k] * s;
      im += code->re[k] * s + code->im[k] * c;
    }
    row[y][0] = re;
    row[y][1] = im;
  }
}

/* tile: [TILE][TILE], in 1/GREY, RMS 1.2: the real part of the sum of all waves, divided by sqrt(WAVES). sums: the
 * same, zeroed. */
static void make_tile(const struct ern_watermark_code *code, int64_t *sums, int16_t *tile) {
  static const int64_t gain = 16918; /* 2^12 1.2 GREY/sqrt(WAVES) */
  struct ern_watermark_waves waves;
  int32_t cosine[TILE], row[TILE][2];
  ern_watermark_list(&waves);
  fill_cosines(cosine);
  for (size_t begin = 0, end = 0; begin < WAVES; begin = end) {
    const int x_of = waves.x[begin];
    while (end < WAVES && waves.x[end] == x_of) end++;
    sum_rows(code, &waves, begin, end, cosine, row);
    for (int y = 0; y < TILE; y++) {
      for (int x = 0; x < TILE; x++) {
        const unsigned turn = (unsigned)(x_of * x) % TILE;
        sums[y * TILE + x] +=
            (int64_t)row[y][0] * cosine[turn] - (int64_t)row[y][1] * cosine[(turn + 3 * TILE / 4) % TILE];
      }
    }
  }
  for (int i = 0; i < TILE * TILE; i++)
    tile[i] = (int16_t)divide_rounded(divide_rounded(sums[i], ONE) * gain, (int64_t)ONE << 12);
}

/* ---- frames ------------------------------------------------------------------------------------------------------ */

/* The position of pixel i's centre in the tile: between tile samples at[0] and at[1], *share (in 1/GREY) from the
 * first. */
static void place(int i, int side, int at[2], int *share) {
  const int64_t shift = (int64_t)TILE * GREY;
  const int64_t where = ((2 * (int64_t)i + 1) * TILE * GREY / (2 * (int64_t)side) - GREY / 2 + shift) % shift;
  at[0] = (int)(where / GREY);
  at[1] = (at[0] + 1) % TILE;
  *share = (int)(where % GREY);
}

/* Fills the plane with the repeated tile, by linear interpolation. */
static void fill_plane(const int16_t *tile, int8_t *plane, int width, int height) {
  const int side = width < height ? width : height;
  for (int y = 0; y < height; y++) {
    int row[2], down, column[2], right;
    place(y, side, row, &down);
    const int16_t *upper = tile + row[0] * TILE, *lower = tile + row[1] * TILE;
    for (int x = 0; x < width; x++) {
      place(x, side, column, &right);
      const int64_t above = upper[column[0]] * (GREY - right) + upper[column[1]] * right;
      const int64_t below = lower[column[0]] * (GREY - right) + lower[column[1]] * right;
      const int64_t value = divide_rounded(above * (GREY - down) + below * down, (int64_t)GREY * GREY * GREY);
      plane[(size_t)y * (size_t)width + (size_t)x] = (int8_t)(value < -127 ? -127 : value > 127 ? 127 : value);
    }
  }
}

ern_status ern_watermark_open(ern_context *context, const char *key, int width, int height, ern_watermark **watermark) {
  if (watermark != NULL) *watermark = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, key);
  ERN_NEED(context, watermark);
  struct ern_watermark_code code;
  ern_watermark *made = NULL;
  int64_t *sums = NULL;
  int16_t *tile = NULL;
  ern_status status = ern_image_check_sides(context, "watermark", width, height);
  if (status == ERN_OK && (width < ERN_WATERMARK_SIDE || height < ERN_WATERMARK_SIDE))
    status = ern_fail(context, ERN_E_SHAPE, "watermark: the frames have %d x %d pixels, expected %d a side or more",
                      width, height, ERN_WATERMARK_SIDE);
  if (status == ERN_OK) status = ern_watermark_code_make(context, key, &code);
  if (status != ERN_OK) return status;
  ERN_TRY(ERN_NEW(context, 1, &made));
  *made = (ern_watermark){.context = context, .width = width, .height = height};
  ERN_TRY(ERN_NEW(context, (size_t)width * (size_t)height, &made->plane));
  ERN_TRY(ERN_NEW(context, (size_t)TILE * TILE, &sums));
  ERN_TRY(ERN_NEW(context, (size_t)TILE * TILE, &tile));
  make_tile(&code, sums, tile);
  fill_plane(tile, made->plane, width, height);
fail:
  ern_release(context, sums);
  ern_release(context, tile);
  if (status != ERN_OK) ern_watermark_free(&made);
  *watermark = made;
  return status;
}

ern_status ern_watermark_put(const ern_watermark *watermark, uint8_t *rgba) {
  if (watermark == NULL) return ERN_E_ARGUMENT;
  ERN_NEED(watermark->context, rgba);
  const size_t pixels = (size_t)watermark->width * (size_t)watermark->height;
  for (size_t i = 0; i < pixels; i++) {
    for (size_t c = 0; c < 3; c++) {
      const int value = rgba[4 * i + c] + watermark->plane[i];
      rgba[4 * i + c] = (uint8_t)(value < 0 ? 0 : value > 255 ? 255 : value);
    }
  }
  return ERN_OK;
}

void ern_watermark_free(ern_watermark **watermark) {
  if (watermark == NULL || *watermark == NULL) return;
  ern_watermark *own = *watermark;
  ern_release(own->context, own->plane);
  ern_release(own->context, own);
  *watermark = NULL;
}
