/* SPDX-License-Identifier: MIT
 * In front of the sources whose kernels go over samples one by one: on a CPU an item takes a block of samples, WIDTH at
 * a time, elsewhere neighbouring items neighbouring samples. Products are rounded by themselves, as the reference has
 * them. */
#pragma OPENCL FP_CONTRACT OFF

#if CPU
#define GROUP 1
#define VECTORS 32
#else
#define GROUP 64
#define VECTORS 1
#endif
#define ITEM (VECTORS * WIDTH) /* samples an item */
#define KERNEL kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void

/* The samples of an item: for each `i`, WIDTH of them from i on. `block` counts blocks of GROUP*ITEM samples. */
#define EACH_SAMPLE(i, block)                                                                 \
  const ulong first_ = ((ulong)(block) * GROUP + get_local_id(0)) * ITEM;                     \
  for (ulong i = first_; i < min(first_ + ITEM, n); i += WIDTH)
