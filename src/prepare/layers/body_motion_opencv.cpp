/* SPDX-License-Identifier: MIT
 * How the body moves: an affine transform of each frame onto a reference, fitted to dense optical flow in the pixels of
 * neck and torso. */
#include <algorithm>
#include <cmath>
#include <memory>
#include <opencv2/video/tracking.hpp>

#include "prepare/layers/layers_opencv.h"

struct ern_body_reference {
  ern_context *context;
  int side, work;
  cv::Mat place;         /* the background, CV_32FC3 [work][work] */
  cv::Mat grey, picture; /* of the reference: CV_8U; CV_32FC3 */
  cv::Mat sum, weight;   /* of the frames that are added, on the reference: CV_32FC3, CV_32F */
  cv::Ptr<cv::DISOpticalFlow> flow;
};

namespace {

constexpr int most_work = 256; /* pixels a side of the pictures that are compared: more is slower and hardly better */
constexpr double texture = 9;  /* squared grey levels a pixel at which a pixel has half of the weight */
constexpr double residual = 1; /* pixels of work at which a pixel has half of the weight */
constexpr int rounds = 10;     /* of the reweighted fit */
constexpr double prior = 1;    /* weight of a slope of one pixel of work over half a side, in pixels */
constexpr int least_pixels = 200;
constexpr float least_frames = 3; /* that show a pixel of the mean picture */

struct Body {
  cv::Mat picture, mask; /* neck and torso over the background, CV_32FC3; 255 in their pixels, CV_8U */
};

cv::Mat grey_of(const cv::Mat &picture) {
  cv::Mat bytes, grey;
  picture.convertTo(bytes, CV_8UC3);
  cv::cvtColor(bytes, grey, cv::COLOR_RGB2GRAY);
  return grey;
}

Body body_of(const ern_body_reference &r, const uint8_t *rgba, const uint8_t *parts) {
  const cv::Mat whole(r.side, r.side, CV_8UC4, const_cast<uint8_t *>(rgba));
  const cv::Mat part(r.side, r.side, CV_8U, const_cast<uint8_t *>(parts));
  cv::Mat layer(r.side, r.side, CV_32FC3), alpha(r.side, r.side, CV_32F), small, share;
  for (int y = 0; y < r.side; y++)
    for (int x = 0; x < r.side; x++) {
      const cv::Vec4b c = whole.at<cv::Vec4b>(y, x);
      const float a = float(c[3]) / 255;
      alpha.at<float>(y, x) = a;
      layer.at<cv::Vec3f>(y, x) = cv::Vec3f(c[0], c[1], c[2]) * a;
    }
  Body body;
  cv::resize(layer, small, cv::Size(r.work, r.work), 0, 0, cv::INTER_AREA);
  cv::resize(alpha, share, cv::Size(r.work, r.work), 0, 0, cv::INTER_AREA);
  body.picture = small;
  for (int y = 0; y < r.work; y++)
    for (int x = 0; x < r.work; x++)
      body.picture.at<cv::Vec3f>(y, x) += r.place.at<cv::Vec3f>(y, x) * (1 - share.at<float>(y, x));
  cv::resize(part >= ERN_PART_NECK, body.mask, cv::Size(r.work, r.work), 0, 0, cv::INTER_AREA);
  body.mask = body.mask >= 128;
  return body;
}

/* Weights of pixels by their texture, 0..1. */
cv::Mat texture_of(const cv::Mat &grey) {
  cv::Mat across, along, energy;
  cv::Sobel(grey, across, CV_32F, 1, 0, 3, 1.0 / 8);
  cv::Sobel(grey, along, CV_32F, 0, 1, 3, 1.0 / 8);
  cv::GaussianBlur(across.mul(across) + along.mul(along), energy, cv::Size(0, 0), 2);
  return energy / (energy + texture);
}

/* Half-side coordinate of a pixel of work, -1..1, and its inverse. */
double place_of(int pixel, int work) { return (2.0 * pixel + 1) / work - 1; }

/* motion (ern_frame_input.torso_motion) of the least squares of flow - motion, reweighted; false: too few pixels. */
bool fit(const cv::Mat &flow, const cv::Mat &mask, const cv::Mat &texture_weight, float motion[6]) {
  struct Sample {
    cv::Vec3d at; /* row, column, 1 */
    cv::Vec2d by; /* pixels of work: down, right */
    double weight;
  };
  const int work = mask.rows;
  std::vector<Sample> samples;
  for (int y = 0; y < work; y++)
    for (int x = 0; x < work; x++) {
      if (mask.at<uchar>(y, x) == 0) continue;
      const cv::Vec2f f = flow.at<cv::Vec2f>(y, x);
      samples.push_back({{place_of(y, work), place_of(x, work), 1}, {f[1], f[0]}, texture_weight.at<float>(y, x)});
    }
  if (samples.size() < size_t(least_pixels)) return false;
  cv::Matx<double, 3, 2> slopes = cv::Matx<double, 3, 2>::zeros();
  for (int round = 0; round < rounds; round++) {
    cv::Matx33d normal(prior, 0, 0, 0, prior, 0, 0, 0, 1e-6);
    cv::Matx<double, 3, 2> right = cv::Matx<double, 3, 2>::zeros();
    for (const Sample &s : samples) {
      const cv::Vec2d left = s.by - slopes.t() * s.at;
      const double weight = round == 0 ? s.weight : s.weight / (1 + left.dot(left) / (residual * residual));
      normal += weight * (s.at * s.at.t());
      right += weight * (s.at * s.by.t());
    }
    if (!cv::solve(normal, right, slopes, cv::DECOMP_CHOLESKY)) return false;
  }
  for (int i = 0; i < 6; i++) motion[i] = float(slopes(i % 3, i / 3) * 2 / work);
  return std::all_of(motion, motion + 6, [](float m) { return std::isfinite(m) && std::fabs(m) < 2; });
}

/* Pixels of work of the frame, as a map for cv::remap, for each pixel of the reference. */
cv::Mat back_map(const float motion[6], int work) {
  const cv::Matx22d linear(1 + double(motion[0]), motion[1], motion[3], 1 + double(motion[4]));
  const cv::Matx22d inverse = linear.inv();
  cv::Mat map(work, work, CV_32FC2);
  for (int y = 0; y < work; y++)
    for (int x = 0; x < work; x++) {
      const cv::Vec2d at =
          inverse * cv::Vec2d(place_of(y, work) - double(motion[2]), place_of(x, work) - double(motion[5]));
      map.at<cv::Vec2f>(y, x) = cv::Vec2f(float(((at[1] + 1) * work - 1) / 2), float(((at[0] + 1) * work - 1) / 2));
    }
  return map;
}

bool find(const ern_body_reference &r, const Body &body, float motion[6]) {
  const cv::Mat grey = grey_of(body.picture);
  cv::Mat flow;
  r.flow->calc(grey, r.grey, flow);
  return fit(flow, body.mask, texture_of(grey), motion);
}

}  // namespace

void ern_body_reference_free(ern_body_reference *reference) { delete reference; }

ern_status ern_body_reference_make(ern_context *context, int side, const uint8_t *background, const uint8_t *rgba,
                                   const uint8_t *parts, ern_body_reference **reference) {
  *reference = nullptr;
  return ern_layers_guarded(context, [&] {
    auto made = std::unique_ptr<ern_body_reference>(new ern_body_reference);
    made->context = context;
    made->side = side;
    made->work = std::min(side, most_work);
    const cv::Mat place(side, side, CV_8UC3, const_cast<uint8_t *>(background));
    cv::Mat small;
    cv::resize(place, small, cv::Size(made->work, made->work), 0, 0, cv::INTER_AREA);
    small.convertTo(made->place, CV_32FC3);
    made->flow = cv::DISOpticalFlow::create(cv::DISOpticalFlow::PRESET_MEDIUM);
    made->flow->setFinestScale(0);
    made->picture = body_of(*made, rgba, parts).picture;
    made->grey = grey_of(made->picture);
    made->sum = cv::Mat::zeros(made->work, made->work, CV_32FC3);
    made->weight = cv::Mat::zeros(made->work, made->work, CV_32F);
    *reference = made.release();
    return ERN_OK;
  });
}

ern_status ern_body_reference_add(ern_body_reference *r, const uint8_t *rgba, const uint8_t *parts) {
  return ern_layers_guarded(r->context, [&] {
    float motion[6];
    const Body body = body_of(*r, rgba, parts);
    if (!find(*r, body, motion)) return ERN_OK;
    const cv::Mat map = back_map(motion, r->work);
    cv::Mat picture, share, mask;
    body.mask.convertTo(mask, CV_32F, 1.0 / 255);
    cv::remap(body.picture, picture, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
    cv::remap(mask, share, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
    for (int y = 0; y < r->work; y++)
      for (int x = 0; x < r->work; x++)
        r->sum.at<cv::Vec3f>(y, x) += picture.at<cv::Vec3f>(y, x) * share.at<float>(y, x);
    r->weight += share;
    return ERN_OK;
  });
}

ern_status ern_body_reference_mean(ern_body_reference *r) {
  return ern_layers_guarded(r->context, [&] {
    for (int y = 0; y < r->work; y++)
      for (int x = 0; x < r->work; x++)
        if (r->weight.at<float>(y, x) >= least_frames)
          r->picture.at<cv::Vec3f>(y, x) = r->sum.at<cv::Vec3f>(y, x) / r->weight.at<float>(y, x);
    r->grey = grey_of(r->picture);
    return ERN_OK;
  });
}

ern_status ern_body_reference_find(ern_body_reference *r, const uint8_t *rgba, const uint8_t *parts, float motion[6],
                                   bool *found) {
  return ern_layers_guarded(r->context, [&] {
    *found = find(*r, body_of(*r, rgba, parts), motion);
    return ERN_OK;
  });
}
