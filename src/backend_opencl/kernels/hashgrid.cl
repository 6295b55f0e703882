/* SPDX-License-Identifier: MIT
 * Multiresolution grids of 1 to 3 dimensions (paper eq. 3-5; Mueller et al. 2022).
 *
 *   u = (x + bound) / (2 bound)      p = u*scale_l + 0.5      cell = floor(p)      t = p - cell
 *   f_l(x) = sum over the 2^dims corners b of prod_d (b_d ? t_d : 1 - t_d) * table[index(cell + b)]
 *
 * Build options: DIMS, FEATURES, INVERSE (1 where multiplication by `inverse` gives exactly the quotient u), DIVIDE (1
 * where the modulo of some level is not a power of two), OWNERS (see grid_bwd_table), GROUP (items of a group), VECTORS
 * (of an item) and FLOAT_ADD (see float_add.cl, which comes before). A group works on one level, so that the level's
 * table stays in the cache. On a CPU an item takes a block of samples, WIDTH at a time; on other devices neighbouring
 * items take neighbouring samples. Products are not fused with sums, and every sum is in the order of the reference, so
 * the results are the reference's to the last bit. */
#pragma OPENCL FP_CONTRACT OFF

#define ITEM (VECTORS * WIDTH) /* samples per item */
#define CORNERS (1 << DIMS)
#define UNROLL _Pragma("unroll")
#define EACH_DIM(d) UNROLL for (int d = 0; d < DIMS; d++)
#define EACH_CORNER(b) UNROLL for (int b = 0; b < CORNERS; b++)
#define EACH_FEATURE(c) for (int c = 0; c < FEATURES; c++)
#define KERNEL kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void

/* table[i] of WIDTH entries */
#if WIDTH == 1
#define GATHER(p, i) ((p)[i])
#elif WIDTH == 4
#define GATHER(p, i) (floatw)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3])
#elif WIDTH == 8
#define GATHER(p, i) \
  (floatw)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3], (p)[i.s4], (p)[i.s5], (p)[i.s6], (p)[i.s7])
#else
#define GATHER(p, i)                                                                                       \
  (floatw)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3], (p)[i.s4], (p)[i.s5], (p)[i.s6], (p)[i.s7], (p)[i.s8], \
         (p)[i.s9], (p)[i.sa], (p)[i.sb], (p)[i.sc], (p)[i.sd], (p)[i.se], (p)[i.sf])
#endif

/* The table index of a cell: index = (sum or XOR over d of cell_d*multiplier_d) modulo size, multiplier_0 = 1. */
struct level {
  float scale;
  float dindex_dx;    /* du/dx * scale */
  uint mask;          /* size - 1 where the modulo is a power of two; all ones where no modulo is needed */
  uint size, offset;  /* entries */
  uint multiplier[2]; /* for dimensions 1, 2: strides of the dense index, 0 where one does not fit; or primes */
  uint hashed;
};

struct grid {
  struct level level[24];
  float bound, inverse; /* 1/(2 bound) */
  uint levels, blocks;  /* blocks of GROUP*ITEM samples, one group each */
};

/* The corners of WIDTH samples in a level. */
struct corners {
  uintw entry[CORNERS];
  floatw side[DIMS][2]; /* 1 - t, t */
};

/* x: coordinates of the samples. Returns which lanes are inside [-bound, bound]. Lanes outside, and NaN, get the
 * corners of u = 0, so that their table entries exist. */
static inline intw find_corners(struct corners *at, const floatw x[DIMS], const struct level *level,
                                const struct grid *grid) {
  intw inside = (intw)(0) == 0;
  uintw term[DIMS][2];
  EACH_DIM(d) inside &= (x[d] >= -grid->bound) & (x[d] <= grid->bound);
  EACH_DIM(d) {
#if INVERSE
    const floatw u = WHERE(inside, (x[d] + grid->bound) * grid->inverse, 0);
#else
    const floatw u = WHERE(inside, (x[d] + grid->bound) / (2 * grid->bound), 0);
#endif
    const floatw p = u * level->scale + 0.5f;
    const intw cell = JOINW(convert_int)(p); /* p > 0: floor */
    const floatw t = p - JOINW(convert_float)(cell);
    const uint multiplier = d > 0 ? level->multiplier[d > 0 ? d - 1 : 0] : 1;
    at->side[d][0] = 1 - t;
    at->side[d][1] = t;
    term[d][0] = JOINW(as_uint)(cell) * multiplier;
    term[d][1] = term[d][0] + multiplier;
  }
  EACH_CORNER(b) {
    uintw sum = term[0][b & 1], hash = sum;
    UNROLL for (int d = 1; d < DIMS; d++) {
      sum += term[d][b >> d & 1];
      hash ^= term[d][b >> d & 1];
    }
    const uintw index = level->hashed ? hash : sum;
#if DIVIDE
    at->entry[b] = level->offset + index % level->size;
#else
    at->entry[b] = level->offset + (index & level->mask);
#endif
  }
  return inside;
}

/* prod_d side_d, without dimension `skip` */
static inline floatw corner_weight(const struct corners *at, int b, int skip) {
  floatw weight = 1;
  EACH_DIM(d) weight = d == skip ? weight : weight * at->side[d][b >> d & 1];
  return weight;
}

#define POSITIONS SPAN(const float, x0), SPAN(const float, x1), SPAN(const float, x2)
#define OPEN_POSITIONS   \
  OPEN(const float, x0); \
  OPEN(const float, x1); \
  OPEN(const float, x2); \
  global const float *const x_of[3] = {x0, x1, x2}

/* f: [levels*FEATURES] rows. */
KERNEL grid_fwd(ROWS(float, f), POSITIONS, SPAN(const float, table), struct grid grid, ulong n) {
  OPEN(float, f);
  OPEN(const float, table);
  OPEN_POSITIONS;
  const uint l = (uint)get_group_id(0) / grid.blocks, block = (uint)get_group_id(0) % grid.blocks;
  const ulong first = ((ulong)block * GROUP + get_local_id(0)) * ITEM, end = min(first + ITEM, n);
  const struct level level = grid.level[l];
  for (ulong i = first; i < end; i += WIDTH) {
    struct corners at;
    floatw x[DIMS];
    EACH_DIM(d) x[d] = loadw_first(x_of[d] + i, n - i);
    const intw inside = find_corners(&at, x, &level, &grid);
    EACH_FEATURE(c) {
      floatw sum = 0;
      EACH_CORNER(b) {
        const uintw place = at.entry[b] * FEATURES + (uint)c;
        sum += corner_weight(&at, b, -1) * GATHER(table, place);
      }
      storew_first(f + (l * FEATURES + c) * f_stride + i, WHERE(inside, sum, 0), n - i);
    }
  }
}

/* dtable[entry][c] += weight * df_c. Each entry has one owner, an item that goes through all samples in order: no
 * atomics, and the sums are the same on every device. */
#if CPU
/* One group per level; its only item owns all entries. */
KERNEL grid_bwd_table(SPAN(float, dtable), ROWS(const float, df), POSITIONS, struct grid grid, ulong n) {
  OPEN(float, dtable);
  OPEN(const float, df);
  OPEN_POSITIONS;
  const uint l = get_group_id(0);
  const struct level level = grid.level[l];
  for (ulong i = 0; i < n; i += WIDTH) {
    const uint count = min((ulong)WIDTH, n - i);
    struct corners at;
    floatw x[DIMS];
    EACH_DIM(d) x[d] = loadw_first(x_of[d] + i, count);
    const intw inside = find_corners(&at, x, &level, &grid);
    EACH_FEATURE(c) {
      const floatw gradient = WHERE(inside, loadw_first(df + (l * FEATURES + c) * df_stride + i, count), 0);
      uint place[CORNERS][WIDTH];
      float part[CORNERS][WIDTH];
      EACH_CORNER(b) {
        STOREW(at.entry[b] * FEATURES + (uint)c, place[b]);
        STOREW(corner_weight(&at, b, -1) * gradient, part[b]);
      }
      for (uint s = 0; s < count; s++)
        EACH_CORNER(b) dtable[place[b][s]] += part[b][s];
    }
  }
}
#else
/* A group stages the corners of GROUP samples in local memory; then each item adds the terms of the entries that it
 * owns. A level has OWNERS items in OWNERS/GROUP groups, and item e mod OWNERS of them owns entry e. */
KERNEL grid_bwd_table(SPAN(float, dtable), ROWS(const float, df), POSITIONS, struct grid grid, ulong n) {
  OPEN(float, dtable);
  OPEN(const float, df);
  OPEN_POSITIONS;
  local uint entries[GROUP][CORNERS];
  local float weights[GROUP][CORNERS], gradients[FEATURES][GROUP];
  const uint item = get_local_id(0), slices = OWNERS / GROUP;
  const uint l = (uint)get_group_id(0) / slices, owner = (uint)get_group_id(0) % slices * GROUP + item;
  const struct level level = grid.level[l];
  for (ulong first = 0; first < n; first += GROUP) {
    const uint count = min((ulong)GROUP, n - first);
    const ulong i = first + min(item, count - 1);
    struct corners at;
    floatw x[DIMS];
    EACH_DIM(d) x[d] = x_of[d][i];
    const intw inside = find_corners(&at, x, &level, &grid);
    EACH_CORNER(b) {
      entries[item][b] = at.entry[b];
      weights[item][b] = corner_weight(&at, b, -1);
    }
    EACH_FEATURE(c) gradients[c][item] = inside ? df[(l * FEATURES + c) * df_stride + i] : 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint s = 0; s < count; s++) {
      EACH_CORNER(b) {
        if (entries[s][b] % OWNERS != owner) continue;
        EACH_FEATURE(c) dtable[entries[s][b] * FEATURES + (uint)c] += weights[s][b] * gradients[c][s];
      }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
  }
}
#endif

/* The same by atomics, in any order: fast on a GPU, and with slightly different rounding on every run. Neighbouring
 * items take samples that are far apart, because neighbouring samples of a ray share entries, for which their items
 * would contend. */
KERNEL grid_bwd_table_atomic(SPAN(float, dtable), ROWS(const float, df), POSITIONS, struct grid grid, ulong n) {
  OPEN(float, dtable);
  OPEN(const float, df);
  OPEN_POSITIONS;
  const uint l = (uint)get_group_id(0) / grid.blocks, block = (uint)get_group_id(0) % grid.blocks;
  const struct level level = grid.level[l];
  for (ulong k = 0; k < VECTORS; k++) {
    const ulong i = ((k * GROUP + get_local_id(0)) * grid.blocks + block) * WIDTH;
    if (i >= n) continue;
    const uint count = min((ulong)WIDTH, n - i);
    struct corners at;
    floatw x[DIMS];
    EACH_DIM(d) x[d] = loadw_first(x_of[d] + i, count);
    const intw inside = find_corners(&at, x, &level, &grid);
    EACH_FEATURE(c) {
      const floatw gradient = WHERE(inside, loadw_first(df + (l * FEATURES + c) * df_stride + i, count), 0);
      EACH_CORNER(b) {
        uint place[WIDTH];
        float part[WIDTH];
        STOREW(at.entry[b] * FEATURES + (uint)c, place);
        STOREW(corner_weight(&at, b, -1) * gradient, part);
        for (uint s = 0; s < count; s++)
          if (part[s] != 0) add_atomically(dtable + place[s], part[s]);
      }
    }
  }
}

/* dx_d += sum over levels of dindex_dx * sum over corners b of (b_d ? 1 : -1) * weight without d * sum_c df_c
 * table[entry][c] */
KERNEL grid_bwd_x(SPAN(float, dx0), SPAN(float, dx1), SPAN(float, dx2), ROWS(const float, df), POSITIONS,
                  SPAN(const float, table), struct grid grid, ulong n) {
  OPEN(float, dx0);
  OPEN(float, dx1);
  OPEN(float, dx2);
  OPEN(const float, df);
  OPEN(const float, table);
  OPEN_POSITIONS;
  global float *const dx_of[3] = {dx0, dx1, dx2};
  const ulong first = get_global_id(0) * ITEM, end = min(first + ITEM, n);
  floatw dx[VECTORS][DIMS];
  for (ulong i = first, v = 0; i < end; i += WIDTH, v++)
    EACH_DIM(d) dx[v][d] = loadw_first(dx_of[d] + i, n - i);
  for (uint l = 0; l < grid.levels; l++) {
    const struct level level = grid.level[l];
    for (ulong i = first, v = 0; i < end; i += WIDTH, v++) {
      struct corners at;
      floatw x[DIMS], sum[DIMS];
      EACH_DIM(d) x[d] = loadw_first(x_of[d] + i, n - i);
      EACH_DIM(d) sum[d] = 0;
      const intw inside = find_corners(&at, x, &level, &grid);
      EACH_CORNER(b) {
        floatw value = 0;
        EACH_FEATURE(c) {
          const uintw place = at.entry[b] * FEATURES + (uint)c;
          value += loadw_first(df + (l * FEATURES + c) * df_stride + i, n - i) * GATHER(table, place);
        }
        EACH_DIM(d) {
          const floatw part = corner_weight(&at, b, d) * value;
          sum[d] = (b >> d & 1) != 0 ? sum[d] + part : sum[d] - part;
        }
      }
      EACH_DIM(d) dx[v][d] = WHERE(inside, dx[v][d] + sum[d] * level.dindex_dx, dx[v][d]);
    }
  }
  for (ulong i = first, v = 0; i < end; i += WIDTH, v++)
    EACH_DIM(d) storew_first(dx_of[d] + i, dx[v][d], n - i);
}
