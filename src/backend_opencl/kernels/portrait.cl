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

/* (r, c) of a packed matrix of `width` columns in blocks of `block` rows. block 0: for tensor cores, each value as two
 * of TF32, all rests after all leading parts. */
static void put(global float *packed, uint rows, uint width, uint block, uint r, uint c, float value) {
  if (block > 0) {
    packed[(r / block * width + c) * block + r % block] = value;
  } else {
    const uint at = fragment_at(r, c, rows);
    packed[at] = tf32_leading(value), packed[rows * width + at] = tf32_rest(value);
  }
}

/* packed (r, at + c) = A (r, c); A: rows `row_step` apart. */
kernel void pack(SPAN(float, packed), SPAN(const float, a), ulong row_step, uint rows, uint columns, uint block,
                        uint width, uint at) {
  OPEN(float, packed);
  OPEN(const float, a);
  const uint r = (uint)get_global_id(0) / columns, c = (uint)get_global_id(0) % columns;
  if (r >= rows) return;
  put(packed, rows, width, block, r, at + c, a[r * row_step + c]);
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
  put(packed, rows, width, block, r, at + c, sum);
}
