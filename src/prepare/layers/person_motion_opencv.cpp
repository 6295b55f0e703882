/* SPDX-License-Identifier: MIT
 * Motion cue of the segmentation: texture that stays still while head or body moves is background. */
#include <algorithm>
#include <cmath>
#include <opencv2/video.hpp>

#include "prepare/layers/layers_opencv.h"

namespace {

enum { GRID = 4, REFERENCES = 12 };
constexpr float NOISE = 4;      /* grey values, of a mean over 3 x 3 pixels of work after compression */
constexpr float ALIKE = 1.5F;   /* the greatest unlikeness() of pictures of the same surface */
constexpr float FAR = 0.01F;    /* in sides of the picture: smaller motion is ignored */
constexpr float BEND = 0.0125F; /* in sides of the picture: smaller motion of the body is ignored, as a body bends */
constexpr float EVIDENCE = 5;   /* log odds where motion is sure */
constexpr float OUTWEIGHS = 3;  /* a reference in which a pixel stands still outweighs so many in which it moves */

cv::Mat grey_of(const cv::Mat &small) {
  cv::Mat grey;
  cv::cvtColor(small, grey, cv::COLOR_RGB2GRAY);
  return grey;
}

float median_of(std::vector<float> &values) {
  const auto middle = values.begin() + long(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/* The body's displacement from `home`, pixels of work: the median over the points of the chest. *known is false without
 * enough points. */
cv::Point2f body_of(const ern_person_model &model, const cv::Mat &small, bool *known) {
  *known = model.body_points.size() >= 8;
  if (!*known) return cv::Point2f(0, 0);
  std::vector<cv::Point2f> moved, back;
  std::vector<uchar> there, again;
  const cv::Mat grey = grey_of(small);
  const cv::Size window(15, 15);
  cv::calcOpticalFlowPyrLK(model.body_home, grey, model.body_points, moved, there, cv::noArray(), window);
  cv::calcOpticalFlowPyrLK(grey, model.body_home, moved, back, again, cv::noArray(), window);
  std::vector<float> x, y;
  for (size_t i = 0; i < moved.size(); i++)
    if (there[i] != 0 && again[i] != 0 && cv::norm(back[i] - model.body_points[i]) < 0.5)
      x.push_back(moved[i].x - model.body_points[i].x), y.push_back(moved[i].y - model.body_points[i].y);
  *known = x.size() >= 8;
  return *known ? cv::Point2f(median_of(x), median_of(y)) : cv::Point2f(0, 0);
}

/* Mean of |d|^2 over channels and size x size pixels, over twice the noise's variance. */
cv::Mat unlikeness(const cv::Mat &d, int size) {
  cv::Mat sum;
  cv::transform(d.mul(d), sum, cv::Matx13f::all(1 / (3 * 2 * NOISE * NOISE)));
  cv::blur(sum, sum, cv::Size(size, size));
  return sum;
}

/* The motion of each pixel, CV_32FC2 in pixels of work, if it belongs to the head, which moved from `from` to `to`.
 * Motion is smooth, so it is computed on a grid of GRID pixels. */
cv::Mat head_motion(const ern_person_model &model, const ern_layer_face &from, const ern_layer_face &to) {
  const double shrink = double(model.work) / model.side;
  const int n = model.work, nodes = (n + GRID - 1) / GRID;
  cv::Mat grid(nodes, nodes, CV_32FC2), motion;
  for (int v = 0; v < nodes; v++)
    for (int u = 0; u < nodes; u++) {
      const double pixel[2] = {(u + 0.5) * GRID / shrink - 0.5, (v + 0.5) * GRID / shrink - 0.5};
      double after[2];
      ern_layer_head_moved(&from, &to, pixel, after);
      grid.at<cv::Vec2f>(v, u) =
          cv::Vec2f(float((after[0] - pixel[0]) * shrink), float((after[1] - pixel[1]) * shrink));
    }
  cv::resize(grid, motion, cv::Size(nodes * GRID, nodes * GRID), 0, 0, cv::INTER_LINEAR);
  return motion(cv::Rect(0, 0, n, n)).clone();
}

/* A reference compared along the person's possible motions: the least unlikeness, and the length of the shortest
 * motion, pixels of work. */
struct moved {
  cv::Mat unlike, far;
};

/* Adds a motion, CV_32FC2, for the rows from `top` to `bottom`. A motion is accurate to a pixel or two: a value between
 * the least and the greatest of the surrounding pixels counts as alike. */
void add_motion(const cv::Mat &picture, const cv::Mat &reference, const cv::Mat &motion, int top, int bottom,
                struct moved *moved) {
  const int n = picture.rows;
  top = std::max(0, top), bottom = std::min(n, bottom);
  if (top >= bottom) return;
  cv::Mat map = motion.rowRange(top, bottom).clone(), there, least, most, d;
  for (int y = 0; y < map.rows; y++)
    for (int x = 0; x < n; x++) {
      cv::Vec2f &m = map.at<cv::Vec2f>(y, x);
      float &far = moved->far.at<float>(top + y, x);
      far = std::min(far, std::hypot(m[0], m[1]));
      m += cv::Vec2f(float(x), float(top + y));
    }
  cv::remap(reference, there, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  const int radius = std::max(1, cvRound(n / 256.0));
  const cv::Mat around(2 * radius + 1, 2 * radius + 1, CV_8U, cv::Scalar(1));
  cv::erode(there, least, around);
  cv::dilate(there, most, around);
  const cv::Mat rows = picture.rowRange(top, bottom);
  const cv::Mat below = least - rows, above = rows - most;
  cv::max(below, above, d);
  d = cv::max(d, 0.0);
  cv::Mat unlike = moved->unlike.rowRange(top, bottom);
  cv::min(unlike, unlikeness(d, 3), unlike);
}

/* Rows above the shoulders move with the head, rows below the neck with the body, rows between with either. The
 * shoulders of a person who leans towards the camera reach above the chin. Pixels of the head move with its surface or,
 * at its outline, with its centre. */
struct moved person_motion(const ern_person_model &model, const cv::Mat &picture, const ern_layer_face &face,
                           const ern_person_reference &r, const cv::Point2f &body) {
  const int n = model.work;
  const float shrink = float(n) / float(model.side), chin = face.points[8][1] * shrink;
  const float tall =
      std::hypot(face.points[8][0] - face.points[27][0], face.points[8][1] - face.points[27][1]) * shrink;
  const int shoulders = int(chin - 0.35F * tall), collar = int(chin + 0.5F * tall);
  struct moved moved = {cv::Mat(n, n, CV_32F, cv::Scalar(1e9)), cv::Mat(n, n, CV_32F, cv::Scalar(1e9))};
  const cv::Scalar middle((r.face.centre[0] - face.centre[0]) * shrink, (r.face.centre[1] - face.centre[1]) * shrink);
  add_motion(picture, r.small, head_motion(model, face, r.face), 0, collar, &moved);
  add_motion(picture, r.small, cv::Mat(n, n, CV_32FC2, middle), 0, collar, &moved);
  add_motion(picture, r.small, cv::Mat(n, n, CV_32FC2, cv::Scalar(body.x, body.y)), shoulders, n, &moved);
  return moved;
}

}  // namespace

void ern_person_motion_learn(ern_person_model *model) {
  const size_t count = model->examples.size();
  const ern_person_example &home = model->examples[count / 2];
  cv::Mat chest;
  cv::erode(home.chest, chest, cv::Mat());
  model->body_home = grey_of(home.small);
  model->body_points.clear();
  cv::goodFeaturesToTrack(model->body_home, model->body_points, 80, 0.02, 3, chest);
  model->references.clear();
  const size_t step = std::max<size_t>(1, count / REFERENCES);
  for (size_t k = 0; k < count; k += step) {
    const ern_person_example &example = model->examples[k];
    ern_person_reference reference;
    example.small.convertTo(reference.small, CV_32FC3);
    reference.face = example.face;
    reference.body = body_of(*model, example.small, &reference.body_known);
    model->references.push_back(reference);
  }
}

/* For each reference since which the person has moved, a pixel votes for the background if its surroundings are
 * unchanged, and for the person if they match along the person's motion. The background beside the head is often
 * covered, but the person never stands still: so one reference in which a pixel stands still outweighs several in which
 * it does not. A reference that matches in neither way, as where a part turns or bends, does not vote. */
cv::Mat ern_person_motion_odds(const ern_person_model &model, const cv::Mat &small, const ern_layer_face &face) {
  const int n = model.work;
  cv::Mat odds(n, n, CV_32F, cv::Scalar(0)), counts = odds.clone(), picture;
  bool known = false;
  const cv::Point2f body = body_of(model, small, &known);
  small.convertTo(picture, CV_32FC3);
  for (const ern_person_reference &r : model.references) {
    const cv::Point2f shift = r.body - body;
    const bool followed = known && r.body_known && cv::norm(shift) >= double(BEND) * n;
    const struct moved moved = person_motion(model, picture, face, r, followed ? shift : cv::Point2f(0, 0));
    const cv::Mat still = unlikeness(picture - r.small, 1);
    for (int y = 0; y < n; y++)
      for (int x = 0; x < n; x++) {
        if (moved.far.at<float>(y, x) < FAR * float(n)) continue;
        const float person = moved.unlike.at<float>(y, x), place = still.at<float>(y, x);
        if (place < ALIKE && person - place > 1) odds.at<float>(y, x) -= OUTWEIGHS;
        if (person < ALIKE && place - person > 1) odds.at<float>(y, x) += 1;
        counts.at<float>(y, x) += 1;
      }
  }
  for (int y = 0; y < n; y++)
    for (int x = 0; x < n; x++) {
      float &o = odds.at<float>(y, x);
      o = EVIDENCE * std::max(-1.0F, std::min(1.0F, o / std::max(counts.at<float>(y, x), float(REFERENCES) / 3)));
    }
  return odds;
}
