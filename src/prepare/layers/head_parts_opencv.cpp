/* SPDX-License-Identifier: MIT
 * Splits the person into head, neck and torso: the head ends at the jaw's landmarks; the skin below is the neck. */
#include <algorithm>
#include <cmath>

#include "prepare/layers/layers_opencv.h"

namespace {

struct Skin {
  float red, green, sigma, bright; /* chromaticities R/(R+G+B), G/(R+G+B); their spread; R+G+B */
  float least, most;               /* bounds of R+G+B, as multiples of `bright` */
  bool is(const cv::Vec3b &c) const {
    const float sum = float(c[0]) + c[1] + c[2] + 1;
    const float d = std::hypot(c[0] / sum - red, c[1] / sum - green);
    return d < 3 * sigma && sum > least * bright && sum < most * bright;
  }
};

float median_of(std::vector<float> &values) {
  const auto middle = values.begin() + long(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

cv::Point at(const ern_layer_face &face, int k) { return {cvRound(face.points[k][0]), cvRound(face.points[k][1])}; }

/* Skin statistics of the pixels in `mask`. */
Skin skin_in(const cv::Mat &frame, const cv::Mat &mask, float least, float most) {
  std::vector<float> red, green, sums;
  for (int y = 0; y < frame.rows; y++)
    for (int x = 0; x < frame.cols; x++) {
      if (mask.at<uchar>(y, x) == 0) continue;
      const cv::Vec3b c = frame.at<cv::Vec3b>(y, x);
      const float sum = float(c[0]) + c[1] + c[2] + 1;
      red.push_back(c[0] / sum), green.push_back(c[1] / sum), sums.push_back(sum);
    }
  if (sums.empty()) return Skin{0.42F, 0.31F, 0.02F, 450, least, most}; /* the face is not in the picture */
  Skin skin{median_of(red), median_of(green), 0, median_of(sums), least, most};
  for (float &v : red) v = std::fabs(v - skin.red);
  skin.sigma = std::max(0.01F, std::min(0.02F, 1.48F * median_of(red)));
  return skin;
}

/* The mask of the cheeks: between jaw, eyes, nose and mouth. */
cv::Mat cheeks_of(const cv::Mat &frame, const ern_layer_face &face) {
  cv::Mat cheeks(frame.size(), CV_8U, cv::Scalar(0));
  cv::fillPoly(
      cheeks, std::vector<std::vector<cv::Point>>{{at(face, 1), at(face, 41), at(face, 31), at(face, 48), at(face, 4)}},
      255);
  cv::fillPoly(
      cheeks,
      std::vector<std::vector<cv::Point>>{{at(face, 15), at(face, 46), at(face, 35), at(face, 54), at(face, 12)}}, 255);
  return cheeks;
}

/* The mask of the pixels above the jaw. Beside the face its lower border continues along the head's horizontal axis
 * from landmarks `from` and 16 - `from`. */
cv::Mat above_jaw(const cv::Size &size, const ern_layer_face &face, int from) {
  const cv::Point2d left(face.points[0][0], face.points[0][1]), right(face.points[16][0], face.points[16][1]);
  cv::Point2d level = right - left;
  const double length = std::max(1.0, std::hypot(level.x, level.y)), far = 4.0 * size.width;
  level = level.x > 0.3 * length ? level * (far / length) : cv::Point2d(far, 0);
  const cv::Point out(cvRound(level.x), cvRound(level.y)), up(cvRound(level.y), cvRound(-level.x));
  std::vector<cv::Point> line{at(face, from) - out + up, at(face, from) - out};
  for (int k = from; k <= 16 - from; k++) line.push_back(at(face, k));
  line.push_back(at(face, 16 - from) + out);
  line.push_back(at(face, 16 - from) + out + up);
  cv::Mat above(size, CV_8U, cv::Scalar(0));
  cv::fillPoly(above, std::vector<std::vector<cv::Point>>{line}, 255);
  return above;
}

/* The connected components of `mask` that touch `seed`. */
cv::Mat connected(const cv::Mat &mask, const cv::Mat &seed) {
  cv::Mat labels;
  const int count = cv::connectedComponents(mask, labels, 4);
  std::vector<uchar> keep(size_t(count), 0);
  cv::Mat kept(mask.size(), CV_8U, cv::Scalar(0));
  for (int y = 0; y < mask.rows; y++)
    for (int x = 0; x < mask.cols; x++)
      if (mask.at<uchar>(y, x) != 0 && seed.at<uchar>(y, x) != 0) keep[size_t(labels.at<int>(y, x))] = 255;
  for (int y = 0; y < mask.rows; y++)
    for (int x = 0; x < mask.cols; x++) kept.at<uchar>(y, x) = keep[size_t(labels.at<int>(y, x))];
  return kept;
}

cv::Mat disk(double radius) {
  const int r = std::max(1, cvRound(radius));
  return cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(2 * r + 1, 2 * r + 1));
}

}  // namespace

ern_status ern_head_parts(ern_context *context, const uint8_t *rgb, const uint8_t *alpha, const ern_layer_face *face,
                          int side, uint8_t *parts) {
  return ern_layers_guarded(context, [&] {
    const cv::Mat frame(side, side, CV_8UC3, const_cast<uint8_t *>(rgb));
    const cv::Mat person = cv::Mat(side, side, CV_8U, const_cast<uint8_t *>(alpha)) >= 128;
    const double tall =
        std::hypot(double(face->points[8][0]) - face->points[27][0], double(face->points[8][1]) - face->points[27][1]);
    const Skin skin = skin_in(frame, cheeks_of(frame, *face), 0.3F, 1.6F);
    cv::Mat skins(side, side, CV_8U, cv::Scalar(0));
    cv::Mat bright(side, side, CV_8U, cv::Scalar(0)); /* too bright for shaded hair */
    for (int y = 0; y < side; y++)
      for (int x = 0; x < side; x++) {
        if (person.at<uchar>(y, x) == 0) continue;
        const cv::Vec3b c = frame.at<cv::Vec3b>(y, x);
        skins.at<uchar>(y, x) = skin.is(c) ? 255 : 0;
        bright.at<uchar>(y, x) = float(c[0]) + c[1] + c[2] > 0.6F * skin.bright ? 255 : 0;
      }
    cv::medianBlur(skins, skins, 5);
    skins &= person;
    const cv::Mat ears = above_jaw(frame.size(), *face, 3), jaw = above_jaw(frame.size(), *face, 4);
    cv::Mat head = person & (ears | (jaw & ~skins));
    /* Clothes above the jaw's line, as a collar, do not belong to the head. */
    cv::Mat band(frame.size(), CV_8U, cv::Scalar(0));
    std::vector<cv::Point> line;
    for (int k = 4; k <= 12; k++) line.push_back(at(*face, k));
    cv::polylines(band, std::vector<std::vector<cv::Point>>{line}, false, 255, std::max(1, cvRound(0.16 * tall)));
    const cv::Mat cloth = ~skins & bright & ((band & head) | (person & ~head));
    head &= ~connected(cloth, person & ~head & ~skins);
    cv::morphologyEx(head, head, cv::MORPH_OPEN, disk(side / 256.0));
    /* Thin strips beside the face, where the jaw's line lies inside it, belong to the head. */
    cv::Mat rest = person & ~head, wide;
    cv::morphologyEx(rest, wide, cv::MORPH_OPEN, disk(0.06 * tall));
    rest &= ~wide;
    const int level = std::max(at(*face, 5).y, at(*face, 11).y);
    rest.rowRange(std::max(0, std::min(side, level)), side).setTo(0);
    head |= rest;
    /* Skin below the jaw that is connected to it. */
    cv::Mat near, reach(frame.size(), CV_8U, cv::Scalar(0));
    const int left = std::min(at(*face, 3).x, at(*face, 13).x), right = std::max(at(*face, 3).x, at(*face, 13).x);
    const int out = cvRound(0.15 * tall);
    cv::rectangle(reach, cv::Point(left - out, 0), cv::Point(right + out, at(*face, 8).y + cvRound(0.8 * tall)), 255,
                  -1);
    cv::dilate(head, near, disk(0.06 * tall));
    /* The head shades the neck, so the neck's colour is taken from the skin close to the jaw. */
    const cv::Mat close = person & ~head & skins & reach & near;
    const Skin shaded = skin_in(frame, close, 0.65F, 2.5F);
    cv::Mat neck = close.clone();
    for (int y = 0; y < side; y++)
      for (int x = 0; x < side; x++)
        if (reach.at<uchar>(y, x) != 0 && skins.at<uchar>(y, x) != 0 && shaded.is(frame.at<cv::Vec3b>(y, x)))
          neck.at<uchar>(y, x) = 255;
    cv::morphologyEx(neck, neck, cv::MORPH_OPEN, disk(0.02 * tall));
    neck = connected(neck & person & ~head, close);
    cv::morphologyEx(neck, neck, cv::MORPH_CLOSE, disk(0.03 * tall));
    /* Pixels in deep shade directly below the jaw, between head and neck. */
    cv::Mat whole = neck | head;
    cv::morphologyEx(whole, whole, cv::MORPH_CLOSE, disk(0.08 * tall));
    cv::dilate(head, near, disk(0.12 * tall));
    neck |= whole & near & (skins | ~bright);
    neck &= person & ~head & reach;
    cv::Mat out_parts(side, side, CV_8U, parts);
    out_parts.setTo(ERN_PART_BACKGROUND);
    out_parts.setTo(ERN_PART_TORSO, person);
    out_parts.setTo(ERN_PART_NECK, neck);
    out_parts.setTo(ERN_PART_HEAD, head);
    return ERN_OK;
  });
}
