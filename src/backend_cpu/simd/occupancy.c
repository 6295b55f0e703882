/* SPDX-License-Identifier: MIT
 * Points, refresh and bits of the head's occupancy grid for any instruction set (simd/isa.h). Points, cells and bits
 * are bit-identical to the reference's; the sum over cells adds the same doubles in another order. */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_block.h"
#include "backend_cpu/simd/lanes_double.h"
#include "backend_cpu/simd/lanes_random.h"
#include "render/occupancy_ops.h"

/* ---- points ---- */

/* Extracts every third bit, from bit 0 (the inverse of ern_morton_spread). */
LANES_INLINE vu gather_bits(vu m) {
  m &= 0x49249249u;
  m = (m ^ (m >> 2)) & 0xC30C30C3u;
  m = (m ^ (m >> 4)) & 0x0F00F00Fu;
  m = (m ^ (m >> 8)) & 0xFF0000FFu;
  return (m ^ (m >> 16)) & 0x000003FFu;
}

void ERN_ISA(ern_occupancy_points)(float *x, size_t stride, const int32_t *cells, float bound, uint64_t seed,
                                   uint64_t step, size_t n) {
  const int last = ERN_OCCUPANCY_SIDE - 1;
  const vf reach = vf_all(bound * (127.0f / 128.0f)), half_cell = vf_all(bound / ERN_OCCUPANCY_SIDE);
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    const vu number = (vu)vf_load_partial((const float *)(const void *)(cells + i), count);
    const struct vu_random random = vu_random_at(seed, step, number, ERN_RNG_REFRESH_CELL);
    for (size_t axis = 0; axis < 3; axis++) {
      const vi from_middle = 2 * (vi)gather_bits(number >> (int)axis) - last;
      const vf centre = vf_multiply_rounded(__builtin_convertvector(from_middle, vf) / (float)last, reach);
      const vf offset = vf_multiply_rounded(2 * vu_uniform(random.word[axis]) - 1, half_cell);
      vf_store_partial(x + axis * stride + i, centre + offset, count);
    }
  }
}

/* ---- refresh ----
 *
 * In Morton order 2x2x2 cells lie together, with the bits of x, y and z in the number of a lane. A cell's neighbour
 * along an axis is beside it in its own block on one side, and in the next block on the other; either way the lane
 * whose number differs in that axis' bit. */

LANES_INLINE vb flipped(vb x, int axis) {
  switch (axis) {
    case 0: return __builtin_shufflevector(x, x, 1, 0, 3, 2, 5, 4, 7, 6);
    case 1: return __builtin_shufflevector(x, x, 2, 3, 0, 1, 6, 7, 4, 5);
    default: return __builtin_shufflevector(x, x, 4, 5, 6, 7, 0, 1, 2, 3);
  }
}

/* For each cell of a block, the maximum of it and its neighbours. */
LANES_INLINE vb largest_around(const float *fresh, uint32_t block) {
  static const vbi upper[3] = {
      {0, -1, 0, -1, 0, -1, 0, -1}, {0, 0, -1, -1, 0, 0, -1, -1}, {0, 0, 0, 0, -1, -1, -1, -1}};
  const uint32_t x_bits = 0x009249; /* 6 of them: blocks an axis are 64 */
  const vb nothing = (vb){0} - INFINITY;
  const vb own = vb_larger(*(const vb_anywhere *)(fresh + (size_t)block * BLOCK), nothing);
  vb most = own;
  for (int axis = 0; axis < 3; axis++) {
    const uint32_t bits = x_bits << axis, at = block & bits, rest = block & ~bits;
    vb below = nothing, above = nothing;
    if (at != 0) below = *(const vb_anywhere *)(fresh + (size_t)(((at - 1) & bits) | rest) * BLOCK);
    if (at != bits) above = *(const vb_anywhere *)(fresh + (size_t)((((block | ~bits) + 1) & bits) | rest) * BLOCK);
    most = vb_larger(flipped(vb_larger(vb_select(upper[axis], below, above), own), axis), most);
  }
  return most;
}

/* Updates whole blocks from cell `begin` on. summand: their new values, 0 for marked cells. */
static void update_blocks(float *grid, const float *fresh, const uint8_t *bits, const struct ern_occupancy_decay *decay,
                          uint32_t begin, uint32_t end, float *summand) {
  float left = 1;
  for (uint32_t cell = begin; cell < end; cell += BLOCK) {
    if (cell == begin || cell % ERN_OCCUPANCY_BLOCK == 0)
      left = ern_occupancy_decay_of(bits, cell / ERN_OCCUPANCY_BLOCK, decay);
    vb_anywhere *const cells = (vb_anywhere *)(grid + cell);
    const vb was = *cells;
    const vb now = vb_larger(largest_around(fresh, cell / BLOCK), was * left);
    *cells = vb_select(was >= 0, now, was);
    *(vb_anywhere *)(summand + (cell - begin)) = vb_select(was >= 0, now, (vb){0});
  }
}

enum { CHUNK = 64 * BLOCK /* cells summed at a time */ };

void ERN_ISA(ern_occupancy_update)(float *grid, double *sum, const float *fresh, const uint8_t *bits,
                                   const struct ern_occupancy_decay *decay, uint32_t cell_begin, uint32_t cell_end) {
  const uint32_t first = (cell_begin + BLOCK - 1) / BLOCK * BLOCK, last = cell_end / BLOCK * BLOCK;
  if (first >= last) {
    ern_occupancy_update_ref(grid, sum, fresh, bits, decay, cell_begin, cell_end);
    return;
  }
  double head = 0, tail = 0;
  struct vd_pair middle = {{{0}}};
  ern_occupancy_update_ref(grid, &head, fresh, bits, decay, cell_begin, first);
  for (uint32_t begin = first; begin < last; begin += CHUNK) {
    const uint32_t end = last - begin < CHUNK ? last : begin + CHUNK;
    float summand[CHUNK];
    update_blocks(grid, fresh, bits, decay, begin, end, summand);
    for (size_t i = 0; i < end - begin; i += LANES)
      vd_add(&middle, vf_load_partial(summand + i, end - begin - i < LANES ? end - begin - i : LANES));
  }
  ern_occupancy_update_ref(grid, &tail, fresh, bits, decay, last, cell_end);
  *sum = head + vd_total(middle) + tail;
}

/* ---- bits ---- */

void ERN_ISA(ern_occupancy_pack)(uint8_t *bits, const float *grid, float threshold, uint32_t byte_begin,
                                 uint32_t byte_end) {
  enum { BYTES = LANES > 8 ? LANES / 8 : 1, CELLS = 8 * BYTES };
  uint32_t byte = byte_begin;
  for (; byte + BYTES <= byte_end; byte += BYTES) {
    uint32_t packed = 0;
    for (size_t i = 0; i < CELLS; i += LANES) packed |= vi_bits(vf_load(grid + 8 * (size_t)byte + i) > threshold) << i;
    for (uint32_t k = 0; k < BYTES; k++) bits[byte + k] = (uint8_t)(packed >> 8 * k);
  }
  if (byte < byte_end) ern_occupancy_pack_ref(bits, grid, threshold, byte, byte_end);
}
