/* SPDX-License-Identifier: MIT
 * Reference of the upsampling (upsample_ops.h), as a separable filter: a part of a row is first interpolated from four
 * rows of the small picture, then along the row. */
#include <math.h>

#include "render/upsample_ops.h"

enum { STRETCH = 128 /* pixels of the large picture */, TAPS = 4, REACH = STRETCH + TAPS };

/* The position of a pixel in the small picture: the first of its four neighbours, and their weights. */
struct place {
  int first; /* of the four; may be outside */
  float weight[TAPS];
};

/* Keys' cubic with a = -1/2 at the distances 1 + f, f, 1 - f, 2 - f. */
static struct place place_of(int pixel, float ratio) {
  const float at = ((float)pixel + 0.5f) * ratio - 0.5f, floor = floorf(at), f = at - floor;
  return (struct place){.first = (int)floor - 1,
                        .weight = {((-0.5f * f + 1) * f - 0.5f) * f, (1.5f * f - 2.5f) * f * f + 1,
                                   ((-1.5f * f + 2) * f + 0.5f) * f, (0.5f * f - 0.5f) * f * f}};
}

static int inside(int pixel, int count) { return pixel < 0 ? 0 : pixel >= count ? count - 1 : pixel; }

static ern_real clamped(ern_real value, ern_real most) { return value > 0 ? (value < most ? value : most) : 0; }

/* out[x] = the four rows of the small picture at columns first + x, outermost ones repeated; x in [0, count) */
static void down(ern_real *out, const ern_real *const row[TAPS], const float weight[TAPS], int first, int count,
                 int width) {
  const int begin = inside(-first, count), end = inside(width - first, count + 1);
  for (int x = begin; x < end; x++)
    out[x] = row[0][first + x] * (ern_real)weight[0] + row[1][first + x] * (ern_real)weight[1] +
             row[2][first + x] * (ern_real)weight[2] + row[3][first + x] * (ern_real)weight[3];
  for (int x = 0; x < begin; x++) out[x] = out[begin];
  for (int x = end; x < count; x++) out[x] = out[end - 1];
}

static void across(ern_real *out, const ern_real *in, const struct place *place, int first, int count) {
  for (int x = 0; x < count; x++) {
    const struct place *p = &place[x];
    const ern_real *from = in + (p->first - first);
    out[x] = from[0] * (ern_real)p->weight[0] + from[1] * (ern_real)p->weight[1] + from[2] * (ern_real)p->weight[2] +
             from[3] * (ern_real)p->weight[3];
  }
}

/* Composites `count` pixels from `at` on over the background. */
static void over(const struct ern_upsample_view *v, size_t at, int count) {
  ern_real *opacity = v->large + 3 * v->large_stride + at;
  for (int x = 0; x < count; x++) opacity[x] = clamped(opacity[x], 1);
  for (size_t c = 0; c < 3; c++) {
    ern_real *colour = v->large + c * v->large_stride + at;
    const ern_real *background = v->background + c * v->background_stride + at;
    for (int x = 0; x < count; x++) colour[x] = clamped(colour[x], opacity[x]) + (1 - opacity[x]) * background[x];
  }
}

void ERN_REF(ern_upsample)(const struct ern_upsample_view *v, int begin, int end) {
  struct place place[STRETCH];
  ern_real line[REACH];
  for (int left = 0; left < v->width; left += STRETCH) {
    const int count = v->width - left < STRETCH ? v->width - left : STRETCH;
    for (int x = 0; x < count; x++) place[x] = place_of(left + x, v->ratio);
    const int first = place[0].first, reach = place[count - 1].first + TAPS - first;
    for (int y = begin; y < end; y++) {
      const struct place row = place_of(y, v->ratio);
      const size_t at = (size_t)y * (size_t)v->width + (size_t)left;
      for (int c = 0; c < v->channels; c++) {
        const ern_real *from[TAPS];
        for (int k = 0; k < TAPS; k++)
          from[k] = v->small + (size_t)c * v->small_stride +
                    (size_t)inside(row.first + k, v->small_height) * (size_t)v->small_width;
        down(line, from, row.weight, first, reach, v->small_width);
        across(v->large + (size_t)c * v->large_stride + at, line, place, first, count);
      }
      if (v->background != NULL) over(v, at, count);
    }
  }
}
