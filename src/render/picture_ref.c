/* SPDX-License-Identifier: MIT
 * Reference of the conversions between bytes and rows (picture_ops.h). */
#include <math.h>

#include "render/picture_ops.h"

void ERN_REF(ern_background)(ern_real *pixel, size_t stride, ern_real *opacity, const uint8_t *background,
                             const uint8_t *torso, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const float a = torso != NULL ? (float)torso[4 * i + 3] / 255 : 0;
    for (size_t c = 0; c < 3; c++) {
      const float back = background != NULL ? (float)background[3 * i + c] / 255 : 0;
      const float front = torso != NULL ? (float)torso[4 * i + c] / 255 : 0;
      pixel[c * stride + i] = front * a + back * (1 - a);
    }
    opacity[i] = a;
  }
}

static uint8_t to_byte(float value) { return (uint8_t)lrintf(fminf(fmaxf(value, 0), 1) * 255); }

void ERN_REF(ern_picture)(const struct ern_picture_view *v, size_t n) {
  for (size_t i = 0; i < n; i++) {
    const bool opaque = v->head == NULL;
    const float head = opaque ? 1 : (float)v->head[i];
    const float alpha = opaque ? 1 : head + (1 - head) * (float)v->torso[i];
    for (size_t c = 0; c < 3; c++) {
      const float value = (float)v->pixel[c * v->stride + i];
      if (v->rgb != NULL) v->rgb[3 * i + c] = value;
      if (v->rgba != NULL) v->rgba[4 * i + c] = to_byte(opaque ? value : alpha > 0 ? value / alpha : 0);
    }
    if (v->rgba != NULL) v->rgba[4 * i + 3] = to_byte(alpha);
    if (v->alpha != NULL) v->alpha[i] = alpha;
  }
}

void ERN_REF(ern_gather)(ern_real *to, size_t to_stride, const ern_real *from, size_t from_stride, int channels,
                         const int32_t *pixel, size_t n) {
  for (size_t c = 0; c < (size_t)channels; c++)
    for (size_t i = 0; i < n; i++) to[c * to_stride + i] = from[c * from_stride + (size_t)pixel[i]];
}

void ERN_REF(ern_scatter)(ern_real *to, size_t to_stride, const ern_real *from, size_t from_stride, int channels,
                          const int32_t *pixel, size_t n) {
  for (size_t c = 0; c < (size_t)channels; c++)
    for (size_t i = 0; i < n; i++) to[c * to_stride + (size_t)pixel[i]] = from[c * from_stride + i];
}

/* In blocks that stay in the cache while the pictures are added. */
void ERN_REF(ern_blend)(ern_real *to, const ern_real *from, size_t from_stride, const ern_real *weight, size_t count,
                        const int32_t *pixel, size_t n) {
  enum { BLOCK = 256 };
  ern_real sum[BLOCK];
  for (size_t begin = 0; begin < n; begin += BLOCK) {
    const size_t some = n - begin < BLOCK ? n - begin : BLOCK;
    for (size_t i = 0; i < some; i++) sum[i] = 0;
    for (size_t k = 0; k < count; k++)
      for (size_t i = 0; i < some; i++) sum[i] += weight[k] * from[k * from_stride + begin + i];
    for (size_t i = 0; i < some; i++) to[pixel[begin + i]] = sum[i];
  }
}

void ERN_REF(ern_overlay)(ern_real *pixel, size_t pixel_stride, const ern_real *colour, size_t colour_stride,
                          const ern_real *opacity, const ern_real *background, size_t background_stride, size_t n) {
  for (size_t c = 0; c < 3; c++)
    for (size_t i = 0; i < n; i++) {
      const ern_real value = colour[c * colour_stride + i] + (1 - opacity[i]) * background[c * background_stride + i];
      pixel[c * pixel_stride + i] = value < 0 ? 0 : value > 1 ? 1 : value;
    }
}

bool ERN_REF(ern_finite)(const ern_real *values, size_t n) {
  for (size_t i = 0; i < n; i++) {
    if (!isfinite(values[i])) return false;
  }
  return true;
}
