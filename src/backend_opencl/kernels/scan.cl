/* SPDX-License-Identifier: MIT
 * Running sums of int32, none of which is negative. A work-item takes a run of `each` values, a group one behind the
 * other. */

/* Sum of count[begin .. end). */
ulong run_sum(global const int *count, ulong begin, ulong end) {
  ulong sum = 0;
  for (ulong i = begin; i < end; i++) sum += (uint)count[i];
  return sum;
}

/* Sum of the items before this one; the last item's `own` added gives the group's. */
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

/* sum[g] of group g's values; one more than an int can be where it is more. */
kernel void scan_sums(SPAN(uint, sum), SPAN(const int, count), ulong each, ulong n, local ulong *sums) {
  OPEN(uint, sum);
  OPEN(const int, count);
  const ulong begin = min(n, get_global_id(0) * each), end = min(n, begin + each);
  const ulong own = run_sum(count, begin, end), before = sum_before(sums, own);
  if (get_local_id(0) + 1 == get_local_size(0)) sum[get_group_id(0)] = (uint)min(before + own, (ulong)INT_MAX + 1);
}

/* first[i] = base[group] + the group's values before i, and behind the last of all the total, which also goes into
 * total[2] as its lower and its upper half. base null: one group, from 0. */
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
