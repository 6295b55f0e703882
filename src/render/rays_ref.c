/* SPDX-License-Identifier: MIT
 * Rays of a pinhole camera (model.md section 1). In float in every build: a ray is an input of the model, and the float
 * and the double build have to look along the same ones. */
#include <math.h>

#include "render/render_kernels.h"

/* camera: c = ((i + 1/2 - cx)/f, (j + 1/2 - cy)/f, 1), then d = R c/|c|, R the rotation of the pose. */
void ERN_REF(ern_rays)(ern_real *dir, size_t stride, const int32_t *pixel, const struct ern_view *view, size_t n) {
  for (size_t r = 0; r < n; r++) {
    const float column = (float)(pixel[r] % view->width), row = (float)(pixel[r] / view->width);
    const float x = (column + 0.5f - view->cx) / view->focal, y = (row + 0.5f - view->cy) / view->focal;
    const float length = sqrtf(x * x + y * y + 1.0f);
    const float unit[3] = {x / length, y / length, 1.0f / length};
    for (size_t axis = 0; axis < 3; axis++) {
      const float *rotation = &view->pose[4 * axis];
      dir[axis * stride + r] = rotation[0] * unit[0] + rotation[1] * unit[1] + rotation[2] * unit[2];
    }
  }
}
