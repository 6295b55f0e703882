/* SPDX-License-Identifier: MIT
 * Estimates the background behind the person from frames in which the person is elsewhere. */
#include <algorithm>
#include <cmath>

#include "prepare/layers/layers_opencv.h"

namespace {

constexpr float NOISE_LEAST = 4, NOISE_MOST = 25; /* grey values, of video after compression */
/* Of a place that stands still; more is a place that changes all the time. Of seven videos 3 in 4 pixels had 5 or
 * less. */
constexpr float NOISE_STILL = 6;

constexpr double LEAST_CHANGE = 5; /* standard deviation of a background, grey values, whose contrast can be told */

/* The mask of an example's visible background, at the clip's side. */
cv::Mat free_of(const ern_person_model &model, const ern_person_example &example) {
  cv::Mat whole;
  cv::resize(example.place, whole, cv::Size(model.side, model.side), 0, 0, cv::INTER_LINEAR);
  return whole == 255;
}

uint8_t median_of(std::vector<uint8_t> &values) {
  const auto middle = values.begin() + long(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/* The values of a pixel's channel in the examples whose place is 255 there. */
void collect(const ern_person_model &model, const std::vector<cv::Mat> &places, int y, int x, int channel,
             std::vector<uint8_t> &values) {
  values.clear();
  for (size_t k = 0; k < places.size(); k++)
    if (places[k].at<uchar>(y, x) != 0) values.push_back(model.examples[k].frame.at<cv::Vec3b>(y, x)[channel]);
}

/* A pixel visible in fewer examples counts as never seen: close to the person, their masks may lack hair or an ear. */
size_t least_examples(const ern_person_model &model) { return (model.examples.size() + 7) / 8; }

/* Median and noise (1.48 times the median absolute deviation, of the channel with the greatest) of each pixel over the
 * examples in which it is visible. */
void medians(ern_person_model *model, cv::Mat &noise) {
  const int n = model->side;
  const size_t least = least_examples(*model);
  std::vector<cv::Mat> places;
  for (const ern_person_example &example : model->examples) places.push_back(free_of(*model, example));
  model->background.create(n, n, CV_8UC3);
  model->background.setTo(cv::Scalar::all(0));
  model->seen.create(n, n, CV_8U);
  noise.create(n, n, CV_32F);
  noise.setTo(NOISE_LEAST);
  std::vector<uint8_t> values;
  for (int y = 0; y < n; y++)
    for (int x = 0; x < n; x++) {
      cv::Vec3b &b = model->background.at<cv::Vec3b>(y, x);
      float most = NOISE_LEAST;
      size_t count = 0;
      for (int i = 0; i < 3; i++) {
        collect(*model, places, y, x, i, values);
        count = values.size();
        if (count == 0) break;
        b[i] = median_of(values);
        for (uint8_t &v : values) v = uint8_t(std::abs(int(v) - int(b[i])));
        most = std::max(most, 1.48F * float(median_of(values)));
      }
      model->seen.at<uchar>(y, x) = count >= least ? 255 : 0;
      noise.at<float>(y, x) = std::min(most, NOISE_MOST);
    }
}

/* Fills the pixels outside `known` with means over ever wider surroundings. */
cv::Mat filled(const cv::Mat &picture, const cv::Mat &known) {
  std::vector<cv::Mat> colours(1), weights(1);
  picture.convertTo(colours[0], CV_32FC3);
  known.convertTo(weights[0], CV_32F, 1.0 / 255);
  cv::Mat three;
  cv::merge(std::vector<cv::Mat>(3, weights[0]), three);
  colours[0] = colours[0].mul(three);
  while (weights.back().rows > 1) {
    cv::Mat colour, weight;
    cv::pyrDown(colours.back(), colour);
    cv::pyrDown(weights.back(), weight);
    colours.push_back(colour);
    weights.push_back(weight);
  }
  cv::Mat below;
  for (size_t level = weights.size(); level-- > 0;) {
    cv::Mat up, result(weights[level].size(), CV_32FC3);
    if (!below.empty()) cv::resize(below, up, result.size(), 0, 0, cv::INTER_LINEAR);
    for (int y = 0; y < result.rows; y++)
      for (int x = 0; x < result.cols; x++) {
        const float w = weights[level].at<float>(y, x), part = std::min(1.0F, w / 0.25F);
        const cv::Vec3f under = up.empty() ? cv::Vec3f(128, 128, 128) : up.at<cv::Vec3f>(y, x);
        const cv::Vec3f own = w > 1e-6F ? colours[level].at<cv::Vec3f>(y, x) / w : under;
        result.at<cv::Vec3f>(y, x) = own * part + under * (1 - part);
      }
    below = result;
  }
  below.convertTo(below, CV_8UC3);
  return below;
}

/* The colour of a chroma key screen: the median of the picture's border above the shoulders, without the person. */
cv::Vec3b screen_colour(const ern_person_model &model) {
  const int n = model.side, strip = std::max(1, n / 20);
  cv::Vec3b colour(0, 0, 0);
  for (int i = 0; i < 3; i++) {
    std::vector<uint8_t> values;
    for (const ern_person_example &example : model.examples)
      for (int y = 0; y < n / 2; y++)
        for (int x = 0; x < n; x += y < strip || x + 1 < strip || x >= n - strip ? 1 : n - 2 * strip)
          values.push_back(example.frame.at<cv::Vec3b>(y, x)[i]);
    colour[i] = median_of(values);
  }
  return colour;
}

double difference(const cv::Vec3b &a, const cv::Vec3b &b) {
  return std::sqrt(std::pow(double(a[0]) - b[0], 2) + std::pow(double(a[1]) - b[1], 2) +
                   std::pow(double(a[2]) - b[2], 2));
}

/* Measures the difference of the supplied picture from the learnt background, and of the frames from the background. */
void measure(const ern_person_model &model, const cv::Mat &noise, const cv::Mat &supplied, ern_person_found *found) {
  const int n = model.side;
  double sum = 0;
  size_t seen = 0, outside = 0, unlike = 0, unlike_lit = 0, behind = 0;
  std::vector<double> lights;
  for (int y = 0; y < n; y++)
    for (int x = 0; x < n; x++) {
      if (model.seen.at<uchar>(y, x) == 0) {
        behind++;
      } else if (!supplied.empty()) {
        sum += difference(model.background.at<cv::Vec3b>(y, x), supplied.at<cv::Vec3b>(y, x));
        seen++;
      }
    }
  for (const ern_person_example &example : model.examples) {
    const cv::Mat place = free_of(model, example);
    const cv::Mat lit = ern_person_place_lit(model.background, example.frame, place);
    const cv::Scalar before = cv::mean(model.background, place), now = cv::mean(example.frame, place);
    lights.push_back(std::abs(now[0] + now[1] + now[2] - before[0] - before[1] - before[2]) / 3);
    for (int y = 0; y < n; y += 2)
      for (int x = 0; x < n; x += 2) {
        if (place.at<uchar>(y, x) == 0) continue;
        const cv::Vec3b &own = example.frame.at<cv::Vec3b>(y, x);
        const double most = 20 + 4 * double(std::min(noise.at<float>(y, x), NOISE_STILL));
        outside++;
        unlike += difference(model.background.at<cv::Vec3b>(y, x), own) > most;
        unlike_lit += cv::norm(lit.at<cv::Vec3f>(y, x) - cv::Vec3f(own)) > most;
      }
  }
  std::sort(lights.begin(), lights.end());
  found->light = lights[lights.size() * 9 / 10];
  found->unlike_lit = outside > 0 ? double(unlike_lit) / double(outside) : 0;
  found->never_seen = double(behind) / (double(n) * n);
  found->unlike = outside > 0 ? double(unlike) / double(outside) : 0;
  found->supplied_difference = seen > 0 ? sum / (std::sqrt(3.0) * double(seen)) : 0;
}

}  // namespace

cv::Mat ern_person_place_lit(const cv::Mat &background, const cv::Mat &frame, const cv::Mat &place) {
  std::vector<cv::Mat> from, to;
  cv::Mat lit;
  cv::split(background, from);
  cv::split(frame, to);
  for (int i = 0; i < 3; i++) {
    cv::Mat a, b;
    cv::Scalar mean_a, mean_b, sigma;
    from[size_t(i)].convertTo(a, CV_32F);
    to[size_t(i)].convertTo(b, CV_32F);
    cv::meanStdDev(a, mean_a, sigma, place);
    mean_b = cv::mean(b, place);
    const cv::Mat da = a - mean_a, db = b - mean_b;
    const double spread = sigma[0] * sigma[0];
    const double gain = sigma[0] < LEAST_CHANGE ? 1 : cv::mean(da.mul(db), place)[0] / spread;
    from[size_t(i)] = da * gain + mean_b;
  }
  cv::merge(from, lit);
  return lit;
}

void ern_person_background(ern_person_model *model, const uint8_t *background, bool key, ern_person_found *found) {
  const int n = model->side;
  const cv::Size small(model->work, model->work);
  cv::Mat noise, supplied;
  medians(model, noise);
  if (background != nullptr) supplied = cv::Mat(n, n, CV_8UC3, const_cast<uint8_t *>(background)).clone();
  if (key) {
    const cv::Vec3b colour = screen_colour(*model);
    supplied = cv::Mat(n, n, CV_8UC3, cv::Scalar(colour[0], colour[1], colour[2]));
  }
  measure(*model, noise, supplied, found);
  if (supplied.empty()) {
    model->background = filled(model->background, model->seen);
    model->shown = model->background;
  } else {
    supplied.copyTo(model->background, model->seen == 0);
    model->seen.setTo(255);
    model->shown = supplied;
  }
  cv::Mat area;
  cv::resize(model->background, area, small, 0, 0, cv::INTER_AREA);
  area.convertTo(model->small_background, CV_32FC3);
  cv::resize(noise, model->small_noise, small, 0, 0, cv::INTER_AREA);
  /* The trust in a filled-in colour falls with the distance to its source. */
  cv::resize(model->seen, area, small, 0, 0, cv::INTER_AREA);
  area = area < 255;
  cv::distanceTransform(area, model->small_trust, cv::DIST_L2, 3);
  model->small_noise += model->small_trust;
  model->small_trust *= -32.0 / model->work;
  cv::exp(model->small_trust, model->small_trust);
}

void ern_person_background_reveal(ern_person_model *model) {
  const int n = model->side, beside = std::max(1, model->work / 128);
  const cv::Mat disc = cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(2 * beside + 1, 2 * beside + 1));
  std::vector<cv::Mat> places;
  for (const ern_person_example &example : model->examples) {
    cv::Mat person, whole;
    cv::dilate(example.mask, person, disc);
    cv::resize(person, whole, cv::Size(n, n), 0, 0, cv::INTER_LINEAR);
    places.push_back(whole == 0);
  }
  cv::Mat revealed = model->background.clone(), known = model->seen.clone();
  std::vector<uint8_t> values;
  for (int y = 0; y < n; y++)
    for (int x = 0; x < n; x++)
      for (int i = 0; i < 3 && model->seen.at<uchar>(y, x) == 0; i++) {
        collect(*model, places, y, x, i, values);
        if (values.size() < least_examples(*model)) break;
        revealed.at<cv::Vec3b>(y, x)[i] = median_of(values);
        known.at<uchar>(y, x) = 255;
      }
  model->shown = filled(revealed, known);
}
