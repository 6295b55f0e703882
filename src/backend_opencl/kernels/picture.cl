/* SPDX-License-Identifier: MIT
 * Conversion between pictures of bytes and rows of floats (picture_ops.h); a work-item takes WIDTH pixels. The results
 * equal the reference's. */

#pragma OPENCL FP_CONTRACT OFF

/* Pixels that an item has from i on. */
ulong count_of(ulong i, ulong n) { return i < n ? min(n - i, (ulong)WIDTH) : 0; }

/* ---- in ---- */

/* byte/255, correctly rounded even on devices whose division is not: the remainder of the quotient is exact and small,
 * and corrects it. */
floatw share_of(uintw byte) {
  const floatw value = JOINW(convert_float)(byte), quotient = value * (1.0f / 255);
  return fma(fma(-quotient, (floatw)255, value), (floatw)(1.0f / 255), quotient);
}

/* RGBA of the first `count` pixels, R in the low byte; 0 in the other lanes. from: byte [count][4] */
uintw load_rgba(global const uchar *from, ulong count) {
  uint word[WIDTH];
  for (uint l = 0; l < WIDTH; l++) word[l] = count >= WIDTH || l < count ? as_uint(vload4(l, from)) : 0;
  return LOADW(word);
}

/* The same for byte [count][3]; the high byte is 0. */
uintw load_rgb(global const uchar *from, ulong count) {
  uint word[WIDTH];
  for (uint l = 0; l < WIDTH; l++)
    word[l] = count >= WIDTH || l < count ? from[3 * l] | from[3 * l + 1] << 8 | from[3 * l + 2] << 16 : 0;
  return LOADW(word);
}

/* pixel: [3] per pixel; opacity: [n]; background: byte [n][3], torso: byte [n][4]; null: none.
 * front a + back (1 - a) */
kernel void background(ROWS(float, pixel), SPAN(float, opacity), SPAN(const uchar, background), SPAN(const uchar, torso),
                     ulong n) {
  OPEN(float, pixel);
  OPEN(float, opacity);
  OPEN(const uchar, background);
  OPEN(const uchar, torso);
  const ulong i = get_global_id(0) * WIDTH, count = count_of(i, n);
  if (count == 0) return;
  const uintw front = torso ? load_rgba(torso + 4 * i, count) : 0;
  const uintw back = background ? load_rgb(background + 3 * i, count) : 0;
  const floatw a = share_of(front >> 24);
  for (uint c = 0; c < 3; c++) {
    const floatw own = share_of(front >> 8 * c & 255), behind = share_of(back >> 8 * c & 255);
    storew_first(pixel + c * pixel_stride + i, own * a + behind * (1 - a), count);
  }
  storew_first(opacity + i, a, count);
}

/* ---- out ---- */

/* round(255 clamp(value, 0, 1)), ties to even, NaN as 0 */
uintw to_byte(floatw value) { return JOINW(convert_uint)(rint(fmin(fmax(value, (floatw)0), (floatw)1) * 255)); }

void store_rgba(global uchar *to, uintw rgba, ulong count) {
  uint word[WIDTH];
  STOREW(rgba, word);
  if (count >= WIDTH) {
    for (uint l = 0; l < WIDTH; l++) vstore4(as_uchar4(word[l]), l, to);
    return;
  }
  for (uint l = 0; l < count; l++) vstore4(as_uchar4(word[l]), l, to);
}

void store_rgb(global float *to, floatw x, floatw y, floatw z, ulong count) {
  float word[3][WIDTH];
  STOREW(x, word[0]);
  STOREW(y, word[1]);
  STOREW(z, word[2]);
  for (uint l = 0; l < count; l++) vstore3((float3)(word[0][l], word[1][l], word[2][l]), l, to);
}

/* rgba: byte [n][4], rgb: [n][3], alpha: [n]; null: not wanted. pixel: [3] per pixel; head, torso: [n]; head null: the
 * pixels include a background, and alpha is 1. */
kernel void picture(SPAN(uchar, rgba), SPAN(float, rgb), SPAN(float, alpha), ROWS(const float, pixel),
                    SPAN(const float, head), SPAN(const float, torso), ulong n) {
  OPEN(uchar, rgba);
  OPEN(float, rgb);
  OPEN(float, alpha);
  OPEN(const float, pixel);
  OPEN(const float, head);
  OPEN(const float, torso);
  const ulong i = get_global_id(0) * WIDTH, count = count_of(i, n);
  if (count == 0) return;
  floatw x = loadw_first(pixel + i, count), y = loadw_first(pixel + pixel_stride + i, count);
  floatw z = loadw_first(pixel + 2 * pixel_stride + i, count), a = 1;
  if (rgb) store_rgb(rgb + 3 * i, x, y, z, count);
  if (head) {
    const floatw own = loadw_first(head + i, count);
    a = own + (1 - own) * loadw_first(torso + i, count);
    x = WHERE(a > 0, x / a, 0);
    y = WHERE(a > 0, y / a, 0);
    z = WHERE(a > 0, z / a, 0);
  }
  if (rgba) store_rgba(rgba + 4 * i, to_byte(x) | to_byte(y) << 8 | to_byte(z) << 16 | to_byte(a) << 24, count);
  if (alpha) storew_first(alpha + i, a, count);
}

/* ---- some pixels ---- */

/* to(c, i) = from(c, pixel[i]); one item per pixel */
kernel void gather(ROWS(float, to), ROWS(const float, from), SPAN(const int, pixel), int channels, ulong n) {
  OPEN(float, to);
  OPEN(const float, from);
  OPEN(const int, pixel);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  for (int c = 0; c < channels; c++) to[c * to_stride + i] = from[c * from_stride + pixel[i]];
}

/* to(c, pixel[i]) = from(c, i) */
kernel void scatter(ROWS(float, to), ROWS(const float, from), SPAN(const int, pixel), int channels, ulong n) {
  OPEN(float, to);
  OPEN(const float, from);
  OPEN(const int, pixel);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  for (int c = 0; c < channels; c++) to[c * to_stride + pixel[i]] = from[c * from_stride + i];
}

/* to(pixel[i]) = sum_k weight[k] from(k, i) */
kernel void blend(SPAN(float, to), ROWS(const float, from), SPAN(const float, weight), SPAN(const int, pixel),
                  ulong count, ulong n) {
  OPEN(float, to);
  OPEN(const float, from);
  OPEN(const float, weight);
  OPEN(const int, pixel);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  float sum = 0;
  for (ulong k = 0; k < count; k++) sum += weight[k] * from[k * from_stride + i];
  to[pixel[i]] = sum;
}

/* pixel = clamp(colour + (1 - opacity) background, 0, 1) */
kernel void overlay(ROWS(float, pixel), ROWS(const float, colour), SPAN(const float, opacity),
                    ROWS(const float, background), ulong n) {
  OPEN(float, pixel);
  OPEN(const float, colour);
  OPEN(const float, opacity);
  OPEN(const float, background);
  const ulong i = get_global_id(0) * WIDTH, count = count_of(i, n);
  if (count == 0) return;
  const floatw through = 1 - loadw_first(opacity + i, count);
  for (uint c = 0; c < 3; c++) {
    const floatw value = loadw_first(colour + c * colour_stride + i, count) +
                         through * loadw_first(background + c * background_stride + i, count);
    storew_first(pixel + c * pixel_stride + i, WHERE(value < 0, 0, WHERE(value > 1, 1, value)), count);
  }
}

/* ---- finite values ---- */

#define GROUP 64              /* values that a group tests at a time; ERN_CL_SUM_GROUP */
#define ITEMS (GROUP / WIDTH) /* work-items of a group */

/* found: [groups], whether one of a group's values, (n + groups - 1)/groups consecutive ones, is not finite */
kernel __attribute__((reqd_work_group_size(ITEMS, 1, 1))) void finite(SPAN(int, found), SPAN(const float, values),
                                                                      ulong n) {
  OPEN(int, found);
  OPEN(const float, values);
  local uint any[GROUP];
  const ulong part = (n + get_num_groups(0) - 1) / get_num_groups(0);
  const ulong begin = min(get_group_id(0) * part, n), end = min(begin + part, n);
  const uint item = get_local_id(0);
  uintw own = 0; /* the largest exponent */
  for (ulong i = begin + item * WIDTH; i < end; i += GROUP)
    own = max(own, JOINW(as_uint)(loadw_first(values + i, end - i)) & 0x7f800000u);
  STOREW(own, any + item * WIDTH);
  barrier(CLK_LOCAL_MEM_FENCE);
  if (item != 0) return;
  uint most = 0;
  for (uint k = 0; k < GROUP; k++) most = max(most, any[k]);
  found[get_group_id(0)] = most == 0x7f800000u;
}
