/* SPDX-License-Identifier: MIT */
#include <cmath>
#include <new>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgproc.hpp>

extern "C" { /* C headers */
#include "core/floats.h"
#include "core/status.h"
#include "io/landmarks.h"
}

#include "prepare/landmarks/landmark_network.h"
#include "prepare/onnx_network_opencv.h"

namespace {

enum { WFLW = 98, UNITS = 2, MOST_SIDE = 8192 }; /* units: fractions of the square, pixels */

const ern_network_colours colours[] = {
    {false, {0, 0, 0}, {255, 255, 255}},
    {true, {0, 0, 0}, {255, 255, 255}},
    {false, {127.5, 127.5, 127.5}, {127.5, 127.5, 127.5}},
    {true, {127.5, 127.5, 127.5}, {127.5, 127.5, 127.5}},
    {false, {123.675, 116.28, 103.53}, {58.395, 57.12, 57.375}}, /* ImageNet */
    {false, {0, 0, 0}, {1, 1, 1}},
    {true, {0, 0, 0}, {1, 1, 1}},
};
/* The square's side as a multiple of the guessed points' extent (the greater of width and height). */
const double squares[] = {1.1, 1.25, 1.4};
enum { COLOURS = sizeof colours / sizeof *colours, SQUARES = sizeof squares / sizeof *squares };

/* The WFLW point (Wu et al., "Look at Boundary", CVPR 2018) that corresponds to each 300-W point. */
const int wflw[ERN_LANDMARKS] = {0,  2,  4,  6,  8,  10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30, 32,
                                 33, 34, 35, 36, 37, 42, 43, 44, 45, 46, 51, 52, 53, 54, 55, 56, 57,
                                 58, 59, 60, 61, 63, 64, 65, 67, 68, 69, 71, 72, 73, 75, 76, 77, 78,
                                 79, 80, 81, 82, 83, 84, 85, 86, 87, 88, 89, 90, 91, 92, 93, 94, 95};

/* A later setting replaces an earlier one only where its points are nearer to the guess by this, in eye distances. */
const double nearer = 0.01;
/* The greatest plausible distance of the points from the guess, in eye distances. */
const double too_far = 0.4;

struct Square {
  int x, y, side;
};

}  // namespace

struct ern_landmark_network {
  ern_context *context;
  std::string path;
  cv::dnn::Net net;
  ern_onnx look;
  size_t examples;
  bool decided;
  double apart[COLOURS][SQUARES][UNITS]; /* sums over the examples */
  int colour, square, unit;              /* the chosen settings */
};

namespace {

template <typename Work>
ern_status guarded(ern_context *context, const char *path, Work work) {
  const auto before = cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  ern_status status = ERN_OK;
  try {
    status = work();
  } catch (const std::bad_alloc &) {
    status = ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory", path);
  } catch (const cv::Exception &error) {
    status = ern_fail(context, error.code == cv::Error::StsNoMem ? ERN_E_NO_MEMORY : ERN_E_UNSUPPORTED,
                      "%s: %.300s; expected x, y of 68 or 98 points of a face", path, error.err.c_str());
  } catch (const std::exception &error) {
    status = ern_fail(context, ERN_E_UNSUPPORTED, "%s: %.300s", path, error.what());
  } catch (...) {
    status = ern_fail(context, ERN_E_UNSUPPORTED, "%s: OpenCV failed and gave no reason", path);
  }
  cv::utils::logging::setLogLevel(before);
  return status;
}

Square square_of(const float guess[ERN_LANDMARKS][2], double scale, const cv::Mat &frame) {
  const int side = std::max(frame.cols, frame.rows);
  float low[2] = {guess[0][0], guess[0][1]}, high[2] = {guess[0][0], guess[0][1]};
  for (int k = 1; k < ERN_LANDMARKS; k++)
    for (int c = 0; c < 2; c++) {
      low[c] = std::min(low[c], guess[k][c]);
      high[c] = std::max(high[c], guess[k][c]);
    }
  const double most = std::max(high[0] - low[0], high[1] - low[1]) * scale;
  if (!(most >= 8) || !(most < 4.0 * side) || !(std::fabs(low[0]) < 8.0 * side) || !(std::fabs(low[1]) < 8.0 * side))
    CV_Error(cv::Error::StsOutOfRange, "the face is expected outside the picture");
  Square square = {0, 0, cvRound(most)};
  square.x = cvRound(0.5 * (low[0] + high[0]) - 0.5 * square.side);
  square.y = cvRound(0.5 * (low[1] + high[1]) - 0.5 * square.side);
  return square;
}

/* Crops the square of the frame at the network's size; black outside the frame. */
cv::Mat cut(const ern_landmark_network &network, const cv::Mat &frame, const Square &square) {
  cv::Mat whole(square.side, square.side, CV_8UC3, cv::Scalar(0, 0, 0)), small;
  const cv::Rect wanted(square.x, square.y, square.side, square.side);
  const cv::Rect there = wanted & cv::Rect(0, 0, frame.cols, frame.rows);
  if (!there.empty()) frame(there).copyTo(whole(there - wanted.tl()));
  const int side = network.look.shape[3];
  cv::resize(whole, small, cv::Size(side, side), 0, 0, side < square.side ? cv::INTER_AREA : cv::INTER_LINEAR);
  return small;
}

/* Whether an output has 68 or 98 points; dimensions of size 1 are ignored. */
bool is_points(const cv::Mat &out, int *count) {
  int sizes[2] = {1, 1}, n = 0;
  if (out.empty() || out.type() != CV_32F) return false;
  for (int k = 0; k < out.dims; k++) {
    if (out.size[k] == 1) continue;
    if (n == 2) return false;
    sizes[n++] = out.size[k];
  }
  for (const int points : {int(ERN_LANDMARKS), int(WFLW)}) {
    *count = points;
    if ((n == 1 && sizes[0] == 2 * points) || (n == 2 && sizes[0] == points && sizes[1] == 2)) return true;
  }
  return false;
}

/* Runs the network; points in its own units. */
void forward(ern_landmark_network &network, const cv::Mat &picture, int colour, float points[ERN_LANDMARKS][2]) {
  const size_t named = std::min(network.look.outputs, size_t(ERN_ONNX_OUTPUTS));
  const std::vector<cv::String> names(network.look.output, network.look.output + named);
  std::vector<cv::Mat> outputs;
  network.net.setInput(ern_network_input(picture, colours[colour]));
  network.net.forward(outputs, names);
  for (cv::Mat &out : outputs) {
    int count = 0;
    if (!is_points(out, &count)) continue;
    if (!out.isContinuous()) out = out.clone();
    const float *values = out.ptr<float>();
    for (int k = 0; k < ERN_LANDMARKS; k++)
      for (int c = 0; c < 2; c++) {
        points[k][c] = values[2 * (count == WFLW ? wflw[k] : k) + c];
        if (!std::isfinite(points[k][c]) || std::fabs(points[k][c]) > 1e5F)
          CV_Error(cv::Error::StsBadArg, "the output is not finite");
      }
    return;
  }
  CV_Error(cv::Error::StsBadSize, "no output has 68 or 98 points");
}

/* Converts points from the network's units to pixels of the frame. */
void place(const ern_landmark_network &network, const Square &square, int unit, const float from[ERN_LANDMARKS][2],
           float to[ERN_LANDMARKS][2]) {
  const float scale = unit == 0 ? float(square.side) : float(square.side) / float(network.look.shape[3]);
  for (int k = 0; k < ERN_LANDMARKS; k++) {
    to[k][0] = float(square.x) + scale * from[k][0];
    to[k][1] = float(square.y) + scale * from[k][1];
  }
}

cv::Mat picture_of(const uint8_t *rgb, int width, int height) {
  return cv::Mat(height, width, CV_8UC3, const_cast<uint8_t *>(rgb));
}

ern_status check_picture(ern_landmark_network *network, const uint8_t *rgb, int width, int height,
                         const float guess[ERN_LANDMARKS][2]) {
  ern_context *context = network->context;
  if (rgb == nullptr || guess == nullptr)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: %s is NULL", network->path.c_str(), rgb == nullptr ? "rgb" : "guess");
  if (width < 1 || height < 1 || width > MOST_SIDE || height > MOST_SIDE)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: the picture is %d x %d, expected 1 to %d a side",
                    network->path.c_str(), width, height, int(MOST_SIDE));
  for (int k = 0; k < ERN_LANDMARKS; k++)
    if (!std::isfinite(guess[k][0]) || !std::isfinite(guess[k][1]))
      return ern_fail(context, ERN_E_ARGUMENT, "%s: point %d of the guess is (%g, %g), expected pixels",
                      network->path.c_str(), k, double(guess[k][0]), double(guess[k][1]));
  return ERN_OK;
}

}  // namespace

double ern_landmarks_distance(const float points[ERN_LANDMARKS][2], const float guess[ERN_LANDMARKS][2]) {
  double eyes[2] = {0, 0}, sum = 0;
  for (int k = 36; k < 48; k++)
    for (int c = 0; c < 2; c++) eyes[c] += (k < 42 ? -1 : 1) * double(guess[k][c]) / 6;
  for (int k = 17; k < ERN_LANDMARKS; k++)
    sum += std::hypot(double(points[k][0] - guess[k][0]), double(points[k][1] - guess[k][1])) / (ERN_LANDMARKS - 17);
  return sum / std::max(std::hypot(eyes[0], eyes[1]), 1.0);
}

ern_status ern_landmark_network_open(ern_context *context, const char *path, ern_landmark_network **network) {
  ERN_PLAIN_FLOATS;
  if (network != nullptr) *network = nullptr;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, network);
  ern_landmark_network *made = nullptr;
  const ern_status status = guarded(context, path, [&] {
    made = new ern_landmark_network{};
    made->context = context;
    made->path = path;
    const ern_onnx &look = made->look;
    const ern_status opened = ern_network_open(context, path, &made->look, &made->net);
    if (opened != ERN_OK || look.shape[2] == look.shape[3]) return opened;
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: the input \"%s\" is a picture of %d x %d, expected a square", path,
                    look.input, look.shape[3], look.shape[2]);
  });
  if (status == ERN_OK)
    *network = made;
  else
    delete made;
  return status;
}

void ern_landmark_network_free(ern_landmark_network **network) {
  if (network == nullptr) return;
  delete *network;
  *network = nullptr;
}

ern_status ern_landmark_network_learn(ern_landmark_network *network, const uint8_t *rgb, int width, int height,
                                      const float guess[ERN_LANDMARKS][2]) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(nullptr, network);
  const ern_status status = check_picture(network, rgb, width, height, guess);
  if (status != ERN_OK) return status;
  return guarded(network->context, network->path.c_str(), [&] {
    const cv::Mat frame = picture_of(rgb, width, height);
    for (int s = 0; s < SQUARES; s++) {
      const Square square = square_of(guess, squares[s], frame);
      const cv::Mat picture = cut(*network, frame, square);
      for (int c = 0; c < COLOURS; c++) {
        float found[ERN_LANDMARKS][2], points[ERN_LANDMARKS][2];
        forward(*network, picture, c, found);
        for (int unit = 0; unit < UNITS; unit++) {
          place(*network, square, unit, found, points);
          network->apart[c][s][unit] += ern_landmarks_distance(points, guess);
        }
      }
    }
    network->examples++;
    return ERN_OK;
  });
}

ern_status ern_landmark_network_decide(ern_landmark_network *network) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(nullptr, network);
  const double examples = double(std::max(network->examples, size_t(1)));
  double best = HUGE_VAL;
  for (int unit = 0; unit < UNITS; unit++)
    for (int c = 0; c < COLOURS; c++)
      for (int s = 0; s < SQUARES; s++) {
        const double apart = network->apart[c][s][unit] / examples;
        if (!(apart < best - nearer)) continue;
        best = apart;
        network->colour = c;
        network->square = s;
        network->unit = unit;
      }
  network->decided = network->examples > 0 && best < too_far;
  if (network->decided) return ERN_OK;
  if (network->examples == 0)
    return ern_fail(network->context, ERN_E_UNSUPPORTED, "%s: there is no picture to learn its colours from",
                    network->path.c_str());
  return ern_fail(network->context, ERN_E_UNSUPPORTED,
                  "%s: the network's points are %.2f eye distances from where the face is, with the best of "
                  "%d ways to scale colours, expected %.1f at most of a network that finds the landmarks of a face; or "
                  "the face is elsewhere (poses or landmarks of the clip are wrong)",
                  network->path.c_str(), best, int(COLOURS), too_far);
}

ern_status ern_landmark_network_find(ern_landmark_network *network, const uint8_t *rgb, int width, int height,
                                     const float guess[ERN_LANDMARKS][2], float points[ERN_LANDMARKS][2]) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(nullptr, network);
  ERN_NEED(network->context, points);
  if (!network->decided)
    return ern_fail(network->context, ERN_E_STATE,
                    "%s: the scale of its input pictures is not known: "
                    "ern_landmark_network_decide was not called, or failed",
                    network->path.c_str());
  const ern_status status = check_picture(network, rgb, width, height, guess);
  if (status != ERN_OK) return status;
  return guarded(network->context, network->path.c_str(), [&] {
    float found[ERN_LANDMARKS][2];
    const cv::Mat frame = picture_of(rgb, width, height);
    const Square square = square_of(guess, squares[network->square], frame);
    forward(*network, cut(*network, frame, square), network->colour, found);
    place(*network, square, network->unit, found, points);
    return ERN_OK;
  });
}
