/* SPDX-License-Identifier: MIT
 * No exception and no C++ type leaves this file. */
#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <new>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <vector>

extern "C" {
#include "prepare/pose/flow_tracks.h"
}

struct ern_flow_reference {
  ern_context *context;
  int side;
  cv::Rect region;
  double scale; /* pixels of the region's picture a pixel of the frame */
  cv::Mat picture;
  cv::Ptr<cv::DISOpticalFlow> flow;
  std::vector<cv::Point2f> points; /* pixels of the frame */
};

namespace {

/* A region is resampled to this many pixels a side: more makes the flow slower and hardly better. A small region is
 * enlarged, up to 2.5 times, as flow has subpixel accuracy. */
constexpr int wanted_side = 320;
constexpr double most_scale = 2.5;
/* Distance of the points, pixels of the region's picture. */
constexpr int spacing = 6;
/* Tolerance of the forward-backward check, pixels of the region's picture. */
constexpr float agreement = 0.7F;
/* The least texture: smaller eigenvalue of the gradients' covariance over 7 x 7, grey levels squared. */
constexpr float least_texture = 1.0F;

template <typename Work>
ern_status guarded(ern_context *context, const char *what, Work work) {
  try {
    return work();
  } catch (const std::bad_alloc &) {
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory", what);
  } catch (const std::exception &error) {
    return ern_fail(context, ERN_E_MEDIA, "%s: OpenCV: %s", what, error.what());
  }
}

/* Resamples the frame onto the reference's region by the warp. */
cv::Mat warp_picture(const struct ern_flow_reference &r, const cv::Mat &frame, const double warp[4]) {
  const double s = 1 / r.scale;
  /* region pixel -> reference pixel -> frame pixel */
  const double x0 = r.region.x + 0.5 * s - 0.5, y0 = r.region.y + 0.5 * s - 0.5;
  const cv::Matx23d map(warp[0] * s, -warp[1] * s, warp[0] * x0 - warp[1] * y0 + warp[2], warp[1] * s, warp[0] * s,
                        warp[1] * x0 + warp[0] * y0 + warp[3]);
  cv::Mat warped;
  cv::warpAffine(frame, warped, map, r.picture.size(), cv::INTER_LINEAR | cv::WARP_INVERSE_MAP, cv::BORDER_REPLICATE);
  return warped;
}

cv::Point2f sample(const cv::Mat &flow, float x, float y) {
  const int x0 = std::min(std::max(static_cast<int>(x), 0), flow.cols - 2);
  const int y0 = std::min(std::max(static_cast<int>(y), 0), flow.rows - 2);
  const float u = x - static_cast<float>(x0), v = y - static_cast<float>(y0);
  const auto *a = flow.ptr<cv::Point2f>(y0) + x0, *b = flow.ptr<cv::Point2f>(y0 + 1) + x0;
  return (1 - v) * ((1 - u) * a[0] + u * a[1]) + v * ((1 - u) * b[0] + u * b[1]);
}

void make(struct ern_flow_reference *r, const cv::Mat &frame, bool (*keep)(const void *user, float x, float y),
          const void *user) {
  const double s = 1 / r->scale;
  const double none[4] = {1, 0, 0, 0};
  r->picture = cv::Mat(cvRound(r->region.height * r->scale), cvRound(r->region.width * r->scale), CV_8UC1);
  r->picture = warp_picture(*r, frame, none);
  cv::Mat texture;
  cv::cornerMinEigenVal(r->picture, texture, 7, 3, cv::BORDER_REPLICATE);
  texture *= 255.0 * 255.0; /* OpenCV scales pictures of bytes to 0..1 */
  for (int y = spacing; y < r->picture.rows - spacing; y += spacing)
    for (int x = spacing; x < r->picture.cols - spacing; x += spacing) {
      const cv::Point2f p(static_cast<float>(r->region.x + (x + 0.5) * s - 0.5),
                          static_cast<float>(r->region.y + (y + 0.5) * s - 0.5));
      if (texture.at<float>(y, x) > least_texture && keep(user, p.x, p.y)) r->points.push_back(p);
    }
  r->flow = cv::DISOpticalFlow::create(cv::DISOpticalFlow::PRESET_MEDIUM);
}

void find(struct ern_flow_reference *r, const cv::Mat &frame, double warp[4], float (*seen)[2]) {
  const cv::Mat warped = warp_picture(*r, frame, warp);
  cv::Mat forward, backward;
  r->flow->calc(r->picture, warped, forward);
  r->flow->calc(warped, r->picture, backward);
  std::vector<cv::Point2f> from, to;
  for (size_t i = 0; i < r->points.size(); i++) {
    const cv::Point2f p = r->points[i];
    const float u = static_cast<float>((p.x + 0.5 - r->region.x) * r->scale - 0.5);
    const float v = static_cast<float>((p.y + 0.5 - r->region.y) * r->scale - 0.5);
    const cv::Point2f way = sample(forward, u, v), at(u + way.x, v + way.y);
    const cv::Point2f back = sample(backward, at.x, at.y);
    const bool inside = at.x >= 2 && at.y >= 2 && at.x < static_cast<float>(warped.cols - 2) &&
                        at.y < static_cast<float>(warped.rows - 2);
    seen[i][0] = seen[i][1] = std::numeric_limits<float>::quiet_NaN();
    if (!inside || std::hypot(way.x + back.x, way.y + back.y) > agreement) continue;
    const double x = r->region.x + (at.x + 0.5) / r->scale - 0.5, y = r->region.y + (at.y + 0.5) / r->scale - 0.5;
    seen[i][0] = static_cast<float>(warp[0] * x - warp[1] * y + warp[2]);
    seen[i][1] = static_cast<float>(warp[1] * x + warp[0] * y + warp[3]);
    from.push_back(p);
    to.emplace_back(seen[i][0], seen[i][1]);
  }
  if (from.size() < 20) return;
  cv::setRNGSeed(1); /* RANSAC's choice is the same on every run */
  const cv::Mat found = cv::estimateAffinePartial2D(from, to, cv::noArray(), cv::RANSAC, 3.0);
  if (found.empty()) return;
  warp[0] = found.at<double>(0, 0);
  warp[1] = found.at<double>(1, 0);
  warp[2] = found.at<double>(0, 2);
  warp[3] = found.at<double>(1, 2);
}

}  // namespace

extern "C" ern_status ern_flow_reference_make(ern_context *context, const char *where, const uint8_t *grey, int side,
                                              struct ern_flow_region region,
                                              bool (*keep)(const void *user, float x, float y), const void *user,
                                              struct ern_flow_reference **reference) {
  *reference = nullptr;
  return guarded(context, "flow", [&] {
    auto *made = new ern_flow_reference{};
    *reference = made;
    made->context = context;
    made->side = side;
    made->region = cv::Rect(cvRound(region.x), cvRound(region.y), cvRound(region.width), cvRound(region.height)) &
                   cv::Rect(0, 0, side, side);
    const int longer = std::max(made->region.width, made->region.height);
    if (std::min(made->region.width, made->region.height) < 32)
      return ern_fail(context, ERN_E_SHAPE,
                      "%s: the face's region is %d x %d pixels, expected at least 32 a side: where the head "
                      "leaves the picture, --from and --to choose a part without it",
                      where, made->region.width, made->region.height);
    made->scale = std::min(static_cast<double>(wanted_side) / longer, most_scale);
    make(made, cv::Mat(side, side, CV_8UC1, const_cast<uint8_t *>(grey)), keep, user);
    return ERN_OK;
  });
}

extern "C" size_t ern_flow_reference_points(const struct ern_flow_reference *reference, const float (**points)[2]) {
  *points = reinterpret_cast<const float(*)[2]>(reference->points.data());
  return reference->points.size();
}

extern "C" ern_status ern_flow_reference_find(struct ern_flow_reference *reference, const uint8_t *grey, double warp[4],
                                              float (*seen)[2]) {
  return guarded(reference->context, "flow", [&] {
    const int side = reference->side;
    find(reference, cv::Mat(side, side, CV_8UC1, const_cast<uint8_t *>(grey)), warp, seen);
    return ERN_OK;
  });
}

extern "C" void ern_flow_reference_free(struct ern_flow_reference **reference) {
  if (reference == nullptr) return;
  delete *reference;
  *reference = nullptr;
}
