/* SPDX-License-Identifier: MIT
 * Between the caller's pictures and the rows that rendering works on: bytes in before the layers, bytes out after, and
 * a layer that was drawn small in between. */
#ifndef ERN_PICTURE_OPS_H
#define ERN_PICTURE_OPS_H

#include "core/types.h"

/* What stands behind the layers, bytes/255: the torso picture over the background, front a + back (1 - a), the
 * background 0 where there is none. In float in every build: the pixels are those of the caller. */
struct ern_backdrop_args {
  ern_rows pixel;      /* out: [3] per pixel, premultiplied */
  ern_span opacity;    /* out: real [n], alpha of the torso picture; 0 without */
  ern_span background; /* byte [n][3]; zeroed: none */
  ern_span torso;      /* byte [n][4], alpha not multiplied in; zeroed: none */
  size_t n;
};
typedef void ern_backdrop_kernel(ern_real *pixel, size_t stride, ern_real *opacity, const uint8_t *background,
                                 const uint8_t *torso, size_t n);

/* Rows to a picture. Over a background alpha is 1; else alpha = head + (1 - head) torso, and the bytes are
 * colour/alpha, 0 where alpha is 0. A byte is round(255 clamp(value, 0, 1)), ties to even, NaN as 0; in float in every
 * build. */
struct ern_picture_args {
  ern_span rgba;        /* out: byte [n][4]; zeroed: not wanted */
  ern_span rgb;         /* out: real [n][3], premultiplied; zeroed: not wanted */
  ern_span alpha;       /* out: real [n]; zeroed: not wanted */
  ern_rows pixel;       /* [3] per pixel, premultiplied */
  ern_span head, torso; /* real [n], opacities; head zeroed: over a background */
  size_t n;
};
/* The same with pointers, all at the first of n pixels; NULL where a span is zeroed. */
struct ern_picture_view {
  uint8_t *rgba;
  ern_real *rgb, *alpha;
  const ern_real *pixel, *head, *torso;
  size_t stride; /* of pixel */
};
typedef void ern_picture_kernel(const struct ern_picture_view *view, size_t n);

/* Rows of a small picture drawn larger: bicubic (Keys 1981, a = -1/2: the cubic that passes through its four points
 * with Catmull-Rom's slopes), the outermost pixels repeated. Pixel x of the large one is at (x + 1/2) ratio - 1/2 of
 * the small one, in float in every build; likewise down. Sums are made down first, then across, left to right. */
struct ern_enlarge_args {
  ern_rows large; /* out: [C] per pixel */
  ern_rows small; /* [C] per pixel */
  /* [3] per pixel of the large one: C is 4, premultiplied colour and opacity a; a becomes clamp(a, 0, 1), the colour
   * clamp(colour, 0, a) + (1 - a) background: a cubic rings. Zeroed: values as they come. */
  ern_rows background;
  int width, height, small_width, small_height; /* of the two, >= 1 */
  float ratio;                                  /* small over large, 0..1 */
};
/* The same with pointers. */
struct ern_enlarge_view {
  ern_real *large;
  const ern_real *small, *background; /* background NULL: none */
  size_t large_stride, small_stride, background_stride;
  int channels, width, small_width, small_height;
  float ratio;
};
/* Rows [begin, end) of the large picture. */
typedef void ern_enlarge_kernel(const struct ern_enlarge_view *view, int begin, int end);

#endif
