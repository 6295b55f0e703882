/* SPDX-License-Identifier: MIT
 * Alpha matting of the person's edge at the clip's resolution: the share of a pixel that the person covers, from the
 * colours on both sides. */
#include <cmath>

#include "prepare/layers/layers_opencv.h"

namespace {

/* Means of the picture over the masked pixels of squares; 0 where a square has none. */
cv::Mat means(const cv::Mat &picture, const cv::Mat &mask, int size) {
  cv::Mat weight, three, sum;
  mask.convertTo(weight, CV_32F, 1.0 / 255);
  cv::merge(std::vector<cv::Mat>(3, weight), three);
  const cv::Size box(size, size);
  cv::boxFilter(picture.mul(three), sum, CV_32F, box);
  cv::boxFilter(three, three, CV_32F, box);
  cv::max(three, 1e-4, three);
  return sum / three;
}

float length_of(const cv::Vec3f &a) { return std::sqrt(a.dot(a)); }

float between(float low, float value, float high) { return std::max(low, std::min(high, value)); }

/* The person's share (alpha) of a pixel of colour C, with foreground F and background B. Where B was seen in an
 * example, any other colour is the person. */
float share(const cv::Vec3f &c, const cv::Vec3f &f, const cv::Vec3f &b, bool seen, float noise) {
  const cv::Vec3f whole = f - b, part = c - b;
  const float far = length_of(whole);
  if (seen) return between(0, (length_of(part) - noise) / std::max(far - 2 * noise, 1.0F), 1);
  return between(0, part.dot(whole) / std::max(far * far, 1.0F), 1);
}

}  // namespace

ern_status ern_person_matte(const ern_person_model *model, const uint8_t *rgb, const uint8_t *voted, uint8_t *alpha,
                            uint8_t *behind, size_t border[16]) {
  return ern_layers_guarded(model->context, [&] {
    const int n = model->side, radius = std::max(2, n / 128);
    const cv::Mat frame(n, n, CV_8UC3, const_cast<uint8_t *>(rgb));
    const cv::Mat small(model->work, model->work, CV_8U, const_cast<uint8_t *>(voted));
    cv::Mat soft, picture, inside, outside, from_inside, from_outside, all(n, n, CV_8U, alpha),
        back(n, n, CV_8UC3, behind);
    cv::resize(small, soft, cv::Size(n, n), 0, 0, cv::INTER_LINEAR);
    cv::GaussianBlur(soft, soft, cv::Size(0, 0), 0.75 * n / model->work);
    frame.convertTo(picture, CV_32FC3);
    const cv::Mat person = soft >= 128;
    cv::distanceTransform(person, from_inside, cv::DIST_L2, 3);
    cv::distanceTransform(person == 0, from_outside, cv::DIST_L2, 3);
    inside = from_inside > radius;
    outside = from_outside > radius;
    const cv::Mat f_mean = means(picture, inside, 4 * radius + 1), b_mean = means(picture, outside, 4 * radius + 1);
    const float wide = float(radius), noise = 6;
    for (int y = 0; y < n; y++)
      for (int x = 0; x < n; x++) {
        uchar &a = all.at<uchar>(y, x);
        cv::Vec3b &b8 = back.at<cv::Vec3b>(y, x);
        b8 = model->background.at<cv::Vec3b>(y, x);
        if (inside.at<uchar>(y, x) != 0 || outside.at<uchar>(y, x) != 0) {
          a = inside.at<uchar>(y, x);
          continue;
        }
        const bool seen = model->seen.at<uchar>(y, x) != 0;
        const cv::Vec3f c = picture.at<cv::Vec3f>(y, x), f = f_mean.at<cv::Vec3f>(y, x);
        cv::Vec3f b = b_mean.at<cv::Vec3f>(y, x);
        if (seen || b == cv::Vec3f(0, 0, 0))
          b = cv::Vec3f(b8);
        else
          b8 = cv::Vec3b(b);
        const bool in = person.at<uchar>(y, x) != 0;
        const float d = in ? from_inside.at<float>(y, x) - 0.5F : 0.5F - from_outside.at<float>(y, x);
        const float far = length_of(f - b), trust = far * far / (far * far + 900);
        border[std::min(15, int(far / 16))]++;
        const float plain = between(0, 0.5F + 0.5F * d, 1);
        const float own = between(between(0, d / wide, 1), share(c, f, b, seen, noise), between(0, 1 + d / wide, 1));
        a = uchar(std::lround(255 * (trust * own + (1 - trust) * plain)));
      }
    return ERN_OK;
  });
}
