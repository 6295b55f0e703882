/* SPDX-License-Identifier: MIT
 * For the C++ files of the step "layers": no exception leaves them. */
#ifndef ERN_PREPARE_LAYERS_OPENCV_H
#define ERN_PREPARE_LAYERS_OPENCV_H

#include <exception>
#include <new>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "ernerf/base.h"

extern "C" { /* C headers */
#include "core/memory.h"
#include "core/status.h"
}

#include "prepare/layers/layers.h"

struct ern_person_example {
  cv::Mat frame, small; /* RGB of side and of work */
  /* of work, 255 where the person, and where the place behind it, is taken to be; both 0 where nothing is known */
  cv::Mat mask, place;
  cv::Mat breast; /* of work, 255 where the body surely is */
  cv::Mat motion; /* log odds of the person by motion, of work */
  ern_layer_face face;
};

struct ern_person_reference { /* a frame that others are held against */
  cv::Mat small;              /* CV_32FC3 of work */
  ern_layer_face face;
  cv::Point2f body; /* where the body is from where it is at home, pixels of work */
  bool body_known;
};

struct ern_person_model {
  ern_context *context;
  int side, work;
  std::vector<ern_person_example> examples;
  bool supplied; /* the examples' masks are the user's */
  /* Of the place: background and what was seen of it (255) of side; small ones of work: CV_32FC3, noise CV_32F in grey
   * values, and how far they are to be trusted, 0..1. `shown` is what the clip gets. */
  cv::Mat background, seen, shown, small_background, small_noise, small_trust;
  /* log densities of colours, 2 zones x 16 x 16 x 16 */
  std::vector<float> person, place;
  /* log odds of the person, work x work, where the head is at `home` */
  cv::Mat prior;
  ern_layer_face home;
  /* of motion: grey picture and points of the breast at home */
  std::vector<ern_person_reference> references;
  cv::Mat body_home;
  std::vector<cv::Point2f> body_points;
  cv::Mat last; /* mask of the frame before */
  ern_layer_face last_face;
};

template <typename Work>
ern_status ern_layers_guarded(ern_context *context, Work work) {
  const auto before = cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  ern_status status = ERN_OK;
  try {
    status = work();
  } catch (const std::bad_alloc &) {
    status = ern_fail(context, ERN_E_NO_MEMORY, "layers: no memory");
  } catch (const cv::Exception &error) {
    status = ern_fail(context, error.code == cv::Error::StsNoMem ? ERN_E_NO_MEMORY : ERN_E_UNSUPPORTED,
                      "layers: OpenCV says: %.400s", error.what());
  } catch (const std::exception &error) {
    status = ern_fail(context, ERN_E_UNSUPPORTED, "layers: %.400s", error.what());
  } catch (...) {
    status = ern_fail(context, ERN_E_UNSUPPORTED, "layers: the step failed and gave no reason");
  }
  cv::utils::logging::setLogLevel(before);
  return status;
}

/* mask, of work, as it is where the head is at `to` in place of `from`: rows of the head move with it, rows at the
 * bottom of the picture by a third. `outside` stands where nothing is known. */
cv::Mat ern_person_carry(const ern_person_model &model, const cv::Mat &mask, const ern_layer_face &from,
                         const ern_layer_face &to);
/* Finds the background in the examples by their masks. */
void ern_person_background(ern_person_model *model, const uint8_t *background, bool key, ern_person_found *found);
/* Takes the examples as references for motion. */
void ern_person_motion_learn(ern_person_model *model);
/* Log odds of the person in each pixel of work by motion against the references, -5..5. */
cv::Mat ern_person_motion_odds(const ern_person_model &model, const cv::Mat &small, const ern_layer_face &face);
/* How far the place moves between the examples. */
void ern_person_place_moves(const ern_person_model &model, ern_person_found *found);
/* The points of a closed line, times `scale` about their centre. */
std::vector<cv::Point> ern_layer_polygon(const float (*points)[2], int count, double scale);

#endif
