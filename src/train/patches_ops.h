/* SPDX-License-Identifier: MIT
 * A loss over square patches of a picture: structural similarity at several scales, value and gradient together
 * (docs/maths.md, The fine stage). */
#ifndef ERN_PATCHES_OPS_H
#define ERN_PATCHES_OPS_H

#include "core/operations.h"
#include "core/types.h"

enum {
  ERN_PATCH_SCALES = 3,     /* each of half the side of the one before */
  ERN_PATCH_UNIT = 16,      /* sides are multiples of it */
  ERN_PATCH_MOST_SIDE = 64, /* pixels */
  ERN_PATCH_RADIUS = 5      /* of the Gaussian window, in pixels of a scale */
};

/* Values of the filters of a patch: for each scale of side S the matrix A [S][S], which applies the Gaussian window to
 * a line of pixels (rows sum to 1, 0 beyond ERN_PATCH_RADIUS), and its transpose. */
static inline size_t ern_patch_filter_count(size_t side) {
  size_t count = 0;
  for (int scale = 0; scale < ERN_PATCH_SCALES; scale++) count += 2 * (side >> scale) * (side >> scale);
  return count;
}

/* x, y: one channel of a patch, rendered and recorded. Each scale averages 2 x 2 pixels of the one before. At each
 * scale:
 *
 *   m_x = A x A^T,   v_x = A x^2 A^T - m_x^2,   v_xy = A xy A^T - m_x m_y,   C1 = 0.01^2, C2 = 0.03^2
 *   SSIM = (2 m_x m_y + C1)(2 v_xy + C2) / ((m_x^2 + m_y^2 + C1)(v_x + v_y + C2))
 *   loss = weight mean(1 - SSIM), the mean over pixels of a scale, scales, channels and patches
 *
 * Wang et al., 2004; at several scales Wang et al., 2003, here their mean, not their product, whose gradient is
 * unbounded where a factor goes to 0. */
struct ern_patch_loss_args {
  ern_rows dpixel;       /* accumulates: [3] per ray */
  double term;           /* out, on the host */
  ern_rows pixel, truth; /* [3] per ray: patch after patch, in each row after row; 0..1 */
  ern_span filter;       /* real [ern_patch_filter_count(side)] */
  float weight;
  int side; /* pixels */
  size_t patches;
};
#define ERN_COST_patch_loss(a) ERN_COST_ELSEWHERE

/* One scale of one channel of a patch, arrays [side][side]: adds factor d(sum of 1 - SSIM)/dx to dx and returns the
 * sum. x, y: minus `base`, the mean of the recorded picture. a: the filter of the scale and its transpose.
 * scratch: [ERN_PATCH_SCALE_SCRATCH side^2] */
enum { ERN_PATCH_SCALE_SCRATCH = 7, ERN_PATCH_SCRATCH = ERN_PATCH_SCALE_SCRATCH + 3 };
typedef double ern_patch_scale_kernel(ern_real *dx, const ern_real *x, const ern_real *y, ern_real base,
                                      const ern_real *a, size_t side, ern_real factor, ern_real *scratch);

/* All scales of a channel: adds weight d(sum over scales of mean(1 - SSIM))/dx to dx [side][side] and returns the sum
 * times weight. scratch: [ERN_PATCH_SCRATCH side^2] */
double ERN_REF(ern_patch_pyramid)(ern_patch_scale_kernel *kernel, ern_real *dx, const ern_real *x, const ern_real *y,
                                  const ern_real *filters, int side, float weight, ern_real *scratch);

ERN_DECLARE_KERNELS(ERN_PATCHES_OPERATIONS)

#endif
