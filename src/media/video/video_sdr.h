/* SPDX-License-Identifier: MIT
 * From HDR (HLG, PQ) or a wide gamut (BT.2020, Display P3) to what an SDR player shows: BT.709. */
#ifndef ERN_MEDIA_VIDEO_SDR_H
#define ERN_MEDIA_VIDEO_SDR_H

#include <libavutil/pixfmt.h>

#include "core/status.h"

struct ern_video_sdr; /* a conversion from one transfer function and one set of primaries */

/* *sdr: NULL where a picture of these tags is SDR already, or says nothing. The caller frees it (ern_release). */
ERN_NODISCARD ern_status ern_video_sdr_make(ern_context *context, enum AVColorTransferCharacteristic transfer,
                                            enum AVColorPrimaries primaries, struct ern_video_sdr **sdr);
/* What is converted, in words. */
const char *ern_video_sdr_words(const struct ern_video_sdr *sdr);
/* to [pixels][3]: R'G'B' of BT.709; from [pixels][3]: R'G'B' of the file, full range, 0..65535. */
void ern_video_sdr_convert(const struct ern_video_sdr *sdr, const uint16_t *from, size_t pixels, uint8_t *to);

#endif
