/* SPDX-License-Identifier: MIT
 * Multiresolution grids of 1 to 3 dimensions (paper eq. 3-5; Mueller et al. 2022).
 *
 *   u = (x + bound) / (2 bound)      p = u*scale_l + 0.5      cell = floor(p)      t = p - cell
 *   f_l(x) = sum over the 2^dims corners b of prod_d (b_d ? t_d : 1 - t_d) * table[index(cell + b)]
 *
 * Built with DIMS, FEATURES, DIVIDE (1 where the modulo of some level is no power of two) and OWNERS (see
 * grid_bwd_table). A group of 64 items works on one level: neighbouring items take neighbouring samples, and a level's
 * table stays in the cache. Every product is rounded by itself and every sum is taken in the order of the reference, so
 * the results are the reference's to the last bit. */
#pragma OPENCL FP_CONTRACT OFF

#define GROUP 64
#define CORNERS (1 << DIMS)

/* How a level is read: index = (sum or XOR over d of cell_d*multiplier_d) modulo size, multiplier_0 = 1. */
struct level {
  float scale;
  float slope;        /* du/dx * scale */
  uint mask;          /* size - 1 where that is the modulo; all ones where none is needed */
  uint size, offset;  /* entries */
  uint multiplier[2]; /* of dimensions 1, 2: strides of the dense index, 0 for one that does not fit; or primes */
  uint hashed;
};

struct grid {
  struct level level[24];
  float bound;
  uint levels;
};

/* The corners of a sample in a level. */
struct corners {
  uint entry[CORNERS];
  float side[DIMS][2]; /* 1 - t, t */
};

/* x: coordinates of a sample. False where one is outside [-bound, bound] or NaN; the corners are then those of u = 0,
 * so that what is read for them is there. */
bool find_corners(struct corners *at, const float x[DIMS], const struct level *level, float bound) {
  bool inside = true;
  uint term[DIMS][2];
  for (int d = 0; d < DIMS; d++) inside = inside & (x[d] >= -bound) & (x[d] <= bound);
  for (int d = 0; d < DIMS; d++) {
    const float u = inside ? (x[d] + bound) / (2 * bound) : 0;
    const float p = u * level->scale + 0.5f;
    const int cell = (int)p; /* p > 0: floor */
    const float t = p - (float)cell;
    const uint multiplier = d > 0 ? level->multiplier[d - 1] : 1;
    at->side[d][0] = 1 - t;
    at->side[d][1] = t;
    term[d][0] = (uint)cell * multiplier;
    term[d][1] = term[d][0] + multiplier;
  }
  for (int b = 0; b < CORNERS; b++) {
    uint sum = term[0][b & 1], hash = sum;
    for (int d = 1; d < DIMS; d++) {
      sum += term[d][b >> d & 1];
      hash ^= term[d][b >> d & 1];
    }
    const uint index = level->hashed ? hash : sum;
#if DIVIDE
    at->entry[b] = level->offset + index % level->size;
#else
    at->entry[b] = level->offset + (index & level->mask);
#endif
  }
  return inside;
}

/* prod_d side_d, without dimension `skip` */
float corner_weight(const struct corners *at, int b, int skip) {
  float weight = 1;
  for (int d = 0; d < DIMS; d++) weight = d == skip ? weight : weight * at->side[d][b >> d & 1];
  return weight;
}

#define POSITIONS SPAN(const float, x0), SPAN(const float, x1), SPAN(const float, x2)
#define OPEN_POSITIONS     \
  OPEN(const float, x0);   \
  OPEN(const float, x1);   \
  OPEN(const float, x2);   \
  global const float *const x_of[3] = {x0, x1, x2}

/* f: [levels*FEATURES] rows. `blocks` groups a level. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void grid_fwd(ROWS(float, f), POSITIONS, SPAN(const float, table), struct grid grid, uint blocks, ulong n) {
  OPEN(float, f);
  OPEN(const float, table);
  OPEN_POSITIONS;
  const uint l = (uint)get_group_id(0) / blocks;
  const ulong i = (ulong)((uint)get_group_id(0) % blocks) * GROUP + get_local_id(0);
  if (i >= n) return;
  const struct level level = grid.level[l];
  struct corners at;
  float x[DIMS];
  for (int d = 0; d < DIMS; d++) x[d] = x_of[d][i];
  const bool inside = find_corners(&at, x, &level, grid.bound);
  for (int c = 0; c < FEATURES; c++) {
    float sum = 0;
    for (int b = 0; b < CORNERS; b++) sum += corner_weight(&at, b, -1) * table[at.entry[b] * FEATURES + c];
    f[(l * FEATURES + c) * f_stride + i] = inside ? sum : 0;
  }
}

/* dtable[entry][c] += weight * df_c, where each entry has one owner, which walks all samples in their order: no atomics,
 * and the sums are the same on every device. A group stages the corners of GROUP samples in local memory; then each
 * item adds those that it owns. On a CPU a level has one group, whose first item owns all (OWNERS = 1); elsewhere entry
 * e belongs to item e mod OWNERS of the OWNERS/GROUP groups of its level. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void grid_bwd_table(SPAN(float, dtable), ROWS(const float, df), POSITIONS, struct grid grid, ulong n) {
  OPEN(float, dtable);
  OPEN(const float, df);
  OPEN_POSITIONS;
  local uint entries[CORNERS][GROUP];
  local float weights[CORNERS][GROUP], slopes[FEATURES][GROUP];
  const uint item = get_local_id(0), slices = (OWNERS + GROUP - 1) / GROUP;
  const uint l = (uint)get_group_id(0) / slices, owner = (uint)get_group_id(0) % slices * GROUP + item;
  for (ulong first = 0; first < n; first += GROUP) {
    const struct level level = grid.level[l];
    const bool real = first + item < n; /* behind the last sample: that one, with no gradient */
    const ulong i = real ? first + item : n - 1;
    struct corners at;
    float x[DIMS];
    for (int d = 0; d < DIMS; d++) x[d] = x_of[d][i];
    const bool inside = find_corners(&at, x, &level, grid.bound) & real;
    for (int b = 0; b < CORNERS; b++) {
      entries[b][item] = at.entry[b];
      weights[b][item] = corner_weight(&at, b, -1);
    }
    for (int c = 0; c < FEATURES; c++) slopes[c][item] = inside ? df[(l * FEATURES + c) * df_stride + i] : 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (owner < OWNERS) {
      for (uint s = 0; s < GROUP; s++) {
        for (int b = 0; b < CORNERS; b++) {
          if (entries[b][s] % OWNERS != owner) continue;
          for (int c = 0; c < FEATURES; c++)
            dtable[entries[b][s] * FEATURES + c] += weights[b][s] * slopes[c][s];
        }
      }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
  }
}

/* *at += value, whatever others add to it meanwhile */
void add_atomically(volatile global float *at, float value) {
  volatile global uint *bits = (volatile global uint *)at;
  uint before = *bits, found;
  while ((found = atomic_cmpxchg(bits, before, as_uint(as_float(before) + value))) != before) before = found;
}

/* The same by atomics, in any order: fast on a GPU, and a little different on every run. The items of a group take
 * samples far from each other, for neighbours on a ray share their entries and would wait for each other. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void grid_bwd_table_atomic(SPAN(float, dtable), ROWS(const float, df), POSITIONS, struct grid grid, uint blocks,
                           ulong n) {
  OPEN(float, dtable);
  OPEN(const float, df);
  OPEN_POSITIONS;
  const uint l = (uint)get_group_id(0) / blocks;
  const ulong i = get_local_id(0) * blocks + (uint)get_group_id(0) % blocks;
  if (i >= n) return;
  const struct level level = grid.level[l];
  struct corners at;
  float x[DIMS];
  for (int d = 0; d < DIMS; d++) x[d] = x_of[d][i];
  if (!find_corners(&at, x, &level, grid.bound)) return;
  for (int c = 0; c < FEATURES; c++) {
    const float slope = df[(l * FEATURES + c) * df_stride + i];
    if (slope == 0) continue;
    for (int b = 0; b < CORNERS; b++)
      add_atomically(dtable + at.entry[b] * FEATURES + c, corner_weight(&at, b, -1) * slope);
  }
}

/* dx_d += sum over levels of slope_l * sum over corners b of (b_d ? 1 : -1) * weight without d * sum_c df_c
 * table[entry][c]; an item a sample. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void grid_bwd_x(SPAN(float, dx0), SPAN(float, dx1), SPAN(float, dx2), ROWS(const float, df), POSITIONS,
                SPAN(const float, table), struct grid grid, ulong n) {
  OPEN(float, dx0);
  OPEN(float, dx1);
  OPEN(float, dx2);
  OPEN(const float, df);
  OPEN(const float, table);
  OPEN_POSITIONS;
  global float *const dx_of[3] = {dx0, dx1, dx2};
  const ulong i = get_global_id(0);
  if (i >= n) return;
  float x[DIMS], dx[DIMS];
  for (int d = 0; d < DIMS; d++) x[d] = x_of[d][i];
  for (int d = 0; d < DIMS; d++) dx[d] = dx_of[d][i];
  for (uint l = 0; l < grid.levels; l++) {
    const struct level level = grid.level[l];
    struct corners at;
    if (!find_corners(&at, x, &level, grid.bound)) continue;
    float sum[DIMS] = {0};
    for (int b = 0; b < CORNERS; b++) {
      float value = 0;
      for (int c = 0; c < FEATURES; c++)
        value += df[(l * FEATURES + c) * df_stride + i] * table[at.entry[b] * FEATURES + c];
      for (int d = 0; d < DIMS; d++) {
        const float part = corner_weight(&at, b, d) * value;
        sum[d] = (b >> d & 1) != 0 ? sum[d] + part : sum[d] - part;
      }
    }
    for (int d = 0; d < DIMS; d++) dx[d] += sum[d] * level.slope;
  }
  for (int d = 0; d < DIMS; d++) dx_of[d][i] = dx[d];
}
