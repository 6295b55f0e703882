/* SPDX-License-Identifier: MIT
 * Faces by YuNet (Wu et al., "YuNet: A Tiny Millisecond-level Face Detector", 2023), which the user supplies as an ONNX
 * file. cv::FaceDetectorYN of OpenCV 4.6 reads only networks from before 2023 and does not validate the file; so this
 * code decodes the network's outputs itself. */
#ifndef ERN_PREPARE_FACE_NETWORK_OPENCV_H
#define ERN_PREPARE_FACE_NETWORK_OPENCV_H

#include <string>

extern "C" {
#include "prepare/prepare_job.h"
}

#include "prepare/onnx_network_opencv.h"

struct ern_face_network {
  std::string path;
  cv::dnn::Net net;
  ern_onnx look;
};

/* May throw std::bad_alloc. */
ERN_NODISCARD ern_status ern_face_network_open(ern_context *context, const char *path, ern_face_network *network);
/* As ern_face_detector_find; `picture` is 8-bit RGB. May throw std::bad_alloc. */
ERN_NODISCARD ern_status ern_face_network_find(ern_context *context, ern_face_network *network, const cv::Mat &picture,
                                               double aspect, ern_found_face *faces, size_t capacity, size_t *count);

#endif
