/* SPDX-License-Identifier: MIT
 * Finds a part of the place behind the person that changes. */
#include <algorithm>
#include <cmath>

#include "prepare/layers/layers_opencv.h"

namespace {

constexpr double HAIR = 1.5; /* of the projected head: up to there hair may pass for background */
constexpr float UNLIKE = 30; /* distance of two colours, grey values */

cv::Mat disc(int radius) {
  return cv::getStructuringElement(cv::MORPH_ELLIPSE, cv::Size(2 * radius + 1, 2 * radius + 1));
}

/* The pixels that are certainly behind the person, and whose background is known, 255. */
cv::Mat far_from(const ern_person_model &model, const cv::Mat &mask, const ern_layer_face &face) {
  cv::Mat person;
  cv::dilate(mask, person, disc(std::max(1, model.work / 24)));
  std::vector<cv::Point> head = ern_layer_polygon(face.outline, ERN_LAYER_OUTLINE, HAIR);
  for (cv::Point &p : head) p = p * model.work / model.side;
  cv::fillPoly(person, std::vector<std::vector<cv::Point>>{head}, 255);
  return (person == 0) & (model.small_trust > 0.999);
}

}  // namespace

ern_status ern_person_inset_add(ern_person_model *model, const uint8_t *rgb, const ern_layer_face *face,
                                const uint8_t *voted) {
  return ern_layers_guarded(model->context, [&] {
    const int n = model->work;
    cv::Mat small;
    cv::resize(cv::Mat(model->side, model->side, CV_8UC3, const_cast<uint8_t *>(rgb)), small, cv::Size(n, n), 0, 0,
               cv::INTER_AREA);
    const cv::Mat place = far_from(*model, cv::Mat(n, n, CV_8U, const_cast<uint8_t *>(voted)), *face);
    const cv::Mat lit = ern_person_place_lit(model->small_background, small, place);
    if (model->inset_frames++ == 0)
      model->inset_visible = cv::Mat::zeros(n, n, CV_32F), model->inset_unlike = cv::Mat::zeros(n, n, CV_32F);
    for (int y = 0; y < n; y++)
      for (int x = 0; x < n; x++) {
        if (place.at<uchar>(y, x) == 0) continue;
        model->inset_visible.at<float>(y, x) += 1;
        model->inset_unlike.at<float>(y, x) +=
            cv::norm(lit.at<cv::Vec3f>(y, x) - cv::Vec3f(small.at<cv::Vec3b>(y, x))) > UNLIKE;
      }
    return ERN_OK;
  });
}

ern_status ern_person_inset_find(const ern_person_model *model, ern_person_found *found) {
  return ern_layers_guarded(model->context, [&] {
    const int n = model->work;
    cv::Mat labels, stats, centres;
    cv::Mat often =
        (model->inset_visible * 2 >= model->inset_frames) & (model->inset_unlike * 5 >= model->inset_visible);
    cv::morphologyEx(often, often, cv::MORPH_CLOSE, disc(std::max(1, n / 48)));
    const int parts = cv::connectedComponentsWithStats(often, labels, stats, centres, 8);
    for (int k = 1; k < parts; k++) {
      const int *s = stats.ptr<int>(k);
      const double share = double(s[cv::CC_STAT_AREA]) / (double(n) * n);
      if (share <= found->inset) continue;
      found->inset = share;
      const int edges[4] = {s[cv::CC_STAT_LEFT], s[cv::CC_STAT_LEFT] + s[cv::CC_STAT_WIDTH], s[cv::CC_STAT_TOP],
                            s[cv::CC_STAT_TOP] + s[cv::CC_STAT_HEIGHT]};
      for (int i = 0; i < 4; i++) found->inset_edges[i] = double(edges[i]) / n;
    }
    return ERN_OK;
  });
}
