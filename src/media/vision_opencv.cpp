/* SPDX-License-Identifier: MIT
 * Resampling by OpenCV. No exception and no C++ type leaves this file. */
#include <exception>
#include <new>
#include <opencv2/imgproc.hpp>

extern "C" {
#include "core/floats.h"
#include "media/image.h"
}

extern "C" ern_status ern_image_resize(ern_context *context, const ern_image *image, int width, int height,
                                       ern_image *resized) {
  ERN_PLAIN_FLOATS;
  if (resized != nullptr && resized != image) *resized = ern_image{};
  ERN_NEED(context, context);
  ERN_NEED(context, image);
  ERN_NEED(context, resized);
  if (resized == image)
    return ern_fail(context, ERN_E_ARGUMENT, "resize: image and resized are the same struct, expected two");
  ern_status status = ern_image_check(context, "resize", image);
  if (status != ERN_OK) return status;
  ern_image made{};
  status = ern_image_make(context, "resize", width, height, image->channels, &made);
  if (status != ERN_OK) return status;
  try {
    const int type = CV_8UC(image->channels);
    const cv::Mat from(image->height, image->width, type, image->data);
    cv::Mat to(height, width, type, made.data);
    cv::resize(from, to, cv::Size(width, height), 0, 0, cv::INTER_AREA);
    if (to.data == made.data) {
      *resized = made;
      return ERN_OK;
    }
    status = ern_fail(context, ERN_E_MEDIA, "resize: OpenCV made a picture of another size");
  } catch (const std::bad_alloc &) {
    status = ern_fail(context, ERN_E_NO_MEMORY, "resize: no memory for %d x %d pixels", width, height);
  } catch (const std::exception &error) {
    status = ern_fail(context, ERN_E_MEDIA, "resize: OpenCV: %s", error.what());
  } catch (...) {
    status = ern_fail(context, ERN_E_MEDIA, "resize: OpenCV failed and gave no reason");
  }
  ern_image_free(context, &made);
  return status;
}
