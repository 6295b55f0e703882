/* SPDX-License-Identifier: MIT
 * Occupied cells as a list, and points inside them. */
#ifndef ERN_RENDER_CELL_POINTS_H
#define ERN_RENDER_CELL_POINTS_H

#include "core/backend.h"

enum { ERN_OCTANTS = 8, ERN_CELL_BLOCK = 27 };

/* The cells whose bits are set, ascending; cell has room for ERN_OCCUPANCY_CELLS. Returns how many. */
size_t ern_cells_list(uint32_t *cell, const uint8_t *bits);

/* x: [3] per point <- the centres of the cells' octants, ERN_OCTANTS a cell. workspace: [cells * ERN_OCTANTS], on the
 * host. */
ERN_NODISCARD ern_status ern_cell_points(struct ern_stream *stream, ern_rows x, const uint32_t *cell, size_t cells,
                                         float bound, float *workspace);

/* A cell and those that touch it, also at an edge or a corner. Returns how many lie in the grid. */
int ern_cell_block(uint32_t block[ERN_CELL_BLOCK], uint32_t number);

#endif
