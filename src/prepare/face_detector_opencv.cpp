/* SPDX-License-Identifier: MIT
 * No exception and no C++ type leaves this file. */
#include <algorithm>
#include <cstdlib>
#include <exception>
#include <memory>
#include <new>
#include <opencv2/core/ocl.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/objdetect.hpp>
#include <string>
#include <vector>

extern "C" {
#include "prepare/face_detector.h"
}

#include "prepare/face_network_opencv.h"

struct ern_face_detector {
  ern_context *context;
  cv::CascadeClassifier face, other, eye;
  std::unique_ptr<ern_face_network> network; /* used instead of the cascades */
};

namespace {

/* Pictures are scaled down to at most this many pixels a side for the cascades: a face that they then miss is too small
 * to train on. */
constexpr int most_side = 640;
/* The size of the cascades' training pictures: they find no smaller face. */
constexpr int least_side = 20;

/* A cascade makes a UMat, for which OpenCV would load the OpenCL drivers, in the calling thread; some end the process
 * that they are loaded into, or never answer. */
template <typename Work>
ern_status guarded(ern_context *context, Work work) {
  cv::ocl::setUseOpenCL(false);
  const auto before = cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  ern_status status = ERN_OK;
  try {
    status = work();
  } catch (const std::bad_alloc &) {
    status = ern_fail(context, ERN_E_NO_MEMORY, "faces: no memory");
  } catch (const std::exception &error) {
    status = ern_fail(context, ERN_E_MEDIA, "faces: OpenCV: %s", error.what());
  }
  cv::utils::logging::setLogLevel(before);
  return status;
}

ern_status load(ern_context *context, const std::string &folder, const char *name, cv::CascadeClassifier &cascade) {
  const std::string path = folder + "/" + name;
  if (cascade.load(path)) return ERN_OK;
  return ern_fail(context, ERN_E_MISSING,
                  "%s: no such cascade, expected those of OpenCV (Debian's opencv-data); ERNERF_CASCADES names their "
                  "folder",
                  path.c_str());
}

/* Chooses the candidate nearest to the expected position of an eye, in its half of the face. */
bool nearest(const std::vector<cv::Rect> &found, const cv::Rect &face, double share, cv::Point2d &eye) {
  double least = 0.18 * face.width;
  bool any = false;
  for (const cv::Rect &r : found) {
    const cv::Point2d centre(face.x + r.x + 0.5 * r.width, face.y + r.y + 0.5 * r.height);
    const double away = std::hypot(centre.x - (face.x + share * face.width), centre.y - (face.y + 0.38 * face.height));
    if (away >= least) continue;
    least = away;
    eye = centre;
    any = true;
  }
  return any;
}

/* Detection runs on a grey picture with square pixels: grey pixels a pixel of the picture. */
struct Scale {
  double x, y;
};

void find_eyes(struct ern_face_detector *d, const cv::Mat &grey, const cv::Rect &face, const Scale &scale,
               struct ern_found_face *found) {
  std::vector<cv::Rect> eyes;
  cv::Point2d left, right;
  const cv::Rect upper(face.x, face.y, face.width, face.height * 6 / 10);
  d->eye.detectMultiScale(grey(upper), eyes, 1.05, 4, 0, cv::Size(face.width / 8, face.width / 8),
                          cv::Size(face.width / 3, face.width / 3));
  found->has_eyes = nearest(eyes, face, 0.30, left) && nearest(eyes, face, 0.70, right);
  if (!found->has_eyes) return;
  const cv::Point2d both[2] = {left, right};
  for (int i = 0; i < 2; i++) {
    found->eyes[i][0] = static_cast<float>(both[i].x / scale.x);
    found->eyes[i][1] = static_cast<float>(both[i].y / scale.y);
  }
}

/* Mean square of what a picture loses by means over by x by pixels, and interpolation between them. */
double lost_energy(const cv::Mat &grey, int by) {
  cv::Mat means, back;
  cv::resize(grey, means, cv::Size(std::max(grey.cols / by, 1), std::max(grey.rows / by, 1)), 0, 0, cv::INTER_AREA);
  cv::resize(means, back, grey.size(), 0, 0, cv::INTER_CUBIC);
  const double norm = cv::norm(grey, back, cv::NORM_L2);
  return norm * norm / double(grey.total());
}

}  // namespace

extern "C" ern_status ern_face_detector_make(ern_context *context, const char *network,
                                             struct ern_face_detector **detector) {
  *detector = nullptr;
  return guarded(context, [&] {
    const char *chosen = std::getenv("ERNERF_CASCADES");
    const std::string folder = chosen != nullptr && chosen[0] != 0 ? chosen : ERN_CASCADES;
    auto *made = new ern_face_detector{};
    *detector = made;
    made->context = context;
    if (network != nullptr) {
      made->network = std::make_unique<ern_face_network>();
      return ern_face_network_open(context, network, made->network.get());
    }
    const ern_status status = load(context, folder, "haarcascade_frontalface_default.xml", made->face);
    if (status != ERN_OK) return status;
    const ern_status other = load(context, folder, "haarcascade_frontalface_alt2.xml", made->other);
    return other == ERN_OK ? load(context, folder, "haarcascade_eye.xml", made->eye) : other;
  });
}

extern "C" ern_status ern_face_detector_find(struct ern_face_detector *detector, const ern_image *picture,
                                             double aspect, struct ern_found_face *faces, size_t capacity,
                                             size_t *count) {
  *count = 0;
  return guarded(detector->context, [&] {
    const cv::Mat whole(picture->height, picture->width, CV_8UC3, picture->data);
    if (detector->network != nullptr)
      return ern_face_network_find(detector->context, detector->network.get(), whole, aspect, faces, capacity, count);
    cv::Mat grey;
    std::vector<cv::Rect> found;
    cv::cvtColor(whole, grey, cv::COLOR_RGB2GRAY);
    const double wide = grey.cols * std::max(aspect, 1.0), high = grey.rows * std::max(1 / aspect, 1.0);
    const double shrunk = std::min(1.0, most_side / std::max(wide, high));
    const Scale scale = {shrunk * std::max(aspect, 1.0), shrunk * std::max(1 / aspect, 1.0)};
    if (scale.x != 1 || scale.y != 1)
      cv::resize(grey, grey,
                 cv::Size(std::max(cvRound(grey.cols * scale.x), 1), std::max(cvRound(grey.rows * scale.y), 1)), 0, 0,
                 shrunk < 1 ? cv::INTER_AREA : cv::INTER_LINEAR);
    const int shorter = std::min(grey.cols, grey.rows), least = std::max(shorter / 9, least_side);
    if (shorter < least_side) return ERN_OK;
    detector->face.detectMultiScale(grey, found, 1.1, 5, 0, cv::Size(least, least));
    if (found.empty()) { /* the first cascade misses faces with dark skin or flat light more often */
      cv::createCLAHE(3.0, cv::Size(8, 8))->apply(grey, grey);
      detector->other.detectMultiScale(grey, found, 1.1, 3, 0, cv::Size(least, least));
    }
    std::sort(found.begin(), found.end(), [](const cv::Rect &a, const cv::Rect &b) { return a.width > b.width; });
    for (const cv::Rect &r : found) {
      if (*count == capacity) break;
      struct ern_found_face *face = &faces[(*count)++];
      *face = ern_found_face{};
      face->x = static_cast<float>(r.x / scale.x);
      face->y = static_cast<float>(r.y / scale.y);
      face->width = static_cast<float>(r.width / scale.x);
      face->height = static_cast<float>(r.height / scale.y);
      find_eyes(detector, grey, r, scale, face);
    }
    return ERN_OK;
  });
}

extern "C" ern_status ern_face_sharpness(ern_context *context, const ern_image *picture, struct ern_found_face *face) {
  constexpr int most = 200, least = 48, coarse = 8; /* pixels of the face's side, of the coarser means */
  face->sharpness = 0;
  return guarded(context, [&] {
    const cv::Mat whole(picture->height, picture->width, CV_8UC3, picture->data);
    const cv::Rect inside = cv::Rect(cvRound(face->x), cvRound(face->y), cvRound(face->width), cvRound(face->height)) &
                            cv::Rect(0, 0, whole.cols, whole.rows);
    if (std::min(inside.width, inside.height) < least) return ERN_OK;
    cv::Mat grey;
    cv::cvtColor(whole(inside), grey, cv::COLOR_RGB2GRAY);
    grey.convertTo(grey, CV_32F);
    const double shrunk = std::min(1.0, double(most) / grey.cols);
    cv::resize(grey, grey,
               cv::Size(cvRound(grey.cols * shrunk) / coarse * coarse, cvRound(grey.rows * shrunk) / coarse * coarse),
               0, 0, cv::INTER_AREA);
    const double lost = lost_energy(grey, coarse);
    if (lost > 0) face->sharpness = float(lost_energy(grey, coarse / 2) / lost);
    return ERN_OK;
  });
}

extern "C" ern_status ern_picture_crop(ern_context *context, const ern_image *picture, const double region[4], int side,
                                       ern_image *crop) {
  *crop = ern_image{};
  return guarded(context, [&] {
    const cv::Mat whole(picture->height, picture->width, CV_8UC3, picture->data);
    const cv::Rect inside = cv::Rect(cvRound(region[0]), cvRound(region[1]), std::max(cvRound(region[2]), 1),
                                     std::max(cvRound(region[3]), 1)) &
                            cv::Rect(0, 0, whole.cols, whole.rows);
    const size_t bytes = 3 * static_cast<size_t>(side) * static_cast<size_t>(side);
    crop->data = static_cast<uint8_t *>(ern_allocate(context, bytes, 1));
    if (crop->data == nullptr) return ERN_E_NO_MEMORY;
    crop->width = crop->height = side;
    crop->channels = 3;
    cv::Mat to(side, side, CV_8UC3, crop->data);
    const bool smaller = inside.width > side;
    cv::resize(whole(inside), to, to.size(), 0, 0, smaller ? cv::INTER_AREA : cv::INTER_CUBIC);
    return ERN_OK;
  });
}

extern "C" void ern_face_detector_free(struct ern_face_detector **detector) {
  if (detector == nullptr) return;
  delete *detector;
  *detector = nullptr;
}
