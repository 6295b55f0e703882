/* SPDX-License-Identifier: MIT
 * A layer that was drawn small, over the picture that it is a part of. */
#ifndef ERN_ENLARGE_OPS_H
#define ERN_ENLARGE_OPS_H

#include "core/types.h"

/* Rows of a small picture drawn larger: bicubic (Keys 1981, a = -1/2: the cubic that passes through its four points
 * with Catmull-Rom's slopes), the outermost pixels repeated. Pixel x of the large one is at (x + 1/2) ratio - 1/2 of
 * the small one, in float in every build; likewise down. Sums are made down first, then across, left to right. */
struct ern_upsample_args {
  ern_rows large; /* out: [C] per pixel */
  ern_rows small; /* [C] per pixel */
  /* [3] per pixel of the large one: C is 4, premultiplied colour and opacity a; a becomes clamp(a, 0, 1), the colour
   * clamp(colour, 0, a) + (1 - a) background: a cubic rings. Zeroed: values as they come. */
  ern_rows background;
  int width, height, small_width, small_height; /* of the two, >= 1 */
  float ratio;                                  /* small over large, 0..1 */
};
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

#define ERN_UPSAMPLE_OPERATIONS(OP, X) OP(X, upsample, SLOT, REF)

#endif
