/* SPDX-License-Identifier: MIT
 * Blocks of 8 x 8 pixels whose rays may meet an occupied cell.
 *
 * With R the 3 x 3 part of the pose and o its origin, the ray of pixel (i, j) is p = o + t R c/|c|, c = (u, v, 1),
 * i + 1/2 = cx + f u. So q = R^-1 (p - o) = t c/|c| gives both u = q_x/q_z and t = |q|, also where R is no rotation.
 * The occupied cells among 4^3, one word of the bits, get a bounding box. The box becomes a centre and half extents in
 * q, and intervals of u, v and t.
 *
 * The march computes p in float. With e = 2^-24: u, v and |c| have relative errors of a few e, so d = R c/|c| is off by
 * less than 16 e |R|, and p by 16 e |R| t + 2 e (|p| + |o|); the cell's number by another 2^-16 of a cell = 2^-22
 * bound. For p in the cube t = |q| <= |R^-1| (|o| + sqrt(3) bound). Boxes that are larger by 32 e (1 + |R| |R^-1|) (|o|
 * + 2 bound) a side contain all these errors (Frobenius norms). This file computes in double, whose errors are
 * negligible. */
#include "render/tile_culling_ops.h"

#include <math.h>

#include "render/render_ops.h"

enum { AXES = 3, LAYERS = 4 /* of cells along an edge of a word */ };

static const double most_condition = 1e4; /* of R; the next is the limit of the other numbers of a usable camera */
static const double most_pixels = 1 << 20;

struct camera {
  double inverse[9], origin[AXES]; /* R^-1 */
  double focal, cx, cy, margin, bound;
  size_t columns, rows; /* blocks */
};

static double norm(const double *m, int count) {
  double sum = 0;
  for (int i = 0; i < count; i++) sum += m[i] * m[i];
  return sqrt(sum);
}

/* False where the camera is not usable. Comparisons are written so that NaN fails them. */
static bool camera_of(struct camera *camera, const struct ern_view *view, float bound) {
  double m[9];
  for (int r = 0; r < AXES; r++) {
    for (int c = 0; c < AXES; c++) m[3 * r + c] = (double)view->pose[4 * r + c];
    camera->origin[r] = (double)view->pose[4 * r + 3];
  }
  const double cofactor[9] = {m[4] * m[8] - m[5] * m[7], m[2] * m[7] - m[1] * m[8], m[1] * m[5] - m[2] * m[4],
                              m[5] * m[6] - m[3] * m[8], m[0] * m[8] - m[2] * m[6], m[2] * m[3] - m[0] * m[5],
                              m[3] * m[7] - m[4] * m[6], m[1] * m[6] - m[0] * m[7], m[0] * m[4] - m[1] * m[3]};
  const double determinant = m[0] * cofactor[0] + m[1] * cofactor[3] + m[2] * cofactor[6];
  for (int i = 0; i < 9; i++) camera->inverse[i] = cofactor[i] / determinant;
  const double condition = norm(m, 9) * norm(camera->inverse, 9), away = norm(camera->origin, AXES);
  camera->focal = (double)view->focal, camera->cx = (double)view->cx, camera->cy = (double)view->cy;
  camera->bound = (double)bound;
  camera->margin = 32 * 0x1p-24 * (1 + condition) * (away + 2 * camera->bound);
  camera->columns = ern_tile_count(view->width), camera->rows = ern_tile_count(view->height);
  const double size = norm(m, 9);
  return condition < most_condition && size > 1e-6 && size < 1e6 && away < 1e6 && bound > 1e-6f && bound < 1e6f &&
         camera->focal > 1e-6 && camera->focal < 1e9 && fabs(camera->cx) < most_pixels &&
         fabs(camera->cy) < most_pixels && view->width <= (int)most_pixels && view->height <= (int)most_pixels;
}

/* Of a word's 64 cells, those in layer k = 0..3 of an axis: their numbers have bit 0 of k in bit `axis`, bit 1 in bit
 * axis + 3. */
static uint64_t layer_mask(int axis, int k) {
  static const uint64_t clear[6] = {0x5555555555555555, 0x3333333333333333, 0x0f0f0f0f0f0f0f0f,
                                    0x00ff00ff00ff00ff, 0x0000ffff0000ffff, 0x00000000ffffffff};
  return ((k & 1) != 0 ? ~clear[axis] : clear[axis]) & ((k & 2) != 0 ? ~clear[axis + 3] : clear[axis + 3]);
}

struct box {
  double centre[AXES], half[AXES];
};

/* The bounding box of the cells of a word that a march can reach. In y a march leaves the box [-bound/2, bound/2] only
 * by rounding, into cells 31 and 96. `at`: the first cell. */
static bool box_of(struct box *box, uint64_t word, const int at[AXES], const struct camera *camera) {
  enum { LOW = ERN_OCCUPANCY_SIDE / 4 - 1, HIGH = 3 * ERN_OCCUPANCY_SIDE / 4 };
  for (int k = 0; k < LAYERS; k++) {
    if (at[1] + k < LOW || at[1] + k > HIGH) word &= ~layer_mask(1, k);
  }
  if (word == 0) return false;
  for (int axis = 0; axis < AXES; axis++) {
    int first = 0, last = LAYERS - 1;
    while ((word & layer_mask(axis, first)) == 0) first++;
    while ((word & layer_mask(axis, last)) == 0) last--;
    double low = (at[axis] + first) / (ERN_OCCUPANCY_SIDE / 2.0) - 1;
    double high = (at[axis] + last + 1) / (ERN_OCCUPANCY_SIDE / 2.0) - 1;
    if (axis == 1) low = fmax(low, -0.5), high = fmin(high, 0.5);
    box->centre[axis] = (low + high) / 2 * camera->bound;
    box->half[axis] = (high - low) / 2 * camera->bound + camera->margin;
  }
  return true;
}

/* Blocks [first, last] of the pixels with u (or v) in [low, high]; false where there are none. */
static bool blocks_of(size_t *first, size_t *last, double low, double high, double focal, double centre, size_t count) {
  const double from = floor((centre + focal * low - 0.5) / ERN_TILE_SIDE - 1e-6);
  const double to = floor((centre + focal * high - 0.5) / ERN_TILE_SIDE + 1e-6);
  if (to < 0 || from >= (double)count) return false;
  *first = from > 0 ? (size_t)from : 0;
  *last = to < (double)(count - 1) ? (size_t)to : count - 1;
  return true;
}

/* The smallest and the largest a/z for a in [centre - half, centre + half], z in [z_low, z_high], z_low > 0. */
static void quotients(double *low, double *high, double centre, double half, double z_low, double z_high) {
  const double least = centre - half, most = centre + half;
  *low = least / (least > 0 ? z_high : z_low);
  *high = most / (most > 0 ? z_low : z_high);
}

/* Lowers the distances of the blocks that may see the box; where all blocks may, lowers only *everywhere. */
static void box_show(float *not_before, float *everywhere, const struct box *box, const struct camera *camera) {
  double q[AXES], half[AXES], nearest[AXES];
  for (int r = 0; r < AXES; r++) {
    const double *row = &camera->inverse[3 * r];
    q[r] = half[r] = 0;
    for (int c = 0; c < AXES; c++) {
      q[r] += row[c] * (box->centre[c] - camera->origin[c]);
      half[r] += fabs(row[c]) * box->half[c];
    }
    nearest[r] = fmax(fabs(q[r]) - half[r], 0);
  }
  const double z_low = q[2] - half[2], z_high = q[2] + half[2];
  if (z_high < 0) return;                                        /* behind the camera */
  const float least = (float)(norm(nearest, AXES) * (1 - 1e-6)); /* rounded down */
  size_t left = 0, right = camera->columns - 1, top = 0, bottom = camera->rows - 1;
  if (z_low > 0) {
    double low, high;
    quotients(&low, &high, q[0], half[0], z_low, z_high);
    if (!blocks_of(&left, &right, low, high, camera->focal, camera->cx, camera->columns)) return;
    quotients(&low, &high, q[1], half[1], z_low, z_high);
    if (!blocks_of(&top, &bottom, low, high, camera->focal, camera->cy, camera->rows)) return;
  }
  if (right - left + 1 == camera->columns && bottom - top + 1 == camera->rows) {
    if (least < *everywhere) *everywhere = least;
    return;
  }
  for (size_t y = top; y <= bottom; y++) {
    float *row = not_before + y * camera->columns;
    for (size_t x = left; x <= right; x++) row[x] = row[x] < least ? row[x] : least;
  }
}

/* The word of cells 64 n to 64 n + 63, cell k in bit k. */
static uint64_t word_at(const uint8_t *bits, size_t n) {
  uint64_t word = 0;
  for (size_t k = 0; k < 8; k++) word |= (uint64_t)bits[8 * n + k] << 8 * k;
  return word;
}

/* First cell of a word along an axis: every third bit of its number, times the cells of its edge. */
static int cell_of(size_t n) {
  int cell = 0;
  for (int k = 0; k < 5; k++) cell |= (int)(n >> 3 * k & 1) << k;
  return LAYERS * cell;
}

void ern_tile_culling(float *not_before, const uint8_t *bits, const struct ern_view *view, float bound) {
  struct camera camera;
  const bool known = camera_of(&camera, view, bound);
  const size_t count = camera.columns * camera.rows;
  for (size_t i = 0; i < count; i++) not_before[i] = known ? INFINITY : 0;
  if (!known || count == 0) return;
  float everywhere = INFINITY;
  for (size_t n = 0; n < ERN_OCCUPANCY_BYTES / 8; n++) {
    const uint64_t word = word_at(bits, n);
    if (word == 0) continue;
    const int at[AXES] = {cell_of(n), cell_of(n >> 1), cell_of(n >> 2)};
    struct box box;
    if (box_of(&box, word, at, &camera)) box_show(not_before, &everywhere, &box, &camera);
  }
  for (size_t i = 0; i < count; i++) not_before[i] = not_before[i] < everywhere ? not_before[i] : everywhere;
}
