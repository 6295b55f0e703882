/* SPDX-License-Identifier: MIT
 * What OpenCL devices and drivers do not do, and the backend therefore does without. A line for each: its name, the
 * bound that the backend keeps to everywhere (0: the device is asked, or there is no number), where it comes from, and
 * the variable of tests/faults/opencl_faults.c that simulates it. The test of a line is test_NAME of
 * tests/faults/test_opencl_limits.c, which does not compile without. Sections and tables are those of the OpenCL 1.2
 * specification, revision 19.
 *
 * Drivers that end the process, and devices that are lost: probe.h and buffer.h. */
#ifndef ERN_OPENCL_LIMITS_H
#define ERN_OPENCL_LIMITS_H

#define ERN_CL_LIMITS(LIMIT)                                                                                         \
  /* Bytes of one clEnqueueFillBuffer. With 2 GiB or more NVIDIA's driver loses the device: measured on an H100 with \
   * driver 580.159; older cards: https://github.com/inducer/pyopencl/issues/395. ERNERF_FAULT_FILL */               \
  LIMIT(fill_bytes, 1 << 28)                                                                                         \
  /* Bytes of one buffer: CL_DEVICE_MAX_MEM_ALLOC_SIZE, which may be 128 MiB or a quarter of the memory (table 4.3). \
   * ERNERF_FAULT_MEMORY */                                                                                          \
  LIMIT(buffer_bytes, 0)                                                                                             \
  /* Memory may be lacking at a buffer's first use instead of when it is made: 5.2.1 and 5.2.3 both have             \
   * CL_MEM_OBJECT_ALLOCATION_FAILURE. ERNERF_FAULT_FIRST_USE */                                                     \
  LIMIT(first_use, 0)                                                                                                \
  /* Memory of the process to compile a program with: where it gets none, LLVM throws through PoCL 3.1, which takes  \
   * 120 MiB for the programs of a frame; and PoCL asserts that a buffer has memory at its first use. Both end the   \
   * process, so the system is asked before. The test limits the addresses */                                        \
  LIMIT(host_bytes, 128 << 20)                                                                                       \
  /* Local memory of a group: CL_DEVICE_LOCAL_MEM_SIZE. 32 KiB at least (table 4.3); 48 KiB on an H100.              \
   * ERNERF_FAULT_LOCAL */                                                                                           \
  LIMIT(local_bytes, 32 << 10)                                                                                       \
  /* Items of a group: CL_DEVICE_MAX_WORK_GROUP_SIZE is asked for larger ones; 1,024 on NVIDIA, 256 on AMD, only 1   \
   * is promised (table 4.3): a device with fewer than 64 is refused. ERNERF_FAULT_GROUP */                          \
  LIMIT(group_items, 64)                                                                                             \
  /* Bytes of all arguments of a kernel: CL_DEVICE_MAX_PARAMETER_SIZE, 1,024 at least (table 4.3).                   \
   * ERNERF_FAULT_ARGUMENTS */                                                                                       \
  LIMIT(argument_bytes, 1024)                                                                                        \
  /* Build options: -cl-fp32-correctly-rounded-divide-sqrt is refused unless the device says that it can (5.6.4.2),  \
   * -cl-nv-maxrregcount is NVIDIA's (cl_nv_compiler_options). ERNERF_FAULT_OPTIONS */                               \
  LIMIT(options, 0)                                                                                                  \
  /* Half and double precision, subgroups, 64-bit atomics, images: optional extensions and queries; an H100 has no   \
   * half and no subgroups. No kernel uses them: the test reads the sources */                                       \
  LIMIT(extensions, 0)                                                                                               \
  /* Additions to a float in memory by one instruction: cl_ext_float_atomics (                                       \
   * https://registry.khronos.org/OpenCL/extensions/ext/cl_ext_float_atomics.html) is optional; else float_add.h.    \
   * ERNERF_FAULT_FLOAT_ADD */                                                                                       \
  LIMIT(float_add, 0)                                                                                                \
  /* Times of events: CL_PROFILING_INFO_NOT_AVAILABLE (5.12). ERNERF_FAULT_TIMES */                                  \
  LIMIT(times, 0)                                                                                                    \
  /* Pinned host memory: CL_MEM_ALLOC_HOST_PTR (5.2.1) and its mapping may be refused. ERNERF_FAULT_PINNED */        \
  LIMIT(pinned, 0)

#define ERN_CL_LIMIT_VALUE(name, value) ERN_CL_LIMIT_##name = value,
enum ern_cl_limit { ERN_CL_LIMITS(ERN_CL_LIMIT_VALUE) };
#undef ERN_CL_LIMIT_VALUE

#endif
