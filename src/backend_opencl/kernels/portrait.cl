/* SPDX-License-Identifier: MIT
 * Run once before the frames: they lay out a model for the fused kernels (tile.cl). */
/* value (c0, c1) = table[index(c0, c1)], for a level of [side][side] values: dense while that fits, else the hash. */
kernel void unhash(SPAN(float, value), SPAN(const float, table), uint side, uint size, int hashed, ulong n) {
  OPEN(float, value);
  OPEN(const float, table);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const uint c1 = (uint)(i / side), c0 = (uint)(i % side);
  value[i] = table[(hashed ? c0 ^ c1 * 2654435761u : c0 + c1 * side) % size];
}

/* packed (r, at + c) = A (r, c), a block of `block` rows being `width` columns wide; A: rows `row_step` apart. */
kernel void pack(SPAN(float, packed), SPAN(const float, a), ulong row_step, uint rows, uint columns, uint block,
                        uint width, uint at) {
  OPEN(float, packed);
  OPEN(const float, a);
  const uint r = (uint)get_global_id(0) / columns, c = (uint)get_global_id(0) % columns;
  if (r >= rows) return;
  packed[(r / block * width + at + c) * block + r % block] = a[r * row_step + c];
}

/* packed (r, at + c) = sum_k A (r, k) scale_k B (k, c); no scale: ones. B: [count][columns]. */
kernel void multiply(SPAN(float, packed), SPAN(const float, a), SPAN(const float, scale), SPAN(const float, b),
                            ulong row_step, uint count, uint rows, uint columns, uint block, uint width, uint at) {
  OPEN(float, packed);
  OPEN(const float, a);
  OPEN(const float, scale);
  OPEN(const float, b);
  const uint r = (uint)get_global_id(0) / columns, c = (uint)get_global_id(0) % columns;
  if (r >= rows) return;
  float sum = 0;
  for (uint k = 0; k < count; k++) sum += a[r * row_step + k] * (scale ? scale[k] : 1) * b[k * columns + c];
  packed[(r / block * width + at + c) * block + r % block] = sum;
}
