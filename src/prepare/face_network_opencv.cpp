/* SPDX-License-Identifier: MIT */
#include "prepare/face_network_opencv.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

extern "C" { /* C headers */
#include "core/status.h"
}

namespace {

const ern_network_colours colours = {true, {0, 0, 0}, {1, 1, 1}};
/* least_score: of the geometric mean of a face's two probabilities. most_overlap: intersection over union, above which
 * two boxes are one face (non-maximum suppression). */
constexpr float least_score = 0.6F, most_overlap = 0.3F;
enum { MOST_BOXES = 5000, STRIDES = 3, COARSEST = 32, BOX = 4, POINTS = 10 };
const int strides[STRIDES] = {8, 16, COARSEST}; /* pixels from cell to cell, by level */

/* Convert YuNet's boxes to the cascades', which the clip's square is based on: the ratio of their side to the root of
 * YuNet's area, and the offset of their centre upwards, in sides. Medians over test footage. */
constexpr double cascade_side = 1.04, cascade_above = 0.03;
/* In a frontal face (up to 40 degrees) the tip of the nose lies between the eyes: bounds of its position, as a share of
 * the way from eye to eye. */
constexpr double nose_low = 0.05, nose_high = 0.95;

/* The network's outputs for the cells of one stride, [rows][columns][1, 4 or 10]. */
struct Level {
  cv::Mat scores[2], boxes, points;
  int columns, rows, stride;
};

struct Candidates {
  std::vector<cv::Rect2d> boxes; /* pixels of the network's input */
  std::vector<float> scores;
  std::vector<const float *> points; /* in strides, from the cell's corner */
  std::vector<cv::Point3d> cells;    /* corner, and stride */
};

template <typename Work>
ern_status guarded(ern_context *context, const ern_face_network &network, Work work) {
  const auto before = cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  ern_status status = ERN_OK;
  try {
    status = work();
  } catch (const cv::Exception &error) {
    status = ern_fail(context, error.code == cv::Error::StsNoMem ? ERN_E_NO_MEMORY : ERN_E_UNSUPPORTED,
                      "%s: %.300s; expected YuNet of 2023 or later: for each of the strides 8, 16 and 32 two outputs "
                      "of 1 number a cell, one of 4 and one of 10",
                      network.path.c_str(), error.err.c_str());
  } catch (...) {
    cv::utils::logging::setLogLevel(before);
    throw;
  }
  cv::utils::logging::setLogLevel(before);
  return status;
}

Level level_of(const std::vector<cv::Mat> &outputs, const ern_onnx &look, int stride) {
  Level level = {{}, {}, {}, look.shape[3] / stride, look.shape[2] / stride, stride};
  int scores = 0, boxes = 0, points = 0;
  for (const cv::Mat &out : outputs) {
    if (out.dims < 2 || out.type() != CV_32F || !out.isContinuous()) continue;
    const int cells = out.size[out.dims - 2], width = out.size[out.dims - 1];
    if (cells != level.columns * level.rows || out.total() != size_t(cells) * size_t(width)) continue;
    if (width == 1 && scores < 2) level.scores[scores] = out;
    if (width == BOX) level.boxes = out;
    if (width == POINTS) level.points = out;
    scores += width == 1;
    boxes += width == BOX;
    points += width == POINTS;
  }
  if (scores != 2 || boxes != 1 || points != 1)
    CV_Error(cv::Error::StsBadSize,
             cv::format("the stride %d has %d outputs of scores, %d of boxes and %d of points of a face", stride,
                        scores, boxes, points));
  return level;
}

void add(const Level &level, const ern_onnx &look, Candidates *to) {
  const float *a = level.scores[0].ptr<float>(), *b = level.scores[1].ptr<float>(), *box = level.boxes.ptr<float>();
  for (int k = 0; k < level.columns * level.rows; k++) {
    if (!std::isfinite(a[k]) || !std::isfinite(b[k])) CV_Error(cv::Error::StsBadArg, "the scores are not finite");
    const float score = std::sqrt(std::min(std::max(a[k], 0.0F), 1.0F) * std::min(std::max(b[k], 0.0F), 1.0F));
    if (score < least_score) continue;
    const double x = k % level.columns, y = k / level.columns, s = level.stride;
    const float *at = box + BOX * k, *points = level.points.ptr<float>() + POINTS * k;
    const cv::Size2d size(std::exp(double(at[2])) * s, std::exp(double(at[3])) * s);
    const cv::Rect2d found((x + at[0]) * s - 0.5 * size.width, (y + at[1]) * s - 0.5 * size.height, size.width,
                           size.height);
    const cv::Rect2d whole(0, 0, look.shape[3], look.shape[2]);
    /* also false where a value is NaN */
    if (!(size.width < 2 * whole.width) || !(size.height < 2 * whole.height) || !((found & whole).area() > 0)) continue;
    if (!std::all_of(points, points + POINTS, [](float v) { return std::fabs(v) < 1e4F; })) continue;
    to->boxes.push_back(found);
    to->scores.push_back(score);
    to->points.push_back(points);
    to->cells.emplace_back(x, y, s);
  }
}

/* Fits the picture into the upper left corner of the network's input, RGB, without enlarging it; the rest is black. */
cv::Mat lay(const cv::Mat &picture, const ern_onnx &look, double aspect, cv::Size2d *scale, int *shorter) {
  const cv::Size whole(look.shape[3], look.shape[2]);
  const double x = std::max(aspect, 1.0), y = std::max(1 / aspect, 1.0); /* to square pixels */
  const double shrunk = std::min({1.0, whole.width / (picture.cols * x), whole.height / (picture.rows * y)});
  *scale = cv::Size2d(shrunk * x, shrunk * y);
  const cv::Size size(std::min(std::max(cvRound(picture.cols * scale->width), 1), whole.width),
                      std::min(std::max(cvRound(picture.rows * scale->height), 1), whole.height));
  cv::Mat input(whole, CV_8UC3, cv::Scalar(0, 0, 0)), there = input(cv::Rect(cv::Point(0, 0), size));
  cv::resize(picture, there, size, 0, 0, shrunk < 1 ? cv::INTER_AREA : cv::INTER_LINEAR);
  *shorter = std::min(size.width, size.height);
  return input;
}

std::vector<cv::Mat> forward(ern_face_network *network, const cv::Mat &input) {
  const size_t named = std::min(network->look.outputs, size_t(ERN_ONNX_OUTPUTS));
  const std::vector<cv::String> names(network->look.output, network->look.output + named);
  std::vector<cv::Mat> outputs;
  network->net.setInput(ern_network_input(input, colours));
  network->net.forward(outputs, names);
  for (cv::Mat &out : outputs)
    if (!out.isContinuous()) out = out.clone();
  return outputs;
}

/* Converts a candidate to pixels of the picture; false where the face is not frontal. */
bool place(const Candidates &from, size_t k, const cv::Size2d &scale, ern_found_face *face) {
  const cv::Rect2d &box = from.boxes[k];
  const cv::Point3d &cell = from.cells[k];
  cv::Point2d at[3]; /* the eyes, the one that is left in the picture first, and the tip of the nose */
  for (int i = 0; i < 3; i++)
    at[i] = cv::Point2d((from.points[k][2 * i] + cell.x) * cell.z, (from.points[k][2 * i + 1] + cell.y) * cell.z);
  const cv::Point2d across = at[1] - at[0];
  const double share = (at[2] - at[0]).dot(across) / std::max(across.dot(across), 1e-9);
  if (!(across.x > 0) || !(share > nose_low && share < nose_high)) return false;
  const double side = cascade_side * std::sqrt(box.area());
  *face = ern_found_face{};
  face->x = float((box.x + 0.5 * (box.width - side)) / scale.width);
  face->y = float((box.y + 0.5 * (box.height - side) - cascade_above * side) / scale.height);
  face->width = float(side / scale.width);
  face->height = float(side / scale.height);
  face->has_eyes = true;
  for (int i = 0; i < 2; i++) {
    face->eyes[i][0] = float(at[i].x / scale.width);
    face->eyes[i][1] = float(at[i].y / scale.height);
  }
  return true;
}

}  // namespace

ern_status ern_face_network_open(ern_context *context, const char *path, ern_face_network *network) {
  network->path = path;
  return guarded(context, *network, [&] {
    const ern_onnx &look = network->look;
    const ern_status status = ern_network_open(context, path, &network->look, &network->net);
    if (status != ERN_OK) return status;
    if (look.shape[2] % COARSEST != 0 || look.shape[3] % COARSEST != 0)
      return ern_fail(context, ERN_E_UNSUPPORTED,
                      "%s: the input \"%s\" is a picture of %d x %d, expected multiples of "
                      "%d",
                      path, look.input, look.shape[3], look.shape[2], int(COARSEST));
    const std::vector<cv::Mat> outputs =
        forward(network, cv::Mat(look.shape[2], look.shape[3], CV_8UC3, cv::Scalar(0, 0, 0)));
    for (const int stride : strides) (void)level_of(outputs, look, stride);
    return ERN_OK;
  });
}

ern_status ern_face_network_find(ern_context *context, ern_face_network *network, const cv::Mat &picture, double aspect,
                                 ern_found_face *faces, size_t capacity, size_t *count) {
  return guarded(context, *network, [&] {
    Candidates candidates;
    std::vector<int> kept;
    std::vector<ern_found_face> found;
    cv::Size2d scale;
    int shorter = 0;
    const std::vector<cv::Mat> outputs = forward(network, lay(picture, network->look, aspect, &scale, &shorter));
    for (const int stride : strides) add(level_of(outputs, network->look, stride), network->look, &candidates);
    cv::dnn::NMSBoxes(candidates.boxes, candidates.scores, least_score, most_overlap, kept, 1.0F, MOST_BOXES);
    for (const int k : kept) {
      ern_found_face face;
      /* as for the cascades, a smaller face is too small to train on */
      if (place(candidates, size_t(k), scale, &face) && double(face.width) * scale.width >= shorter / 9)
        found.push_back(face);
    }
    std::stable_sort(found.begin(), found.end(),
                     [](const ern_found_face &a, const ern_found_face &b) { return a.width > b.width; });
    *count = std::min(capacity, found.size());
    std::copy_n(found.begin(), *count, faces);
    return ERN_OK;
  });
}
