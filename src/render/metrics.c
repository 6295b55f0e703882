/* SPDX-License-Identifier: MIT
 * PSNR and SSIM of a float picture against bytes. */
#include <math.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/render.h"

double ern_psnr(const float *rgb, const uint8_t *truth, int width, int height, const ern_box *box) {
  ERN_PLAIN_FLOATS;
  if (rgb == NULL || truth == NULL || width < 1 || height < 1) return NAN;
  const ern_box all = {0, height, 0, width}, in = box != NULL ? *box : all;
  double sum = 0;
  size_t count = 0;
  for (int j = in.top < 0 ? 0 : in.top; j < in.bottom && j < height; j++)
    for (int i = in.left < 0 ? 0 : in.left; i < in.right && i < width; i++)
      for (size_t c = 0; c < 3; c++) {
        const size_t at = 3 * ((size_t)j * (size_t)width + (size_t)i) + c;
        const double d = (double)rgb[at] - truth[at] / 255.0;
        sum += d * d;
        count++;
      }
  const double mse = count > 0 ? sum / (double)count : 0;
  return mse <= 1e-10 ? 100 : -10 * log10(mse); /* NaN does not give 100 */
}

enum { SSIM_WINDOW = 11, SSIM_MOMENTS = 5 }; /* of x, y, x^2, y^2, xy */

/* Blurs one row or column direction: out[i] = sum_k weight[k] in[i + k*step]. */
static void blur(double *out, const double *in, size_t count, size_t step, const double weight[SSIM_WINDOW]) {
  for (size_t i = 0; i < count; i++) {
    double sum = 0;
    for (size_t k = 0; k < SSIM_WINDOW; k++) sum += weight[k] * in[i + k * step];
    out[i] = sum;
  }
}

/* Mean SSIM of one channel. workspace: [2][SSIM_MOMENTS][width*height] doubles. */
static double ssim_channel(const float *rgb, const uint8_t *truth, int width, int height, int channel,
                           double *workspace, const double weight[SSIM_WINDOW]) {
  const size_t w = (size_t)width, h = (size_t)height, pixels = w * h, out_h = h - SSIM_WINDOW + 1,
               out_w = w - SSIM_WINDOW + 1;
  double *moment[SSIM_MOMENTS], *mean[SSIM_MOMENTS];
  for (size_t m = 0; m < SSIM_MOMENTS; m++) {
    moment[m] = workspace + m * pixels;
    mean[m] = workspace + (SSIM_MOMENTS + m) * pixels;
  }
  for (size_t i = 0; i < pixels; i++) {
    const double x = (double)rgb[3 * i + (size_t)channel], y = truth[3 * i + (size_t)channel] / 255.0;
    moment[0][i] = x, moment[1][i] = y, moment[2][i] = x * x, moment[3][i] = y * y, moment[4][i] = x * y;
  }
  for (size_t m = 0; m < SSIM_MOMENTS; m++) {
    blur(mean[m], moment[m], out_h * w, w, weight);
    for (size_t j = 0; j < out_h; j++) blur(moment[m] + j * w, mean[m] + j * w, out_w, 1, weight);
  }
  const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
  double sum = 0;
  for (size_t j = 0; j < out_h; j++)
    for (size_t i = j * w; i < j * w + out_w; i++) {
      const double ux = moment[0][i], uy = moment[1][i];
      const double vx = moment[2][i] - ux * ux, vy = moment[3][i] - uy * uy, vxy = moment[4][i] - ux * uy;
      sum += (2 * ux * uy + c1) * (2 * vxy + c2) / ((ux * ux + uy * uy + c1) * (vx + vy + c2));
    }
  return sum / (double)(out_h * out_w);
}

ern_status ern_ssim(ern_context *context, const float *rgb, const uint8_t *truth, int width, int height, double *ssim) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, rgb);
  ERN_NEED(context, truth);
  ERN_NEED(context, ssim);
  if (width < SSIM_WINDOW || height < SSIM_WINDOW)
    return ern_fail(context, ERN_E_ARGUMENT, "SSIM: the picture is %d x %d, expected at least %d x %d", width, height,
                    SSIM_WINDOW, SSIM_WINDOW);
  double weight[SSIM_WINDOW], total = 0;
  for (int k = 0; k < SSIM_WINDOW; k++) total += weight[k] = exp(-(k - 5) * (k - 5) / (2 * 1.5 * 1.5));
  for (int k = 0; k < SSIM_WINDOW; k++) weight[k] /= total;
  double *planes = NULL;
  const ern_status status = ERN_NEW(context, (size_t)width * (size_t)height * 2 * SSIM_MOMENTS, &planes);
  if (status != ERN_OK) return status;
  *ssim = 0;
  for (int c = 0; c < 3; c++) *ssim += ssim_channel(rgb, truth, width, height, c, planes, weight) / 3;
  ern_release(context, planes);
  return ERN_OK;
}
