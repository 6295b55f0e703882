/* SPDX-License-Identifier: MIT
 * Segments the person on small pictures. GrabCut segments examples from the whole clip around the projected head. The
 * colours, positions and background learnt from them segment every frame by one graph cut. */
#include "prepare/layers/layers_opencv.h"

#include <algorithm>
#include <climits>
#include <cmath>
#include <cstring>

#include <opencv2/imgproc/detail/gcgraph.hpp> /* needs those above */

namespace {

enum { BINS = 16, ROUNDS = 3, NEAR = 3 /* pixels of work */ };
constexpr double SKULL = 0.92, HAIR = 1.5; /* of the projected ellipsoid */
constexpr float COLOUR_LIMIT = 6, LAST_FRAME = 1, SMOOTHNESS = 5, OTHER = 0.15F, STATIC_MOTION = 4;
constexpr double STATIC_SHARE = 0.2; /* of the examples */

/* The histogram bin of a colour. Bins are uniform in the square root of a value, as dark colours lie closer. */
size_t bin_of(const cv::Vec3b &c) {
  size_t bin = 0;
  for (int i = 0; i < 3; i++) bin = bin * BINS + std::min(size_t{BINS - 1}, size_t(std::sqrt(float(c[i]) + 0.5F)));
  return bin;
}
/* The number of colours of a bin: bin r has 2 r + 1 values along each axis. */
double colours_of(size_t bin) {
  double count = 1;
  for (int i = 0; i < 3; i++, bin /= BINS) count *= 2 * double(bin % BINS) + 1;
  return count;
}

cv::Mat disk(int radius) {
  return cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(2 * radius + 1, 2 * radius + 1));
}

/* Fills a polygon, given in pixels of the clip, in a small mask. */
void fill(cv::Mat &mask, std::vector<cv::Point> polygon, double shrink, int value) {
  for (cv::Point &p : polygon) p = cv::Point(cvRound(p.x * shrink), cvRound(p.y * shrink));
  cv::fillPoly(mask, std::vector<std::vector<cv::Point>>{polygon}, value);
}

/* The polygon of the face between jaw and brows, scaled. */
std::vector<cv::Point> face_polygon(const ern_layer_face &face, double scale) {
  float points[27][2];
  for (int k = 0; k < 17; k++) std::copy(face.points[k], face.points[k] + 2, points[k]);
  for (int k = 0; k < 10; k++) std::copy(face.points[26 - k], face.points[26 - k] + 2, points[17 + k]);
  return ern_layer_polygon(points, 27, scale);
}

/* The outline of the head: the projected one scaled by `scale` above the ears, the jaw's landmarks scaled by `jaw`
 * below. */
std::vector<cv::Point> head_of(const ern_layer_face &face, double scale, double jaw) {
  float points[ERN_LAYER_OUTLINE + 15][2];
  const float *left = face.points[1], *right = face.points[15];
  int count = 0;
  for (const float(&p)[2] : face.outline)
    if ((right[0] - left[0]) * (p[1] - left[1]) < (right[1] - left[1]) * (p[0] - left[0]))
      std::copy(p, p + 2, points[count++]);
  for (int k = 1; k <= 15; k++) std::copy(face.points[k], face.points[k] + 2, points[count++]);
  std::vector<cv::Point> polygon, hull;
  for (int k = 0; k < count; k++) {
    const double s = k < count - 15 ? scale : jaw;
    polygon.emplace_back(cvRound(face.centre[0] + s * (points[k][0] - face.centre[0])),
                         cvRound(face.centre[1] + s * (points[k][1] - face.centre[1])));
  }
  cv::convexHull(polygon, hull);
  return hull;
}

/* Both sides of the neck: a line from `out` beside the middle, `down` below the chin, that falls by `slope` to the
 * side; what lies above it, or below. Lengths in widths and heights of the head. */
std::vector<cv::Point> shoulders(const ern_layer_face &face, double out, double down, double slope, bool above) {
  const cv::Rect head = cv::boundingRect(head_of(face, 1, 1));
  const int middle = head.x + head.width / 2, step = cvRound(out * head.width), far = 8 * head.width;
  const int high = cvRound(face.points[8][1] + down * head.height), low = high + cvRound(slope * far);
  const int end = above ? -2 * far : low + 2 * far;
  return {{middle - step - far, end}, {middle + step + far, end}, {middle + step + far, low},
          {middle + step, high},      {middle - step, high},      {middle - step - far, low}};
}

/* Marks the pixels that are certain before any colour is known: skull, face and chest as person; the area above the
 * shoulders and away from the head as background. */
void seed(const ern_person_model &model, ern_person_example &example) {
  const int n = model.work;
  const double shrink = double(n) / model.side;
  example.mask = cv::Mat(n, n, CV_8U, cv::Scalar(0));
  fill(example.mask, head_of(example.face, SKULL, SKULL), shrink, 255);
  fill(example.mask, face_polygon(example.face, 0.95), shrink, 255);
  example.chest = cv::Mat(n, n, CV_8U, cv::Scalar(0));
  fill(example.chest, shoulders(example.face, 0.25, 0.1, 1.4, false), shrink, 255);
  example.mask |= example.chest;
  example.place = cv::Mat(n, n, CV_8U, cv::Scalar(0));
  fill(example.place, shoulders(example.face, 0.9, -0.12, 0.25, true), shrink, 255);
  fill(example.place, head_of(example.face, HAIR, HAIR), shrink, 0);
}

/* The prior probability, in percent, that a pixel is the person, from the head's position alone. */
cv::Mat likely(const ern_person_model &model, const ern_layer_face &face) {
  const double shrink = double(model.work) / model.side;
  cv::Mat percent(model.work, model.work, CV_8U, cv::Scalar(3));
  fill(percent, head_of(face, HAIR, HAIR), shrink, 10);
  fill(percent, shoulders(face, 0.9, -0.3, 0.25, false), shrink, 50);
  fill(percent, head_of(face, 1.3, 1.1), shrink, 35);
  fill(percent, shoulders(face, 0.45, -0.05, 0.4, false), shrink, 70);
  fill(percent, shoulders(face, 0.38, 0.02, 0.9, false), shrink, 85);
  fill(percent, head_of(face, 1.1, 1.03), shrink, 70);
  fill(percent, shoulders(face, 0.25, 0.1, 1.4, false), shrink, 97);
  fill(percent, head_of(face, SKULL, SKULL), shrink, 97);
  return percent;
}

/* The pixels of an example that are learnt as background: all but the person, `margin` pixels around it, and the
 * surroundings of head and neck, so that a missed part of the person is not learnt as background. */
cv::Mat around(const ern_person_model &model, const cv::Mat &mask, const ern_layer_face &face, int margin) {
  const double shrink = double(model.work) / model.side;
  cv::Mat wide;
  cv::dilate(mask, wide, disk(margin));
  fill(wide, head_of(face, 1.3, 1.3), shrink, 255);
  fill(wide, shoulders(face, 0.6, -0.1, 0.8, false), shrink, 255);
  return wide == 0;
}

/* Pixels outside the masks that are static in many examples are learnt as background close to the head as well. */
void learn_static(ern_person_model *model) {
  const size_t count = model->examples.size();
  cv::Mat often(model->work, model->work, CV_8U, cv::Scalar(0));
  for (const ern_person_example &example : model->examples) cv::add(often, 1, often, example.motion < -STATIC_MOTION);
  const cv::Mat steady = often >= double(count) * STATIC_SHARE;
  for (ern_person_example &example : model->examples)
    example.place.setTo(255, steady & (example.motion < -STATIC_MOTION) & (example.mask == 0));
}

/* Keeps the connected component of the face and fills small holes. */
void tidy(const ern_person_model &model, const ern_layer_face &face, cv::Mat &mask) {
  const double shrink = double(model.work) / model.side;
  cv::Mat core(mask.size(), CV_8U, cv::Scalar(0)), labels, stats, centres;
  fill(core, face_polygon(face, 0.8), shrink, 255);
  int count = cv::connectedComponentsWithStats(mask, labels, stats, centres, 4);
  std::vector<int> votes(size_t(count), 0);
  for (int y = 0; y < mask.rows; y++)
    for (int x = 0; x < mask.cols; x++)
      if (core.at<uchar>(y, x) != 0 && mask.at<uchar>(y, x) != 0) votes[size_t(labels.at<int>(y, x))]++;
  const int best = int(std::max_element(votes.begin(), votes.end()) - votes.begin());
  if (votes[size_t(best)] > 0) mask = labels == best;
  cv::Mat outside = mask == 0;
  count = cv::connectedComponentsWithStats(outside, labels, stats, centres, 4);
  const int limit = mask.rows * mask.cols / 200;
  for (int k = 1; k < count; k++) {
    const int *s = stats.ptr<int>(k);
    const bool at_border =
        s[cv::CC_STAT_LEFT] == 0 || s[cv::CC_STAT_TOP] == 0 || s[cv::CC_STAT_LEFT] + s[cv::CC_STAT_WIDTH] == mask.cols;
    if (!at_border && s[cv::CC_STAT_AREA] < limit) mask.setTo(255, labels == k);
  }
}

cv::Mat small_of(const ern_person_model &model, const cv::Mat &frame) {
  cv::Mat small;
  cv::resize(frame, small, cv::Size(model.work, model.work), 0, 0, cv::INTER_AREA);
  return small;
}

cv::Mat small_mask(const ern_person_model &model, const uint8_t *mask) {
  cv::Mat small;
  const cv::Mat whole(model.side, model.side, CV_8U, const_cast<uint8_t *>(mask));
  cv::resize(whole, small, cv::Size(model.work, model.work), 0, 0, cv::INTER_AREA);
  return small >= 128;
}

/* The zone of a row, 0 above the chin, 1 below it: their colours differ. */
int zone_of(const ern_person_model &model, const ern_layer_face &face, int row) {
  return row * double(model.side) / model.work > face.points[8][1] ? 1 : 0;
}

/* Log density of the examples' colours, of the person or the background, in a zone; the other zone counts with weight
 * OTHER. */
void colours(const ern_person_model &model, bool person, int zone, std::vector<float> &logs) {
  std::vector<float> bins(size_t{BINS} * BINS * BINS, 0), next(bins.size());
  double total = 0;
  for (const ern_person_example &example : model.examples) {
    cv::Mat part;
    if (person)
      cv::erode(example.mask, part, disk(1), cv::Point(-1, -1), 1, cv::BORDER_CONSTANT, cv::Scalar(255));
    else
      part = example.place;
    for (int y = 0; y < part.rows; y++) {
      const float weight = zone_of(model, example.face, y) == zone ? 1 : OTHER;
      for (int x = 0; x < part.cols; x++)
        if (part.at<uchar>(y, x) != 0) bins[bin_of(example.small.at<cv::Vec3b>(y, x))] += weight, total += weight;
    }
  }
  for (size_t step : {size_t{1}, size_t{BINS}, size_t{BINS} * BINS}) { /* (1 2 1)/4 along each axis */
    for (size_t i = 0; i < bins.size(); i++) {
      const size_t at = i / step % BINS;
      next[i] = (2 * bins[i] + bins[at > 0 ? i - step : i] + bins[at + 1 < BINS ? i + step : i]) / 4;
    }
    bins.swap(next);
  }
  for (size_t i = 0; i < bins.size(); i++)
    logs.push_back(float(std::log(0.98 * bins[i] / std::max(total, 1.0) / colours_of(i) + 0.02 / (256.0 * 256 * 256))));
}

/* Learns the log odds of the person at each pixel, with the head at `home`; half of the probability is the prior of
 * likely(). */
void learn_places(ern_person_model *model, bool first) {
  cv::Mat sum(model->work, model->work, CV_32F, cv::Scalar(0)), odds, moved;
  model->home = model->examples[model->examples.size() / 2].face;
  for (const ern_person_example &example : model->examples) {
    ern_person_warp_mask(*model, example.mask, example.face, model->home).convertTo(moved, CV_32F, 1.0 / 255);
    sum += moved / double(model->examples.size());
  }
  likely(*model, model->home).convertTo(moved, CV_32F, 0.01);
  sum = first ? moved : cv::Mat(0.5 * sum + 0.5 * moved);
  const int size = (model->work / 16) | 1;
  cv::GaussianBlur(sum, sum, cv::Size(size, size), 0);
  odds = sum / (1 - sum);
  cv::log(odds, model->prior);
}

/* Log odds of the person in each pixel. */
cv::Mat odds_of(const ern_person_model &model, const cv::Mat &small, const ern_layer_face &face) {
  cv::Mat odds = ern_person_warp_mask(model, model.prior, model.home, face);
  for (int y = 0; y < small.rows; y++) {
    const size_t zone = size_t(zone_of(model, face, y)) * BINS * BINS * BINS;
    for (int x = 0; x < small.cols; x++) {
      const cv::Vec3b c = small.at<cv::Vec3b>(y, x);
      const size_t bin = zone + bin_of(c);
      double place = std::exp(double(model.place[bin]));
      const double trust = 0.97 * model.small_trust.at<float>(y, x);
      if (trust > 0.01) { /* a narrow density around the background's colour at this pixel */
        const double sigma = model.small_noise.at<float>(y, x);
        const cv::Vec3f b = model.small_background.at<cv::Vec3f>(y, x);
        double d = 0;
        for (int i = 0; i < 3; i++) d += (c[i] - b[i]) * (c[i] - b[i]);
        place = trust * std::exp(-0.5 * d / (sigma * sigma)) / (15.75 * sigma * sigma * sigma) + (1 - trust) * place;
      }
      const float colour = model.person[bin] - float(std::log(place));
      odds.at<float>(y, x) += std::max(-COLOUR_LIMIT, std::min(COLOUR_LIMIT, colour));
    }
  }
  return odds;
}

/* Graph cut: the labels that minimise the sum of odds and, between neighbours, SMOOTHNESS exp(-beta |c - c'|^2) /
 * distance. */
cv::Mat cut(const cv::Mat &small, const cv::Mat &odds) {
  static const int to[4][2] = {{1, 0}, {0, 1}, {1, 1}, {-1, 1}};
  const int n = small.rows;
  double sum = 0;
  for (int y = 0; y + 1 < n; y++)
    for (int x = 0; x + 1 < n; x++)
      for (int i = 0; i < 3; i++) {
        const double c = small.at<cv::Vec3b>(y, x)[i];
        sum += std::pow(c - small.at<cv::Vec3b>(y, x + 1)[i], 2) + std::pow(c - small.at<cv::Vec3b>(y + 1, x)[i], 2);
      }
  const double beta = sum > 0 ? double(n) * n / sum : 0;
  cv::detail::GCGraph<float> graph(unsigned(n * n), unsigned(8 * n * n));
  for (int k = 0; k < n * n; k++) {
    graph.addVtx();
    const float o = odds.at<float>(k / n, k % n);
    graph.addTermWeights(k, std::max(o, 0.0F), std::max(-o, 0.0F));
  }
  for (int y = 0; y < n; y++)
    for (int x = 0; x < n; x++)
      for (const auto &t : to) {
        const int u = x + t[0], v = y + t[1];
        if (u < 0 || u >= n || v >= n) continue;
        double d = 0;
        for (int i = 0; i < 3; i++)
          d += std::pow(double(small.at<cv::Vec3b>(y, x)[i]) - small.at<cv::Vec3b>(v, u)[i], 2);
        const float w = float(SMOOTHNESS * std::exp(-beta * d) / std::sqrt(double(t[0] * t[0] + t[1] * t[1])));
        graph.addEdges(y * n + x, v * n + u, w, w);
      }
  graph.maxFlow();
  cv::Mat mask(n, n, CV_8U);
  for (int k = 0; k < n * n; k++) mask.at<uchar>(k / n, k % n) = graph.inSourceSegment(k) ? 255 : 0;
  return mask;
}

cv::Mat person_of(const ern_person_model &model, const cv::Mat &small, const ern_layer_face &face,
                  const cv::Mat &motion) {
  const double shrink = double(model.work) / model.side;
  cv::Mat odds = odds_of(model, small, face) + motion;
  if (!model.last.empty()) {
    cv::Mat last;
    ern_person_warp_mask(model, model.last, model.last_face, face)
        .convertTo(last, CV_32F, 2 * LAST_FRAME / 255, -LAST_FRAME);
    cv::GaussianBlur(last, last, cv::Size(5, 5), 0);
    odds += last;
  }
  cv::Mat sure(small.size(), CV_8U, cv::Scalar(0));
  fill(sure, face_polygon(face, 0.9), shrink, 255);
  odds.setTo(50, sure);
  cv::Mat mask = cut(small, odds);
  tidy(model, face, mask);
  return mask;
}

}  // namespace

std::vector<cv::Point> ern_layer_polygon(const float (*points)[2], int count, double scale) {
  double x = 0, y = 0;
  for (int k = 0; k < count; k++) x += double(points[k][0]) / count, y += double(points[k][1]) / count;
  std::vector<cv::Point> polygon;
  for (int k = 0; k < count; k++)
    polygon.emplace_back(cvRound(x + scale * (points[k][0] - x)), cvRound(y + scale * (points[k][1] - y)));
  return polygon;
}

cv::Mat ern_person_warp_mask(const ern_person_model &model, const cv::Mat &mask, const ern_layer_face &from,
                             const ern_layer_face &to) {
  const float shrink = float(model.work) / float(model.side);
  const float dx = (to.centre[0] - from.centre[0]) * shrink, dy = (to.centre[1] - from.centre[1]) * shrink;
  if (std::fabs(dx) < 0.05F && std::fabs(dy) < 0.05F) return mask.clone();
  const float chin = to.points[8][1] * shrink, n = float(model.work);
  cv::Mat x(mask.size(), CV_32F), y(mask.size(), CV_32F), moved;
  for (int v = 0; v < mask.rows; v++) {
    const float down = chin < n - 1 ? std::max(0.0F, std::min(1.0F, (float(v) - chin) / (n - chin))) : 0;
    const float part = 1 - down * 2 / 3;
    for (int u = 0; u < mask.cols; u++) {
      x.at<float>(v, u) = float(u) - part * dx;
      y.at<float>(v, u) = std::min(float(v) - part * dy, n - 1);
    }
  }
  cv::remap(mask, moved, x, y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  return moved;
}

int ern_person_work(int side) { return side / std::max(1, (side + 128) / 256); }

ern_status ern_person_model_make(ern_context *context, int side, ern_person_model **model) {
  *model = nullptr;
  return ern_layers_guarded(context, [&] {
    *model = new ern_person_model{};
    (*model)->context = context;
    (*model)->side = side;
    (*model)->work = ern_person_work(side);
    return ERN_OK;
  });
}

void ern_person_model_free(ern_person_model *model) { delete model; }

ern_status ern_person_model_add(ern_person_model *model, const uint8_t *rgb, const ern_layer_face *face,
                                const uint8_t *supplied) {
  return ern_layers_guarded(model->context, [&] {
    ern_person_example example;
    example.frame = cv::Mat(model->side, model->side, CV_8UC3, const_cast<uint8_t *>(rgb)).clone();
    example.small = small_of(*model, example.frame);
    example.face = *face;
    if (supplied == nullptr) {
      seed(*model, example);
    } else {
      example.mask = small_mask(*model, supplied);
      example.place = around(*model, example.mask, example.face, NEAR);
    }
    model->supplied = supplied != nullptr;
    model->examples.push_back(example);
    return ERN_OK;
  });
}

ern_status ern_person_model_learn(ern_person_model *model, const uint8_t *background, bool key,
                                  ern_person_found *found) {
  *found = ern_person_found{};
  if (model->examples.empty()) return ern_fail(model->context, ERN_E_STATE, "layers: no frame to learn from");
  return ern_layers_guarded(model->context, [&] {
    ern_person_place_moves(*model, found);
    if (!model->supplied) {
      ern_person_motion_learn(model);
      for (ern_person_example &example : model->examples)
        example.motion = ern_person_motion_odds(*model, example.small, example.face);
    }
    for (int round = 0;; round++) {
      ern_person_background(model, background, key, found);
      model->person.clear();
      model->place.clear();
      for (int zone = 0; zone < 2; zone++) {
        colours(*model, true, zone, model->person);
        colours(*model, false, zone, model->place);
      }
      learn_places(model, round == 0);
      if (round == ROUNDS || model->supplied) break;
      for (ern_person_example &example : model->examples) {
        example.mask = person_of(*model, example.small, example.face, example.motion);
        example.place = around(*model, example.mask, example.face, round + 1 < ROUNDS ? 2 * NEAR : NEAR);
      }
      learn_static(model);
    }
    if (background == nullptr && !key) ern_person_background_reveal(model);
    model->examples.clear();
    return ERN_OK;
  });
}

const uint8_t *ern_person_model_background(const ern_person_model *model) { return model->shown.ptr<uint8_t>(); }

ern_status ern_person_mask(ern_person_model *model, const uint8_t *rgb, const ern_layer_face *face,
                           const uint8_t *supplied, uint8_t *mask) {
  return ern_layers_guarded(model->context, [&] {
    const cv::Mat frame(model->side, model->side, CV_8UC3, const_cast<uint8_t *>(rgb));
    if (supplied != nullptr) {
      model->last = small_mask(*model, supplied);
    } else {
      const cv::Mat small = small_of(*model, frame);
      model->last = person_of(*model, small, *face, ern_person_motion_odds(*model, small, *face));
    }
    model->last_face = *face;
    model->last.copyTo(cv::Mat(model->work, model->work, CV_8U, mask));
    return ERN_OK;
  });
}

ern_status ern_person_temporal_mean(ern_person_model *model, const uint8_t *const *masks,
                                    const ern_layer_face *const *faces, size_t count, size_t which, uint8_t *voted) {
  return ern_layers_guarded(model->context, [&] {
    const int n = model->work;
    cv::Mat sum(n, n, CV_16U, cv::Scalar(0)), wide;
    for (size_t k = 0; k < count; k++) {
      const cv::Mat mask(n, n, CV_8U, const_cast<uint8_t *>(masks[k]));
      ern_person_warp_mask(*model, mask, *faces[k], *faces[which]).convertTo(wide, CV_16U);
      sum += wide;
    }
    cv::Mat out(n, n, CV_8U, voted);
    sum.convertTo(out, CV_8U, 1.0 / double(count));
    return ERN_OK;
  });
}
