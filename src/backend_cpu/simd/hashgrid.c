/* SPDX-License-Identifier: MIT
 * The multiresolution grids for any instruction set (simd/isa.h).
 *
 * A register holds one quantity of LANES samples. Sums keep the reference's order and products are rounded separately,
 * so on every instruction set the results are bit-identical to the reference's. */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes.h"
#include "hashgrid/hashgrid_ops.h"

/* Samples whose coordinates are prepared together for all levels. A level's table stays in the cache while its block is
 * processed. */
enum { BLOCK = 1024, DIMS = ERN_GRID_MAX_DIMS, CORNERS = 1 << ERN_GRID_MAX_DIMS };

struct prepared {
  size_t first, count; /* of the samples */
  vf u[DIMS][BLOCK / LANES];
  vi inside[BLOCK / LANES];
};

/* u = (x + bound)/(2 bound); 0 where any coordinate is outside, so that its reads stay inside the table. */
static void prepare(struct prepared *block, const float *const x[DIMS], const struct ern_grid *grid, size_t first,
                    size_t n) {
  const size_t dims = (size_t)grid->dims;
  const vf bound = vf_all(grid->bound);
  block->first = first;
  block->count = n - first < BLOCK ? n - first : BLOCK;
  for (size_t i = 0; i < block->count; i += LANES) {
    const size_t count = block->count - i < LANES ? block->count - i : LANES, at = i / LANES;
    vi inside = (vi){0} == (vi){0};
    vf value[DIMS];
    for (size_t d = 0; d < dims; d++) {
      value[d] = vf_load_partial(x[d] + first + i, count);
      inside &= (value[d] >= -bound) & (value[d] <= bound);
    }
    block->inside[at] = inside;
    for (size_t d = 0; d < dims; d++) {
      block->u[d][at] = vf_select(inside, (value[d] + bound) / (2 * bound), (vf){0});
    }
  }
}

/* How a level is indexed: index = (sum or XOR over d of cell_d*multiplier_d) modulo size. */
struct plan {
  float scale;
  uint32_t multiplier[DIMS]; /* strides of the dense index, 0 for a dimension that does not fit; or primes */
  uint32_t mask;             /* size - 1 for a modulo by a power of two; all ones: no modulo */
  uint32_t size, offset;
  bool hashed, divide; /* divide: the size is not a power of two */
};

/* The dense index needs no modulo: u <= 1 makes cell + 1 <= resolution, so it is below (resolution + 1)^dims <= size.
 */
static struct plan plan_level(const struct ern_grid *grid, int l) {
  static const uint32_t prime[DIMS] = {1, 2654435761u, 805459861u};
  const struct ern_grid_level *level = &grid->level[l];
  struct plan plan = {.scale = level->scale, .mask = UINT32_MAX, .size = level->size, .offset = level->offset};
  uint64_t stride = 1;
  for (int d = 0; d < grid->dims && stride <= level->size; d++) {
    plan.multiplier[d] = (uint32_t)stride;
    stride *= level->resolution + 1;
  }
  if (stride <= level->size) return plan;
  plan.hashed = grid->hashed;
  if (plan.hashed) memcpy(plan.multiplier, prime, sizeof prime);
  plan.divide = (plan.size & (plan.size - 1)) != 0;
  if (!plan.divide) plan.mask = plan.size - 1;
  return plan;
}

LANES_INLINE int corner_count(const int dims) { return dims == 3 ? 8 : dims == 2 ? 4 : 2; }

/* The entries and weights of all corners of LANES samples; t is kept for the gradients. */
struct corners {
  vu entry[CORNERS];
  vf side[DIMS][2]; /* 1 - t, t */
};

LANES_INLINE struct corners find_corners(const struct plan *plan, const struct prepared *block, size_t at,
                                         const int dims, const bool hashed) {
  struct corners corners;
  vu term[DIMS][2];
#pragma GCC unroll 3
  for (int d = 0; d < dims; d++) {
    const vf p = vf_multiply_rounded(block->u[d][at], vf_all(plan->scale)) + 0.5f;
    const vi cell = __builtin_convertvector(p, vi); /* p >= 0: floor */
    const vf t = p - __builtin_convertvector(cell, vf);
    corners.side[d][0] = 1 - t;
    corners.side[d][1] = t;
    term[d][0] = (vu)cell * plan->multiplier[d];
    term[d][1] = term[d][0] + plan->multiplier[d];
  }
#pragma GCC unroll 8
  for (int b = 0; b < corner_count(dims); b++) {
    vu index = term[0][b & 1];
#pragma GCC unroll 3
    for (int d = 1; d < dims; d++) index = hashed ? index ^ term[d][b >> d & 1] : index + term[d][b >> d & 1];
    corners.entry[b] = index & plan->mask;
  }
  if (plan->divide) {
    for (int b = 0; b < corner_count(dims); b++) corners.entry[b] %= plan->size;
  }
#pragma GCC unroll 8
  for (int b = 0; b < corner_count(dims); b++) corners.entry[b] += plan->offset;
  return corners;
}

/* prod_d side_d, without dimension `skip` */
LANES_INLINE vf corner_weight(const struct corners *corners, int b, const int dims, const int skip) {
  vf weight = vf_all(1);
#pragma GCC unroll 3
  for (int d = 0; d < dims; d++) {
    if (d != skip) weight = vf_multiply_rounded(weight, corners->side[d][b >> d & 1]);
  }
  return weight;
}

/* f_c = sum over corners of weight * table[entry][c] */
LANES_INLINE void level_fwd_of(float *rows, size_t stride, const float *table, const struct plan *plan,
                               const struct prepared *block, const int dims, const size_t features, const bool hashed) {
  for (size_t i = 0; i < block->count; i += LANES) {
    const size_t count = block->count - i < LANES ? block->count - i : LANES;
    const struct corners corners = find_corners(plan, block, i / LANES, dims, hashed);
    for (size_t c = 0; c < features; c++) {
      vf sum = {0};
#pragma GCC unroll 8
      for (int b = 0; b < corner_count(dims); b++) {
        const vf value = vf_gather(table, corners.entry[b] * (uint32_t)features + (uint32_t)c);
        sum += vf_multiply_rounded(corner_weight(&corners, b, dims, -1), value);
      }
      sum = vf_select(block->inside[i / LANES], sum, (vf){0});
      vf_store_partial(rows + c * stride + block->first + i, sum, count);
    }
  }
}

/* Outputs of the backward pass; NULL: not wanted. */
struct gradients {
  float *dtable;
  float *const *dx;
  const float *df;
  size_t stride;
};

/* dtable[entry][c] += weight*df_c, sample by sample */
LANES_INLINE void add_to_table(float *dtable, const struct corners *corners, const vf *df, vi inside, size_t count,
                               const int dims, const size_t features) {
  for (size_t c = 0; c < features; c++) {
    vu entry[CORNERS];
    vf part[CORNERS];
#pragma GCC unroll 8
    for (int b = 0; b < corner_count(dims); b++) {
      entry[b] = corners->entry[b] * (uint32_t)features + (uint32_t)c;
      part[b] = vf_multiply_rounded(corner_weight(corners, b, dims, -1), df[c]);
    }
    const uint32_t *at = (const uint32_t *)entry;
    const float *value = (const float *)part;
    for (size_t l = 0; l < count; l++) {
      if (!inside[l]) continue;
#pragma GCC unroll 8
      for (size_t b = 0; b < (size_t)corner_count(dims); b++) dtable[at[b * LANES + l]] += value[b * LANES + l];
    }
  }
}

/* Two neighbouring values of a table, added to at once. */
typedef float two __attribute__((vector_size(8), aligned(4), may_alias));

/* Interleaves the lanes of a and b: first those of the lower halves, then the others. */
LANES_INLINE void interleave(float *to, vf a, vf b) {
#define FIRST(l, d) ((l)&1 ? LANES : 0) + (l) / 2
#define SECOND(l, d) ((l)&1 ? LANES : 0) + LANES / 2 + (l) / 2
  vf_store(to, __builtin_shufflevector(a, b, LANES_EACH(FIRST, 0)));
  vf_store(to + LANES, __builtin_shufflevector(a, b, LANES_EACH(SECOND, 0)));
#undef FIRST
#undef SECOND
}

/* The same for one feature of a dense level in two dimensions, where every sample is inside: the two entries along the
 * first coordinate are contiguous and take one vector addition. Every entry is summed in the same order as before. */
LANES_INLINE void add_to_plane(float *dtable, const struct corners *corners, vf df) {
  vf part[4];
  uint32_t near_entry[LANES] __attribute__((aligned(64))), far_entry[LANES] __attribute__((aligned(64)));
  float near[2 * LANES] __attribute__((aligned(64))), far[2 * LANES] __attribute__((aligned(64)));
#pragma GCC unroll 4
  for (int b = 0; b < 4; b++) part[b] = vf_multiply_rounded(corner_weight(corners, b, 2, -1), df);
  memcpy(near_entry, &corners->entry[0], sizeof near_entry);
  memcpy(far_entry, &corners->entry[2], sizeof far_entry);
  interleave(near, part[0], part[1]);
  interleave(far, part[2], part[3]);
#pragma GCC unroll 16
  for (int l = 0; l < LANES; l++) {
    *(two *)(dtable + near_entry[l]) += *(const two *)(near + 2 * l);
    *(two *)(dtable + far_entry[l]) += *(const two *)(far + 2 * l);
  }
}

/* dx_d += scale/(2 bound) * sum over corners of (b_d ? 1 : -1) * weight without d * sum_c df_c table[entry][c] */
LANES_INLINE void add_to_positions(float *const *dx, size_t at, const struct corners *corners, const vf *df, vi inside,
                                   size_t count, const float *table, float factor, const int dims,
                                   const size_t features) {
  vf sum[DIMS] = {{0}};
#pragma GCC unroll 8
  for (int b = 0; b < corner_count(dims); b++) {
    vf value = {0};
    for (size_t c = 0; c < features; c++) {
      value += vf_multiply_rounded(df[c], vf_gather(table, corners->entry[b] * (uint32_t)features + (uint32_t)c));
    }
#pragma GCC unroll 3
    for (int d = 0; d < dims; d++) {
      const vf part = vf_multiply_rounded(corner_weight(corners, b, dims, d), value);
      sum[d] = (b >> d & 1) != 0 ? sum[d] + part : sum[d] - part;
    }
  }
#pragma GCC unroll 3
  for (int d = 0; d < dims; d++) {
    const vf old = vf_load_partial(dx[d] + at, count);
    const vf gradient = old + vf_multiply_rounded(sum[d], vf_all(factor));
    vf_store_partial(dx[d] + at, vf_select(inside, gradient, old), count);
  }
}

enum { MAX_FEATURES = 64 }; /* the limit of ern_grid_build */

LANES_INLINE void level_bwd_of(const struct gradients *to, const float *table, const struct plan *plan,
                               const struct prepared *block, float factor, const int dims, const size_t features,
                               const bool hashed) {
  /* no modulo between neighbours */
  const bool side_by_side = dims == 2 && features == 1 && !hashed && !plan->divide && plan->mask == UINT32_MAX;
  for (size_t i = 0; i < block->count; i += LANES) {
    const size_t count = block->count - i < LANES ? block->count - i : LANES, at = block->first + i;
    const struct corners corners = find_corners(plan, block, i / LANES, dims, hashed);
    const vi inside = block->inside[i / LANES];
    vf df[MAX_FEATURES];
    for (size_t c = 0; c < features; c++) df[c] = vf_load_partial(to->df + c * to->stride + at, count);
    if (to->dtable != NULL && side_by_side && count == LANES && !vi_any(~inside)) {
      add_to_plane(to->dtable, &corners, df[0]);
    } else if (to->dtable != NULL) {
      add_to_table(to->dtable, &corners, df, inside, count, dims, features);
    }
    if (to->dx[0] != NULL) {
      add_to_positions(to->dx, at, &corners, df, inside, count, table, factor, dims, features);
    }
  }
}

/* The cases that occur in the models get specialised loops. */
#define SPECIALISE(function, dims, features, hashed, ...) \
  do {                                                    \
    if ((dims) == 2 && (features) == 1 && (hashed))       \
      function(__VA_ARGS__, 2, 1, true);                  \
    else if ((dims) == 2 && (features) == 1)              \
      function(__VA_ARGS__, 2, 1, false);                 \
    else if ((dims) == 2 && (features) == 2 && !(hashed)) \
      function(__VA_ARGS__, 2, 2, false);                 \
    else if ((dims) == 2)                                 \
      function(__VA_ARGS__, 2, features, hashed);         \
    else if ((dims) == 3)                                 \
      function(__VA_ARGS__, 3, features, hashed);         \
    else                                                  \
      function(__VA_ARGS__, 1, features, hashed);         \
  } while (0)

void ERN_ISA(ern_grid_fwd)(float *f, size_t stride, const float *const x[DIMS], const float *table,
                           const struct ern_grid *grid, int level_begin, int level_end, size_t n) {
  const size_t features = (size_t)grid->features;
  struct prepared block;
  for (size_t first = 0; first < n; first += BLOCK) {
    prepare(&block, x, grid, first, n);
    for (int l = level_begin; l < level_end; l++) {
      const struct plan plan = plan_level(grid, l);
      float *rows = f + (size_t)l * features * stride;
      SPECIALISE(level_fwd_of, grid->dims, features, plan.hashed, rows, stride, table, &plan, &block);
    }
  }
}

void ERN_ISA(ern_grid_bwd)(float *dtable, float *const dx[DIMS], const float *df, size_t stride,
                           const float *const x[DIMS], const float *table, const struct ern_grid *grid, int level_begin,
                           int level_end, size_t n) {
  const size_t features = (size_t)grid->features;
  struct prepared block;
  for (size_t first = 0; first < n; first += BLOCK) {
    prepare(&block, x, grid, first, n);
    for (int l = level_begin; l < level_end; l++) {
      const struct plan plan = plan_level(grid, l);
      const struct gradients to = {dtable, dx, df + (size_t)l * features * stride, stride};
      const float factor = plan.scale / (2 * grid->bound);
      SPECIALISE(level_bwd_of, grid->dims, features, plan.hashed, &to, table, &plan, &block, factor);
    }
  }
}
