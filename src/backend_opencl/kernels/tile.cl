/* SPDX-License-Identifier: MIT
 * This text is put in front of the sources of the fused kernels: vectors of lanes, and the layers of a network over a
 * tile of lanes.
 *
 * A work-item has LANES lanes, VECTORS vectors of WIDTH; a group has GROUP items. A tile is the samples or pixels that
 * all lanes of a group process at one time. Its activations are in local memory, [rows][VECTORS][GROUP] vectors. An
 * item reads and writes only its own columns, so no barriers are needed. OUTPUTS outputs of a layer are summed at once.
 *
 * A matrix is packed in blocks of BLOCK(outputs) rows, in a block column by column: [outputs/BLOCK][inputs][BLOCK]. */

/* Inlined before loops are unrolled, so that their bounds are constants. */
#define INLINE static inline __attribute__((always_inline))
#define LANES (WIDTH * VECTORS)
#define TILE (GROUP * VECTORS) /* vectors of a group */
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
