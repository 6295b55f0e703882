/* SPDX-License-Identifier: MIT
 * Fully connected stacks without biases, ReLU between layers: h_0 = x, h_{l+1} = relu(W_l h_l), y = W_last h_last.
 *
 * A work-group takes a tile of samples through all layers. Values are in local memory, [channel][sample of the tile].
 * On a CPU a work-item computes whole columns, those of its own samples. On a GPU SHARE items share a column: each
 * computes its part of a layer's rows, because one item a column leaves too few for the latency of the memory. Weights
 * are staged in local memory on a GPU and read from the caches on a CPU. TENSOR: a warp computes strips of 16 rows by
 * tensor cores (tensor.cl), and reads the weights from the caches.
 *
 * Built for one stack, by the options of mlp.c:
 *   LAYERS, HIDDEN = LAYERS - 1; C0 .. widths; A0 .. offset of each W from the first W
 *   R0 .. R3 rows of the input's pieces (0: no such piece), P0 .. P3 their kinds: 0 per sample, 1 per ray, 2 per batch
 *   GROUP work-items, SHARE for each VECTORS vectors of LANES samples
 *   forward: EVEN, ODD the most channels of the two tiles between which the layers alternate
 *   backward: V0 .. first channel of each layer's values, V<LAYERS> of the output's gradient, VALUES channels in all
 *     TURNED vectors of the longest row of weights
 *     D0 .. D3 whether a piece's gradient is wanted; all wanted ones are in the DX_ROWS input channels from DX_FROM on
 *     PART floats hold the sums of one part of the samples: dW_l at G<l>, in rows of E<l> floats, and the gradient rows
 *       of a per-batch piece at B0 .. B3, LANES floats each */
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define COLUMNS (GROUP / SHARE)
#define TILE (COLUMNS * VECTORS * LANES) /* samples */
#if SHARE == 1
#define COLUMN(item) (item)
#define PART_OF(item) 0
#else
#define COLUMN(item) ((item) % COLUMNS)
#define PART_OF(item) ((item) / COLUMNS) /* which of the items that share the column */
#endif

#if LANES == 1
typedef float vf;
#define LOAD(from) (*(from))
#define STORE(value, to) (*(to) = (value))
#else
typedef JOIN(float, LANES) vf;
#define LOAD(from) JOIN(vload, LANES)(0, from)
#define STORE(value, to) JOIN(vstore, LANES)(value, 0, to)
#endif

/* A row of a tile is LINE vectors: on a GPU one more than needed, so that a column is spread over the memory banks, and
 * four more where tensor cores read fragments.
 * BLOCK rows x VECTORS sums are computed at a time, those of an item in registers: 8 x 3 where there are 32 registers,
 * 4 x 3 where there are 16. */
#if CPU
#define LINE VECTORS
#define BLOCK (LANES == 8 ? 4 : 8)
#define WAIT
#elif TENSOR
#define LINE (COLUMNS + 4)
#define WAIT barrier(CLK_LOCAL_MEM_FENCE);
#else
#define LINE (COLUMNS * VECTORS + 1)
#define BLOCK 32
#define CHUNK 32                           /* terms whose weights are staged at a time */
#define ROUND_UP(count) (((count) + 3) / 4 * 4) /* vector loads are aligned */
#define STAGE_ROW (SHARE * ROUND_UP(BLOCK / SHARE + 1)) /* room for one row more than a block */
#define STAGE , local float *stage
#define STAGED , stage
#define STAGE_MEMORY local float stage[CHUNK * STAGE_ROW] __attribute__((aligned(16)));
#define WAIT barrier(CLK_LOCAL_MEM_FENCE);
#endif
#if CPU || TENSOR
#define STAGE
#define STAGED
#define STAGE_MEMORY
#endif
/* Rows after the last full block; a single one is added to that block where there are registers for it. */
#define REST(rows) ((rows) % BLOCK == 1 && (rows) > BLOCK && BLOCK != 4 ? BLOCK + 1 : (rows) % BLOCK)

/* UP_n, DOWN_n: DO(l, l + 1) for the first n layers, in ascending and in descending order. */
#define UP_0(DO)
#define UP_1(DO) DO(0, 1)
#define UP_2(DO) UP_1(DO) DO(1, 2)
#define UP_3(DO) UP_2(DO) DO(2, 3)
#define UP_4(DO) UP_3(DO) DO(3, 4)
#define UP_5(DO) UP_4(DO) DO(4, 5)
#define UP_6(DO) UP_5(DO) DO(5, 6)
#define UP_7(DO) UP_6(DO) DO(6, 7)
#define UP_8(DO) UP_7(DO) DO(7, 8)
#define UP_9(DO) UP_8(DO) DO(8, 9)
#define DOWN_1(DO) DO(0, 1)
#define DOWN_2(DO) DO(1, 2) DOWN_1(DO)
#define DOWN_3(DO) DO(2, 3) DOWN_2(DO)
#define DOWN_4(DO) DO(3, 4) DOWN_3(DO)
#define DOWN_5(DO) DO(4, 5) DOWN_4(DO)
#define DOWN_6(DO) DO(5, 6) DOWN_5(DO)
#define DOWN_7(DO) DO(6, 7) DOWN_6(DO)
#define DOWN_8(DO) DO(7, 8) DOWN_7(DO)
#define DOWN_9(DO) DO(8, 9) DOWN_8(DO)
#define EACH_PIECE(DO) DO(0) DO(1) DO(2) DO(3)

/* DO(r) for the rows of sums, DO(r, v) for each sum. Unrolled by hand: some compilers keep the sums of a loop in
 * memory. */
#define EIGHT(DO, a, b, c, d, e, f, g, h) DO(a) DO(b) DO(c) DO(d) DO(e) DO(f) DO(g) DO(h)
#if CPU
#define EACH_ROW(DO) EIGHT(DO, 0, 1, 2, 3, 4, 5, 6, 7) DO(8)
#else
#define EACH_ROW(DO)                                                                    \
  EIGHT(DO, 0, 1, 2, 3, 4, 5, 6, 7) EIGHT(DO, 8, 9, 10, 11, 12, 13, 14, 15)             \
      EIGHT(DO, 16, 17, 18, 19, 20, 21, 22, 23) EIGHT(DO, 24, 25, 26, 27, 28, 29, 30, 31) DO(32)
#endif
#define EACH_VECTOR(DO, r) \
  if (vectors > 0) DO(r, 0) if (vectors > 1) DO(r, 1) if (vectors > 2) DO(r, 2)

/* ---- samples into a tile and out of it --------------------------------------------------------------------------- */

enum { PER_SAMPLE, PER_RAY, PER_BATCH };

#if CPU
/* Fills rows of a tile with the samples from `first` on of each channel of a piece; zeros from sample n on. */
INLINE void gather(local vf *tile, global const float *x, const ulong stride, const int rows, const int per,
                   global const int *ray, const ulong first, const ulong n, const int item) {
  tile += PART_OF(item) * LINE, x += PART_OF(item) * stride;
  for (int c = PART_OF(item); c < rows; c += SHARE, tile += SHARE * LINE, x += SHARE * stride) {
    for (int v = 0; v < VECTORS; v++) {
      const int column = v * COLUMNS + COLUMN(item);
      const ulong sample = first + (ulong)(column * LANES);
      if (per != PER_RAY && first + TILE <= n) {
        tile[column] = per == PER_SAMPLE ? LOAD(x + sample) : (vf)*x;
        continue;
      }
      local float *to = (local float *)(tile + column);
#pragma unroll 1
      for (int i = 0; i < LANES; i++) {
        const bool there = sample + (ulong)i < n;
        to[i] = there ? x[per == PER_SAMPLE ? sample + (ulong)i : per == PER_RAY ? (ulong)ray[sample + (ulong)i] : 0]
                      : 0;
      }
    }
  }
}

/* y[at ..] = value, or += it, up to sample n. (`value` is a parameter because LLVM uses 512-bit registers only in
 * functions that have a vector parameter, and in those that they are inlined into.) */
INLINE void put(global float *y, const ulong at, const ulong n, const vf value, const bool add) {
  if (at + LANES <= n) {
    STORE(add ? LOAD(y + at) + value : value, y + at);
    return;
  }
  const vf kept = value;
  private const float *lane = (private const float *)&kept;
#pragma unroll 1
  for (int i = 0; i < LANES; i++) {
    if (at + (ulong)i < n) y[at + (ulong)i] = add ? y[at + (ulong)i] + lane[i] : lane[i];
  }
}

/* y [rows][n] = the item's part of a tile, or += it */
INLINE void put_rows(global float *y, const ulong stride, local const vf *tile, const int rows, const bool add,
                     const ulong first, const ulong n, const int item) {
  for (int c = PART_OF(item); c < rows; c += SHARE) {
    for (int v = 0; v < VECTORS; v++) {
      const int column = v * COLUMNS + COLUMN(item);
      put(y + (ulong)c * stride, first + (ulong)(column * LANES), n, tile[c * LINE + column], add);
    }
  }
}

#else
/* The same on a GPU. Rows are read BATCH at a time, because an item waits for what it stores. */
#define BATCH 8
#define EACH_OF_BATCH _Pragma("unroll") for (int b = 0; b < BATCH; b++)
INLINE void gather(local float *tile, global const float *x, const ulong stride, const int rows, const int per,
                   global const int *ray, const ulong first, const ulong n, const int item) {
  const ulong sample = first + (ulong)COLUMN(item);
  const bool there = sample < n;
  x += PART_OF(item) * stride + (per == PER_SAMPLE ? sample : per == PER_RAY && there ? (ulong)ray[sample] : 0);
  for (int c = PART_OF(item); c < rows; c += BATCH * SHARE) {
    float value[BATCH];
    EACH_OF_BATCH value[b] = there && c + b * SHARE < rows ? *x : 0, x += SHARE * stride;
    EACH_OF_BATCH if (c + b * SHARE < rows) tile[(c + b * SHARE) * LINE + COLUMN(item)] = value[b];
  }
}

INLINE void put_rows(global float *y, const ulong stride, local const float *tile, const int rows, const bool add,
                     const ulong first, const ulong n, const int item) {
  const ulong sample = first + (ulong)COLUMN(item);
  global const float *from = y + (PART_OF(item) * stride + sample);
  y += PART_OF(item) * stride + sample;
  for (int c = PART_OF(item); c < rows && sample < n; c += BATCH * SHARE) {
    float before[BATCH];
    EACH_OF_BATCH before[b] = add && c + b * SHARE < rows ? *from : 0, from += SHARE * stride;
    EACH_OF_BATCH {
      if (c + b * SHARE < rows) *y = before[b] + tile[(c + b * SHARE) * LINE + COLUMN(item)];
      y += SHARE * stride;
    }
  }
}
#endif

/* ---- products ---------------------------------------------------------------------------------------------------- */

typedef enum finish {
  AS_IT_IS,
  RELU, /* max(sum, 0); NaN stays NaN, so that it is noticed */
  RELU_BWD /* derivative of the ReLU: sum where the value that `out` holds is above 0 (or NaN); else 0 */
} finish;
#define FINISHED(how, sum, out) \
  (how == RELU ? (sum) < 0 ? (vf)0 : (sum) : how == RELU_BWD ? (out) <= 0 ? (vf)0 : (sum) : (sum))

#if TENSOR
/* How the strips of 16 rows, each `across` fragments wide, are shared out to the warps of a group: each is cut into
 * parts of equal width, as many as take the least time. */
#define WARPS (GROUP / WARP)
#define UP(a, b) (((a) + (b)-1) / (b))
INLINE int cost(const int strips, const int across, const int parts) {
  return UP(strips * parts, WARPS) * (UP(across, parts) + 1);
}
INLINE int parts_of(const int strips, const int across) {
  const int least = UP(across, FRAGMENTS_MOST);
  const int two = cost(strips, across, 2 * least) < cost(strips, across, least) ? 2 * least : least;
  return cost(strips, across, 4 * least) < cost(strips, across, two) ? 4 * least : two;
}

/* DO(r, c, value) for the values that an item has of a strip from row `top` and column `left` on. */
#define AT_VALUE(DO, f, i, value)                                                                            \
  do {                                                                                                       \
    const int r = top + SUM_ROW(item % WARP, i), c = left + 8 * (f) + SUM_COLUMN(item % WARP, i);            \
    if (r < rows && c < columns) DO(r, c, value)                                                             \
  } while (0);
#define EACH_VALUE(DO, value) EACH(f, wide) EACH(i, 4) AT_VALUE(DO, f, i, value)
/* The same where tensor cores are emulated or numbers are not finite: one by one. */
#define ONE_BY_ONE(DO, value) \
  _Pragma("unroll 1") for (int at = 0; at < 4 * wide; at++) AT_VALUE(DO, at / 4, at % 4, value)

/* All rows of out = A in; A (r, k) at r*a_row + k*a_step. */
INLINE void product(const finish how, local float *out, local const float *in, global const float *a, const int a_row,
                    const int a_step, const int rows, const int count, const int item) {
  const int columns = TILE, strips = UP(rows, 16), parts = parts_of(strips, TILE / 8), wide = UP(TILE / 8, parts);
  barrier(CLK_LOCAL_MEM_FENCE);
  for (int units = 0; units < strips * parts; units += WARPS) { /* all warps take part: PoCL needs uniform loops */
    const int unit = units + item / WARP, top = unit % strips * 16, left = unit / strips * wide * 8;
#define FINISH(r, c, value) out[(r) * LINE + (c)] = FINISHED(how, value, out[(r) * LINE + (c)]);
#if NVIDIA
    if (unit >= strips * parts) break;
    float sum[FRAGMENTS_MOST][4];
    global_strip(sum, wide, a + top * a_row, a_row, a_step, rows - top, in + left, LINE, 1, columns - left,
                 item % WARP, count);
    if (are_finite(sum, wide)) {
      EACH_VALUE(FINISH, sum[f][i])
      continue;
    }
#endif
    ONE_BY_ONE(FINISH, dot_global(a + r * a_row, a_step, in + c, LINE, count))
  }
}

#else
/* The sums of a block, rows x `vectors`. */
#define SUMS vf sum[9 > BLOCK ? 9 : BLOCK + 1][3]
#define CLEAR_SUM(r, v) sum[r][v] = 0;
#define CLEAR_ROW(r) \
  if (r < rows) { EACH_VECTOR(CLEAR_SUM, r) }
/* A term of each sum: weight(r) * value[v]. */
#define ADD_TERM(r, v) sum[r][v] += weight * value[v];
#define ADD_ROW(r)               \
  if (r < rows) {                \
    const vf weight = WEIGHT(r); \
    EACH_VECTOR(ADD_TERM, r)     \
  }

/* Rows of a block that each of the items of a column computes. */
#define ROWS_EACH(all) (((all) + SHARE - 1) / SHARE)

/* sum[r][v] = sum_k A[r][k] in[k][column v], k < count; A (r, k) at r*a_row + k*a_step, one of which is 1. Of all `all`
 * rows an item has `rows`. */
INLINE void products(SUMS, local const vf *in, global const float *a, const int a_row, const int a_step,
                     const int all, const int count, const int item STAGE) {
  const int rows = ROWS_EACH(all);
  const int vectors = VECTORS;
  EACH_ROW(CLEAR_ROW)
#if CPU
#define WEIGHT(r) (vf)(a[r * a_row + k * a_step])
  for (int k = 0; k < count; k++) {
    vf value[3];
    value[0] = in[k * LINE];
    if (VECTORS > 1) value[1] = in[k * LINE + 1];
    if (VECTORS > 2) value[2] = in[k * LINE + 2];
    EACH_ROW(ADD_ROW)
  }
#undef WEIGHT
#else
#define WEIGHT(r) own[k * STAGE_ROW + r]
  local const float *const own = stage + PART_OF(item) * ROUND_UP(rows);
  for (int begin = 0; begin < count; begin += CHUNK) {
    const int terms = min(CHUNK, count - begin);
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = item; i < all * terms; i += GROUP) { /* neighbours read neighbouring weights */
      const int r = a_step == 1 ? i / terms : i % all, k = a_step == 1 ? i % terms : i / all;
      stage[k * STAGE_ROW + r / rows * ROUND_UP(rows) + r % rows] = a[r * a_row + (begin + k) * a_step];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int k = 0; k < terms; k++) {
      const float value[1] = {in[(begin + k) * LINE + COLUMN(item)]};
      EACH_ROW(ADD_ROW)
    }
  }
#undef WEIGHT
#endif
}

/* Rows row .. row+all-1 of out = A in. */
INLINE void block(const finish how, local vf *out, local const vf *in, global const float *a, const int a_row,
                  const int a_step, const int row, const int all, const int count, const int item STAGE) {
  const int vectors = VECTORS, rows = ROWS_EACH(all), before = PART_OF(item) * rows;
  SUMS;
  products(sum, in, a + row * a_row, a_row, a_step, all, count, item STAGED);
  out += (row + before) * LINE + COLUMN(item);
#define FINISH(r, v) out[r * LINE + v * COLUMNS] = FINISHED(how, sum[r][v], out[r * LINE + v * COLUMNS]);
#define FINISH_ROW(r) \
  if (r < rows && (all % SHARE == 0 || before + r < all)) { EACH_VECTOR(FINISH, r) }
  EACH_ROW(FINISH_ROW)
}

/* All rows of out = A in. */
INLINE void product(const finish how, local vf *out, local const vf *in, global const float *a, const int a_row,
                    const int a_step, const int rows, const int count, const int item STAGE) {
  for (int row = 0; row + BLOCK <= rows - (REST(rows) > BLOCK ? BLOCK + 1 : 0); row += BLOCK)
    block(how, out, in, a, a_row, a_step, row, BLOCK, count, item STAGED);
  if (REST(rows) > 0) block(how, out, in, a, a_row, a_step, rows - REST(rows), REST(rows), count, item STAGED);
}
#endif

/* ---- forward ----------------------------------------------------------------------------------------------------- */

#define GATHER(p) \
  if (R##p > 0) gather(to, x##p, x##p##_stride, R##p, P##p, ray, first, n, item), to += R##p * LINE;
#define INPUTS                                                                                                   \
  ROWS(const float, x0), ROWS(const float, x1), ROWS(const float, x2), ROWS(const float, x3), SPAN(const int, ray), \
      SPAN(const float, w)
#define OPEN_INPUTS      \
  OPEN(const float, x0); \
  OPEN(const float, x1); \
  OPEN(const float, x2); \
  OPEN(const float, x3); \
  OPEN(const int, ray);  \
  OPEN(const float, w);

#if !defined(PART)
/* y [C<LAYERS>][n]; one group per tile. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void mlp_fwd(ROWS(float, y), INPUTS, ulong n) {
  local vf tiles[(EVEN + ODD) * LINE];
  STAGE_MEMORY
  OPEN(float, y);
  OPEN_INPUTS
  local vf *const turns[2] = {tiles, tiles + EVEN * LINE};
  const int item = (int)get_local_id(0);
  const ulong first = get_group_id(0) * TILE;
  local vf *to = tiles;
  EACH_PIECE(GATHER)
#define LAYER(l, next) \
  product(next < LAYERS ? RELU : AS_IT_IS, turns[next % 2], turns[l % 2], w + A##l, C##l, 1, C##next, C##l, \
          item STAGED);
  JOIN(UP_, LAYERS)(LAYER)
  WAIT
  put_rows(y, y_stride, turns[LAYERS % 2], JOIN(C, LAYERS), false, first, n, item);
}
#endif

/* ---- backward ---------------------------------------------------------------------------------------------------- */

#if defined(PART)
#if CPU
/* to [TILE][padded channels] = the transpose of tile [channels][TILE], in 4 x 4 blocks. Channels past the layer's own
 * are read from whatever follows in memory, and only reach columns of sums that nobody reads. */
INLINE void turn(local float *to, local const float *tile, const int padded) {
#if LANES == 1
  for (int c = 0; c < padded; c++)
    for (int i = 0; i < TILE; i++) to[i * padded + c] = tile[c * TILE + i];
#else
  for (int c = 0; c < padded; c += 4) {
    for (int i = 0; i < TILE; i += 4) {
      local const float *from = tile + c * TILE + i;
      const float4 a = vload4(0, from), b = vload4(0, from + TILE), p = vload4(0, from + 2 * TILE),
                   q = vload4(0, from + 3 * TILE);
      local float *row = to + i * padded + c;
#if defined(__clang__) /* clang generates more instructions from the plain form */
      const float4 ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), ab2 = __builtin_shufflevector(a, b, 2, 6, 3, 7),
                   pq = __builtin_shufflevector(p, q, 0, 4, 1, 5), pq2 = __builtin_shufflevector(p, q, 2, 6, 3, 7);
      vstore4(__builtin_shufflevector(ab, pq, 0, 1, 4, 5), 0, row);
      vstore4(__builtin_shufflevector(ab, pq, 2, 3, 6, 7), 0, row + padded);
      vstore4(__builtin_shufflevector(ab2, pq2, 0, 1, 4, 5), 0, row + 2 * padded);
      vstore4(__builtin_shufflevector(ab2, pq2, 2, 3, 6, 7), 0, row + 3 * padded);
#else
      vstore4((float4)(a.s0, b.s0, p.s0, q.s0), 0, row);
      vstore4((float4)(a.s1, b.s1, p.s1, q.s1), 0, row + padded);
      vstore4((float4)(a.s2, b.s2, p.s2, q.s2), 0, row + 2 * padded);
      vstore4((float4)(a.s3, b.s3, p.s3, q.s3), 0, row + 3 * padded);
#endif
    }
  }
#endif
}

/* dW [rows][vectors] += gradient [rows][TILE] times transposed [TILE][vectors]; rows of dW are `padded` vectors long */
INLINE void add_block(global float *dw, local const float *gradient, local const vf *transposed, const int padded,
                      const int rows, const int vectors) {
  SUMS;
  EACH_ROW(CLEAR_ROW)
#define WEIGHT(r) (vf)(gradient[r * TILE + i])
  for (int i = 0; i < TILE; i++) {
    vf value[3];
    value[0] = transposed[i * padded];
    if (vectors > 1) value[1] = transposed[i * padded + 1];
    if (vectors > 2) value[2] = transposed[i * padded + 2];
    EACH_ROW(ADD_ROW)
  }
#undef WEIGHT
#define ADD_SUM(r, v) STORE(LOAD(dw + (r * padded + v) * LANES) + sum[r][v], dw + (r * padded + v) * LANES);
#define ADD_SUMS(r) \
  if (r < rows) { EACH_VECTOR(ADD_SUM, r) }
  EACH_ROW(ADD_SUMS)
}

INLINE void add_rows(global float *dw, local const float *gradient, local const vf *transposed, const int padded,
                     const int rows, const int column, const int vectors) {
  dw += column * LANES;
  transposed += column;
  for (int row = 0; row + BLOCK <= rows - (REST(rows) > BLOCK ? BLOCK + 1 : 0); row += BLOCK)
    add_block(dw + row * padded * LANES, gradient + row * TILE, transposed, padded, BLOCK, vectors);
  const int rest = rows - REST(rows);
  if (REST(rows) > 0) add_block(dw + rest * padded * LANES, gradient + rest * TILE, transposed, padded, REST(rows), vectors);
}

/* dW [outs][ins] += gradient [outs][TILE] value^T [TILE][ins]: columns three vectors at a time, the last four in two
 * pairs. */
INLINE void add_weights(global float *dw, local const vf *gradient, local const vf *value, local vf *transposed,
                        const int outs, const int ins, const int row, const int item) {
  const int padded = row / LANES, last = padded % 3 == 1 && padded > 1 ? 4 : padded % 3;
  local const float *from = (local const float *)gradient;
  turn((local float *)transposed, (local const float *)value, row);
  for (int column = 0; column < padded - last; column += 3) add_rows(dw, from, transposed, padded, outs, column, 3);
  for (int column = padded - last; column + 2 <= padded; column += 2)
    add_rows(dw, from, transposed, padded, outs, column, 2);
  if (last == 1) add_rows(dw, from, transposed, padded, outs, padded - 1, 1);
}

#elif TENSOR
/* The same in strips of the outputs, or of the inputs if that takes less time. */
INLINE void add_weights(global float *dw, local const float *gradient, local const float *value, local float *transposed,
                        const int outs, const int ins, const int row, const int item) {
  const int by_outs = parts_of(UP(outs, 16), UP(ins, 8)), by_ins = parts_of(UP(ins, 16), UP(outs, 8));
  const bool turned = cost(UP(ins, 16), UP(outs, 8), by_ins) < cost(UP(outs, 16), UP(ins, 8), by_outs);
  local const float *const a = turned ? value : gradient, *const b = turned ? gradient : value;
  const int rows = turned ? ins : outs, columns = turned ? outs : ins, parts = turned ? by_ins : by_outs;
  const int strips = UP(rows, 16), wide = UP(UP(columns, 8), parts);
  for (int units = 0; units < strips * parts; units += WARPS) {
    const int unit = units + item / WARP, top = unit % strips * 16, left = unit / strips * wide * 8;
#define AT(r, c) (turned ? (c) * row + (r) : (r) * row + (c))
#define LOAD_SUM(r, c, to) to = dw[AT(r, c)];
#define STORE_SUM(r, c, value) dw[AT(r, c)] = value;
#define ADD_SUM(r, c, value) dw[AT(r, c)] += value;
#if NVIDIA
    if (unit >= strips * parts) break;
    float sum[FRAGMENTS_MOST][4], before[FRAGMENTS_MOST][4];
    local_strip(sum, wide, a + top * LINE, LINE, 1, rows - top, b + left * LINE, 1, LINE, columns - left, item % WARP,
                TILE);
    if (are_finite(sum, wide)) {
      EACH_VALUE(LOAD_SUM, before[f][i])
      EACH_VALUE(STORE_SUM, before[f][i] + sum[f][i])
      continue;
    }
#endif
    ONE_BY_ONE(ADD_SUM, dot_local(a + r * LINE, 1, b + c * LINE, 1, TILE))
  }
}

#else
/* The same on a GPU: an item computes 4 x 4 sums. Their rows and columns are apart, so that neighbouring items read
 * neighbouring elements. */
INLINE void add_weights(global float *dw, local const float *gradient, local const float *value, local float *transposed,
                        const int outs, const int ins, const int row, const int item) {
  const int down = (outs + 3) / 4, across = (ins + 3) / 4;
  for (int block = item; block < down * across; block += GROUP) {
    const int j = block / across, k = block % across;
    float sum[4][4] = {{0}};
    for (int i = 0; i < TILE; i++) {
      float s[4], x[4];
#pragma unroll
      for (int q = 0; q < 4; q++) s[q] = gradient[min(j + q * down, outs - 1) * LINE + i];
#pragma unroll
      for (int q = 0; q < 4; q++) x[q] = value[min(k + q * across, ins - 1) * LINE + i];
#pragma unroll
      for (int q = 0; q < 16; q++) sum[q / 4][q % 4] = fma(s[q / 4], x[q % 4], sum[q / 4][q % 4]);
    }
#pragma unroll
    for (int q = 0; q < 16; q++) {
      const int out = j + q / 4 * down, in = k + q % 4 * across;
      if (out < outs && in < ins) dw[out * row + in] += sum[q / 4][q % 4];
    }
  }
}
#endif

/* Adds a piece's gradient, taken from the tile of the input's gradient: that of a per-sample piece to dx, that of a
 * per-batch piece to `sums`. */
INLINE void scatter(global float *dx, const ulong stride, global float *sums, local const vf *tile, const int rows,
                    const int per, const ulong first, const ulong n, const int item) {
  if (per == PER_SAMPLE) {
    put_rows(dx, stride, tile, rows, true, first, n, item);
    return;
  }
  for (int c = item; c < rows; c += GROUP) {
    vf sum = 0;
    for (int i = 0; i < COLUMNS * VECTORS; i++) sum += tile[c * LINE + i];
    STORE(LOAD(sums + c * LANES) + sum, sums + c * LANES);
  }
}

#define GRADIENTS ROWS(float, dx0), ROWS(float, dx1), ROWS(float, dx2), ROWS(float, dx3)
#define OPEN_GRADIENTS \
  OPEN(float, dx0);    \
  OPEN(float, dx1);    \
  OPEN(float, dx2);    \
  OPEN(float, dx3);

/* Gradients of the samples of a group's `each` tiles; the last group may have fewer. Activations are computed again;
 * the gradient of a layer's values overwrites them as soon as they have been used. sums [group][PART] is
 * overwritten. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void mlp_bwd(GRADIENTS, SPAN(float, sums),
                                                                       ROWS(const float, dy), INPUTS, ulong each,
                                                                       ulong n) {
#if CPU
  local vf values[(VALUES + LANES - 1) * LINE]; /* `turn` may read past the last channel */
  local vf transposed[TILE * TURNED];
#else
  local vf values[VALUES * LINE];
  local float *const transposed = 0;
#endif
  STAGE_MEMORY
  OPEN_GRADIENTS
  OPEN(float, sums);
  OPEN(const float, dy);
  OPEN_INPUTS
  const uint number = (uint)get_local_id(0);
  global float *const own = sums + get_group_id(0) * PART;
  const ulong begin = get_group_id(0) * each * TILE, end = min(begin + each * TILE, n);
  for (int i = (int)number; i < PART; i += GROUP) own[i] = 0;
#if !CPU
  barrier(CLK_GLOBAL_MEM_FENCE);
#endif
  for (ulong first = begin; first < end; first += TILE) {
    const int item = item_of(number, (uint)first);
    local vf *to = values;
    EACH_PIECE(GATHER)
#define ITEM(l) item_of(number, (uint)first + 1 + (l))
#define LAYER(l, next)                                                                                               \
  product(RELU, values + V##next * LINE, values + V##l * LINE, w + A##l, C##l, 1, C##next, C##l, ITEM(l) STAGED);
    JOIN(UP_, HIDDEN)(LAYER)
    gather(values + JOIN(V, LAYERS) * LINE, dy, dy_stride, JOIN(C, LAYERS), PER_SAMPLE, 0, first, n, item);
#define LAYER_BWD(l, next)                                                                                           \
  WAIT add_weights(own + G##l, values + V##next * LINE, values + V##l * LINE, transposed, C##next, C##l, E##l,        \
                   ITEM(LAYERS + l));                                                                                \
  WAIT if (l > 0) product(RELU_BWD, values + V##l * LINE, values + V##next * LINE, w + A##l, 1, C##l, C##l, C##next,     \
                          ITEM(2 * LAYERS + l) STAGED);
    JOIN(DOWN_, LAYERS)(LAYER_BWD)
#if DX_ROWS > 0
    product(AS_IT_IS, values + DX_FROM * LINE, values + V1 * LINE, w + DX_FROM, 1, C0, DX_ROWS, C1, ITEM(0) STAGED);
    WAIT
    to = values;
#define SCATTER(p) \
  if (D##p) scatter(dx##p, dx##p##_stride, own + B##p, to, R##p, P##p, first, n, ITEM(1)); \
  to += R##p * LINE;
    EACH_PIECE(SCATTER)
    WAIT
#endif
  }
}

/* dW and the gradients of per-batch rows += the sums of all parts, in the order of the parts; one item per element. */
kernel void mlp_sum(GRADIENTS, SPAN(float, dw), SPAN(const float, sums), int parts) {
  OPEN_GRADIENTS
  OPEN(float, dw);
  OPEN(const float, sums);
  int at = (int)get_global_id(0);
  float sum = 0;
#define LAYER_SUM(l, next)                                                                             \
  if (at >= 0 && at < C##next * C##l) {                                                                \
    _Pragma("unroll 16") for (int k = 0; k < parts; k++) sum += sums[(ulong)k * PART + G##l + at / C##l * E##l + at % C##l]; \
    dw[A##l + at] += sum;                                                                              \
  }                                                                                                    \
  at -= C##next * C##l;
  JOIN(UP_, LAYERS)(LAYER_SUM)
#define PIECE_SUM(p)                                                              \
  if (D##p && P##p == PER_BATCH) {                                                \
    if (at >= 0 && at < R##p) {                                                   \
      for (int k = 0; k < parts * LANES; k++)                                     \
        sum += sums[(ulong)(k / LANES) * PART + B##p + at * LANES + k % LANES];   \
      dx##p[(ulong)at * dx##p##_stride] += sum;                                   \
    }                                                                             \
    at -= R##p;                                                                   \
  }
  EACH_PIECE(PIECE_SUM)
}
#endif
