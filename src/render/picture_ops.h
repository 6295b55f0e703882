/* SPDX-License-Identifier: MIT
 * Conversions between the caller's pictures and the rows that rendering works on: bytes to rows before the layers, rows
 * to bytes after them, and layers of which only some pixels were rendered. */
#ifndef ERN_PICTURE_OPS_H
#define ERN_PICTURE_OPS_H

#include "core/operations.h"
#include "core/types.h"

/* The picture behind the layers, bytes/255: the torso picture over the background, front a + back (1 - a); without a
 * background it is 0. In float in every build: the pixels are those of the caller. */
struct ern_background_args {
  ern_rows pixel;      /* out: [3] per pixel, premultiplied */
  ern_span opacity;    /* out: real [n], alpha of the torso picture; 0 without */
  ern_span background; /* byte [n][3]; zeroed: none */
  ern_span torso;      /* byte [n][4], alpha not multiplied in; zeroed: none */
  size_t n;
};
/* Bytes are a quarter of an int. */
#define ERN_COST_background(a) \
  ern_cost("pixel", (a)->n, (a)->torso.buffer != NULL ? 13 : 3, 4, (a)->torso.buffer != NULL ? 1.75 : 0.75, 0)
typedef void ern_background_kernel(ern_real *pixel, size_t stride, ern_real *opacity, const uint8_t *background,
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
#define ERN_COST_picture(a) \
  ern_cost("pixel", (a)->n, (a)->head.buffer != NULL ? 10 : 3, (a)->head.buffer != NULL ? 5 : 3, 1, 0)
/* The same with pointers, all at the first of n pixels; NULL where a span is zeroed. */
struct ern_picture_view {
  uint8_t *rgba;
  ern_real *rgb, *alpha;
  const ern_real *pixel, *head, *torso;
  size_t stride; /* of pixel */
};
typedef void ern_picture_kernel(const struct ern_picture_view *view, size_t n);

/* Some pixels of a picture as rows in the order of a list: to(c, i) = from(c, pixel[i]) */
struct ern_gather_args {
  ern_rows to; /* out: [C] */
  ern_rows from;
  ern_span pixel; /* int32 [n] */
  size_t n;
};
#define ERN_COST_gather(a) ern_cost("pixel", (a)->n, 0, 2.0 * (a)->from.rows, 1, 0)
typedef void ern_gather_kernel(ern_real *to, size_t to_stride, const ern_real *from, size_t from_stride, int channels,
                               const int32_t *pixel, size_t n);

/* And back: to(c, pixel[i]) = from(c, i); no pixel is listed twice. */
struct ern_scatter_args {
  ern_rows to; /* out: [C] */
  ern_rows from;
  ern_span pixel; /* int32 [n] */
  size_t n;
};
#define ERN_COST_scatter(a) ern_cost("pixel", (a)->n, 0, 2.0 * (a)->from.rows, 1, 0)
typedef ern_gather_kernel ern_scatter_kernel;

/* Interpolates pixels between known pictures: to(pixel[i]) = sum_k weight[k] from(k, i), added in the order of k. No
 * pixel is listed twice. */
struct ern_blend_args {
  ern_span to;     /* out: real, one a pixel */
  ern_rows from;   /* [count], in the order of the list */
  ern_span weight; /* real [count] */
  ern_span pixel;  /* int32 [n] */
  size_t n;
};
#define ERN_COST_blend(a) ern_cost("pixel", (a)->n, 2.0 * (a)->from.rows, 1.0 + (a)->from.rows, 1, 0)
typedef void ern_blend_kernel(ern_real *to, const ern_real *from, size_t from_stride, const ern_real *weight,
                              size_t count, const int32_t *pixel, size_t n);

/* Repeats the last step of compositing over another background: pixel = clamp(colour + (1 - opacity) background, 0,
 * 1). */
struct ern_overlay_args {
  ern_rows pixel;   /* out: [3] per pixel */
  ern_rows colour;  /* [3], sum w rgb */
  ern_span opacity; /* real [n], sum w */
  ern_rows background;
  size_t n;
};
#define ERN_COST_overlay(a) ern_cost("pixel", (a)->n, 7, 10, 0, 0)
typedef void ern_overlay_kernel(ern_real *pixel, size_t pixel_stride, const ern_real *colour, size_t colour_stride,
                                const ern_real *opacity, const ern_real *background, size_t background_stride,
                                size_t n);

/* Whether all values are finite. */
struct ern_finite_args {
  ern_span values;
  size_t n;
  bool finite; /* out, on the host */
};
#define ERN_COST_finite(a) ern_cost("value", (a)->n, 0, 1, 0, 0)
typedef bool ern_finite_kernel(const ern_real *values, size_t n);

ERN_DECLARE_KERNELS(ERN_PICTURE_OPERATIONS)

#endif
