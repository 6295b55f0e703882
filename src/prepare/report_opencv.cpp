/* SPDX-License-Identifier: MIT
 * No exception and no C++ type leaves this file. */
#include <cmath>
#include <exception>
#include <new>
#include <opencv2/imgproc.hpp>

extern "C" {
#include "io/landmarks.h"
#include "prepare/head_shape.h"
#include "prepare/report.h"
}

namespace {

constexpr double axis = 0.06;
constexpr int shift = 4; /* OpenCV draws with coordinates in sixteenths of a pixel */

cv::Point sixteenths(const double pixel[2]) {
  const auto whole = [](double value) {
    return static_cast<int>(std::lround(std::fmin(std::fmax(value, -9e3), 9e3) * 16));
  };
  return {whole(pixel[0] - 0.5), whole(pixel[1] - 0.5)};
}

void draw(const struct ern_prepare_job *job, cv::Mat &picture, const struct ern_head_pose *pose,
          const float (*landmarks)[2]) {
  const double centre = 0.5 * job->side;
  const double origin[3] = {0, ERN_HEAD_EYES_Y - 0.03, ern_head_surface(0, ERN_HEAD_EYES_Y - 0.03)};
  const int thick = job->side / 256 > 0 ? job->side / 256 : 1;
  double from[2];
  if (ern_head_project(pose, job->focal, centre, origin, from))
    for (int i = 0; i < 3; i++) {
      double tip[3] = {origin[0], origin[1], origin[2]}, to[2];
      tip[i] += axis;
      const cv::Scalar colour(i == 0 ? 255 : 40, i == 1 ? 220 : 40, i == 2 ? 255 : 40);
      if (ern_head_project(pose, job->focal, centre, tip, to))
        cv::line(picture, sixteenths(from), sixteenths(to), colour, thick, cv::LINE_AA, shift);
    }
  for (int i = 0; i < ERN_LANDMARKS && landmarks != nullptr; i++) {
    const double at[2] = {landmarks[i][0], landmarks[i][1]};
    cv::circle(picture, sixteenths(at), 16 * thick, cv::Scalar(120, 255, 120), cv::FILLED, cv::LINE_AA, shift);
  }
}

}  // namespace

extern "C" ern_status ern_report_draw(const struct ern_prepare_job *job, ern_image *picture,
                                      const struct ern_head_pose *pose, const float (*landmarks)[2]) {
  try {
    cv::Mat to(picture->height, picture->width, CV_8UC3, picture->data);
    draw(job, to, pose, landmarks);
    return ERN_OK;
  } catch (const std::bad_alloc &) {
    return ern_fail(job->context, ERN_E_NO_MEMORY, "report: no memory");
  } catch (const std::exception &error) {
    return ern_fail(job->context, ERN_E_MEDIA, "report: OpenCV: %s", error.what());
  }
}
