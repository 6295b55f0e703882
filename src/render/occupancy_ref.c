/* SPDX-License-Identifier: MIT
 * The head's occupancy grid: which cells a camera sees, where to look at them, and its refresh (model.md section 5).
 * Geometry is in float in every build, so that float and double mark and look at the same cells and points. */
#include <math.h>

#include "core/rng.h"
#include "render/morton.h"
#include "render/render_kernels.h"

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

/* Camera coordinates q = transpose(R)(p - o). Seen: q2 > 0, |q0| < cx/f q2 + 2/128 bound, |q1| < cy/f q2 + 2/128 bound.
 */
static bool view_sees(const struct ern_view *view, const float p[3], float bound) {
  float q[3] = {0, 0, 0};
  for (size_t k = 0; k < 3; k++) {
    const float from_camera = p[k] - view->pose[4 * k + 3];
    for (size_t axis = 0; axis < 3; axis++) q[axis] += view->pose[4 * k + axis] * from_camera;
  }
  const float slack = 2.0f / ERN_OCCUPANCY_SIDE * bound;
  return q[2] > 0 && fabsf(q[0]) < view->cx / view->focal * q[2] + slack &&
         fabsf(q[1]) < view->cy / view->focal * q[2] + slack;
}

void ERN_REF(ern_occupancy_mark)(ern_real *grid, const struct ern_view *views, size_t view_count, float bound,
                                 uint32_t cell_begin, uint32_t cell_end) {
  for (uint32_t number = cell_begin; number < cell_end; number++) {
    const struct cell cell = cell_at(number);
    const float p[3] = {centre_of(cell.axis[0], bound), centre_of(cell.axis[1], bound), centre_of(cell.axis[2], bound)};
    bool seen = false;
    for (size_t k = 0; k < view_count && !seen; k++) seen = view_sees(&views[k], p, bound);
    grid[number] = seen ? 0 : -1;
  }
}

/* Numbers of the up to 6 cells that share a face with this one. */
static int neighbours(uint32_t number_out[6], uint32_t number) {
  const struct cell cell = cell_at(number);
  int count = 0;
  for (int axis = 0; axis < 3; axis++) {
    for (int side = 0; side < 2; side++) {
      if (cell.axis[axis] == (side ? last_cell : 0)) continue;
      struct cell other = cell;
      other.axis[axis] += side ? 1u : (uint32_t)-1;
      number_out[count++] = ern_morton(other.axis[0], other.axis[1], other.axis[2]);
    }
  }
  return count;
}

size_t ERN_REF(ern_occupancy_list)(int32_t *cells, const ern_real *grid) {
  size_t count = 0;
  for (uint32_t number = 0; number < ERN_OCCUPANCY_CELLS; number++) {
    bool needed = grid[number] >= 0;
    if (!needed) {
      uint32_t beside[6];
      const int sides = neighbours(beside, number);
      for (int k = 0; k < sides && !needed; k++) needed = grid[beside[k]] >= 0;
    }
    if (needed) cells[count++] = (int32_t)number;
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
void ERN_REF(ern_occupancy_update)(ern_real *grid, double *sum, const ern_real *fresh, float decay, uint32_t cell_begin,
                                   uint32_t cell_end) {
  *sum = 0;
  for (uint32_t number = cell_begin; number < cell_end; number++) {
    if (!(grid[number] >= 0)) continue;
    uint32_t beside[6];
    const int sides = neighbours(beside, number);
    ern_real most = grid[number] * decay;
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
