/* SPDX-License-Identifier: MIT
 * Shared by the C++ files of the step "layers". ern_layers_guarded turns exceptions into statuses. */
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
  cv::Mat frame, small; /* RGB, [side][side] and [work][work] */
  /* [work][work], 255 where the pixel is taken as the person, and as the background; both 0: unknown */
  cv::Mat mask, place;
  cv::Mat chest;  /* [work][work], 255 where the pixel is certainly the body */
  cv::Mat motion; /* [work][work], log odds of the person by motion */
  ern_layer_face face;
};

struct ern_person_reference { /* a frame that other frames are compared with */
  cv::Mat small;              /* CV_32FC3 [work][work] */
  ern_layer_face face;
  cv::Point2f body; /* displacement of the body from `home`, pixels of work */
  bool body_known;
};

struct ern_person_model {
  ern_context *context;
  int side, work;
  std::vector<ern_person_example> examples;
  bool supplied; /* the user supplied the examples' masks */
  /* The background. [side][side]: background, seen (255 where an example shows it), shown (the clip's). [work][work]:
   * small_background CV_32FC3, small_noise CV_32F in grey values, small_trust 0..1, the confidence in it. */
  cv::Mat background, seen, shown, small_background, small_noise, small_trust;
  /* log densities of the colours of person and background, [2 zones][16][16][16] */
  std::vector<float> person, place;
  /* log odds of the person, [work][work], with the head at `home` */
  cv::Mat prior;
  ern_layer_face home;
  /* for motion: grey picture and points of the chest with the head at `home` */
  std::vector<ern_person_reference> references;
  cv::Mat body_home;
  std::vector<cv::Point2f> body_points;
  cv::Mat last; /* mask of the previous frame */
  /* of ern_person_inset_add, CV_32F [work][work]: frames that show a pixel of the place; those of them that differ */
  cv::Mat inset_visible, inset_unlike;
  int inset_frames;
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

/* Warps mask [work][work] from the head's position in `from` to that in `to`: rows of the head move with it, rows at
 * the bottom of the picture by a third. */
cv::Mat ern_person_warp_mask(const ern_person_model &model, const cv::Mat &mask, const ern_layer_face &from,
                             const ern_layer_face &to);
/* Estimates the background from the examples and their masks. */
void ern_person_background(ern_person_model *model, const uint8_t *background, bool key, ern_person_found *found);
/* Fills what the estimate had to leave out near the person, for the clip alone, from the examples and their last masks.
 */
void ern_person_background_reveal(ern_person_model *model);
/* Stores the examples as references for motion. */
void ern_person_motion_learn(ern_person_model *model);
/* Log odds of the person in each pixel of work by motion against the references, -5..5. */
cv::Mat ern_person_motion_odds(const ern_person_model &model, const cv::Mat &small, const ern_layer_face &face);
/* Measures how far the background moves between the examples. */
void ern_person_place_moves(const ern_person_model &model, ern_person_found *found);
/* The background, CV_32FC3, in a frame's light: of each channel gain and offset are those that fit best, by least
 * squares, where place is not 0. */
cv::Mat ern_person_place_lit(const cv::Mat &background, const cv::Mat &frame, const cv::Mat &place);
/* The points of a closed polygon, scaled by `scale` about their centre. */
std::vector<cv::Point> ern_layer_polygon(const float (*points)[2], int count, double scale);

#endif
