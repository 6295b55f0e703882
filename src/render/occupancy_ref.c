/* SPDX-License-Identifier: MIT
 * The head's occupancy grid: the cells that a camera sees, their sample points, and the refresh (docs/maths.md,
 * Occupancy). Geometry is in float in every build, so that float and double builds mark the same cells and sample the
 * same points. */
#include <math.h>

#include "core/rng.h"
#include "render/march_ops.h"
#include "render/morton.h"
#include "render/occupancy_ops.h"

static const uint32_t last_cell = ERN_OCCUPANCY_SIDE - 1;

struct cell {
  uint32_t axis[3];
};

static struct cell cell_at(uint32_t number) {
  return (struct cell){{ern_morton_gather(number), ern_morton_gather(number >> 1), ern_morton_gather(number >> 2)}};
}

/* (2c/127 - 1) bound (127/128): cell 0 is centred at -bound + bound/128. */
static float centre_of(uint32_t c, float bound) {
  return ((float)(2 * (int)c - (int)last_cell) / (float)last_cell) * (bound * (127.0f / 128.0f));
}

enum { BLOCK_SIDE = 4, BLOCK_CELLS = ERN_OCCUPANCY_BLOCK };

/* A camera as the test for cells needs it: q = transpose(R)(p - o); q2 > 0, |q0| < x q2 + slack, |q1| < y q2 + slack.
 */
struct frustum {
  float column[3][3], origin[3], slope_x, slope_y, slack;
};

static struct frustum frustum_of(const struct ern_view *view, float bound) {
  struct frustum frustum = {
      .slope_x = view->cx / view->focal, .slope_y = view->cy / view->focal, .slack = 2.0f / ERN_OCCUPANCY_SIDE * bound};
  for (int k = 0; k < 3; k++) {
    frustum.origin[k] = view->pose[4 * k + 3];
    for (int axis = 0; axis < 3; axis++) frustum.column[axis][k] = view->pose[4 * k + axis];
  }
  return frustum;
}

static float dot(const float a[3], float x, float y, float z) { return a[0] * x + a[1] * y + a[2] * z; }

/* Whether a point is in the frustum; with reach > 0, whether the ball of that radius around it may intersect the
 * frustum. */
static int sees(const struct frustum *s, float x, float y, float z, float reach) {
  const float dx = x - s->origin[0], dy = y - s->origin[1], dz = z - s->origin[2];
  const float depth = dot(s->column[2], dx, dy, dz) + reach, slack = s->slack + reach;
  const int before = depth > 0, across = fabsf(dot(s->column[0], dx, dy, dz)) < s->slope_x * depth + slack,
            down = fabsf(dot(s->column[1], dx, dy, dz)) < s->slope_y * depth + slack;
  return before & across & down; /* without a branch */
}

/* grid of the cells [begin, end), all of one block, by views. A clip has thousands of views, and the frustum's border
 * passes through a block for few of them, so the ball around the block is tested first. Where the pose is a rotation,
 * this changes no cell. */
static void mark_block(ern_real *grid, const struct ern_view *views, size_t view_count, float bound, uint32_t begin,
                       uint32_t end) {
  const uint32_t first = begin / BLOCK_CELLS * BLOCK_CELLS;
  float x[BLOCK_CELLS], y[BLOCK_CELLS], z[BLOCK_CELLS];
  int seen[BLOCK_CELLS] = {0};
  for (uint32_t i = 0; i < BLOCK_CELLS; i++) {
    const struct cell cell = cell_at(first + i);
    x[i] = centre_of(cell.axis[0], bound);
    y[i] = centre_of(cell.axis[1], bound);
    z[i] = centre_of(cell.axis[2], bound);
  }
  const int far = BLOCK_CELLS - 1;
  const float middle[3] = {(x[0] + x[far]) / 2, (y[0] + y[far]) / 2, (z[0] + z[far]) / 2};
  /* The outermost centres are 0.65 of this away from the middle, which leaves room for rounding. */
  const float reach = 2.0f / ERN_OCCUPANCY_SIDE * BLOCK_SIDE * bound;
  bool all_seen = false;
  for (size_t k = 0; k < view_count && !all_seen; k++) {
    const struct frustum frustum = frustum_of(&views[k], bound);
    if (!sees(&frustum, middle[0], middle[1], middle[2], reach)) continue;
    int least = 1;
    for (int i = 0; i < BLOCK_CELLS; i++) {
      seen[i] |= sees(&frustum, x[i], y[i], z[i], 0);
      least &= seen[i];
    }
    all_seen = least == 1;
  }
  for (uint32_t number = begin; number < end; number++) grid[number] = seen[number - first] ? 0 : -1;
}

void ERN_REF(ern_occupancy_mark)(ern_real *grid, const struct ern_view *views, size_t view_count, float bound,
                                 uint32_t cell_begin, uint32_t cell_end) {
  for (uint32_t begin = cell_begin; begin < cell_end;) {
    const uint32_t block_end = (begin / BLOCK_CELLS + 1) * BLOCK_CELLS,
                   end = block_end < cell_end ? block_end : cell_end;
    mark_block(grid, views, view_count, bound, begin, end);
    begin = end;
  }
}

/* Numbers of the up to 6 cells that share a face with this one: a coordinate is every third bit of the number. With
 * ones in the bits between, an addition's carry reaches the coordinate's next bit; with zeros, a subtraction's borrow
 * does. */
static int neighbours(uint32_t number_out[6], uint32_t number) {
  const uint32_t x_bits = 0x049249; /* 7 of them */
  int count = 0;
  for (int axis = 0; axis < 3; axis++) {
    const uint32_t bits = x_bits << axis, own = number & bits, rest = number & ~bits;
    if (own != 0) number_out[count++] = ((own - 1) & bits) | rest;
    if (own != bits) number_out[count++] = (((number | ~bits) + 1) & bits) | rest;
  }
  return count;
}

static bool is_needed(const ern_real *grid, uint32_t number) {
  uint32_t beside[6];
  if (grid[number] >= 0) return true;
  const int sides = neighbours(beside, number);
  for (int k = 0; k < sides; k++) {
    if (grid[beside[k]] >= 0) return true;
  }
  return false;
}

size_t ERN_REF(ern_occupancy_list)(int32_t *cells, const ern_real *grid, const uint8_t *bits,
                                   struct ern_occupancy_turn turn) {
  size_t count = 0;
  for (uint32_t block = 0; block < ERN_OCCUPANCY_CELLS / ERN_OCCUPANCY_BLOCK; block++) {
    if (!ern_occupancy_block_due(bits, block, turn)) continue;
    for (uint32_t number = ERN_OCCUPANCY_BLOCK * block; number < ERN_OCCUPANCY_BLOCK * (block + 1); number++) {
      if (is_needed(grid, number)) cells[count++] = (int32_t)number;
    }
  }
  return count;
}

void ERN_REF(ern_occupancy_points)(ern_real *x, size_t stride, const int32_t *cells, float bound, uint64_t seed,
                                   uint64_t step, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const uint32_t number = (uint32_t)cells[i];
    const struct cell cell = cell_at(number);
    const struct ern_random random = ern_random_at(seed, step, number, ERN_RNG_REFRESH_CELL);
    for (size_t axis = 0; axis < 3; axis++) {
      const float uniform = 2 * ern_uniform(random.word[axis]) - 1;
      x[axis * stride + i] = centre_of(cell.axis[axis], bound) + uniform * (bound / ERN_OCCUPANCY_SIDE);
    }
  }
}

/* grid = max(decay grid, max of fresh over the cell and its neighbours), where the cell is not marked. A fresh value
 * that is NaN never wins. */
void ERN_REF(ern_occupancy_update)(ern_real *grid, double *sum, const ern_real *fresh, const uint8_t *bits,
                                   const struct ern_occupancy_decay *decay, uint32_t cell_begin, uint32_t cell_end) {
  *sum = 0;
  for (uint32_t number = cell_begin; number < cell_end; number++) {
    if (!(grid[number] >= 0)) continue;
    uint32_t beside[6];
    const int sides = neighbours(beside, number);
    ern_real most = grid[number] * ern_occupancy_decay_of(bits, number / ERN_OCCUPANCY_BLOCK, decay);
    if (fresh[number] > most) most = fresh[number];
    for (int k = 0; k < sides; k++) {
      if (fresh[beside[k]] > most) most = fresh[beside[k]];
    }
    grid[number] = most;
    *sum += most;
  }
}

void ERN_REF(ern_occupancy_pack)(uint8_t *bits, const ern_real *grid, float threshold, uint32_t byte_begin,
                                 uint32_t byte_end) {
  for (uint32_t byte = byte_begin; byte < byte_end; byte++) {
    unsigned packed = 0;
    for (unsigned bit = 0; bit < 8; bit++) packed |= (unsigned)(grid[8 * byte + bit] > threshold) << bit;
    bits[byte] = (uint8_t)packed;
  }
}
