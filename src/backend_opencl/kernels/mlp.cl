/* SPDX-License-Identifier: MIT
 * Fully connected stacks without biases, ReLU between layers: h_0 = x, h_{l+1} = relu(W_l h_l), y = W_last h_last.
 *
 * A work-group takes a tile of samples through all layers. Values lie in local memory, [channel][sample of the tile];
 * a work-item computes the columns of its own samples, so that only what is shared is waited for: weights, which a GPU
 * stages in local memory and a CPU reads from its caches, and sums over samples.
 *
 * Built for one stack, by the options of slots_mlp.c:
 *   LAYERS, HIDDEN = LAYERS - 1; C0 .. widths; A0 .. first element of each W, from that of the first
 *   R0 .. R3 rows of the input's pieces (0: there is none), P0 .. P3 their kinds: 0 per sample, 1 per ray, 2 per batch
 *   GROUP work-items, each with VECTORS vectors of LANES samples
 *   forward: EVEN, ODD the most channels of the tiles that the layers take turns in
 *   backward: V0 .. first channel of each layer's values, V<LAYERS> of the output's gradient, VALUES of all;
 *     D0 .. D3 whether a piece's gradient is wanted, DX whether any is; the sums of a part of the samples: PART floats,
 *     of them W_l at G<l>, rows of E<l> floats, and a piece's rows at B0 .. B3, LANES floats each */
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define INLINE static inline __attribute__((always_inline))
#define TILE (GROUP * VECTORS * LANES) /* samples */

#if LANES == 1
typedef float vf;
#define LOAD(from) (*(from))
#define STORE(value, to) (*(to) = (value))
#else
typedef JOIN(float, LANES) vf;
#define LOAD(from) JOIN(vload, LANES)(0, from)
#define STORE(value, to) JOIN(vstore, LANES)(value, 0, to)
#endif

/* A row of a tile is LINE vectors: on a GPU one more than it holds, so that a column lies across the banks.
 * BLOCK rows x VECTORS sums are in registers at a time: 8 x 3 of 32, or 4 x 3 of 16. */
#if CPU
#define LINE VECTORS
#define BLOCK (LANES == 8 ? 4 : 8)
#define STAGE
#define STAGED
#define STAGED_ROOM
#define WAIT
#else
#define LINE (GROUP * VECTORS + 1)
#define BLOCK 32
#define CHUNK 32              /* terms of which the weights are staged at a time */
#define STAGE_ROW (BLOCK + 4) /* room for one row more than a block; a multiple of four */
#define STAGE , local float *stage
#define STAGED , stage
#define STAGED_ROOM local float stage[CHUNK * STAGE_ROW] __attribute__((aligned(16)));
#define WAIT barrier(CLK_LOCAL_MEM_FENCE);
#endif
/* Rows behind the last full block; a single one joins that block where there are registers for it. */
#define REST(rows) ((rows) % BLOCK == 1 && (rows) > BLOCK && BLOCK != 4 ? BLOCK + 1 : (rows) % BLOCK)

/* DO(l, l + 1) for the first layers, upwards, and downwards. */
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

/* Its vectors are parameters: LLVM keeps 512 bits whole only in functions that have such. */
INLINE vf multiply_add(const vf a, const vf b, const vf c) { return a * b + c; }

/* ---- samples into a tile and out of it --------------------------------------------------------------------------- */

enum { PER_SAMPLE, PER_RAY, PER_BATCH };

/* Rows of a tile: samples first .. of each channel of a piece, zeros from sample n on. */
INLINE void gather(local vf *tile, global const float *x, const ulong stride, const int rows, const int per,
                   global const int *ray, const ulong first, const ulong n, const int item) {
  for (int c = 0; c < rows; c++, tile += LINE, x += stride) {
    for (int v = 0; v < VECTORS; v++) {
      const int column = v * GROUP + item;
      const ulong sample = first + (ulong)(column * LANES);
      if (per == PER_SAMPLE && first + TILE <= n) {
        tile[column] = LOAD(x + sample);
        continue;
      }
      local float *to = (local float *)(tile + column);
      for (int i = 0; i < LANES; i++) {
        const bool there = sample + (ulong)i < n;
        to[i] = there ? x[per == PER_SAMPLE ? sample + (ulong)i : per == PER_RAY ? (ulong)ray[sample + (ulong)i] : 0]
                      : 0;
      }
    }
  }
}

/* y[at ..] = value, or += it, up to sample n */
INLINE void put(global float *y, const ulong at, const ulong n, const vf value, const bool add) {
  if (at + LANES <= n) {
    STORE(add ? LOAD(y + at) + value : value, y + at);
    return;
  }
  const vf kept = value;
  private const float *lane = (private const float *)&kept;
  for (int i = 0; i < LANES; i++) {
    if (at + (ulong)i < n) y[at + (ulong)i] = add ? y[at + (ulong)i] + lane[i] : lane[i];
  }
}

/* ---- products ---------------------------------------------------------------------------------------------------- */

/* sum[r][v] += sum_k A[r][k] in[k][column v], k < count; A (r, k) at r*a_row + k*a_step, one of which is 1. */
INLINE void add_products(vf sum[BLOCK + 1][VECTORS], local const vf *in, global const float *a, const int a_row,
                         const int a_step, const int rows, const int count, const int item STAGE) {
#if CPU
  for (int k = 0; k < count; k++) {
    vf value[VECTORS];
#pragma unroll
    for (int v = 0; v < VECTORS; v++) value[v] = in[k * LINE + v];
#pragma unroll
    for (int r = 0; r < rows; r++) {
      const vf weight = (vf)(a[r * a_row + k * a_step]);
#pragma unroll
      for (int v = 0; v < VECTORS; v++) sum[r][v] = multiply_add(weight, value[v], sum[r][v]);
    }
  }
#else
  for (int begin = 0; begin < count; begin += CHUNK) {
    const int terms = min(CHUNK, count - begin);
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = item; i < rows * terms; i += GROUP) { /* neighbours read neighbouring weights */
      const int r = a_step == 1 ? i / terms : i % rows, k = a_step == 1 ? i % terms : i / rows;
      stage[k * STAGE_ROW + r] = a[r * a_row + (begin + k) * a_step];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int k = 0; k < terms; k++) {
      const float value = in[(begin + k) * LINE + item];
#pragma unroll
      for (int r = 0; r < rows; r++) sum[r][0] = fma(stage[k * STAGE_ROW + r], value, sum[r][0]);
    }
  }
#endif
}

typedef enum finish {
  TO_HIDDEN, /* out = relu(sum); a NaN stays one, so that it is noticed */
  TO_OUTPUT, /* y = sum */
  TO_SLOPE,  /* out = sum where the unit was on, that is where the value that lies there is above 0 (or NaN); else 0 */
  TO_INPUT   /* out = sum */
} finish;

/* Rows row .. row+rows-1 of one product. */
INLINE void block(const finish how, local vf *out, global float *y, const ulong y_stride, const ulong first,
                  const ulong n, local const vf *in, global const float *a, const int a_row, const int a_step,
                  const int row, const int rows, const int count, const int item STAGE) {
  vf sum[BLOCK + 1][VECTORS];
#pragma unroll
  for (int r = 0; r < rows; r++) {
#pragma unroll
    for (int v = 0; v < VECTORS; v++) sum[r][v] = 0;
  }
  add_products(sum, in, a + row * a_row, a_row, a_step, rows, count, item STAGED);
#pragma unroll
  for (int r = 0; r < rows; r++) {
#pragma unroll
    for (int v = 0; v < VECTORS; v++) {
      const int column = v * GROUP + item;
      local vf *to = out + (row + r) * LINE + column;
      const vf value = sum[r][v];
      if (how == TO_HIDDEN) *to = value < 0 ? (vf)0 : value;
      if (how == TO_OUTPUT)
        put(y + (ulong)(row + r) * y_stride, first + (ulong)(column * LANES), n, value, false);
      if (how == TO_SLOPE) *to = *to <= 0 ? (vf)0 : value;
      if (how == TO_INPUT) *to = value;
    }
  }
}

/* All rows. */
INLINE void product(const finish how, local vf *out, global float *y, const ulong y_stride, const ulong first,
                    const ulong n, local const vf *in, global const float *a, const int a_row, const int a_step,
                    const int rows, const int count, const int item STAGE) {
  for (int row = 0; row + BLOCK <= rows - (REST(rows) > BLOCK ? BLOCK + 1 : 0); row += BLOCK)
    block(how, out, y, y_stride, first, n, in, a, a_row, a_step, row, BLOCK, count, item STAGED);
  if (REST(rows) > 0)
    block(how, out, y, y_stride, first, n, in, a, a_row, a_step, rows - REST(rows), REST(rows), count, item STAGED);
}

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
/* y [C<LAYERS>][n]; a group a tile. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void mlp_fwd(ROWS(float, y), INPUTS, ulong n) {
  local vf tiles[(EVEN + ODD) * LINE];
  STAGED_ROOM
  OPEN(float, y);
  OPEN_INPUTS
  local vf *const turns[2] = {tiles, tiles + EVEN * LINE};
  const int item = (int)get_local_id(0);
  const ulong first = get_group_id(0) * TILE;
  local vf *to = tiles;
  EACH_PIECE(GATHER)
#define LAYER(l, next) \
  product(TO_HIDDEN, turns[next % 2], 0, 0, 0, 0, turns[l % 2], w + A##l, C##l, 1, C##next, C##l, item STAGED);
  JOIN(UP_, HIDDEN)(LAYER)
  product(TO_OUTPUT, 0, y, y_stride, first, n, turns[HIDDEN % 2], w + JOIN(A, HIDDEN), JOIN(C, HIDDEN), 1,
          JOIN(C, LAYERS), JOIN(C, HIDDEN), item STAGED);
}
#endif
