/* SPDX-License-Identifier: MIT
 * The mask and the colours of a dubbed frame, by OpenCV. Lengths are in shares of the face's width, the distance
 * between the ends of the jaw's line. No exception and no C++ type leaves this file. */
#include <algorithm>
#include <cmath>
#include <exception>
#include <new>
#include <opencv2/imgproc.hpp>
#include <vector>

extern "C" {
#include "media/dub.h"
}

namespace {

constexpr float least_face = 16;             /* pixels */
constexpr float mouth_growth = 1.45F;        /* so that no recorded lips or teeth are beside the rendered ones */
constexpr float inside_jaw = 0.04F;          /* the recorded jaw stays: its edge is that of the recorded neck */
constexpr float feather = 0.03F;             /* standard deviation of the mask's edge */
constexpr float margin = 0.08F;              /* of the box, round the lower face: the mask's edge ends within it */
constexpr float match_deviation = 0.15F;     /* of the low-pass that colours are matched in */
constexpr float match_most = 15;             /* grey levels */
constexpr float sure_opacity = 0.95F;        /* of the rendered head: its edge carries a light rim */
constexpr float least_cover = 0.5F;          /* of the mask, by the rendered head */
constexpr int ring_low = 8, ring_high = 153; /* of 255: where the mask is an edge */

enum { JAW_RIGHT = 2, JAW_LEFT = 14, NOSE = 29, LIPS = 48, LIPS_END = 60 };

/* The box in the frame, and the face in it. */
struct face {
  cv::Rect box;                       /* pixels of the frame */
  std::vector<cv::Point2f> landmarks; /* pixels of the box */
  float width;
};

/* The region eroded by a disc; its radius is rounded, at least 1 pixel, and the picture's border is no outside. */
cv::Mat eroded(const cv::Mat &depth, float radius) { return depth > std::max(1.0F, std::round(radius)) + 0.5F; }

/* Pixels from the nearest one outside of the region. */
cv::Mat depth_of(const cv::Mat &region) {
  cv::Mat depth;
  cv::distanceTransform(region, depth, cv::DIST_L2, cv::DIST_MASK_5);
  return depth;
}

/* A Gaussian blur; a wide one at a smaller size, which costs less and looks the same. */
cv::Mat low_pass(const cv::Mat &picture, float deviation) {
  const int shrink = std::max(1, (int)(deviation / 4));
  cv::Mat out;
  if (shrink == 1) {
    cv::GaussianBlur(picture, out, cv::Size(), std::max(deviation, 0.3F), 0, cv::BORDER_REPLICATE);
    return out;
  }
  cv::Mat small;
  const cv::Size size((picture.cols + shrink - 1) / shrink, (picture.rows + shrink - 1) / shrink);
  cv::resize(picture, small, size, 0, 0, cv::INTER_AREA);
  cv::GaussianBlur(small, small, cv::Size(), deviation / (float)shrink, 0, cv::BORDER_REPLICATE);
  cv::resize(small, out, picture.size(), 0, 0, cv::INTER_LINEAR);
  return out;
}

cv::Rect rect(const int at[4]) { return cv::Rect(at[0], at[1], at[2], at[3]); }

/* The landmarks in pixels of the frame. */
std::vector<cv::Point2f> landmarks_of(const ern_dub_input &in) {
  const cv::Rect square = rect(in.square);
  const float most = 4.0F * ERN_IMAGE_MAX_SIDE; /* so that sums of pixels do not overflow */
  std::vector<cv::Point2f> at;
  for (const auto &point : in.landmarks)
    at.emplace_back(std::clamp((float)square.x + point[0] * (float)square.width, -most, most),
                    std::clamp((float)square.y + point[1] * (float)square.height, -most, most));
  return at;
}

float width_of(const std::vector<cv::Point2f> &at) { return (float)cv::norm(at[16] - at[0]); }

/* Empty: the face is too small, or its lower half leaves the square or the frame. */
cv::Rect box_of(const ern_dub_input &in) {
  const cv::Rect square = rect(in.square) & cv::Rect(0, 0, in.width, in.height);
  const std::vector<cv::Point2f> at = landmarks_of(in);
  std::vector<cv::Point2f> lower(at.begin() + JAW_RIGHT, at.begin() + JAW_LEFT + 1);
  lower.insert(lower.end(), at.begin() + LIPS, at.begin() + LIPS_END);
  lower.push_back(at[NOSE]);
  const cv::Rect tight = cv::boundingRect(lower);
  if (width_of(at) < least_face || (tight & square) != tight) return cv::Rect();
  const int grow = (int)std::ceil(margin * width_of(at));
  return cv::Rect(tight.x - grow, tight.y - grow, tight.width + 2 * grow, tight.height + 2 * grow) & square;
}

face face_of(const ern_dub_input &in) {
  face f{rect(in.box), landmarks_of(in), 0};
  f.width = width_of(f.landmarks);
  for (cv::Point2f &point : f.landmarks) point -= cv::Point2f((float)f.box.x, (float)f.box.y);
  return f;
}

void fill_hull(cv::Mat &mask, const std::vector<cv::Point2f> &points) {
  std::vector<cv::Point> whole, hull;
  for (const cv::Point2f &point : points) whole.emplace_back((int)std::lround(point.x), (int)std::lround(point.y));
  cv::convexHull(whole, hull);
  cv::fillConvexPoly(mask, hull, cv::Scalar(255));
}

/* 255 where the recorded head is. */
cv::Mat head_recorded(const ern_dub_input &in, const face &f) {
  if (in.recorded_head == nullptr) return cv::Mat(f.box.size(), CV_8U, cv::Scalar(255));
  const ern_image &head = *in.recorded_head;
  const double sx = (double)head.width / in.square[2], sy = (double)head.height / in.square[3];
  const cv::Matx23d where(sx, 0, sx * (f.box.x - in.square[0] + 0.5) - 0.5, /* pixels' centres */
                          0, sy, sy * (f.box.y - in.square[1] + 0.5) - 0.5);
  cv::Mat there;
  cv::warpAffine(cv::Mat(head.height, head.width, CV_8U, head.data), there, where, f.box.size(),
                 cv::INTER_LINEAR | cv::WARP_INVERSE_MAP, cv::BORDER_REPLICATE);
  return there > 127;
}

/* A picture in the pixels of the rendered head, in the pixels of the box. */
cv::Mat in_box(const cv::Mat &picture, const ern_dub_input &in, const face &f, int interpolation) {
  const double sx = in.head_scale[0], sy = in.head_scale[1];
  const cv::Matx23d where(sx, 0, 0.5 * sx - 0.5, 0, sy, 0.5 * sy - 0.5); /* pixels' centres */
  cv::Mat out;
  cv::warpAffine(picture, out, where, f.box.size(), interpolation | cv::WARP_INVERSE_MAP, cv::BORDER_REPLICATE);
  return out;
}

/* 0..255: the lower face inside the jaw and the recorded mouth, inside the recorded head, with a soft edge. */
cv::Mat mask_of(const face &f, const cv::Mat &head) {
  const std::vector<cv::Point2f> &at = f.landmarks;
  cv::Mat lower = cv::Mat::zeros(f.box.size(), CV_8U), mouth = lower.clone(), edge;
  std::vector<cv::Point2f> outline(at.begin() + JAW_RIGHT, at.begin() + JAW_LEFT + 1), lips;
  outline.push_back(0.5F * (at[JAW_LEFT] + at[NOSE]));
  outline.push_back(at[NOSE]);
  outline.push_back(0.5F * (at[JAW_RIGHT] + at[NOSE]));
  fill_hull(lower, outline);
  cv::rectangle(lower, cv::Rect(cv::Point(0, 0), lower.size()),
                cv::Scalar(0)); /* the box may end at the square's edge */
  lower = eroded(depth_of(lower), inside_jaw * f.width);
  cv::Point2f middle(0, 0);
  for (int i = LIPS; i < LIPS_END; i++) middle += at[(size_t)i] * (1.0F / (LIPS_END - LIPS));
  for (int i = LIPS; i < LIPS_END; i++) lips.push_back(middle + mouth_growth * (at[(size_t)i] - middle));
  fill_hull(mouth, lips);
  const cv::Mat depth = depth_of(head);
  cv::bitwise_and(mouth, eroded(depth, 0.02F * f.width), mouth);
  const cv::Mat mask = low_pass(lower | mouth, feather * f.width);
  low_pass(eroded(depth, 0.015F * f.width), 0.012F * f.width).convertTo(edge, CV_8U, 2, -255);
  return cv::min(mask, edge);
}

/* The head's colours where it is certain to be, continued outwards by normalised blurs of growing width; `there`
 * becomes 255 where there is a colour. All in the head's pixels, of which the face is `width` wide. */
cv::Mat continue_colours(const cv::Mat &head, const cv::Mat &opacity, float width, cv::Mat &there) {
  cv::Mat sure, colour, weight3, masked, out;
  there = eroded(depth_of(opacity > 255 * sure_opacity), 0.02F * width);
  there.convertTo(sure, CV_32F, 1 / 255.0);
  cv::cvtColor(head, colour, cv::COLOR_RGBA2RGB);
  colour.convertTo(colour, CV_32F);
  cv::merge(std::vector<cv::Mat>(3, sure), weight3);
  masked = colour.mul(weight3);
  out = masked.clone();
  for (float deviation = 0.01F; deviation < 0.2F; deviation *= 2) {
    const cv::Mat weight = low_pass(sure, deviation * width);
    cv::Mat blurred = low_pass(masked, deviation * width), use = (there == 0) & (weight > 0.08);
    cv::merge(std::vector<cv::Mat>(3, cv::max(weight, 1e-6)), weight3);
    cv::divide(blurred, weight3, blurred);
    blurred.copyTo(out, use);
    there.setTo(255, use);
  }
  out.convertTo(out, CV_8U);
  return out;
}

/* Adds to the head's colours the low frequencies of what the recorded skin differs by in the mask's edge. */
void match(cv::Mat &colour, const cv::Mat &recorded, const cv::Mat &ring, float width) {
  cv::Mat apart = cv::min(cv::max(recorded - colour, -match_most), match_most), ring3, weight3;
  cv::merge(std::vector<cv::Mat>(3, ring), ring3);
  apart = low_pass(apart.mul(ring3), match_deviation * width);
  cv::merge(std::vector<cv::Mat>(3, low_pass(ring, match_deviation * width) + 1e-4), weight3);
  cv::divide(apart, weight3, apart);
  colour += apart;
}

bool compose(const ern_dub_input &in, uint8_t *rgba) {
  const face f = face_of(in);
  const cv::Mat head(in.head_height, in.head_width, CV_8UC4, const_cast<uint8_t *>(in.head));
  cv::Mat frame = cv::Mat(in.height, in.width, CV_8UC4, rgba)(f.box), recorded, opacity, there, colour, ring;
  const cv::Mat head_there = head_recorded(in, f), mask = mask_of(f, head_there), inner = mask >= 128;
  const int wanted = cv::countNonZero(inner);
  cv::extractChannel(head, opacity, 3);
  const auto covers = [&](const cv::Mat &picture) {
    return (float)cv::countNonZero(inner & (in_box(picture, in, f, cv::INTER_LINEAR) >= 128)) >=
           least_cover * (float)wanted;
  };
  if (wanted == 0 || !covers(opacity)) return false;
  const cv::Mat continued = continue_colours(head, opacity, f.width * in.head_scale[0], there);
  if (!covers(there)) return false;
  there = in_box(there, in, f, cv::INTER_LINEAR) >= 128;

  cv::cvtColor(frame, recorded, cv::COLOR_RGBA2RGB);
  recorded.convertTo(recorded, CV_32F);
  in_box(continued, in, f, cv::INTER_CUBIC).convertTo(colour, CV_32F);
  recorded.copyTo(colour, ~there);
  cv::Mat((mask >= ring_low) & (mask <= ring_high) & head_there & there).convertTo(ring, CV_32F, 1 / 255.0);
  match(colour, recorded, ring, f.width);

  cv::Mat share, share3;
  mask.convertTo(share, CV_32F, 1 / 255.0);
  cv::merge(std::vector<cv::Mat>(3, share), share3);
  cv::Mat out = recorded + share3.mul(colour - recorded), bytes;
  out.convertTo(bytes, CV_8U);
  const int channels[] = {0, 0, 1, 1, 2, 2};
  cv::mixChannels(&bytes, 1, &frame, 1, channels, 3);
  return true;
}

ern_status failed(ern_context *context) {
  try {
    throw;
  } catch (const std::bad_alloc &) {
    return ern_fail(context, ERN_E_NO_MEMORY, "dub: no memory for a frame");
  } catch (const std::exception &error) {
    return ern_fail(context, ERN_E_MEDIA, "dub: OpenCV: %s", error.what());
  } catch (...) {
    return ern_fail(context, ERN_E_MEDIA, "dub: OpenCV failed and gave no reason");
  }
}

}  // namespace

extern "C" ern_status ern_dub_find_box(ern_context *context, const ern_dub_input *input, int box[4]) {
  try {
    const cv::Rect found = box_of(*input);
    const int at[4] = {found.x, found.y, found.width, found.height};
    std::copy(at, at + 4, box);
    return ERN_OK;
  } catch (...) {
    return failed(context);
  }
}

extern "C" ern_status ern_dub_compose(ern_context *context, const ern_dub_input *input, uint8_t *rgba, bool *drawn) {
  try {
    *drawn = compose(*input, rgba);
    return ERN_OK;
  } catch (...) {
    return failed(context);
  }
}
