/* SPDX-License-Identifier: MIT
 * This text is put in front of the sources that may use tensor cores (TENSOR): C = A B in fragments that the 32 items
 * of a warp compute together, C 16 x 8, A 16 x 8, B 8 x 8.
 *
 * TF32 has 11 significant bits. A number is the sum of two of them, and of the four products of two numbers all but
 * that of the two rests is added: sums have about the precision of float. Where the compiler does not take PTX, each
 * value of C is computed in plain arithmetic from the same parts. */

/* Inlined before loops are unrolled, so that their bounds are constants. */
#define INLINE static inline __attribute__((always_inline))

#if TENSOR
#define EACH(i, count) _Pragma("unroll") for (int i = 0; i < (count); i++)
#define WARP 32
/* Row and column of value i that an item has of C: */
#define SUM_ROW(lane, i) ((lane) / 4 + (i) / 2 * 8)
#define SUM_COLUMN(lane, i) ((lane) % 4 * 2 + (i) % 2)

#if NVIDIA
/* sum += A B (PTX ISA, mma.m16n8k8 of .tf32) */
INLINE void multiply_add(float sum[4], float4 a, const float b[2]) {
  asm("mma.sync.aligned.m16n8k8.row.col.f32.tf32.tf32.f32 {%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, "
               "{%0,%1,%2,%3};"
               : "+f"(sum[0]), "+f"(sum[1]), "+f"(sum[2]), "+f"(sum[3])
               : "r"(as_uint(a.s0)), "r"(as_uint(a.s1)), "r"(as_uint(a.s2)), "r"(as_uint(a.s3)), "r"(as_uint(b[0])),
                 "r"(as_uint(b[1])));
}
/* item, in a way that depends on `turn`. What follows from an item's number, such as addresses, is computed before a
 * loop of turns otherwise, and is more than there are registers for. */
INLINE int item_of(uint item, uint turn) {
  asm("" : "+r"(item) : "r"(turn));
  return (int)(item % GROUP);
}
#else
#define item_of(item, turn) (item)
#endif

/* ---- products of matrices as they lie in memory ------------------------------------------------------------------ */

#define FRAGMENTS_MOST 6 /* that an item sums at a time: 24 registers */

/* x = nearest + rest. Of a number that is not finite the rest is NaN, and so is each sum that it is in. */
INLINE float tf32_nearest(float x) { return as_float((as_uint(x) + 0x1000u) & 0xFFFFE000u); }
INLINE float tf32_rest_of(float x, float nearest) { return as_float(as_uint(x - nearest) & 0xFFFFE000u); }

/* sum_k a[k*a_step] b[k*b_step], k < count; of the parts where tensor cores are emulated, unless that is NaN. */
#define DOT(name, space)                                                                                       \
  INLINE float name(space const float *a, const int a_step, local const float *b, const int b_step, const int count) {\
    float sum = 0, of_parts = 0;                                                                               \
    _Pragma("unroll 1") for (int k = 0; k < count; k++) {                                                      \
      const float x = a[k * a_step], y = b[k * b_step], high_x = tf32_nearest(x), high_y = tf32_nearest(y);    \
      sum += x * y;                                                                                            \
      of_parts += high_x * tf32_rest_of(y, high_y) + tf32_rest_of(x, high_x) * high_y;                         \
      of_parts += high_x * high_y;                                                                             \
    }                                                                                                          \
    return NVIDIA || isnan(of_parts) ? sum : of_parts;                                                         \
  }

/* sum[f] = A B, `fragments` of them side by side, a strip of 16 rows. A(r, k) is at r*a_row + k*a_step, B(k, c) at
 * k*b_step + c*b_column. Rows from `rows` on and columns from `columns` on repeat the last one. */
#define STRIP_ARGUMENTS(space)                                                                                 \
  float(*sum)[4], const int fragments, space const float *a, const int a_row, const int a_step, const int rows,\
      local const float *b, const int b_step, const int b_column, const int columns, const int lane
#if NVIDIA
/* Which of eight terms an item has, j = 0 and 1. Either order leaves local memory without bank conflicts where a row is
 * 4 more than a multiple of 8 long. */
#define TERM(j) (b_step == 1 ? lane % 4 + 4 * (j) : lane % 4 * 2 + (j))
#define STRIP(name, space)                                                                                     \
  INLINE void eight_##name(STRIP_ARGUMENTS(space), const int terms) {                                          \
    float high[4], low[4];                                                                                     \
    EACH(i, 4) {                                                                                               \
      const int r = min(lane / 4 + i % 2 * 8, rows - 1), k = TERM(i / 2);                                      \
      const float value = k < terms ? a[r * a_row + k * a_step] : 0;                                           \
      high[i] = tf32_nearest(value), low[i] = tf32_rest_of(value, high[i]);                                    \
    }                                                                                                          \
    EACH(f, fragments) {                                                                                       \
      const int c = min(8 * f + lane / 4, columns - 1);                                                        \
      float b_high[2], b_low[2];                                                                               \
      EACH(j, 2) {                                                                                             \
        const float value = TERM(j) < terms ? b[TERM(j) * b_step + c * b_column] : 0;                          \
        b_high[j] = tf32_nearest(value), b_low[j] = tf32_rest_of(value, b_high[j]);                            \
      }                                                                                                        \
      multiply_add(sum[f], (float4)(high[0], high[1], high[2], high[3]), b_low);                               \
      multiply_add(sum[f], (float4)(low[0], low[1], low[2], low[3]), b_high);                                  \
      multiply_add(sum[f], (float4)(high[0], high[1], high[2], high[3]), b_high);                              \
    }                                                                                                          \
  }                                                                                                            \
  INLINE void name(STRIP_ARGUMENTS(space), const int count) {                                                  \
    EACH(f, FRAGMENTS_MOST) EACH(i, 4) sum[f][i] = 0;                                                          \
    const int whole = count / 8 * 8;                                                                           \
    _Pragma("unroll 2") for (int k = 0; k < whole; k += 8)                                                     \
      eight_##name(sum, fragments, a + k * a_step, a_row, a_step, rows, b + k * b_step, b_step, b_column,      \
                   columns, lane, 8);                                                                          \
    if (whole < count)                                                                                         \
      eight_##name(sum, fragments, a + whole * a_step, a_row, a_step, rows, b + whole * b_step, b_step,        \
                   b_column, columns, lane, count - whole);                                                    \
  }
STRIP(global_strip, global)
STRIP(local_strip, local)
/* Whether all of an item's sums are numbers: 0 * x is NaN where x is none. */
INLINE bool are_finite(float (*sum)[4], const int fragments) {
  float zero = 0;
  EACH(f, fragments) EACH(i, 4) zero += 0 * sum[f][i];
  return zero == 0;
}
#endif
DOT(dot_global, global)
DOT(dot_local, local)
#else
#define item_of(item, turn) (item)
#endif
