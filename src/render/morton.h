/* SPDX-License-Identifier: MIT
 * Morton order of the occupancy grid: x in bit 0, y in bit 1, z in bit 2 of each group of three. */
#ifndef ERN_RENDER_MORTON_H
#define ERN_RENDER_MORTON_H

#include <stdint.h>

/* 10 bits of v moved apart so that two zeros lie between neighbours. */
static inline uint32_t ern_morton_spread(uint32_t v) {
  v = (v * 0x00010001u) & 0xFF0000FFu;
  v = (v * 0x00000101u) & 0x0F00F00Fu;
  v = (v * 0x00000011u) & 0xC30C30C3u;
  v = (v * 0x00000005u) & 0x49249249u;
  return v;
}
static inline uint32_t ern_morton(uint32_t x, uint32_t y, uint32_t z) {
  return ern_morton_spread(x) | ern_morton_spread(y) << 1 | ern_morton_spread(z) << 2;
}
/* The inverse of ern_morton_spread: every third bit of m, from bit 0. */
static inline uint32_t ern_morton_gather(uint32_t m) {
  m &= 0x49249249u;
  m = (m ^ (m >> 2)) & 0xC30C30C3u;
  m = (m ^ (m >> 4)) & 0x0F00F00Fu;
  m = (m ^ (m >> 8)) & 0xFF0000FFu;
  m = (m ^ (m >> 16)) & 0x000003FFu;
  return m;
}

#endif
