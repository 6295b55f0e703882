/* SPDX-License-Identifier: MIT */
extern "C" { /* C headers */
#include "core/memory.h"
#include "io/file.h"
}

#include "prepare/onnx_network_opencv.h"

enum { FILE_LIMIT = 1 << 29, SIDE_LIMIT = 2048 };

ern_status ern_network_open(ern_context *context, const char *path, ern_onnx *look, cv::dnn::Net *net) {
  uint8_t *bytes = nullptr;
  size_t count = 0;
  ern_status status = ern_file_read(context, path, FILE_LIMIT, &bytes, &count);
  if (status == ERN_OK) status = ern_onnx_inspect(context, path, bytes, count, look);
  if (status == ERN_OK && (look->dims != 4 || look->shape[0] != 1 || look->shape[1] != 3 || look->shape[2] < 16 ||
                           look->shape[2] > SIDE_LIMIT || look->shape[3] < 16 || look->shape[3] > SIDE_LIMIT))
    status = ern_fail(context, ERN_E_UNSUPPORTED,
                      "%s: the input \"%s\" has %d sizes, [%d, %d, %d, %d], expected [1, 3, height, width] of at most "
                      "%d",
                      path, look->input, look->dims, look->shape[0], look->shape[1], look->shape[2], look->shape[3],
                      SIDE_LIMIT);
  if (status == ERN_OK) {
    try {
      *net = cv::dnn::readNetFromONNX(reinterpret_cast<const char *>(bytes), count);
      net->setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
      net->setPreferableTarget(cv::dnn::DNN_TARGET_CPU);
    } catch (const cv::Exception &error) {
      status = ern_fail(context, ERN_E_UNSUPPORTED, "%s: OpenCV %s does not read the network: %.300s", path, CV_VERSION,
                        error.err.c_str());
    } catch (...) {
      ern_release(context, bytes);
      throw;
    }
  }
  ern_release(context, bytes);
  return status;
}

cv::Mat ern_network_input(const cv::Mat &picture, const ern_network_colours &way) {
  const int size[] = {1, 3, picture.rows, picture.cols};
  cv::Mat in(4, size, CV_32F), wide;
  picture.convertTo(wide, CV_32FC3);
  for (int c = 0; c < 3; c++) {
    cv::Mat plane(picture.rows, picture.cols, CV_32F, in.ptr<float>(0, c)), channel;
    cv::extractChannel(wide, channel, way.bgr ? 2 - c : c);
    channel = (channel - way.mean[c]) / way.deviation[c];
    channel.copyTo(plane);
  }
  return in;
}
