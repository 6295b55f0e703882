/* SPDX-License-Identifier: MIT
 * The video stream of a file or live stream that is being written: converts RGBA to the codec's pixel format, and
 * encodes it or writes it raw. */
#ifndef ERN_MEDIA_PICTURE_TRACK_H
#define ERN_MEDIA_PICTURE_TRACK_H

#include <libswscale/swscale.h>

#include "media/ffmpeg.h"
#include "media/live/video_forms.h"

/* ERN_E_ARGUMENT unless numerator/denominator pictures a second are 1/100 to 1000, both parts 1 to ERN_RATE_PART: the
 * times of every container hold such pictures apart, and do not overflow. */
enum { ERN_RATE_PART = 1000000 };
ERN_NODISCARD ern_status ern_picture_rate_check(ern_context *context, const char *path, int numerator, int denominator);

enum ern_picture_coding {
  ERN_PICTURES_FILE,   /* for a file */
  ERN_PICTURES_LIVE,   /* H.264 without B-frames, a key frame a second */
  ERN_PICTURES_RAW,    /* raw yuv420p */
  ERN_PICTURES_WRAPPED /* raw yuv420p, wrapped as FFmpeg's y4m muxer wants it */
};

struct ern_picture_settings {
  enum ern_picture_coding coding;
  const struct ern_video_codec *codec; /* of the first two */
  const char *preset;                  /* NULL: the default */
  const char *profile;                 /* of H.264; NULL: what the preset makes */
  int crf;
  double pixel_aspect; /* width of a pixel over its height; 0: 1 */
};

struct ern_picture_track {
  int width, height;     /* of the caller's pictures */
  AVCodecContext *codec; /* its sides are even */
  AVStream *stream;
  struct SwsContext *convert;
  struct SwsContext *convert_patch; /* of a part of patch's size */
  AVFrame *patch;
  AVFrame *frame;  /* in the codec's pixel format: yuv420p, or one of RGB */
  uint8_t *padded; /* [codec->height][codec->width][4]; NULL where the sides are even */
  int64_t count;   /* pictures so far */
};

/* Adds a stream of `rate` pictures a second to the muxer's container, whose header is not written yet. */
ERN_NODISCARD ern_status ern_picture_track_open(struct ern_muxer *muxer, int width, int height, AVRational rate,
                                                const struct ern_picture_settings *settings,
                                                struct ern_picture_track *track);
/* rgba: [height][width][4], or NULL: repeats the last picture (black where there is none). */
ERN_NODISCARD ern_status ern_picture_track_add(struct ern_muxer *muxer, struct ern_picture_track *track,
                                               const uint8_t *rgba);
/* The recorded frame, yuv420p, with the part (x, y, width, height, even; NULL: none) replaced by rgba
 * [height][width][4]. ERN_E_UNSUPPORTED: the track has another size or pixel format. */
ERN_NODISCARD ern_status ern_picture_track_add_patched(struct ern_muxer *muxer, struct ern_picture_track *track,
                                                       const AVFrame *recorded, const int part[4], const uint8_t *rgba);
void ern_picture_track_close(ern_context *context, struct ern_picture_track *track); /* accepts a zeroed one */

#endif
