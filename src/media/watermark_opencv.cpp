/* SPDX-License-Identifier: MIT
 * Computes the spectrum of a picture at the watermark's waves, and its correlation with a code, by OpenCV. No exception
 * and no C++ type leaves this file. */
#include <algorithm>
#include <cmath>
#include <exception>
#include <new>
#include <opencv2/imgproc.hpp>

extern "C" {
#include "media/watermark.h"
}

namespace {

constexpr int cells = ERN_WATERMARK_CELLS, waves = ERN_WATERMARK_WAVES;

int odd(int length, int least) { return std::max(length / 2 * 2 + 1, least); }

/* Suppresses the picture's content (whitening): subtracts a blur of about the longest wave, divides by the local RMS
 * (sizes relative to the shorter side), and clamps to -1..1, so that edges do not dominate. The shorter side becomes at
 * most that of the smallest scale's grid. */
cv::Mat flatten(const cv::Mat &mean, double smallest) {
  constexpr double blur = 0.03, neighbourhood = 0.083;
  constexpr float least = 0.3F; /* of 255: rounding noise of 8 bits */
  const int side = std::min(mean.cols, mean.rows), most = (int)std::ceil(cells / smallest);
  const cv::Size window(odd((int)(blur * side), 5), odd((int)(blur * side), 5));
  const cv::Size around(odd((int)(neighbourhood * side), 7), odd((int)(neighbourhood * side), 7));
  cv::Mat low, rms, small;
  cv::blur(mean, low, window, cv::Point(-1, -1), cv::BORDER_REPLICATE);
  cv::blur(low, low, window, cv::Point(-1, -1), cv::BORDER_REPLICATE);
  cv::Mat high = mean - low;
  cv::blur(high.mul(high), rms, around, cv::Point(-1, -1), cv::BORDER_REPLICATE);
  cv::sqrt(cv::max(rms, 0), rms);
  rms += least;
  high /= rms;
  high = cv::min(cv::max(high, -1), 1);
  if (side <= most) return high;
  const double ratio = (double)most / side;
  const cv::Size size((int)std::lround(mean.cols * ratio), (int)std::lround(mean.rows * ratio));
  cv::resize(high, small, size, 0, 0, cv::INTER_AREA);
  return small;
}

/* Folds the picture onto one period: a grid of `cells` cells, which spans scale times the shorter side; repeated parts
 * are added up. */
cv::Mat fold(const cv::Mat &flat, double scale) {
  const double step = scale * std::min(flat.cols, flat.rows) / cells; /* pixels a cell */
  const int width = (int)std::ceil(flat.cols / step), height = (int)std::ceil(flat.rows / step);
  const cv::Matx23d where(step, 0, step / 2 - 0.5, 0, step, step / 2 - 0.5);
  cv::Mat grid, folded = cv::Mat::zeros(cells, cells, CV_32F);
  cv::warpAffine(flat, grid, where, cv::Size(width, height), cv::INTER_CUBIC | cv::WARP_INVERSE_MAP,
                 cv::BORDER_CONSTANT);
  for (int y = 0; y < height; y += cells) {
    for (int x = 0; x < width; x += cells) {
      const cv::Rect to(0, 0, std::min(cells, width - x), std::min(cells, height - y));
      folded(to) += grid(to + cv::Point(x, y));
    }
  }
  return folded;
}

void take_waves(const cv::Mat &folded, const struct ern_watermark_waves &list, ern_watermark_spectrum spectrum) {
  constexpr float nothing = 1e-3F; /* the grid's values are up to 1, their sums rounded to 2^-24 of some 256 */
  cv::Mat all;
  cv::dft(folded, all, cv::DFT_COMPLEX_OUTPUT);
  for (int k = 0; k < waves; k++) {
    const cv::Vec2f wave = all.at<cv::Vec2f>((list.y[k] + cells) % cells, list.x[k]);
    const float length = std::hypot(wave[0], wave[1]);
    for (int i = 0; i < 2; i++) spectrum[k][i] = length > nothing ? wave[i] / length : 0;
  }
}

double peak(const struct ern_watermark_waves &list, const ern_watermark_spectrum spectrum,
            const struct ern_watermark_code &code) {
  cv::Mat product = cv::Mat::zeros(cells, cells, CV_32FC2), sums;
  const float unit = std::sqrt(0.5F);
  int there = 0;
  for (int k = 0; k < waves; k++) {
    const float a = spectrum[k][0], b = spectrum[k][1], re = unit * code.re[k], im = unit * code.im[k];
    const cv::Vec2f wave(a * re + b * im, b * re - a * im);
    there += a != 0 || b != 0;
    product.at<cv::Vec2f>((list.y[k] + cells) % cells, list.x[k]) = wave;
    product.at<cv::Vec2f>((cells - list.y[k]) % cells, (cells - list.x[k]) % cells) = cv::Vec2f(wave[0], -wave[1]);
  }
  if (there == 0) return 0;
  double greatest = 0;
  cv::dft(product, sums, cv::DFT_INVERSE | cv::DFT_REAL_OUTPUT);
  cv::minMaxLoc(sums, nullptr, &greatest); /* twice the real part: the sum has both waves of a pair */
  return std::max(greatest / 2 * std::sqrt(2.0 / there), 0.0);
}

ern_status failed(ern_context *context) {
  try {
    throw;
  } catch (const std::bad_alloc &) {
    return ern_fail(context, ERN_E_NO_MEMORY, "watermark: no memory for the search");
  } catch (const std::exception &error) {
    return ern_fail(context, ERN_E_MEDIA, "watermark: OpenCV: %s", error.what());
  } catch (...) {
    return ern_fail(context, ERN_E_MEDIA, "watermark: OpenCV failed and gave no reason");
  }
}

}  // namespace

extern "C" ern_status ern_watermark_spectra(ern_context *context, const float *mean, int width, int height,
                                            const double *scales, size_t count, ern_watermark_spectrum *spectra) {
  try {
    struct ern_watermark_waves list;
    ern_watermark_list(&list);
    const cv::Mat flat = flatten(cv::Mat(height, width, CV_32F, const_cast<float *>(mean)), scales[0]);
    for (size_t i = 0; i < count; i++) take_waves(fold(flat, scales[i]), list, spectra[i]);
    return ERN_OK;
  } catch (...) {
    return failed(context);
  }
}

extern "C" ern_status ern_watermark_peak(ern_context *context, const ern_watermark_spectrum spectrum,
                                         const struct ern_watermark_code *code, double *score) {
  try {
    struct ern_watermark_waves list;
    ern_watermark_list(&list);
    *score = peak(list, spectrum, *code);
    return ERN_OK;
  } catch (...) {
    return failed(context);
  }
}
