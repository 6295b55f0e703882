/* SPDX-License-Identifier: MIT
 * The torso's tiles for any instruction set (simd/isa.h). */
#include "backend_cpu/fused/torso.h"
#include "backend_cpu/simd/gemm_tile.h"
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_math.h"
#include "backend_cpu/simd/lanes_quads.h"
#include "model/torso_ops.h"

/* A band has BANDS rows of blocks; BLOCKS blocks are a tile. Lane 4r + c of a block is its pixel (r, c). */
enum {
  HIDDEN = ERN_TORSO_HIDDEN,
  TERMS = ERN_TORSO_TERMS,
  BANDS = ERN_TORSO_BAND / QUADS,
  BLOCKS = TILE / LANES,
  FEATURES = 2 * ERN_GRID_MAX_LEVELS
};

static void axis_terms(float *terms, const float *bias, const float *weight, const float *encoding, size_t stride,
                       size_t count) {
  for (size_t i = 0; i < count; i += LANES) {
    vf value[ERN_TORSO_AXIS_ROWS];
#pragma GCC unroll 17
    for (size_t c = 0; c < ERN_TORSO_AXIS_ROWS; c++) value[c] = vf_load(encoding + c * stride + i);
    for (size_t j = 0; j < TERMS; j++) {
      vf sum = vf_all(bias[j]);
#pragma GCC unroll 17
      for (size_t c = 0; c < ERN_TORSO_AXIS_ROWS; c++) sum += weight[c * TERMS + j] * value[c];
      float *to[QUADS];
      for (size_t k = 0; k < QUADS; k++) to[k] = terms + ((i / 4 + k) * TERMS + j) * 4;
      vf_store_quads(to, sum);
    }
  }
}

/* Values that the pixels of a row of blocks share. */
struct rows {
  int row[BANDS]; /* first */
  vu cell[BANDS];
  vf weight[BANDS], q[BANDS];
  vf term[BANDS][TERMS];
};

static void rows_fill(struct rows *rows, const struct ern_torso_frame *frame, size_t band) {
  const struct ern_torso_axis *axis = &frame->row;
  for (size_t b = 0; b < BANDS; b++) {
    const size_t first = band * ERN_TORSO_BAND + b * QUADS;
    rows->row[b] = (int)first;
    for (size_t l = 0; l < LANES; l++) {
      rows->cell[b][l] = (uint32_t)axis->cell[first + l / 4];
      rows->weight[b][l] = axis->weight[first + l / 4];
      rows->q[b][l] = axis->q[first + l / 4];
    }
    for (size_t j = 0; j < TERMS; j++) {
      const float *from = axis->terms + (first / 4 * TERMS + j) * 4 + first % 4;
      float *to = (float *)&rows->term[b][j];
      for (size_t l = 0; l < LANES; l++) to[l] = from[l / 4];
    }
  }
}

struct block {
  size_t band, column; /* row of blocks in the band; first column of pixels */
  vi chosen;
};

#define LANE_ROW(l, d) (l) / 4
#define LANE_COLUMN(l, d) (l) % 4

/* The lanes inside the picture in which the occupancy, interpolated as in the reference, is above the threshold. */
static vi choose(const struct ern_torso_frame *frame, const struct rows *rows, size_t band, size_t column) {
  static const vi lane_row = {LANES_EACH(LANE_ROW, 0)}, lane_column = {LANES_EACH(LANE_COLUMN, 0)};
  const vf right = vf_all_quad(frame->column.weight + column), lower = rows->weight[band];
  const vu cell = (vu)vf_all_quad(frame->column.cell + column) * ERN_TORSO_SIDE + rows->cell[band];
  vf side[2];
#pragma GCC unroll 2
  for (uint32_t s = 0; s < 2; s++) {
    const vu at = cell + s * ERN_TORSO_SIDE;
    side[s] = vf_multiply_rounded(1 - lower, vf_gather(frame->occupancy, at)) +
              vf_multiply_rounded(lower, vf_gather(frame->occupancy, at + 1));
  }
  const vf value = vf_multiply_rounded(1 - right, side[0]) + vf_multiply_rounded(right, side[1]);
  return (value > frame->threshold) & (lane_row + rows->row[band] < frame->height) &
         (lane_column + (int32_t)column < frame->width);
}

/* The work memory of a tile; about 30 KiB. */
struct tile {
  float first[TERMS * TILE]; /* first layers without the grid's part; the deformation's after its ReLU */
  float hidden[HIDDEN * TILE];
  float features[FEATURES * TILE];
  float out[4 * TILE];
  vf u[2][BLOCKS];
  vi outside[BLOCKS];
  struct block block[BLOCKS];
  size_t count;
};

static void first_layers(struct tile *tile, const struct ern_torso_frame *frame, const struct rows *rows) {
  const vf *row[BLOCKS];
  const float *column[BLOCKS];
  for (size_t b = 0; b < BLOCKS; b++) {
    row[b] = rows->term[tile->block[b].band];
    column[b] = frame->column.terms + tile->block[b].column * TERMS;
  }
  for (size_t j = 0; j < HIDDEN; j++) {
#pragma GCC unroll 12
    for (size_t b = 0; b < BLOCKS; b++) {
      const vf sum = row[b][j] + vf_all_quad(column[b] + 4 * j);
      vf_store(tile->first + j * TILE + b * LANES, vf_select(sum < 0, (vf){0}, sum));
    }
  }
  for (size_t j = HIDDEN; j < TERMS; j++) {
#pragma GCC unroll 12
    for (size_t b = 0; b < BLOCKS; b++) {
      vf_store(tile->first + j * TILE + b * LANES, row[b][j] + vf_all_quad(column[b] + 4 * j));
    }
  }
}

/* moved = q' of ern_torso_move, where q has row and column. */
LANES_INLINE void move_with_body(vf moved[2], const struct ern_torso_frame *frame, const vf q[2]) {
  enum { SIDE = ERN_MOTION_SIDE };
  vu cell[2];
  vf toward[2];
  for (size_t d = 0; d < 2; d++) {
    const vf at = vf_clamp(q[d] * frame->control + (SIDE - 1) / 2.0f, 0, SIDE - 1);
    const vi whole = __builtin_convertvector(at, vi), last = whole > SIDE - 2;
    cell[d] = (vu)(whole + last);
    toward[d] = at - __builtin_convertvector((vi)cell[d], vf);
  }
  for (uint32_t d = 0; d < 2; d++) {
    const vu at = cell[0] * SIDE + cell[1] + d * SIDE * SIDE;
    vf side[2]; /* in the upper and the lower row of control points */
    for (uint32_t s = 0; s < 2; s++)
      side[s] = (1 - toward[1]) * vf_gather(frame->motion, at + s * SIDE) +
                toward[1] * vf_gather(frame->motion, at + s * SIDE + 1);
    moved[d] = q[d] + ((1 - toward[0]) * side[0] + toward[0] * side[1]);
  }
}

/* u = (clamp(q' + d, -1, 1) + 1)/2, q' being q moved with the body; 0 for NaN. */
static void positions(struct tile *tile, const struct ern_torso_frame *frame, const struct rows *rows) {
  for (size_t b = 0; b < BLOCKS; b++) {
    const vf q[2] = {rows->q[tile->block[b].band], vf_all_quad(frame->column.q + tile->block[b].column)};
    vi outside = {0};
    vf moved[2];
    move_with_body(moved, frame, q);
    for (size_t d = 0; d < 2; d++) {
      const vf x = vf_clamp(moved[d] + vf_load(tile->out + d * TILE + b * LANES), -1, 1);
      outside |= x != x;
      tile->u[d][b] = vf_select(x != x, (vf){0}, (x + 1) * 0.5f);
    }
    tile->outside[b] = outside;
  }
}

/* Cells of a block's pixels at a level: entries, weights of the next row and of the next column. */
struct cells {
  vu entry;
  vi row, column;
  vf lower, later;
};

LANES_INLINE struct cells cells_of(const struct ern_torso_level *level, vf u_row, vf u_column) {
  const vf row = vf_multiply_rounded(u_row, vf_all(level->scale)) + 0.5f;
  const vf column = vf_multiply_rounded(u_column, vf_all(level->scale)) + 0.5f;
  struct cells cells = {.row = __builtin_convertvector(row, vi), .column = __builtin_convertvector(column, vi)};
  cells.lower = row - __builtin_convertvector(cells.row, vf);
  cells.later = column - __builtin_convertvector(cells.column, vf);
  cells.entry = (vu)cells.column * level->column_step + (vu)cells.row;
  return cells;
}

/* value + weight (next - value) */
LANES_INLINE vf between(vf value, vf next, vf weight) { return value + weight * (next - value); }

/* A block's entries stored in memory for scalar loads: extracting them from registers would occupy the shuffle unit. */
struct entries {
  _Alignas(64) uint32_t left[LANES], right[LANES]; /* entry at the cell's row and column, and in the next column */
  vf lower, later;
  bool wraps; /* an entry is the last of its level, which the first follows */
};

LANES_INLINE void find_entries(struct entries *entries, const struct ern_torso_level *level, vf u_row, vf u_column) {
  const struct cells cells = cells_of(level, u_row, u_column);
  const vu left = cells.entry & level->mask, right = (cells.entry + level->column_step) & level->mask;
  memcpy(entries->left, &left, sizeof left);
  memcpy(entries->right, &right, sizeof right);
  entries->lower = cells.lower;
  entries->later = cells.later;
  entries->wraps = vi_any((left == level->mask) | (right == level->mask));
}

/* quad[i], in quad k: [entry][2], [entry + 1][2] of lane 4k + i. */
LANES_INLINE void load_quads(vf quad[4], const float *table, const uint32_t *entry) {
#pragma GCC unroll 4
  for (size_t i = 0; i < 4; i++) {
    const float *at[QUADS];
#pragma GCC unroll 4
    for (size_t k = 0; k < QUADS; k++) at[k] = table + (size_t)entry[4 * k + i] * 2;
    quad[i] = vf_load_quads(at);
  }
}

/* The same where the last entry of the level is followed by its first. */
static __attribute__((noinline)) void load_wrapped(vf quad[4], const struct ern_torso_level *level,
                                                   const uint32_t *entry) {
  for (size_t l = 0; l < LANES; l++) {
    const uint32_t at[2] = {entry[l], (entry[l] + 1) & level->mask};
    for (size_t e = 0; e < 4; e++) quad[l % 4][l / 4 * 4 + e] = level->table[(size_t)at[e / 2] * 2 + e % 2];
  }
}

/* The two features of a level: between columns first, for both rows and both features at once; then between rows. */
LANES_INLINE void look_up(float *feature, const struct ern_torso_level *level, const struct entries *entries) {
  vf quad[4], next[4];
  if (__builtin_expect(entries->wraps, 0)) {
    load_wrapped(quad, level, entries->left);
    load_wrapped(next, level, entries->right);
  } else {
    load_quads(quad, level->table, entries->left);
    load_quads(next, level->table, entries->right);
  }
  quad[0] = between(quad[0], next[0], vf_quad_element(entries->later, 0));
  quad[1] = between(quad[1], next[1], vf_quad_element(entries->later, 1));
  quad[2] = between(quad[2], next[2], vf_quad_element(entries->later, 2));
  quad[3] = between(quad[3], next[3], vf_quad_element(entries->later, 3));
  vf_transpose_quads(quad);
  vf_store(feature, between(quad[0], quad[2], entries->lower));
  vf_store(feature + TILE, between(quad[1], quad[3], entries->lower));
}

/* The same where all cells of a block lie in one window of 4 x 4 entries. */
LANES_INLINE void look_up_window(float *feature, const struct ern_torso_level *level, uint32_t entry, int32_t origin,
                                 vf u_row, vf u_column) {
  const struct cells cells = cells_of(level, u_row, u_column);
  const struct window window = window_load(level->table + (size_t)entry * 2, (size_t)level->column_step * 2);
  const vi at = (cells.column << 3) + (cells.row << 1) - origin;
#pragma GCC unroll 2
  for (int c = 0; c < 2; c++) {
    const vf upper = between(window_at(&window, at + c), window_at(&window, at + (8 + c)), cells.later);
    const vf lower = between(window_at(&window, at + (2 + c)), window_at(&window, at + (10 + c)), cells.later);
    vf_store(feature + (size_t)c * TILE, between(upper, lower, cells.lower));
  }
}

/* A block's window by level: its first entry; 8*column + 2*row of its first cell. Bit l of `fits`: the window holds all
 * cells of level l. */
struct windows {
  _Alignas(64) int32_t entry[ERN_TORSO_LEVELS], origin[ERN_TORSO_LEVELS];
  uint32_t fits;
};

/* Cell indices grow with u, so a block's cells lie between those of its least and its greatest u. */
static void find_windows(struct windows *windows, const struct ern_torso_levels *levels, vf u_row, vf u_column) {
  const float least[2] = {vf_least(u_row), vf_least(u_column)};
  const float greatest[2] = {vf_greatest(u_row), vf_greatest(u_column)};
  windows->fits = 0;
  for (size_t l = 0; l < ERN_TORSO_LEVELS; l += LANES) {
    const vf scale = vf_load(levels->scale + l);
    vi first[2], step, mask, last, fits = {0};
    memcpy(&step, levels->column_step + l, sizeof step);
    memcpy(&mask, levels->mask + l, sizeof mask);
    memcpy(&last, levels->last + l, sizeof last);
    fits = ~fits;
#pragma GCC unroll 2
    for (size_t d = 0; d < 2; d++) {
      first[d] = __builtin_convertvector(vf_multiply_rounded(vf_all(least[d]), scale) + 0.5f, vi);
      fits &= __builtin_convertvector(vf_multiply_rounded(vf_all(greatest[d]), scale) + 0.5f, vi) <= first[d] + 2;
    }
    const vi entry = (vi)((vu)first[1] * (vu)step + (vu)first[0]) & mask, origin = (first[1] << 3) + (first[0] << 1);
    fits &= entry <= last;
    memcpy(windows->entry + l, &entry, sizeof entry);
    memcpy(windows->origin + l, &origin, sizeof origin);
    windows->fits |= vi_bits(fits) << l;
  }
}

/* Computes all addresses first, finest level first, so that loads do not wait for them. */
static __attribute__((noinline)) void encode(struct tile *tile, const struct ern_torso_frame *frame) {
  const size_t levels = (size_t)frame->levels;
  struct windows windows[BLOCKS];
  struct entries entries[ERN_GRID_MAX_LEVELS][BLOCKS];
  for (size_t b = 0; b < BLOCKS; b++) {
    windows[b].fits = 0;
    if (WINDOW_IS_FAST) find_windows(&windows[b], &frame->abreast, tile->u[0][b], tile->u[1][b]);
  }
  for (size_t l = 0; l < levels; l++) {
    const struct ern_torso_level level = frame->level[l];
    for (size_t b = 0; b < BLOCKS; b++)
      if ((windows[b].fits >> l & 1) == 0) find_entries(&entries[l][b], &level, tile->u[0][b], tile->u[1][b]);
  }
  __asm__("" : "+m"(entries));
  for (size_t l = 0; l < levels; l++) {
    const struct ern_torso_level level = frame->level[l];
    float *feature = tile->features + 2 * l * TILE;
    for (size_t b = 0; b < BLOCKS; b++) {
      if (WINDOW_IS_FAST && (windows[b].fits >> l & 1) != 0) {
        look_up_window(feature + b * LANES, &level, (uint32_t)windows[b].entry[l], windows[b].origin[l], tile->u[0][b],
                       tile->u[1][b]);
      } else {
        look_up(feature + b * LANES, &level, &entries[l][b]);
      }
    }
  }
  for (size_t b = 0; b < BLOCKS; b++) {
    if (!vi_any(tile->outside[b])) continue;
    for (size_t c = 0; c < 2 * (size_t)frame->levels; c++) {
      float *feature = tile->features + c * TILE + b * LANES;
      vf_store(feature, vf_select(tile->outside[b], (vf){0}, vf_load(feature)));
    }
  }
}

/* Writes whole blocks of the picture at once; blocks at its right and lower edges pixel by pixel. */
static void composite(const struct tile *tile, const struct ern_torso_frame *frame, const struct rows *rows) {
  for (size_t b = 0; b < tile->count; b++) {
    const struct block *block = &tile->block[b];
    const size_t width = (size_t)frame->width, row = (size_t)rows->row[block->band];
    const size_t at = row * width + block->column;
    const bool whole = block->column + 4 <= width && row + QUADS <= (size_t)frame->height;
    vf layer[4];
    for (size_t c = 0; c < 4; c++) {
      layer[c] = 1.002f * vf_sigmoid(vf_load(tile->out + c * TILE + b * LANES)) - 0.001f;
    }
    for (size_t c = 0; c < 4; c++) {
      if (c == 3 && frame->opacity == NULL) break;
      float *plane = at + (c < 3 ? frame->pixel + c * frame->stride : frame->opacity);
      if (whole) {
        float *to[QUADS];
        for (size_t k = 0; k < QUADS; k++) to[k] = plane + k * width;
        const vf back = vf_load_quads((const float *const *)to);
        const vf value = c < 3 ? layer[0] * layer[c + 1] + (1 - layer[0]) * back : layer[0];
        vf_store_quads(to, vf_select(block->chosen, value, back));
        continue;
      }
      for (size_t l = 0; l < LANES; l++) {
        float *to = plane + l / 4 * width + l % 4;
        const float alpha = layer[0][l];
        if (block->chosen[l]) *to = c < 3 ? alpha * layer[c + 1][l] + (1 - alpha) * *to : alpha;
      }
    }
  }
}

static void tile_run(struct tile *tile, const struct ern_torso_frame *frame, const struct rows *rows) {
  const size_t features = 2 * (size_t)frame->levels;
  float *const first = tile->first + HIDDEN * TILE;
  for (size_t b = tile->count; b < BLOCKS; b++) tile->block[b] = tile->block[0];
  first_layers(tile, frame, rows);
  tile_product(tile->hidden, NULL, frame->deform1, tile->first, HIDDEN, HIDDEN, TILE_RELU);
  tile_product(tile->out, NULL, frame->deform2, tile->hidden, 2, HIDDEN, TILE_STORE);
  positions(tile, frame, rows);
  encode(tile, frame);
  tile_product(first, first, frame->layer0, tile->features, HIDDEN, features, TILE_RELU);
  tile_product(tile->hidden, NULL, frame->layer1, first, HIDDEN, HIDDEN, TILE_RELU);
  tile_product(tile->out, NULL, frame->layer2, tile->hidden, 4, HIDDEN, TILE_STORE);
  composite(tile, frame, rows);
  tile->count = 0;
}

static void draw_band(const struct ern_torso_frame *frame, size_t band) {
  const size_t begin = band * ERN_TORSO_BAND, left = (size_t)frame->height - begin, width = (size_t)frame->width;
  const size_t height = left < ERN_TORSO_BAND ? left : ERN_TORSO_BAND;
  struct rows rows;
  struct tile tile;
  tile.count = 0;
  rows_fill(&rows, frame, band);
  if (frame->opacity != NULL) memset(frame->opacity + begin * width, 0, height * width * sizeof(float));
  for (size_t column = 0; column < width; column += 4) {
    for (size_t b = 0; b * QUADS < height; b++) {
      const vi chosen = choose(frame, &rows, b, column);
      if (!vi_any(chosen)) continue;
      tile.block[tile.count++] = (struct block){b, column, chosen};
      if (tile.count == BLOCKS) tile_run(&tile, frame, &rows);
    }
  }
  if (tile.count > 0) tile_run(&tile, frame, &rows);
}

const struct ern_torso_kernels ERN_ISA(ern_torso_kernels) = {axis_terms, draw_band};
