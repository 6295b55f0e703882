/* SPDX-License-Identifier: MIT
 * Prefix sums of int32, none of which is negative. A work-item takes a run of `each` values, a group consecutive
 * runs. */

/* Sum of count[begin .. end). */
ulong run_sum(global const int *count, ulong begin, ulong end) {
  ulong sum = 0;
  for (ulong i = begin; i < end; i++) sum += (uint)count[i];
  return sum;
}

/* Sum of the items before this one. For the last item, this plus its `own` is the group's sum. */
ulong sum_before(local ulong *sums, ulong own) {
  const size_t item = get_local_id(0), items = get_local_size(0);
  ulong sum = own;
  sums[item] = sum;
  for (size_t apart = 1; apart < items; apart *= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    const ulong before = item >= apart ? sums[item - apart] : 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    sum += before;
    sums[item] = sum;
  }
  return sum - own;
}

/* sum[g] = the sum of group g's values, at most INT_MAX + 1. */
kernel void scan_sums(SPAN(uint, sum), SPAN(const int, count), ulong each, ulong n, local ulong *sums) {
  OPEN(uint, sum);
  OPEN(const int, count);
  const ulong begin = min(n, get_global_id(0) * each), end = min(n, begin + each);
  const ulong own = run_sum(count, begin, end), before = sum_before(sums, own);
  if (get_local_id(0) + 1 == get_local_size(0)) sum[get_group_id(0)] = (uint)min(before + own, (ulong)INT_MAX + 1);
}

/* first[i] = base[group] + the sum of the group's values before i; first[n] = the total. total [2]: the lower and the
 * upper half of the total, null: not wanted. base null: one group, from 0. */
kernel void scan(SPAN(int, first), SPAN(uint, total), SPAN(const int, count), SPAN(const int, base), ulong each,
                 ulong n, local ulong *sums) {
  OPEN(int, first);
  OPEN(uint, total);
  OPEN(const int, count);
  OPEN(const int, base);
  const ulong begin = min(n, get_global_id(0) * each), end = min(n, begin + each);
  ulong sum = sum_before(sums, run_sum(count, begin, end));
  if (base) sum += base[get_group_id(0)];
  for (ulong i = begin; i < end; i++) {
    first[i] = (int)sum;
    sum += (uint)count[i];
  }
  const bool is_last = n == 0 ? get_global_id(0) == 0 : begin < n && end == n;
  if (!is_last) return;
  first[n] = (int)sum;
  if (total) {
    total[0] = (uint)sum;
    total[1] = (uint)(sum >> 32);
  }
}
