/* SPDX-License-Identifier: MIT
 * This text is put in front of the sources whose kernels process samples one by one. On a CPU an item takes a block of
 * samples, WIDTH at a time; on other devices neighbouring items take neighbouring samples. Products are not fused with
 * sums, as in the reference. */
#pragma OPENCL FP_CONTRACT OFF

#if CPU
#define GROUP 1
#define VECTORS 32
#else
#define GROUP 64
#define VECTORS 1
#endif
#define ITEM (VECTORS * WIDTH) /* samples per item */
#define KERNEL kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void

/* Loops over the samples of an item, WIDTH of them at a time from i on. `block` is the number of a block of GROUP*ITEM
 * samples. */
#define EACH_SAMPLE(i, block)                                                                 \
  const ulong first_ = ((ulong)(block) * GROUP + get_local_id(0)) * ITEM;                     \
  for (ulong i = first_; i < min(first_ + ITEM, n); i += WIDTH)
