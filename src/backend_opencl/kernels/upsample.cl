/* SPDX-License-Identifier: MIT
 * Upsamples a picture (upsample_ops.h); one work-item per pixel. The sums and their order are those of the
 * reference. */

#pragma OPENCL FP_CONTRACT OFF

/* The first of the four small pixels around a large one, and their weights: Keys' cubic with a = -1/2. */
static int place_of(int pixel, float ratio, float weight[4]) {
  const float at = ((float)pixel + 0.5f) * ratio - 0.5f, low = floor(at), f = at - low;
  weight[0] = ((-0.5f * f + 1) * f - 0.5f) * f;
  weight[1] = (1.5f * f - 2.5f) * f * f + 1;
  weight[2] = ((-1.5f * f + 2) * f + 0.5f) * f;
  weight[3] = (0.5f * f - 0.5f) * f * f;
  return (int)low - 1;
}

static float clamped(float value, float most) { return value > 0 ? (value < most ? value : most) : 0; }

/* large: [channels] per pixel of width x height; small: the same of small_width x small_height; background: [3], null:
 * none (ern_upsample_args). */
kernel void upsample_picture(ROWS(float, large), ROWS(const float, small), ROWS(const float, background), int channels,
                    int width, int height, int small_width, int small_height, float ratio) {
  OPEN(float, large);
  OPEN(const float, small);
  OPEN(const float, background);
  const ulong i = get_global_id(0);
  if (i >= (ulong)width * height) return;
  float wx[4], wy[4], value[4];
  const int left = place_of(i % width, ratio, wx), top = place_of(i / width, ratio, wy);
  for (int c = 0; c < channels; c++) {
    float sum[4];
    for (int x = 0; x < 4; x++) {
      const global float *column = small + c * small_stride + clamp(left + x, 0, small_width - 1);
      float s[4];
      for (int y = 0; y < 4; y++) s[y] = column[(ulong)clamp(top + y, 0, small_height - 1) * small_width];
      sum[x] = s[0] * wy[0] + s[1] * wy[1] + s[2] * wy[2] + s[3] * wy[3];
    }
    value[c] = sum[0] * wx[0] + sum[1] * wx[1] + sum[2] * wx[2] + sum[3] * wx[3];
  }
  if (background) {
    value[3] = clamped(value[3], 1);
    for (int c = 0; c < 3; c++)
      value[c] = clamped(value[c], value[3]) + (1 - value[3]) * background[c * background_stride + i];
  }
  for (int c = 0; c < channels; c++) large[c * large_stride + i] = value[c];
}
