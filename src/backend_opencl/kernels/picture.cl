/* SPDX-License-Identifier: MIT
 * Between bytes and rows (picture_ops.h): a work-item a pixel, the same numbers as the reference's. */

#pragma OPENCL FP_CONTRACT OFF

/* byte/255, correctly rounded on devices too whose division is not: the quotient's remainder is exact, and small. */
float share_of(uchar byte) {
  const float quotient = byte * (1.0f / 255);
  return fma(fma(-quotient, 255.0f, (float)byte), 1.0f / 255, quotient);
}

/* pixel: [3] per pixel; opacity: [n]; background: byte [n][3], torso: byte [n][4]; null: none.
 * front a + back (1 - a) */
kernel void backdrop(ROWS(float, pixel), SPAN(float, opacity), SPAN(const uchar, background), SPAN(const uchar, torso),
                     ulong n) {
  OPEN(float, pixel);
  OPEN(float, opacity);
  OPEN(const uchar, background);
  OPEN(const uchar, torso);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const uchar4 layer = torso ? vload4(i, torso) : (uchar4)0;
  const uchar3 behind = background ? vload3(i, background) : (uchar3)0;
  const float a = share_of(layer.w);
  pixel[i] = share_of(layer.x) * a + share_of(behind.x) * (1 - a);
  pixel[pixel_stride + i] = share_of(layer.y) * a + share_of(behind.y) * (1 - a);
  pixel[2 * pixel_stride + i] = share_of(layer.z) * a + share_of(behind.z) * (1 - a);
  opacity[i] = a;
}

/* round(255 clamp(value, 0, 1)), ties to even, NaN as 0 */
uchar to_byte(float value) { return (uchar)(int)rint(fmin(fmax(value, 0.0f), 1.0f) * 255); }

/* rgba: byte [n][4], rgb: [n][3], alpha: [n]; null: not wanted. pixel: [3] per pixel; head, torso: [n]; head null: over
 * a background, where alpha is 1. */
kernel void picture(SPAN(uchar, rgba), SPAN(float, rgb), SPAN(float, alpha), ROWS(const float, pixel),
                    SPAN(const float, head), SPAN(const float, torso), ulong n) {
  OPEN(uchar, rgba);
  OPEN(float, rgb);
  OPEN(float, alpha);
  OPEN(const float, pixel);
  OPEN(const float, head);
  OPEN(const float, torso);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const float x = pixel[i], y = pixel[pixel_stride + i], z = pixel[2 * pixel_stride + i];
  const float a = head ? head[i] + (1 - head[i]) * torso[i] : 1;
  if (rgba) {
    uchar4 bytes = (uchar4)(0, 0, 0, to_byte(a));
    if (!head) bytes.xyz = (uchar3)(to_byte(x), to_byte(y), to_byte(z));
    if (head && a > 0) bytes.xyz = (uchar3)(to_byte(x / a), to_byte(y / a), to_byte(z / a));
    vstore4(bytes, i, rgba);
  }
  if (rgb) vstore3((float3)(x, y, z), i, rgb);
  if (alpha) alpha[i] = a;
}
