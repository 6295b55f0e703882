/* SPDX-License-Identifier: MIT
 * An addition to a float in global memory that other items may add to at the same time. Build option: FLOAT_ADD, the
 * way (ern_cl_float_add of device/float_add.h). */
#pragma OPENCL FP_CONTRACT OFF

static inline void add_atomically(volatile global float *at, float value) {
#if FLOAT_ADD == 1
  /* PTX ISA, red: subnormal values and sums become zero */
  asm volatile("red.global.add.f32 [%0], %1;" ::"l"(at), "f"(value) : "memory");
#elif FLOAT_ADD == 2
  atomic_fetch_add_explicit((volatile global atomic_float *)at, value, memory_order_relaxed);
#elif FLOAT_ADD == 3
  __builtin_amdgcn_global_atomic_fadd_f32((global float *)at, value);
#else
  volatile global uint *bits = (volatile global uint *)at;
  uint before = atomic_or(bits, 0), found; /* reads it */
  while ((found = atomic_cmpxchg(bits, before, as_uint(as_float(before) + value))) != before) before = found;
#endif
}
