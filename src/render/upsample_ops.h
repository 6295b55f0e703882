/* SPDX-License-Identifier: MIT
 * Upsampling of a layer that was rendered at low resolution, and its compositing over the picture. */
#ifndef ERN_UPSAMPLE_OPS_H
#define ERN_UPSAMPLE_OPS_H

#include "core/operations.h"
#include "core/types.h"

/* Bicubic upsampling (Keys 1981, a = -1/2: the Catmull-Rom cubic), edge pixels repeated. Pixel x of the large picture
 * is at (x + 1/2) ratio - 1/2 of the small one, in float in every build; rows likewise. Sums run vertically first, then
 * horizontally, left to right. */
struct ern_upsample_args {
  ern_rows large; /* out: [C] per pixel */
  ern_rows small; /* [C] per pixel */
  /* [3] per pixel of the large one: C is 4, premultiplied colour and opacity a; a becomes clamp(a, 0, 1), the colour
   * clamp(colour, 0, a) + (1 - a) background: bicubic interpolation overshoots. Zeroed: values are not changed. */
  ern_rows background;
  int width, height, small_width, small_height; /* of both pictures, >= 1 */
  float ratio;                                  /* small over large, 0..1 */
};
/* 7 multiply-adds for each channel and intermediate column, 7 for the rows. */
#define ERN_COST_upsample(a) \
  ern_cost("pixel", (size_t)(a)->width *(size_t)(a)->height, 14.0 * (a)->large.rows, 2.0 * (a)->large.rows, 0, 0)
/* The same with pointers. */
struct ern_upsample_view {
  ern_real *large;
  const ern_real *small, *background; /* background NULL: none */
  size_t large_stride, small_stride, background_stride;
  int channels, width, small_width, small_height;
  float ratio;
};
/* Rows [begin, end) of the large picture. */
typedef void ern_upsample_kernel(const struct ern_upsample_view *view, int begin, int end);

ERN_DECLARE_KERNELS(ERN_UPSAMPLE_OPERATIONS)

#endif
