/* SPDX-License-Identifier: MIT
 * Detects a watermark in the mean of a video's frames. */
#include <math.h>

#include "core/floats.h"
#include "core/memory.h"
#include "media/image.h"
#include "media/watermark.h"

enum { SCALES = ERN_WATERMARK_SCALES, MOST_FRAMES = 1 << 24 /* 255 times this fits in 32 bits */ };

struct ern_watermark_detector {
  ern_context *context;
  struct ern_watermark_code code;
  int width, height;
  uint32_t frames;
  uint32_t *sum; /* [height][width], of the frames' luma; NULL before the first */
};

double ern_watermark_scale(int index) { return pow(1.005, index - SCALES / 2); }

double ern_watermark_bound(double score, double places) { return fmin(1, places * exp(-score * score / 2)); }

ern_status ern_watermark_detector_open(ern_context *context, const char *key, ern_watermark_detector **detector) {
  if (detector != NULL) *detector = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, key);
  ERN_NEED(context, detector);
  ern_watermark_detector *made = NULL;
  ern_status status = ERN_NEW(context, 1, &made);
  if (status != ERN_OK) return status;
  made->context = context;
  status = ern_watermark_code_make(context, key, &made->code);
  if (status != ERN_OK) ern_watermark_detector_free(&made);
  *detector = made;
  return status;
}

static ern_status begin(ern_watermark_detector *detector, const ern_image *frame) {
  if (frame->width < ERN_WATERMARK_LEAST || frame->height < ERN_WATERMARK_LEAST)
    return ern_fail(detector->context, ERN_E_SHAPE,
                    "watermark: the frames have %d x %d pixels, expected %d a side or more", frame->width,
                    frame->height, ERN_WATERMARK_LEAST);
  detector->width = frame->width;
  detector->height = frame->height;
  return ERN_NEW(detector->context, (size_t)frame->width * (size_t)frame->height, &detector->sum);
}

ern_status ern_watermark_detector_frame(ern_watermark_detector *detector, const ern_image *frame) {
  if (detector == NULL) return ERN_E_ARGUMENT;
  ERN_NEED(detector->context, frame);
  ern_status status = ern_image_check(detector->context, "watermark", frame);
  if (status == ERN_OK && frame->channels != 3)
    status =
        ern_fail(detector->context, ERN_E_SHAPE, "watermark: a frame has %d channels, expected 3", frame->channels);
  if (status == ERN_OK && detector->sum == NULL) status = begin(detector, frame);
  if (status != ERN_OK) return status;
  if (frame->width != detector->width || frame->height != detector->height)
    return ern_fail(detector->context, ERN_E_SHAPE, "watermark: a frame has %d x %d pixels, expected %d x %d",
                    frame->width, frame->height, detector->width, detector->height);
  if (detector->frames == MOST_FRAMES)
    return ern_fail(detector->context, ERN_E_STATE, "watermark: more than %d frames in one search", MOST_FRAMES);
  detector->frames++;
  const size_t pixels = (size_t)frame->width * (size_t)frame->height;
  for (size_t i = 0; i < pixels; i++) {
    const uint8_t *rgb = frame->data + 3 * i;
    detector->sum[i] += (54U * rgb[0] + 183U * rgb[1] + 19U * rgb[2]) >> 8; /* BT.709 */
  }
  return ERN_OK;
}

static ern_status search(ern_watermark_detector *detector, const float *mean, ern_watermark_spectrum *spectra,
                         double *score, double *scale) {
  double scales[SCALES];
  for (int i = 0; i < SCALES; i++) scales[i] = ern_watermark_scale(i);
  ern_status status =
      ern_watermark_spectra(detector->context, mean, detector->width, detector->height, scales, SCALES, spectra);
  for (int i = 0; i < SCALES && status == ERN_OK; i++) {
    double found = 0;
    status = ern_watermark_peak(detector->context, spectra[i], &detector->code, &found);
    if (status != ERN_OK || found <= *score) continue;
    *score = found;
    *scale = scales[i];
  }
  return status;
}

ern_status ern_watermark_detector_search(ern_watermark_detector *detector, double *score, double *false_positive,
                                         double *scale) {
  ERN_PLAIN_FLOATS;
  if (detector == NULL) return ERN_E_ARGUMENT;
  ern_context *context = detector->context;
  ERN_NEED(context, score);
  ERN_NEED(context, false_positive);
  ERN_NEED(context, scale);
  *score = 0;
  *false_positive = 1;
  *scale = 1;
  if (detector->sum == NULL) return ern_fail(context, ERN_E_STATE, "watermark: no frames to search");
  const size_t pixels = (size_t)detector->width * (size_t)detector->height;
  const double places = (double)SCALES * ERN_WATERMARK_CELLS * ERN_WATERMARK_CELLS;
  ern_watermark_spectrum *spectra = NULL;
  float *mean = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, pixels, &mean));
  ERN_TRY(ERN_NEW(context, SCALES, &spectra));
  for (size_t i = 0; i < pixels; i++) mean[i] = (float)(detector->sum[i] / (double)detector->frames);
  ERN_TRY(search(detector, mean, spectra, score, scale));
  *false_positive = ern_watermark_bound(*score, places);
fail:
  ern_release(context, mean);
  ern_release(context, spectra);
  ern_release(context, detector->sum);
  detector->sum = NULL;
  detector->frames = 0;
  return status;
}

void ern_watermark_detector_free(ern_watermark_detector **detector) {
  if (detector == NULL || *detector == NULL) return;
  ern_watermark_detector *own = *detector;
  ern_release(own->context, own->sum);
  ern_release(own->context, own);
  *detector = NULL;
}
