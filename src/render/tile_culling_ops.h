/* SPDX-License-Identifier: MIT
 * Finds the blocks of a picture whose rays can meet an occupied cell, and from which distance on: rays that miss the
 * head, and rays before they reach it, then test no cells. */
#ifndef ERN_RENDER_TILE_CULLING_OPS_H
#define ERN_RENDER_TILE_CULLING_OPS_H

#include "core/types.h"

struct ern_view;

enum { ERN_TILE_SIDE = 8 }; /* pixels an edge of a block */

/* Blocks in a row of `pixels`, or in a column; the last one may be cut off. */
static inline size_t ern_tile_count(int pixels) { return ((size_t)pixels + ERN_TILE_SIDE - 1) / ERN_TILE_SIDE; }

/* For each block, row by row (ern_tile_count(width) * ern_tile_count(height) of them): INFINITY where no ray of
 * its pixels has a sample, else a distance before which none has one (ern_march_from_kernel's not_before). It holds for
 * marches whose settings.near is not negative, whatever the other settings; for a view that is not a pinhole camera
 * with usable numbers, it is 0 everywhere. bits: [ERN_OCCUPANCY_BYTES] */
void ern_tile_culling(float *not_before, const uint8_t *bits, const struct ern_view *view, float bound);

#endif
