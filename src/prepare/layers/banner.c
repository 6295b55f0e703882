/* SPDX-License-Identifier: MIT */
#include "prepare/layers/banner.h"

#include <stdlib.h>

#include "core/memory.h"

enum { SIDE = 256, CELL = SIDE / ERN_BANNER_COLUMNS, BAND = SIDE / ERN_BANNER_ROWS, FARTHEST = 32, FEWEST_PAIRS = 10 };

/* Grey values a pixel: less difference than this between two frames is noise and compression. */
enum { NOISE = 4 };

static ern_status make_grey(ern_context *context, const ern_image *image, uint8_t grey[SIDE][SIDE]) {
  ern_image small = {0};
  const ern_status status = ern_image_resize(context, image, SIDE, SIDE, &small);
  if (status != ERN_OK) return status;
  const uint8_t *rgb = small.data;
  for (int k = 0; k < SIDE * SIDE; k++, rgb += 3)
    grey[k / SIDE][k % SIDE] = (uint8_t)((rgb[0] + 2 * rgb[1] + rgb[2]) / 4);
  ern_image_free(context, &small);
  return ERN_OK;
}

/* Sum of absolute differences of a cell with the one `shift` to its right in the second picture. */
static int difference(uint8_t first[SIDE][SIDE], uint8_t second[SIDE][SIDE], int row, int column, int shift) {
  int sum = 0;
  for (int y = row * BAND; y < (row + 1) * BAND; y++)
    for (int x = column * CELL; x < (column + 1) * CELL; x++) sum += abs(first[y][x] - second[y][x + shift]);
  return sum;
}

/* The shift at which a cell matches, if it does so by far better than in its own place; else 0. */
static int shift_of(uint8_t first[SIDE][SIDE], uint8_t second[SIDE][SIDE], int row, int column) {
  const int still = difference(first, second, row, column, 0);
  int best = still, shift = 0;
  if (still < NOISE * CELL * BAND) return 0;
  for (int s = -FARTHEST; s <= FARTHEST; s++) {
    if (column * CELL + s < 0 || (column + 1) * CELL + s > SIDE) continue;
    const int found = difference(first, second, row, column, s);
    if (found < best) best = found, shift = s;
  }
  return best < still / 2 ? shift : 0;
}

ern_status ern_banner_add(struct ern_banner *banner, ern_context *context, const ern_image *first,
                          const ern_image *second) {
  ern_status status = ERN_OK;
  uint8_t(*grey)[SIDE][SIDE] = NULL;
  if (banner->pairs == ERN_BANNER_PAIRS) return ERN_OK;
  ERN_TRY(ERN_NEW(context, 2, &grey));
  ERN_TRY(make_grey(context, first, grey[0]));
  ERN_TRY(make_grey(context, second, grey[1]));
  for (int row = 0; row < ERN_BANNER_ROWS; row++)
    for (int column = 0; column < ERN_BANNER_COLUMNS; column++)
      banner->shift[row][column][banner->pairs] = (int8_t)shift_of(grey[0], grey[1], row, column);
  banner->pairs++;
fail:
  ern_release(context, grey);
  return status;
}

static int by_size(const void *a, const void *b) { return *(const int8_t *)a - *(const int8_t *)b; }

/* Whether a cell moves at one speed, within a quarter, in three of five pairs or more, as the gaps between the words of
 * a banner match anywhere, and would move by half of the picture in the clip: a head that turns does not. */
static bool runs(const int8_t *shift, size_t pairs, size_t frames) {
  int8_t sorted[ERN_BANNER_PAIRS];
  size_t moving = 0, alike = 0;
  for (size_t i = 0; i < pairs; i++)
    if (shift[i] != 0) sorted[moving++] = shift[i];
  if (moving < FEWEST_PAIRS) return false;
  qsort(sorted, moving, 1, by_size);
  const int median = sorted[moving / 2];
  const int apart = abs(median) / 4 > 1 ? abs(median) / 4 : 1;
  for (size_t i = 0; i < moving; i++) alike += abs(sorted[i] - median) <= apart && (sorted[i] < 0) == (median < 0);
  return 5 * alike >= 3 * pairs && (size_t)abs(median) * frames / ERN_BANNER_GAP >= SIDE / 2;
}

bool ern_banner_find(const struct ern_banner *banner, size_t frames, double *top, double *bottom) {
  int bands = 0, first = 0, last = 0;
  for (int row = 0; row < ERN_BANNER_ROWS; row++) {
    int cells = 0;
    for (int column = 0; column < ERN_BANNER_COLUMNS; column++)
      cells += runs(banner->shift[row][column], banner->pairs, frames);
    if (cells < 2) continue;
    if (bands++ == 0) first = row;
    last = row;
  }
  *top = (double)first / ERN_BANNER_ROWS;
  *bottom = (double)(last + 1) / ERN_BANNER_ROWS;
  return bands > 0 && bands <= ERN_BANNER_ROWS / 2; /* more: the camera moves */
}
