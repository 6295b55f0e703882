/* SPDX-License-Identifier: MIT
 * Kernels that measure a device's peaks: multiply-adds in registers, reads at random places of a small table, and
 * streams. The work is the same as that of a core in backend_cpu/peak_body.h. */
#define JOIN(a, b) a##b
#define VECTOR(type, width) JOIN(type, width)
#if WIDTH == 1
typedef float lanes;
typedef uint index;
#define LOAD(place) (*(place))
#define STORE(value, place) (*(place) = (value))
#else
typedef VECTOR(float, WIDTH) lanes;
typedef VECTOR(uint, WIDTH) index;
#define LOAD(place) VECTOR(vload, WIDTH)(0, place)
#define STORE(value, place) VECTOR(vstore, WIDTH)(value, 0, place)
#endif

#define MULTIPLY_CHAINS 12 /* independent, to hide the latency of the arithmetic units */
#define GATHER_CHAINS 4
#define TABLE_BITS 14 /* the table has 2^14 floats: 64 KiB, a level of a hash grid */
#define BLOCK 4096    /* floats that an item copies on a CPU; on a GPU neighbouring items take neighbouring float4 */

lanes multiply_add(lanes x, lanes a, lanes b) {
#ifdef FP_FAST_FMAF
  return fma(x, a, b);
#else
  return x * a + b;
#endif
}

/* chain = chain*a + b stays near its fixed point b/(1 - a): no denormals, no overflow. sink: [items] */
kernel void peak_multiply(SPAN(float, sink), uint turns) {
  OPEN(float, sink);
  const uint item = get_global_id(0);
  const lanes a = 0.999f, b = 1e-3f;
  lanes chain[MULTIPLY_CHAINS];
  for (int k = 0; k < MULTIPLY_CHAINS; k++) chain[k] = b * (float)(k + (item & 15));
  for (uint turn = 0; turn < turns; turn++) {
#pragma unroll
    for (int k = 0; k < MULTIPLY_CHAINS; k++) chain[k] = multiply_add(chain[k], a, b);
  }
  for (int k = 1; k < MULTIPLY_CHAINS; k++) chain[0] += chain[k];
  float first[WIDTH];
  STORE(chain[0], first);
  sink[item] = first[0];
}

#define AT4(i) table[i.s0], table[i.s1], table[i.s2], table[i.s3]
#if WIDTH == 1
#define AT(i) table[i]
#elif WIDTH == 4
#define AT(i) AT4(i)
#elif WIDTH == 8
#define AT(i) AT4(i.lo), AT4(i.hi)
#else
#define AT(i) AT4(i.lo.lo), AT4(i.lo.hi), AT4(i.hi.lo), AT4(i.hi.hi)
#endif
lanes gather(lanes sum, index at, global const float *table) { return sum + (lanes)(AT(at)); }

/* Indices are the high bits of a linear congruential generator (Numerical Recipes' constants). */
kernel void peak_gather(SPAN(float, sink), SPAN(const float, table), uint turns) {
  OPEN(float, sink);
  OPEN(const float, table);
  const uint item = get_global_id(0);
  lanes sum[GATHER_CHAINS];
  index state[GATHER_CHAINS];
  for (int k = 0; k < GATHER_CHAINS; k++) {
    uint seed[WIDTH];
    for (int l = 0; l < WIDTH; l++) seed[l] = 2654435761u * ((item * GATHER_CHAINS + k) * WIDTH + l + 1);
    state[k] = LOAD(seed);
    sum[k] = 0;
  }
  for (uint turn = 0; turn < turns; turn++) {
#pragma unroll
    for (int k = 0; k < GATHER_CHAINS; k++) {
      state[k] = state[k] * 1664525u + 1013904223u;
      sum[k] = gather(sum[k], state[k] >> (32 - TABLE_BITS), table);
    }
  }
  for (int k = 1; k < GATHER_CHAINS; k++) sum[0] += sum[k];
  float first[WIDTH];
  STORE(sum[0], first);
  sink[item] = first[0];
}

/* to = from; count: a multiple of BLOCK; both aligned to a vector. */
kernel void peak_copy(SPAN(float, to), SPAN(const float, from), ulong count) {
  OPEN(float, to);
  OPEN(const float, from);
  const ulong item = get_global_id(0);
#if CPU
  global lanes *const to_lanes = (global lanes *)(to + item * BLOCK);
  global const lanes *const from_lanes = (global const lanes *)(from + item * BLOCK);
  for (uint i = 0; i < BLOCK / WIDTH && item * BLOCK < count; i++) to_lanes[i] = from_lanes[i];
#else
  if (item * 4 < count) ((global float4 *)to)[item] = ((global const float4 *)from)[item];
#endif
}

/* x = -x in place: no cache line is fetched only to be overwritten. */
kernel void peak_update(SPAN(float, x), ulong count) {
  OPEN(float, x);
  const ulong item = get_global_id(0);
#if CPU
  global lanes *const x_lanes = (global lanes *)(x + item * BLOCK);
  for (uint i = 0; i < BLOCK / WIDTH && item * BLOCK < count; i++) x_lanes[i] = -x_lanes[i];
#else
  if (item * 4 < count) ((global float4 *)x)[item] = -((global const float4 *)x)[item];
#endif
}
