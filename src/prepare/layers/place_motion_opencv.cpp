/* SPDX-License-Identifier: MIT
 * How far the place behind the person moves: a camera that does not stand still. Two motions are proposed between two
 * frames, of corners and of all pixels, as a place out of focus has no corners. The cells of a grid vote: hair beyond
 * the masks moves with the head, and with it few cells only. */
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/video.hpp>

#include "prepare/layers/layers_opencv.h"

namespace {

constexpr int SIDE = 192, CELL = 12; /* pixels of the pictures that are compared, and of a cell */
constexpr int BESIDE = 3;            /* pixels beside the person that are left out */
constexpr int LEAST_CORNERS = 12, LEAST_CELLS = 4;
/* A cell is better off if a motion takes a fifth of its difference, and half a grey value. */
constexpr double BETTER = 0.8, GREY = 0.5;
constexpr double MOST = 0.2; /* of the side; a frame that moves further shows another place */
/* The votes of a motion, (for - against)/(for + against). Five people by a camera that moves: in 52 to 100 % of the
 * frames more; by one that stands still: in none, and of one of them in 14 and 17 %. */
constexpr double CONVINCING = 0.5;

struct view {
  cv::Mat grey;   /* CV_8U */
  cv::Mat smooth; /* CV_32F: interpolation smooths, and the blur hides it */
  cv::Mat place;  /* 255: shows the place */
};

view view_of(const ern_person_example &example) {
  view v;
  cv::Mat small;
  cv::resize(example.frame, small, cv::Size(SIDE, SIDE), 0, 0, cv::INTER_AREA);
  cv::cvtColor(small, v.grey, cv::COLOR_RGB2GRAY);
  v.grey.convertTo(v.smooth, CV_32F);
  cv::GaussianBlur(v.smooth, v.smooth, cv::Size(), 1);
  cv::resize(example.place, v.place, cv::Size(SIDE, SIDE), 0, 0, cv::INTER_LINEAR);
  v.place = v.place == 255;
  const cv::Mat disc = cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(2 * BESIDE + 1, 2 * BESIDE + 1));
  cv::erode(v.place, v.place, disc);
  return v;
}

/* The similarity that moves most corners of `a` to where they are in `b`; empty: too few. */
cv::Mat by_corners(const view &a, const view &b) {
  std::vector<cv::Point2f> points, moved, from, to;
  std::vector<uchar> found;
  cv::goodFeaturesToTrack(a.grey, points, 200, 0.02, SIDE / 60.0, a.place);
  if (int(points.size()) < LEAST_CORNERS) return {};
  cv::calcOpticalFlowPyrLK(a.grey, b.grey, points, moved, found, cv::noArray());
  for (size_t i = 0; i < points.size(); i++)
    if (found[i] != 0) from.push_back(points[i]), to.push_back(moved[i]);
  if (int(from.size()) < LEAST_CORNERS) return {};
  cv::Mat motion = cv::estimateAffinePartial2D(from, to, cv::noArray(), cv::RANSAC, 1.5);
  if (!motion.empty()) motion.convertTo(motion, CV_32F);
  return motion;
}

/* The displacement and turn with the greatest correlation of all pixels (Evangelidis and Psarakis 2008), from coarse to
 * fine; empty: none was found. */
cv::Mat by_pixels(const view &a, const view &b) {
  cv::Mat motion = cv::Mat::eye(2, 3, CV_32F);
  const cv::Mat both = a.place & b.place;
  const struct { int blur, steps; } levels[] = {{31, 30}, {15, 30}, {5, 60}};
  try {
    for (const auto &level : levels)
      cv::findTransformECC(a.smooth, b.smooth, motion, cv::MOTION_EUCLIDEAN,
                           cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, level.steps, 1e-4), both,
                           level.blur);
  } catch (const cv::Exception &error) {
    if (error.code == cv::Error::StsNoMem) throw;
    return {}; /* it does not converge, or nothing overlaps */
  }
  return motion;
}

/* Mean displacement of the pixels of `place`. */
double displacement(const cv::Mat &motion, const cv::Mat &place) {
  const float *m = motion.ptr<float>(0), *q = motion.ptr<float>(1);
  double sum = 0, count = 0;
  for (int y = 0; y < SIDE; y++)
    for (int x = 0; x < SIDE; x++) {
      if (place.at<uchar>(y, x) == 0) continue;
      const double fx = x, fy = y;
      sum += std::hypot(m[0] * fx + m[1] * fy + m[2] - fx, q[0] * fx + q[1] * fy + q[2] - fy);
      count++;
    }
  return count > 0 ? sum / count : 0;
}

/* |a - b| within `inside`, b in the light of a. */
cv::Mat difference(const cv::Mat &a, const cv::Mat &b, const cv::Mat &inside) {
  cv::Mat lit = b * (cv::mean(a, inside)[0] / std::max(cv::mean(b, inside)[0], 1.0)), result;
  cv::absdiff(a, lit, result);
  result.setTo(0, inside == 0);
  return result;
}

struct votes {
  int better, worse;
};

/* Of the cells that show enough of the place in both views. */
votes vote(const view &a, const view &b, const cv::Mat &motion) {
  const int inverse = cv::INTER_LINEAR | cv::WARP_INVERSE_MAP;
  cv::Mat back, inside;
  cv::warpAffine(b.smooth, back, motion, a.smooth.size(), inverse);
  cv::warpAffine(b.place, inside, motion, a.place.size(), cv::INTER_NEAREST | cv::WARP_INVERSE_MAP);
  inside &= a.place;
  const cv::Mat still = difference(a.smooth, b.smooth, inside), moved = difference(a.smooth, back, inside);
  votes result = {0, 0};
  int used = 0;
  for (int y = 0; y < SIDE; y += CELL)
    for (int x = 0; x < SIDE; x += CELL) {
      const cv::Rect cell(x, y, CELL, CELL);
      const int pixels = cv::countNonZero(inside(cell));
      if (4 * pixels <= CELL * CELL) continue;
      const double before = cv::sum(still(cell))[0] / pixels, after = cv::sum(moved(cell))[0] / pixels;
      used++;
      result.better += after < BETTER * before - GREY;
      result.worse += after > (2 - BETTER) * before + GREY;
    }
  if (result.better < std::max(LEAST_CELLS, used / 10)) result = {0, 0};
  return result;
}

/* Shares of the side; 0: nothing proves a motion. */
double moved_by(const view &a, const view &b) {
  const cv::Mat both = a.place & b.place;
  int lead = 0;
  double share = 0;
  for (const cv::Mat &motion : {by_corners(a, b), by_pixels(a, b)}) {
    if (motion.empty()) continue;
    const double moved = displacement(motion, both) / SIDE;
    if (!(moved <= MOST)) continue;
    const votes v = vote(a, b, motion);
    if (v.better - v.worse <= lead) continue;
    lead = v.better - v.worse;
    share = lead > CONVINCING * (v.better + v.worse) ? moved : 0;
  }
  return share;
}

}  // namespace

void ern_person_place_moves(const ern_person_model &model, ern_person_found *found) {
  const size_t count = model.examples.size(), middle = count / 2;
  const view home = view_of(model.examples[middle]);
  std::vector<double> shifts;
  for (size_t k = 0; k < count; k++)
    if (k != middle) shifts.push_back(model.side * moved_by(home, view_of(model.examples[k])));
  std::sort(shifts.begin(), shifts.end());
  const auto still = std::upper_bound(shifts.begin(), shifts.end(), 0.0);
  found->shift = shifts.empty() ? 0 : shifts[shifts.size() * 9 / 10];
  found->shifted = shifts.empty() ? 0 : double(shifts.end() - still) / double(shifts.size());
}
