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

constexpr float least_face = 16;         /* pixels */
constexpr float mouth_growth = 1.45F;    /* so that no recorded lips or teeth are beside the rendered ones */
constexpr float inside_jaw = 0.04F;      /* the recorded jaw stays: its edge is that of the recorded neck */
constexpr float round_nose = 0.05F;      /* what is so near to it stays as recorded */
constexpr float feather = 0.03F;         /* standard deviation of the mask's edge */
constexpr float edge_feather = 0.012F;   /* standard deviation of the mask's edge where the recorded head's ends it */
constexpr float outline_feather = 0.05F; /* where the rendered head's does: its chin may lie within the recorded one */
constexpr float margin = 0.08F;          /* of the box, round the lower face: the mask's edge ends within it */
constexpr float match_deviation = 0.15F; /* of the low-pass that colours are matched in */
constexpr float match_most = 15;         /* grey levels */
constexpr float sure_opacity = 0.95F;    /* of the rendered head: its edge carries a light rim */
constexpr float certain_depth = 0.02F;   /* colours are taken so far from where it is less */
constexpr float least_cover = 0.5F;      /* of the mask, by the rendered head */
constexpr int ring_low = 8, ring_high = 153; /* of 255: where the mask is an edge */

enum {
  JAW_RIGHT = 2, /* of the box */
  JAW_LEFT = 14,
  CHEEK_RIGHT = 3, /* of the mask */
  CHEEK_LEFT = 13,
  NOSE = 29,
  NOSE_BASE = 33,
  NOSE_END = 36,
  LIPS = 48,
  LIPS_END = 60
};

/* The box in the frame, and the face in it. */
struct face {
  cv::Rect box;                       /* pixels of the frame */
  cv::Size size;                      /* of a picture of the box, pixels; all that follows is in these */
  float scale[2];                     /* pixels a pixel of the frame, across and down */
  std::vector<cv::Point2f> landmarks; /* from the box's corner */
  float width;
};

float whole_radius(float radius) { return std::max(1.0F, std::round(radius)); }

/* The region eroded by a disc of a whole radius; the picture's border is no outside. */
cv::Mat eroded(const cv::Mat &depth, float radius) { return depth > whole_radius(radius) + 0.5F; }

/* Pixels from the nearest one outside of the region. */
cv::Mat depth_of(const cv::Mat &region) {
  cv::Mat depth;
  cv::distanceTransform(region, depth, cv::DIST_L2, cv::DIST_MASK_5);
  return depth;
}

/* A Gaussian blur; a wide one at a smaller size, which costs less and looks the same. */
cv::Mat low_pass(const cv::Mat &picture, float deviation) {
  const int shrink = std::clamp((int)(deviation / 3), 1, std::max(picture.cols, picture.rows)),
            columns = (picture.cols + shrink - 1) / shrink, rows = (picture.rows + shrink - 1) / shrink;
  cv::Mat out, small;
  if (shrink == 1) {
    cv::GaussianBlur(picture, out, cv::Size(), std::max(deviation, 0.3F), 0, cv::BORDER_REPLICATE);
    return out;
  }
  cv::copyMakeBorder(picture, out, 0, rows * shrink - picture.rows, 0, columns * shrink - picture.cols,
                     cv::BORDER_REPLICATE); /* a whole number of small pixels: faster */
  cv::resize(out, small, cv::Size(columns, rows), 0, 0, cv::INTER_AREA);
  cv::GaussianBlur(small, small, cv::Size(), std::min(deviation / (float)shrink, 6.0F), 0, cv::BORDER_REPLICATE);
  cv::resize(small, out, out.size(), 0, 0, cv::INTER_LINEAR);
  return out(cv::Rect(0, 0, picture.cols, picture.rows));
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

/* In pixels of the frame, or of the rendered head. */
face face_of(const ern_dub_input &in, bool of_head) {
  face f{rect(in.box),
         of_head ? cv::Size(in.head_width, in.head_height) : rect(in.box).size(),
         {1, 1},
         landmarks_of(in),
         0};
  if (of_head) std::copy(in.head_scale, in.head_scale + 2, f.scale);
  f.width = width_of(f.landmarks) * f.scale[0];
  for (cv::Point2f &point : f.landmarks)
    point = cv::Point2f((point.x - (float)f.box.x) * f.scale[0], (point.y - (float)f.box.y) * f.scale[1]);
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
  if (in.recorded_head == nullptr) return cv::Mat(f.size, CV_8U, cv::Scalar(255));
  const ern_image &head = *in.recorded_head;
  const double sx = (double)head.width / in.square[2], sy = (double)head.height / in.square[3];
  const double dx = 1 / (double)f.scale[0], dy = 1 / (double)f.scale[1];              /* pixels of the frame */
  const cv::Matx23d where(sx * dx, 0, sx * (f.box.x - in.square[0] + 0.5 * dx) - 0.5, /* pixels' centres */
                          0, sy * dy, sy * (f.box.y - in.square[1] + 0.5 * dy) - 0.5);
  cv::Mat there;
  cv::warpAffine(cv::Mat(head.height, head.width, CV_8U, head.data), there, where, f.size,
                 cv::INTER_LINEAR | cv::WARP_INVERSE_MAP, cv::BORDER_REPLICATE);
  return there > 127;
}

/* A picture in the pixels of the rendered head, in the pixels of the box. */
cv::Mat in_box(const cv::Mat &picture, const ern_dub_input &in, const face &f, int interpolation) {
  const double sx = in.head_scale[0], sy = in.head_scale[1];
  const cv::Rect used(0, 0, (int)std::ceil(sx * f.box.width) + 2, (int)std::ceil(sy * f.box.height) + 2);
  cv::Mat out;
  cv::resize(picture(used & cv::Rect(cv::Point(), picture.size())), out, cv::Size(), 1 / sx, 1 / sy, interpolation);
  return out(cv::Rect(cv::Point(), f.box.size()));
}

/* 255 on the nose and near it: it does not speak, and is sharper as recorded. */
cv::Mat nose_of(const face &f) {
  cv::Mat nose = cv::Mat::zeros(f.size, CV_8U);
  fill_hull(nose, std::vector<cv::Point2f>(f.landmarks.begin() + NOSE, f.landmarks.begin() + NOSE_END));
  return depth_of(nose == 0) <= round_nose * f.width;
}

/* 255 in the recorded mouth, enlarged. */
cv::Mat mouth_of(const face &f) {
  const std::vector<cv::Point2f> &at = f.landmarks;
  cv::Mat mouth = cv::Mat::zeros(f.size, CV_8U);
  std::vector<cv::Point2f> lips;
  cv::Point2f middle(0, 0);
  for (int i = LIPS; i < LIPS_END; i++) middle += at[(size_t)i] * (1.0F / (LIPS_END - LIPS));
  for (int i = LIPS; i < LIPS_END; i++) lips.push_back(middle + mouth_growth * (at[(size_t)i] - middle));
  fill_hull(mouth, lips);
  return mouth;
}

/* 0..255: a region that ends inside its border, within two deviations. */
cv::Mat softened_inward(const cv::Mat &region, float deviation) {
  cv::Mat soft;
  low_pass(region, deviation).convertTo(soft, CV_8U, 2, -255);
  return soft;
}

/* 0..255: the lower face inside the jaw, less the nose, and the recorded mouth, inside the recorded head, with a soft
 * edge. */
cv::Mat mask_of(const face &f, const cv::Mat &head) {
  const std::vector<cv::Point2f> &at = f.landmarks;
  cv::Mat lower = cv::Mat::zeros(f.size, CV_8U), mouth = mouth_of(f);
  std::vector<cv::Point2f> outline(at.begin() + CHEEK_RIGHT, at.begin() + CHEEK_LEFT + 1);
  outline.push_back(at[NOSE_BASE]);
  fill_hull(lower, outline);
  cv::rectangle(lower, cv::Rect(cv::Point(0, 0), lower.size()),
                cv::Scalar(0)); /* the box may end at the square's edge */
  lower = eroded(depth_of(lower), inside_jaw * f.width) & ~nose_of(f);
  const cv::Mat depth = depth_of(head);
  cv::bitwise_and(mouth, eroded(depth, 0.02F * f.width), mouth);
  const cv::Mat mask = low_pass(lower | mouth, feather * f.width);
  return cv::min(mask, softened_inward(eroded(depth, 0.015F * f.width), edge_feather * f.width));
}

/* Colours of sums (RGB, weight) where there are none yet, and the weight is not too small. */
void put_missing(cv::Mat &colours, cv::Mat &there, const cv::Mat &sums) {
  for (int y = 0; y < sums.rows; y++) {
    for (int x = 0; x < sums.cols; x++) {
      const cv::Vec4f &sum = sums.at<cv::Vec4f>(y, x);
      if (there.at<uint8_t>(y, x) != 0 || !(sum[3] > 0.08F)) continue;
      for (int c = 0; c < 3; c++) colours.at<cv::Vec3b>(y, x)[c] = cv::saturate_cast<uint8_t>(sum[c] / sum[3]);
      there.at<uint8_t>(y, x) = 255;
    }
  }
}

/* The head's colours where it is certain to be (`there`: 255), continued outwards by normalised blurs of growing width;
 * `there` becomes 255 where there is a colour. All in the head's pixels, of which the face is `width` wide. */
cv::Mat continue_colours(const cv::Mat &head, float width, cv::Mat &there) {
  cv::Mat known(head.size(), CV_32FC4, cv::Scalar::all(0)),
      out(head.size(), CV_8UC3, cv::Scalar::all(0)); /* RGB, weight */
  for (int y = 0; y < head.rows; y++) {
    for (int x = 0; x < head.cols; x++) {
      const cv::Vec4b &colour = head.at<cv::Vec4b>(y, x);
      if (there.at<uint8_t>(y, x) == 0) continue;
      known.at<cv::Vec4f>(y, x) = cv::Vec4f(colour[0], colour[1], colour[2], 1);
      out.at<cv::Vec3b>(y, x) = cv::Vec3b(colour[0], colour[1], colour[2]);
    }
  }
  for (float deviation = 0.01F; deviation < 0.2F; deviation *= 2)
    put_missing(out, there, low_pass(known, deviation * width));
  return out;
}

/* Beyond the head's outline the recorded skin is nearer than continued colours, which are flat, but in the recorded
 * mouth. Holes within it stay filled: the recorded mouth may reach them. */
void end_at_head(cv::Mat &mask, const cv::Mat &certain, const face &f) {
  cv::Mat within = cv::Mat::zeros(certain.size(), CV_8U);
  std::vector<std::vector<cv::Point>> outlines;
  cv::findContours(certain >= 128, outlines, cv::RETR_EXTERNAL, cv::CHAIN_APPROX_NONE);
  cv::drawContours(within, outlines, -1, cv::Scalar(255), cv::FILLED);
  const cv::Mat mouth = low_pass(mouth_of(f), feather * f.width);
  cv::min(mask, cv::max(softened_inward(within, outline_feather * f.width), mouth), mask);
}

/* What a dubbed frame is made of, in the pixels of the box. */
struct layers {
  cv::Mat frame;      /* RGBA: the recorded frame */
  cv::Mat colour;     /* RGB: of the head */
  cv::Mat there;      /* 128..255: `colour` is known */
  cv::Mat head_there; /* 255: the recorded head is there */
  cv::Mat mask;       /* 0..255: the share of `colour` */
};

/* Sums over the mask's edge: in how far the recorded skin differs from the head's colours, and how many pixels. */
cv::Mat differences(const layers &l) {
  cv::Mat out(l.mask.size(), CV_32FC4);
  for (int y = 0; y < out.rows; y++) {
    const uint8_t *recorded = l.frame.ptr(y), *colour = l.colour.ptr(y), *there = l.there.ptr(y), *mask = l.mask.ptr(y),
                  *head_there = l.head_there.ptr(y);
    float *to = out.ptr<float>(y);
    for (int x = 0; x < out.cols; x++, to += 4, recorded += 4, colour += 3) {
      const float in_ring = mask[x] >= ring_low && mask[x] <= ring_high && head_there[x] != 0 && there[x] >= 128;
      for (int c = 0; c < 3; c++)
        to[c] = in_ring * std::clamp((float)(recorded[c] - colour[c]), -match_most, match_most);
      to[3] = in_ring;
    }
  }
  return out;
}

/* Draws the head's colours by the mask, after their low frequencies are matched to those of the recorded skin. */
void blend(layers &l, float width) {
  const cv::Mat apart = low_pass(differences(l), match_deviation * width);
  for (int y = 0; y < apart.rows; y++) {
    const uint8_t *colour = l.colour.ptr(y), *there = l.there.ptr(y), *mask = l.mask.ptr(y);
    const float *sum = apart.ptr<float>(y);
    uint8_t *to = l.frame.ptr(y);
    for (int x = 0; x < apart.cols; x++, to += 4, sum += 4, colour += 3) {
      if (mask[x] == 0) continue;
      const float share = (float)mask[x] / 255, weight = 1 / (sum[3] + 1e-4F);
      for (int c = 0; c < 3; c++) {
        const float own = (float)(there[x] >= 128 ? colour[c] - to[c] : 0);
        to[c] = cv::saturate_cast<uint8_t>((float)to[c] + share * (own + weight * sum[c]));
      }
    }
  }
}

/* 255 where the head's colours are used: in the mask, and around it, where it decides which colours are certain. The
 * further pixels are 2 for cubic interpolation, 1 as the mask of fewer pixels may be smaller, and half of one for the
 * border of a pixel. */
cv::Mat wanted_of(const ern_dub_input &in) {
  const face f = face_of(in, true);
  const cv::Mat mask = mask_of(f, head_recorded(in, f));
  return depth_of(mask == 0) <= whole_radius(certain_depth * f.width) + 3.5F;
}

bool compose(const ern_dub_input &in, uint8_t *rgba) {
  const face f = face_of(in, false);
  const cv::Mat head(in.head_height, in.head_width, CV_8UC4, const_cast<uint8_t *>(in.head));
  layers l;
  l.frame = cv::Mat(in.height, in.width, CV_8UC4, rgba)(f.box);
  l.head_there = head_recorded(in, f);
  l.mask = mask_of(f, l.head_there);
  const cv::Mat inner = l.mask >= 128;
  const int wanted = cv::countNonZero(inner);
  cv::Mat opacity, there;
  cv::extractChannel(head, opacity, 3);
  opacity.setTo(0, wanted_of(in) == 0); /* so that the frame does not depend on what is there */
  const auto covers = [&](const cv::Mat &picture) {
    return (float)cv::countNonZero(inner & (picture >= 128)) >= least_cover * (float)wanted;
  };
  if (wanted == 0 || !covers(in_box(opacity, in, f, cv::INTER_LINEAR))) return false;
  const float head_width = f.width * in.head_scale[0]; /* of the face */
  there = eroded(depth_of(opacity > 255 * sure_opacity), certain_depth * head_width);
  const cv::Mat certain = in_box(there, in, f, cv::INTER_LINEAR), continued = continue_colours(head, head_width, there);
  l.there = in_box(there, in, f, cv::INTER_LINEAR);
  if (!covers(l.there)) return false;
  l.colour = in_box(continued, in, f, cv::INTER_CUBIC);
  end_at_head(l.mask, certain, f);
  blend(l, f.width);
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

extern "C" ern_status ern_dub_find_wanted(ern_context *context, const ern_dub_input *input, uint8_t *wanted) {
  try {
    wanted_of(*input).copyTo(cv::Mat(input->head_height, input->head_width, CV_8U, wanted));
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
