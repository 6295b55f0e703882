/* SPDX-License-Identifier: MIT
 * A network that the user supplies as an ONNX file, on OpenCV's DNN module: one picture of three channels in (NCHW). */
#ifndef ERN_PREPARE_ONNX_NETWORK_OPENCV_H
#define ERN_PREPARE_ONNX_NETWORK_OPENCV_H

#include <opencv2/core.hpp>
#include <opencv2/dnn.hpp>

extern "C" {
#include "io/onnx.h"
}

/* A normalisation of a network's input: (c - mean) / deviation of colours c in 0..255. */
struct ern_network_colours {
  bool bgr;
  double mean[3], deviation[3]; /* in the network's order of channels */
};

/* Reads a file whose input is [1, 3, height, width], height and width 16 to 2048. May throw std::bad_alloc. */
ERN_NODISCARD ern_status ern_network_open(ern_context *context, const char *path, ern_onnx *look, cv::dnn::Net *net);
/* Converts a picture, 8-bit RGB of the network's size, to the network's input. */
cv::Mat ern_network_input(const cv::Mat &picture, const ern_network_colours &way);

#endif
