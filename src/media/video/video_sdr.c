/* SPDX-License-Identifier: MIT */
#include "media/video/video_sdr.h"

#include <math.h>

#include "core/memory.h"

enum { LEVELS = 1 << 12 }; /* four for each level of 10 bit */

/* Light is in units of SDR white, 100 cd/m2. An HLG display has 1000 cd/m2, and most PQ footage is graded for one. */
static const float HDR_PEAK = 10;
static const float SDR_GAMMA = 2.4F; /* of an SDR display, BT.1886 */

struct ern_video_sdr {
  enum AVColorTransferCharacteristic transfer;
  enum AVColorPrimaries primaries;
  float light[LEVELS];     /* of a value k/(LEVELS - 1) */
  uint8_t value[LEVELS];   /* of the light (k/(LEVELS - 1))^2; the square has dark steps below one level of 8 bit */
  const float (*gamut)[3]; /* from linear RGB of the primaries to that of BT.709 */
};

static const float BT2020_TO_BT709[3][3] = {
    {1.66049F, -0.58764F, -0.07285F}, {-0.12455F, 1.13290F, -0.00835F}, {-0.01815F, -0.10058F, 1.11873F}};
static const float P3_TO_BT709[3][3] = {
    {1.22494F, -0.22494F, 0}, {-0.04206F, 1.04206F, 0}, {-0.01964F, -0.07864F, 1.09828F}};
static const float SAME[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

/* BT.2100, HLG: the inverse OETF, scene light 0..1 of a value 0..1. */
static double hlg_light(double value) {
  const double a = 0.17883277, b = 1 - 4 * a, c = 0.5 - a * log(4 * a);
  return value <= 0.5 ? value * value / 3 : (exp((value - c) / a) + b) / 12;
}

/* BT.2100, PQ: the EOTF, light of a display, of a value 0..1. */
static double pq_light(double value) {
  const double m1 = 0.1593017578125, m2 = 78.84375, c1 = 0.8359375, c2 = 18.8515625, c3 = 18.6875;
  const double power = pow(value, 1 / m2);
  return 100 * pow(fmax(power - c1, 0) / (c2 - c3 * power), 1 / m1);
}

static bool is_hdr(const struct ern_video_sdr *sdr) {
  return sdr->transfer == AVCOL_TRC_ARIB_STD_B67 || sdr->transfer == AVCOL_TRC_SMPTE2084;
}

ern_status ern_video_sdr_make(ern_context *context, enum AVColorTransferCharacteristic transfer,
                              enum AVColorPrimaries primaries, struct ern_video_sdr **sdr) {
  const struct ern_video_sdr tags = {.transfer = transfer, .primaries = primaries};
  const bool wide = primaries == AVCOL_PRI_BT2020 || primaries == AVCOL_PRI_SMPTE432;
  *sdr = NULL;
  if (!is_hdr(&tags) && !wide) return ERN_OK;
  const ern_status status = ERN_NEW(context, 1, sdr);
  if (status != ERN_OK) return status;
  struct ern_video_sdr *made = *sdr;
  *made = tags;
  if (primaries == AVCOL_PRI_UNSPECIFIED) made->primaries = AVCOL_PRI_BT2020; /* the only ones of HLG and PQ, BT.2100 */
  made->gamut = made->primaries == AVCOL_PRI_BT2020     ? BT2020_TO_BT709
                : made->primaries == AVCOL_PRI_SMPTE432 ? P3_TO_BT709
                                                        : SAME;
  for (int k = 0; k < LEVELS; k++) {
    const double part = (double)k / (LEVELS - 1);
    made->light[k] = (float)(transfer == AVCOL_TRC_ARIB_STD_B67 ? hlg_light(part)
                             : transfer == AVCOL_TRC_SMPTE2084  ? pq_light(part)
                                                                : pow(part, (double)SDR_GAMMA));
    made->value[k] = (uint8_t)lrint(255 * pow(part * part, 1 / (double)SDR_GAMMA));
  }
  return ERN_OK;
}

const char *ern_video_sdr_words(const struct ern_video_sdr *sdr) {
  return sdr->transfer == AVCOL_TRC_ARIB_STD_B67 ? "is HDR (HLG)"
         : sdr->transfer == AVCOL_TRC_SMPTE2084  ? "is HDR (PQ)"
                                                 : "has a wide gamut";
}

/* The factor for light whose largest component is `peak`: Mobius, (a x + b)/(x + c), is x and has slope 1 at the knee,
 * and takes HDR_PEAK to 1. Below the knee nothing changes, and one factor for all components keeps the hue. */
static float tone_factor(float peak) {
  const float knee = 0.5F, p = HDR_PEAK;
  if (peak <= knee) return 1;
  const float a = -knee * knee * (p - 1) / (knee * knee - 2 * knee + p);
  const float b = (knee * knee - 2 * knee * p + p) / (p - 1);
  const float scale = (b * b + 2 * b * knee + knee * knee) / (b - a);
  return scale * (peak + a) / (peak + b) / peak;
}

void ern_video_sdr_convert(const struct ern_video_sdr *sdr, const uint16_t *from, size_t pixels, uint8_t *to) {
  const bool hlg = sdr->transfer == AVCOL_TRC_ARIB_STD_B67, hdr = is_hdr(sdr);
  for (size_t i = 0; i < pixels; i++, from += 3, to += 3) {
    float light[3], shown[3], peak = 0, factor = 1;
    for (int c = 0; c < 3; c++) light[c] = sdr->light[from[c] * (LEVELS - 1) / UINT16_MAX];
    /* BT.2100, HLG: a display shows Y^0.2 of the scene's light, Y its luminance */
    if (hlg) factor = HDR_PEAK * powf(0.2627F * light[0] + 0.6780F * light[1] + 0.0593F * light[2], 0.2F);
    for (int c = 0; c < 3; c++) {
      const float *row = sdr->gamut[c];
      shown[c] = fmaxf(factor * (row[0] * light[0] + row[1] * light[1] + row[2] * light[2]), 0);
      peak = fmaxf(peak, shown[c]);
    }
    const float tone = hdr ? tone_factor(peak) : 1;
    for (int c = 0; c < 3; c++) to[c] = sdr->value[lrintf(sqrtf(fminf(tone * shown[c], 1)) * (LEVELS - 1))];
  }
}
