/* SPDX-License-Identifier: MIT
 * The head's occupancy grid; the reference is occupancy_ref.c. Marks, lists, points, cells and bits equal the
 * reference's bit for bit. The sum over cells is compensated: its rounding errors are added up too.
 *
 * In Morton order (x in bit 0, y in bit 1, z in bit 2 of each group of three) a cube of 2x2x2 cells is contiguous, and
 * so is a block of 4x4x4. */
#pragma OPENCL FP_CONTRACT OFF

enum {
  LAST = 127, /* last cell of an axis */
  CELLS = 1 << 21,
  CUBES = CELLS / 8,
  BLOCKS = CELLS / 64,
  FRUSTUM = 14, /* floats of a camera */
  GROUP = 64  /* ERN_CL_SUM_GROUP */
};

/* Every third bit of m, from bit 0. */
uint gather(uint m) {
  m &= 0x49249249u;
  m = (m ^ (m >> 2)) & 0xC30C30C3u;
  m = (m ^ (m >> 4)) & 0x0F00F00Fu;
  m = (m ^ (m >> 8)) & 0xFF0000FFu;
  return (m ^ (m >> 16)) & 0x000003FFu;
}

/* (2c/127 - 1) bound (127/128) on one axis of cell `number`; reach = bound (127/128) */
float centre_of(uint number, int axis, float reach) {
  return ((float)(2 * (int)gather(number >> axis) - LAST) / (float)LAST) * reach;
}

/* The number of the cube or block before or behind this one on an axis; at the ends the number itself. `bits` are the
 * axis' bits of a number. With ones in the bits between, a carry runs on to the next of them; with zeros, a borrow
 * does. */
uint before(uint number, uint bits) {
  const uint own = number & bits;
  return own == 0 ? number : ((own - 1) & bits) | (number & ~bits);
}
uint behind(uint number, uint bits) {
  const uint own = number & bits;
  return own == bits ? number : (((number | ~bits) + 1) & bits) | (number & ~bits);
}

/* ---- cells that a camera sees ------------------------------------------------------------------------------------ */

float dot_of(global const float *a, float x, float y, float z) { return a[0] * x + a[1] * y + a[2] * z; }

/* Whether a camera sees p: with q = transpose(R)(p - o), whether q2 > 0, |q0| < x q2 + slack, |q1| < y q2 + slack. With
 * reach > 0: whether that may hold for a point in the ball of that radius around p. A camera is [column 0, 1, 2 of its
 * rotation R][origin o][slopes x = cx/f, y = cy/f]. */
int sees(global const float *frustum, float x, float y, float z, float slack, float reach) {
  const float dx = x - frustum[9], dy = y - frustum[10], dz = z - frustum[11];
  const float depth = dot_of(frustum + 6, dx, dy, dz) + reach, wide = slack + reach;
  return (depth > 0) & (fabs(dot_of(frustum, dx, dy, dz)) < frustum[12] * depth + wide) &
         (fabs(dot_of(frustum + 3, dx, dy, dz)) < frustum[13] * depth + wide);
}

#define MARKED (CPU ? 64 : 1) /* cells per work-item: a block, or one cell of it */

/* grid [CELLS] = 0 where one of the cameras sees the cell, else -1. Each camera is first tested against the ball around
 * the block. The outermost centres are 0.65 of its radius `ball` away from the middle, which leaves a margin for
 * rounding. */
kernel void occupancy_mark(SPAN(float, grid), SPAN(const float, frusta), float reach, float slack, float ball,
                           ulong n) {
  OPEN(float, grid);
  OPEN(const float, frusta);
  const uint begin = get_global_id(0) * MARKED, first = begin / 64 * 64, last = first + 63;
  if (begin >= CELLS) return;
  float x[MARKED], y[MARKED], z[MARKED];
  int seen[MARKED];
  for (uint i = 0; i < MARKED; i++) {
    x[i] = centre_of(begin + i, 0, reach);
    y[i] = centre_of(begin + i, 1, reach);
    z[i] = centre_of(begin + i, 2, reach);
    seen[i] = 0;
  }
  const float middle_x = (centre_of(first, 0, reach) + centre_of(last, 0, reach)) / 2,
              middle_y = (centre_of(first, 1, reach) + centre_of(last, 1, reach)) / 2,
              middle_z = (centre_of(first, 2, reach) + centre_of(last, 2, reach)) / 2;
  int least = 0;
  for (ulong k = 0; k < n && least == 0; k++) {
    global const float *frustum = frusta + k * FRUSTUM;
    if (!sees(frustum, middle_x, middle_y, middle_z, slack, ball)) continue;
    least = 1;
    for (uint i = 0; i < MARKED; i++) {
      seen[i] |= sees(frustum, x[i], y[i], z[i], slack, 0);
      least &= seen[i];
    }
  }
  for (uint i = 0; i < MARKED; i++) grid[begin + i] = seen[i] ? 0.0f : -1.0f;
}

/* ---- cells to evaluate ------------------------------------------------------------------------------------------- */

/* Bit k of byte n is cell 8n + k. */
uchar bits_of(int8 truth) {
  const int8 bit = truth & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
  const int4 four = bit.lo | bit.hi;
  const int2 two = four.lo | four.hi;
  return (uchar)(two.lo | two.hi);
}

/* open [CUBES]: a bit for each cell that is not marked */
kernel void occupancy_open(SPAN(uchar, open), SPAN(const float, grid)) {
  OPEN(uchar, open);
  OPEN(const float, grid);
  const uint cube = get_global_id(0);
  if (cube < CUBES) open[cube] = bits_of(vload8(cube, grid) >= 0.0f);
}

/* A bit for each of a block's 64 cells: set for the open cells and the neighbours of open ones. On an axis a cell's
 * number has a low bit of weight `low` and a high one of weight 8*low. Bits are shifted by the difference of the
 * neighbours' numbers; those of the first and the last plane of cells are shifted to and from the adjacent blocks. */
ulong needed(global const uchar *open, uint block) {
  const ulong low_zero[3] = {0x5555555555555555, 0x3333333333333333, 0x0F0F0F0F0F0F0F0F};
  const ulong high_zero[3] = {0x00FF00FF00FF00FF, 0x0000FFFF0000FFFF, 0x00000000FFFFFFFF};
  const ulong own = as_ulong(vload8(block, open));
  ulong all = own;
  for (int axis = 0; axis < 3; axis++) {
    const uint bits = 0x1249u << axis; /* 5 bits: 32 blocks per axis */
    const uint low = 1u << axis, high = 8 * low, back = before(block, bits), on = behind(block, bits);
    const ulong lz = low_zero[axis], hz = high_zero[axis];
    all |= ((own >> low) & lz) | ((own >> (high - low)) & ~lz & hz);
    all |= ((own << low) & ~lz) | ((own << (high - low)) & lz & ~hz);
    if (back != block) all |= (as_ulong(vload8(back, open)) >> (high + low)) & lz & hz;
    if (on != block) all |= (as_ulong(vload8(on, open)) << (high + low)) & ~lz & ~hz;
  }
  return all;
}

/* Whether a block has an occupied cell. */
int is_near(global const uchar *bits, uint block) { return as_ulong(vload8(block, bits)) != 0; }

/* A bit for each of a block's cells: set for those that a refresh evaluates. */
ulong due(global const uchar *open, global const uchar *bits, uint block, uint turn, uint mask) {
  return (block & mask) == turn || is_near(bits, block) ? needed(open, block) : 0;
}

/* count [BLOCKS]: cells of each block that a refresh evaluates */
kernel void occupancy_count(SPAN(int, count), SPAN(const uchar, open), SPAN(const uchar, bits), uint turn, uint mask) {
  OPEN(int, count);
  OPEN(const uchar, open);
  OPEN(const uchar, bits);
  const uint block = get_global_id(0);
  if (block < BLOCKS) count[block] = (int)popcount(due(open, bits, block, turn, mask));
}

/* cells: their numbers, those of a block from first[block] on */
kernel void occupancy_list(SPAN(int, cells), SPAN(const int, first), SPAN(const uchar, open), SPAN(const uchar, bits),
                           uint turn, uint mask) {
  OPEN(int, cells);
  OPEN(const int, first);
  OPEN(const uchar, open);
  OPEN(const uchar, bits);
  const uint block = get_global_id(0);
  if (block >= BLOCKS) return;
  ulong left = due(open, bits, block, turn, mask);
  for (int at = first[block]; left != 0; left &= left - 1) {
    cells[at++] = (int)(64 * block + 63 - (uint)clz(left & -left));
  }
}

/* ---- points to evaluate ------------------------------------------------------------------------------------------ */

/* 2u - 1 for u in [0, 1), made from the upper 24 bits of a word, which are exact in float */
float either_side(uint word) { return 2 * ((float)(word >> 8) * 0x1p-24f) - 1; }

/* x [3] per cell = centre + uniform(-1, 1) half_cell. */
kernel void occupancy_points(ROWS(float, x), SPAN(const int, cells), float reach, float half_cell, ulong seed,
                             ulong step, uint purpose, ulong n) {
  OPEN(float, x);
  OPEN(const int, cells);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const uint number = (uint)cells[i];
  uint word[3];
  random_of_one(word, seed, step, number, purpose);
  x[i] = centre_of(number, 0, reach) + either_side(word[0]) * half_cell;
  x[x_stride + i] = centre_of(number, 1, reach) + either_side(word[1]) * half_cell;
  x[2 * x_stride + i] = centre_of(number, 2, reach) + either_side(word[2]) * half_cell;
}

/* fresh[cells[i]] = sigma[i] */
kernel void occupancy_scatter(SPAN(float, fresh), SPAN(const int, cells), SPAN(const float, sigma), ulong n) {
  OPEN(float, fresh);
  OPEN(const int, cells);
  OPEN(const float, sigma);
  const ulong i = get_global_id(0);
  if (i < n) fresh[cells[i]] = sigma[i];
}

/* ---- refresh ----------------------------------------------------------------------------------------------------- */

/* A compensated sum: its value, and the sum of its rounding errors. */
struct sum8 {
  float8 value, lost;
};
struct sum {
  float value, lost;
};

/* a + b = value + lost, exactly (Knuth's two-sum), where it is finite */
void add8(struct sum8 *a, float8 b) {
  const float8 value = a->value + b, part = value - a->value;
  a->lost += (a->value - (value - part)) + (b - part);
  a->value = value;
}
void add(struct sum *a, struct sum b) {
  const float value = a->value + b.value, part = value - a->value;
  a->lost += b.lost + ((a->value - (value - part)) + (b.value - part));
  a->value = value;
}

/* NaN is never the larger. */
float8 larger(float8 most, float8 other) { return select(most, other, other > most); }

/* max(most, the cells of a cube and their neighbours), in the reference's order. The number of a cell's neighbour on an
 * axis differs in that axis' bit; on one side the neighbour is in the same cube, on the other in the next. */
float8 largest_around(float8 most, global const float *fresh, uint cube) {
  const int8 upper_x = (int8)(0, -1, 0, -1, 0, -1, 0, -1), upper_y = (int8)(0, 0, -1, -1, 0, 0, -1, -1),
             upper_z = (int8)(0, 0, 0, 0, -1, -1, -1, -1);
  const uint bits = 0x9249; /* 6 bits: 64 cubes per axis */
  const float8 own = vload8(cube, fresh), x = own.s10325476, y = own.s23016745, z = own.s45670123;
  const uint back_x = before(cube, bits), on_x = behind(cube, bits), back_y = before(cube, bits << 1),
             on_y = behind(cube, bits << 1), back_z = before(cube, bits << 2), on_z = behind(cube, bits << 2);
  most = larger(most, own);
  /* at the ends of the grid there is no neighbour: a cell's own value instead */
  most = larger(most, select(back_x != cube ? vload8(back_x, fresh).s10325476 : own, x, upper_x));
  most = larger(most, select(x, on_x != cube ? vload8(on_x, fresh).s10325476 : own, upper_x));
  most = larger(most, select(back_y != cube ? vload8(back_y, fresh).s23016745 : own, y, upper_y));
  most = larger(most, select(y, on_y != cube ? vload8(on_y, fresh).s23016745 : own, upper_y));
  most = larger(most, select(back_z != cube ? vload8(back_z, fresh).s45670123 : own, z, upper_z));
  return larger(most, select(z, on_z != cube ? vload8(on_z, fresh).s45670123 : own, upper_z));
}

/* grid = max(decay grid, fresh of the cell and its neighbours) where the cell is not marked; the decay is `near` in
 * blocks with an occupied cell, `far` in others whose turn it is, else 1. part [groups][2]: the sum over a group's
 * cells and its rounding errors; each of the group's GROUP work-items takes `each` consecutive cubes. */
kernel void occupancy_update(SPAN(float, part), SPAN(float, grid), SPAN(const float, fresh), SPAN(const uchar, bits),
                             float near, float far, uint turn, uint mask, uint each) {
  OPEN(float, part);
  OPEN(float, grid);
  OPEN(const float, fresh);
  OPEN(const uchar, bits);
  local struct sum sums[GROUP];
  const uint item = get_local_id(0), begin = get_global_id(0) * each;
  struct sum8 own = {(float8)0.0f, (float8)0.0f};
  for (uint cube = begin; cube < begin + each; cube++) {
    const uint block = cube / 8;
    const float decay = is_near(bits, block) ? near : (block & mask) == turn ? far : 1.0f;
    const float8 was = vload8(cube, grid), now = largest_around(was * decay, fresh, cube);
    const int8 open = was >= 0.0f;
    vstore8(select(was, now, open), cube, grid);
    add8(&own, select((float8)0.0f, now, open));
  }
  float value[8], lost[8];
  vstore8(own.value, 0, value);
  vstore8(own.lost, 0, lost);
  struct sum sum = {value[0], lost[0]};
  for (int k = 1; k < 8; k++) add(&sum, (struct sum){value[k], lost[k]});
  sums[item] = sum;
  for (uint half_of = GROUP / 2; half_of > 0; half_of /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < half_of) {
      struct sum both = sums[item];
      add(&both, sums[item + half_of]);
      sums[item] = both;
    }
  }
  if (item == 0) {
    part[2 * get_group_id(0)] = sums[0].value;
    part[2 * get_group_id(0) + 1] = sums[0].lost;
  }
}

/* bits [CUBES]: grid > threshold */
kernel void occupancy_bits(SPAN(uchar, bits), SPAN(const float, grid), float threshold) {
  OPEN(uchar, bits);
  OPEN(const float, grid);
  const uint byte = get_global_id(0);
  if (byte < CUBES) bits[byte] = bits_of(vload8(byte, grid) > threshold);
}
