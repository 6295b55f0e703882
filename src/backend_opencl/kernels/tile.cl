/* SPDX-License-Identifier: MIT
 * This text is put in front of the sources of the fused kernels: vectors of lanes, and the layers of a network over a
 * tile of lanes.
 *
 * A work-item has LANES lanes, VECTORS vectors of WIDTH; a group has GROUP items. A tile is the samples or pixels that
 * all lanes of a group process at one time. Its activations are in local memory, [rows][VECTORS][GROUP] vectors. An
 * item reads and writes only its own columns, so no barriers are needed. OUTPUTS outputs of a layer are summed at once.
 *
 * A matrix is packed in blocks of BLOCK(outputs) rows, in a block column by column: [outputs/BLOCK][inputs][BLOCK].
 *
 * TENSOR: wide layers of a tile are computed by tensor cores, 32 items together. An item then reads and writes other
 * columns than its own, so all items of a group have to take part, and a row has room for eight more: eight columns of
 * four rows are in 32 memory banks. */

#define LANES (WIDTH * VECTORS)
#if TENSOR
#define TILE (GROUP + 8)
#else
#define TILE (GROUP * VECTORS) /* vectors of a group */
#endif
#define BLOCK(n) ((n) < OUTPUTS ? (n) : OUTPUTS)
#define AT(row, v) ((row) * TILE + (v) * GROUP)

/* Truth values of common.cl's vectors: combine them by &, | and NOT. */
#if WIDTH == 1
#define ANY(m) ((m) != 0)
#define WHOLE(x) convert_uint_rtz(x)
#define REAL(x) convert_float(x)
#define GATHER(vector, p, i) ((p)[i])
#else
#define ANY(m) any(m)
#define TOWARD_ZERO_(convert) convert##_rtz
#define TOWARD_ZERO(convert) TOWARD_ZERO_(convert)
#define WHOLE(x) TOWARD_ZERO(JOINW(convert_uint))(x)
#define REAL(x) JOINW(convert_float)(x)
#if WIDTH == 4
#define GATHER(vector, p, i) (vector)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3])
#elif WIDTH == 8
#define GATHER(vector, p, i) \
  (vector)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3], (p)[i.s4], (p)[i.s5], (p)[i.s6], (p)[i.s7])
#else
#define GATHER(vector, p, i)                                                                                  \
  (vector)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3], (p)[i.s4], (p)[i.s5], (p)[i.s6], (p)[i.s7], (p)[i.s8], \
           (p)[i.s9], (p)[i.sa], (p)[i.sb], (p)[i.sc], (p)[i.sd], (p)[i.se], (p)[i.sf])
#endif
#endif
#define NOT(m) ((m) == 0)
#define LANE(x, lane) (((float *)(x))[lane]) /* of private vectors */
#define LANE_INT(x, lane) (((int *)(x))[lane])
#define EACH_VECTOR _Pragma("unroll") for (int v = 0; v < VECTORS; v++)
#define EACH_AXIS _Pragma("unroll") for (int axis = 0; axis < 3; axis++)

/* A call with a vector as its argument lets LLVM use registers of 512 bits, which it otherwise splits. */
INLINE floatw full(floatw x) { return x; }

/* NaN becomes `low`. */
INLINE floatw clamped(floatw x, float low, float high) {
  return select((floatw)(low), select((floatw)(high), x, x < high), x > low);
}

INLINE floatw sigmoid(floatw x) { return 1 / (1 + exp(-x)); }

/* ---- reading pairs ---- */

/* first[l], second[l] = p[i[l]], p[i[l] + 1], for indices in memory. */
#if WIDTH == 1
#define KEPT uint
#define PAIRS(first, second, p, i) first = (p)[(i)[0]], second = (p)[(i)[0] + 1]
#else
#define KEPT volatile uint
#define PAIR(p, i) vload2(0, (p) + (i))
#define PAIRS(first, second, p, i)                                                   \
  do {                                                                               \
    const floatw low_ = HALF(p, i, 0), high_ = HALF(p, i, WIDTH / 2);                \
    first = (floatw)(low_.even, high_.even), second = (floatw)(low_.odd, high_.odd); \
  } while (0)
#if WIDTH == 4
#define HALF(p, i, l) (floatw)(PAIR(p, i[l]), PAIR(p, i[l + 1]))
#elif WIDTH == 8
#define HALF(p, i, l) (floatw)(PAIR(p, i[l]), PAIR(p, i[l + 1]), PAIR(p, i[l + 2]), PAIR(p, i[l + 3]))
#else
#define HALF(p, i, l)                                                                                 \
  (floatw)(PAIR(p, i[l]), PAIR(p, i[l + 1]), PAIR(p, i[l + 2]), PAIR(p, i[l + 3]), PAIR(p, i[l + 4]), \
         PAIR(p, i[l + 5]), PAIR(p, i[l + 6]), PAIR(p, i[l + 7]))
#endif
#endif

/* ---- layers ---- */

#define EACH_ROW(rows) _Pragma("unroll") for (int r = 0; r < (rows); r++)

/* sum += A x over `count` inputs, for a block of `rows`. `rows` is known before functions are inlined, so that loops
 * over it are unrolled and the sums stay in registers. GPUs read four weights at a time. */
#if WIDTH == 1
#define WEIGH(r, weight) EACH_VECTOR sum[r][v] += (weight) * value[v];
#define FOUR(rows)                                                                                \
  if ((rows) % 4 == 0) {                                                                          \
    global const float4 *weights = (global const float4 *)(a + k * (rows));                       \
    _Pragma("unroll") for (int r = 0; r < (rows) / 4 * 4; r += 4) {                               \
      const float4 weight = weights[r / 4];                                                       \
      WEIGH(r, weight.s0) WEIGH(r + 1, weight.s1) WEIGH(r + 2, weight.s2) WEIGH(r + 3, weight.s3) \
    }                                                                                             \
    continue;                                                                                     \
  }
#else
#define FOUR(rows)
#endif
#define PRODUCT(name, rows)                                                                                 \
  INLINE void name(floatw (*sum)[VECTORS], global const float *a, local const floatw *x, const int count) { \
    for (int k = 0; k < count; k++) {                                                                       \
      floatw value[VECTORS];                                                                                \
      EACH_VECTOR value[v] = x[AT(k, v)];                                                                   \
      FOUR(rows)                                                                                            \
      EACH_ROW(rows) {                                                                                      \
        const floatw weight = (floatw)(a[k * (rows) + r]);                                                  \
        EACH_VECTOR sum[r][v] += weight * value[v];                                                         \
      }                                                                                                     \
    }                                                                                                       \
  }

/* y = relu(start + A x), or relu(begin + A x); start [outputs]: the same for all lanes; begin: rows of a tile; 0: none.
 * y may be x where all outputs are one block. NaN stays NaN. */
#define LAYER(name, outputs, count)                                                            \
  PRODUCT(product_##name, BLOCK(outputs))                                                      \
  INLINE void name(local floatw *y, global const float *start, local const floatw *begin,      \
                   global const float *a, local const floatw *x) {                             \
    for (int row = 0; row < (outputs); row += BLOCK(outputs), a += BLOCK(outputs) * (count)) { \
      floatw sum[BLOCK(outputs)][VECTORS];                                                     \
      EACH_ROW(BLOCK(outputs)) {                                                               \
        EACH_VECTOR sum[r][v] = start ? (floatw)(start[row + r]) : (floatw)(0);                \
        if (begin) EACH_VECTOR sum[r][v] = begin[AT(row + r, v)];                              \
      }                                                                                        \
      product_##name(sum, a, x, count);                                                        \
      EACH_ROW(BLOCK(outputs))                                                                 \
        EACH_VECTOR y[AT(row + r, v)] = full(select(sum[r][v], (floatw)(0), sum[r][v] < 0));   \
    }                                                                                          \
  }

/* ---- layers by tensor cores ---- */

#if TENSOR
#define PADDED(count) (((count) + 7) / 8 * 8)
/* Fragment 4 m + n of the sums has rows from 16 m and columns from 8 n on. */

/* sum += A x, for 32 columns of a tile from x on: of the products of leading parts and rests, all but that of two
 * rests. a: as fragment_at says, the leading parts of all, then their rests. */
#if NVIDIA
/* All of A that eight columns need is loaded before it is used, or each fragment would wait for its own. */
#define TENSOR_PRODUCT(name, outputs, count)                                                               \
  INLINE void name(float (*sum)[4], global const float *a, local const float *x, int lane) {               \
    global const float4 *first = (global const float4 *)a + lane;                                          \
    for (int k = 0; k < (count); k += 8, first += (outputs) * 2) {                                         \
      float4 high[(outputs) / 16], low[(outputs) / 16];                                                    \
      float b[4][2], rest[4][2];                                                                           \
      EACH(m, (outputs) / 16) high[m] = first[32 * m], low[m] = first[(outputs) * PADDED(count) / 4 + 32 * m]; \
      EACH(n, 4) EACH(j, 2) {                                                                              \
        const int row = k + 4 * j + lane % 4;                                                              \
        const float value = row < (count) ? x[row * TILE + 8 * n + lane / 4] : 0;                          \
        b[n][j] = tf32_leading(value), rest[n][j] = tf32_rest(value);                                      \
      }                                                                                                    \
      EACH(m, (outputs) / 16) {                                                                            \
        EACH(n, 4) multiply_add(sum[4 * m + n], high[m], rest[n]);                                         \
        EACH(n, 4) multiply_add(sum[4 * m + n], low[m], b[n]);                                             \
        EACH(n, 4) multiply_add(sum[4 * m + n], high[m], b[n]);                                            \
      }                                                                                                    \
    }                                                                                                      \
  }
#else
#define TENSOR_PRODUCT(name, outputs, count)                                                          \
  INLINE void name(float (*sum)[4], global const float *a, local const float *x, int lane) {          \
    for (int f = 0; f < (outputs) / 4; f++) {                                                         \
      for (int i = 0; i < 4; i++) {                                                                   \
        const uint row = f / 4 * 16 + SUM_ROW(lane, i), column = f % 4 * 8 + SUM_COLUMN(lane, i);     \
        for (int k = 0; k < (count); k++) {                                                           \
          const uint at = fragment_at(row, k, outputs);                                               \
          const float high = a[at], low = a[(outputs) * PADDED(count) + at], value = x[k * TILE + column]; \
          sum[f][i] += high * tf32_rest(value) + low * tf32_leading(value) + high * tf32_leading(value);          \
        }                                                                                             \
      }                                                                                               \
    }                                                                                                 \
  }
#endif

/* A LAYER. Columns of x and y: the item's own. */
#define WIDE_LAYER(name, outputs, count)                                                                    \
  TENSOR_PRODUCT(product_##name, outputs, count)                                                            \
  INLINE void name(local float *y, global const float *start, local const float *begin,                    \
                   global const float *a, local const float *x) {                                          \
    const int lane = get_local_id(0) % 32;                                                                  \
    float sum[(outputs) / 4][4];                                                                            \
    EACH(f, (outputs) / 4) EACH(i, 4) sum[f][i] = start ? start[f / 4 * 16 + SUM_ROW(lane, i)] : 0;         \
    barrier(CLK_LOCAL_MEM_FENCE);                                                                           \
    product_##name(sum, a, x - lane, lane);                                                                 \
    barrier(CLK_LOCAL_MEM_FENCE);                                                                           \
    EACH(f, (outputs) / 4) EACH(i, 4) {                                                                     \
      const int row = f / 4 * 16 + SUM_ROW(lane, i), column = f % 4 * 8 + SUM_COLUMN(lane, i);              \
      y[row * TILE + column - lane] = select(sum[f][i], 0.0f, sum[f][i] < 0);                               \
    }                                                                                                       \
    barrier(CLK_LOCAL_MEM_FENCE);                                                                           \
  }
#else
#define WIDE_LAYER LAYER
#endif
