/* SPDX-License-Identifier: MIT
 * This text is put in front of every kernel source. Build options: WIDTH (floats in a work-item's vector: 1, 4, 8 or
 * 16), CPU (1 where work-items run on the host's cores), NVIDIA (1 where the compiler takes PTX) and the device's
 * limits.
 *
 * A kernel takes a span as two arguments (base, offset) and rows as three (base, offset, stride). OPEN makes the
 * pointer from them, null where the base is null:
 *
 *   kernel void ema(SPAN(float, average), SPAN(const float, parameters), float decay, ulong n) {
 *     OPEN(float, average);
 *     OPEN(const float, parameters);
 *
 * Layout: channel c of sample i of rows is at [c*x_stride + i]. */
#define SPAN(type, name) global type *name##_base, ulong name##_at
#define ROWS(type, name) global type *name##_base, ulong name##_at, ulong name##_stride
#define OPEN(type, name) global type *const name = name##_base ? name##_base + name##_at : 0

/* floatw holds WIDTH floats: a vector, or a scalar where WIDTH is 1. A comparison of two gives an intw, in which true
 * is -1 in a vector and 1 in a scalar: combine such values by WHERE, & and |. */
#if WIDTH == 1
#define JOINW(name) name
#define LOADW(from) (*(from))
#define STOREW(value, to) (*(to) = (value))
#else
#define JOINW_(name, width) name##width
#define JOINW__(name, width) JOINW_(name, width)
#define JOINW(name) JOINW__(name, WIDTH)
#define LOADW(from) JOINW(vload)(0, from)
#define STOREW(value, to) JOINW(vstore)(value, 0, to)
#endif
typedef JOINW(float) floatw;
typedef JOINW(int) intw;
typedef JOINW(uint) uintw;
typedef JOINW(ulong) ulongw;
#define WHERE(truth, yes, no) select((floatw)(no), (floatw)(yes), truth)

/* The first `count` of WIDTH values; 0 in the other lanes. */
static inline floatw loadw_first(global const float *from, ulong count) {
  float values[WIDTH];
  if (count >= WIDTH) return LOADW(from);
  for (uint l = 0; l < WIDTH; l++) values[l] = l < count ? from[l] : 0;
  return LOADW(values);
}

/* Stores the first `count` of WIDTH values. (On an x86 CPU, LLVM uses 512-bit registers in a function that has a vector
 * argument, and splits vectors into halves elsewhere.) */
static inline void storew_first(global float *to, floatw value, ulong count) {
  float values[WIDTH];
  if (count >= WIDTH) {
    STOREW(value, to);
    return;
  }
  STOREW(value, values);
  for (uint l = 0; l < count; l++) to[l] = values[l];
}

/* 0, 1, ... WIDTH - 1 */
static inline uintw lane_numbers(void) {
  uint values[WIDTH];
  for (uint l = 0; l < WIDTH; l++) values[l] = l;
  return LOADW(values);
}

/* Where row r and column c of a matrix of `rows` rows are that is laid out for tensor cores (tile.cl): fragments of 16 x 8
 * one after the other, of all rows for eight columns first; in a fragment the four values of each of 32 work-items. */
static inline uint fragment_at(uint r, uint c, uint rows) {
  return (((c / 8 * (rows / 16) + r / 16) * 32 + r % 8 * 4 + c % 4) * 4) + r % 16 / 8 + c % 8 / 4 * 2;
}
/* The 11 leading bits of x, which TF32 has, and as many after them. */
static inline float tf32_leading(float x) { return as_float(as_uint(x) & 0xFFFFE000u); }
static inline float tf32_rest(float x) { return x == tf32_leading(x) ? 0 : tf32_leading(x - tf32_leading(x)); }

/* Philox 4x32-10 as in core/rng.h: the first three words for one index, or for each of WIDTH indices. (The rounds are
 * unrolled so that a CPU's compiler vectorises over work-items.) */
#define RANDOM_AT(name, uints)                                                                           \
  static inline void name(uints word[3], ulong seed, ulong step, uints index, uint purpose) {            \
    uints c0 = (uint)step, c1 = (uint)(step >> 32), c2 = index, c3 = purpose;                            \
    uint k0 = (uint)seed, k1 = (uint)(seed >> 32);                                                       \
    _Pragma("unroll") for (int round = 0; round < 10; round++, k0 += 0x9E3779B9u, k1 += 0xBB67AE85u) {   \
      const uints low0 = 0xD2511F53u * c0, high0 = mul_hi((uints)(0xD2511F53u), c0);                     \
      const uints low1 = 0xCD9E8D57u * c2, high1 = mul_hi((uints)(0xCD9E8D57u), c2);                     \
      c0 = high1 ^ c1 ^ k0, c1 = low1;                                                                   \
      c2 = high0 ^ c3 ^ k1, c3 = low0;                                                                   \
    }                                                                                                    \
    word[0] = c0, word[1] = c1, word[2] = c2;                                                            \
  }
RANDOM_AT(random_of_one, uint)
RANDOM_AT(random_at, uintw)
