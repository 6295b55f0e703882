/* SPDX-License-Identifier: MIT
 * Converts between bytes and rows (picture_ops.h), LANES pixels at a time, bit-identical to the reference. Assumes a
 * little-endian machine, as all with these instruction sets are. */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes.h"
#include "render/picture_ops.h"

/* Bytes of a pixel, r in the lowest. */
LANES_INLINE vu pixels_of_3(const uint8_t *from, size_t count) {
  uint32_t value[LANES] = {0};
  vu all;
  for (size_t l = 0; l < count; l++)
    value[l] = (uint32_t)from[3 * l] | (uint32_t)from[3 * l + 1] << 8 | (uint32_t)from[3 * l + 2] << 16;
  memcpy(&all, value, sizeof all);
  return all;
}
LANES_INLINE vu pixels_of_4(const uint8_t *from, size_t count) {
  vu all = {0};
  if (count == LANES)
    memcpy(&all, from, sizeof all);
  else
    memcpy(&all, from, 4 * count);
  return all;
}

/* byte/255, a division as in the reference: 1/255 has no exact float */
LANES_INLINE vf share_of(vu pixels, int byte) {
  return __builtin_convertvector((vi)(pixels >> (uint32_t)(8 * byte) & 255u), vf) / vf_all(255);
}

LANES_INLINE void background_some(float *pixel, size_t stride, float *opacity, const uint8_t *background,
                                  const uint8_t *torso, size_t count) {
  const vu back = background != NULL ? pixels_of_3(background, count) : (vu){0};
  const vu front = torso != NULL ? pixels_of_4(torso, count) : (vu){0};
  const vf a = share_of(front, 3);
  for (int c = 0; c < 3; c++) {
    vf value = share_of(back, c);
    if (torso != NULL) value = vf_multiply_rounded(share_of(front, c), a) + vf_multiply_rounded(value, vf_all(1) - a);
    vf_store_partial(pixel + (size_t)c * stride, value, count);
  }
  vf_store_partial(opacity, a, count);
}

void ERN_ISA(ern_background)(float *pixel, size_t stride, float *opacity, const uint8_t *background,
                             const uint8_t *torso, size_t n) {
  for (size_t i = 0; i < n; i += LANES) {
    const size_t count = n - i < LANES ? n - i : LANES;
    background_some(pixel + i, stride, opacity + i, background != NULL ? background + 3 * i : NULL,
                    torso != NULL ? torso + 4 * i : NULL, count);
  }
}

/* round(255 clamp(value, 0, 1)) in the lowest bits: adding 1.5*2^23 leaves an integer in the mantissa, rounded to even.
 */
LANES_INLINE vu byte_of(vf value) {
  const vf above = vf_select(value > vf_all(0), value, vf_all(0)); /* NaN: 0 */
  const vf inside = vf_select(above < vf_all(1), above, vf_all(1));
  return (vu)(vf_multiply_rounded(inside, vf_all(255)) + vf_all(12582912.0f)) & 255u;
}

LANES_INLINE void store_pixels(uint8_t *to, vu pixels, size_t count) {
  if (count == LANES)
    memcpy(to, &pixels, sizeof pixels);
  else
    memcpy(to, &pixels, 4 * count);
}

LANES_INLINE void picture_some(const struct ern_picture_view *v, size_t i, size_t count) {
  vf alpha = vf_all(1);
  vu pixels = vu_all(0);
  if (v->head != NULL) {
    const vf head = vf_load_partial(v->head + i, count);
    alpha = head + vf_multiply_rounded(vf_all(1) - head, vf_load_partial(v->torso + i, count));
  }
  for (int c = 0; c < 3; c++) {
    vf value = vf_load_partial(v->pixel + (size_t)c * v->stride + i, count);
    if (v->rgb != NULL)
      for (size_t l = 0; l < count; l++) v->rgb[3 * (i + l) + (size_t)c] = value[l];
    if (v->head != NULL) value = vf_select(alpha > vf_all(0), value / alpha, vf_all(0));
    pixels |= byte_of(value) << (uint32_t)(8 * c);
  }
  if (v->rgba != NULL) store_pixels(v->rgba + 4 * i, pixels | byte_of(alpha) << 24u, count);
  if (v->alpha != NULL) vf_store_partial(v->alpha + i, alpha, count);
}

void ERN_ISA(ern_picture)(const struct ern_picture_view *view, size_t n) {
  for (size_t i = 0; i < n; i += LANES) picture_some(view, i, n - i < LANES ? n - i : LANES);
}

bool ERN_ISA(ern_finite)(const float *values, size_t n) {
  enum { ABREAST = 8, TURN = ABREAST * LANES };
  const int32_t exponent = 0x7f800000;
  size_t i = 0;
  for (; i + TURN <= n; i += TURN) {
    vi odd = {0};
    for (size_t k = 0; k < ABREAST; k++) odd |= ((vi)vf_load(values + i + k * LANES) & exponent) == exponent;
    if (vi_any(odd)) return false;
  }
  for (; i < n; i += LANES) {
    const vi bits = (vi)vf_load_partial(values + i, n - i < LANES ? n - i : LANES);
    if (vi_any((bits & exponent) == exponent)) return false;
  }
  return true;
}
