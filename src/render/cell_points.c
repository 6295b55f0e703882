/* SPDX-License-Identifier: MIT */
#include "render/cell_points.h"

#include "core/status.h"
#include "render/morton.h"

size_t ern_cells_list(uint32_t *cell, const uint8_t *bits) {
  size_t count = 0;
  for (uint32_t number = 0; number < ERN_OCCUPANCY_CELLS; number++)
    if (bits[number >> 3] >> (number & 7) & 1) cell[count++] = number;
  return count;
}

/* Coordinate `axis` of the points. */
static void octant_centres(float *x, const uint32_t *cell, size_t cells, int axis, float bound) {
  for (size_t i = 0; i < cells; i++) {
    const float corner = (float)ern_morton_gather(cell[i] >> axis);
    for (int e = 0; e < ERN_OCTANTS; e++) {
      const float inside = (e >> axis & 1) != 0 ? 0.75f : 0.25f;
      x[i * ERN_OCTANTS + (size_t)e] = ((corner + inside) / (ERN_OCCUPANCY_SIDE / 2) - 1) * bound;
    }
  }
}

ern_status ern_cell_points(struct ern_stream *stream, ern_rows x, const uint32_t *cell, size_t cells, float bound,
                           float *workspace) {
  const size_t n = cells * ERN_OCTANTS;
  ern_status status = ERN_OK;
  for (int axis = 0; axis < 3; axis++) {
    octant_centres(workspace, cell, cells, axis, bound);
    ERN_TRY(stream->backend->upload_reals(stream, ern_span_of_row(x, axis, n), workspace, n));
  }
fail:
  return status;
}

int ern_cell_block(uint32_t block[ERN_CELL_BLOCK], uint32_t number) {
  uint32_t first[3], last[3];
  int count = 0;
  for (int axis = 0; axis < 3; axis++) {
    const uint32_t at = ern_morton_gather(number >> axis);
    first[axis] = at > 0 ? at - 1 : 0;
    last[axis] = at + 1 < ERN_OCCUPANCY_SIDE ? at + 1 : at;
  }
  for (uint32_t z = first[2]; z <= last[2]; z++)
    for (uint32_t y = first[1]; y <= last[1]; y++)
      for (uint32_t x = first[0]; x <= last[0]; x++) block[count++] = ern_morton(x, y, z);
  return count;
}
