/* SPDX-License-Identifier: MIT
 * Which containers a video file may have, by its name, and which codecs these hold. */
#ifndef ERN_MEDIA_VIDEO_FORMS_H
#define ERN_MEDIA_VIDEO_FORMS_H

#include <libavcodec/avcodec.h>

#include "core/status.h"

enum { ERN_VIDEO_CODECS_MOST = 5 };

struct ern_video_codec {
  const char *name;    /* "h264" */
  const char *encoder; /* FFmpeg's name; where it is missing, any of `id` that takes `format` */
  enum AVCodecID id;
  enum AVPixelFormat format;
  int most_crf;    /* 0: it has no quality to choose */
  bool has_preset; /* the names that x264 has */
  const char *settings[3][2];
};

struct ern_video_form {
  const char *endings[3]; /* of names, in small letters */
  const char *muxer;
  const char *codecs[ERN_VIDEO_CODECS_MOST]; /* by name, the first is the default */
  enum AVCodecID sound;                      /* NONE: it is silent */
};

/* By the ending of `path`; mp4 where that is none of the table's. */
const struct ern_video_form *ern_video_form_of(const char *path);
/* *codec = that of the name, NULL: the form's first. ERN_E_UNSUPPORTED where the form has no such codec. */
ERN_NODISCARD ern_status ern_video_codec_of(ern_context *context, const char *path, const struct ern_video_form *form,
                                            const char *name, const struct ern_video_codec **codec);
/* H.264, of streams. */
const struct ern_video_codec *ern_video_codec_live(void);
/* ERN_E_ARGUMENT where the codec does not take them; preset NULL: its default. */
ERN_NODISCARD ern_status ern_video_codec_check(ern_context *context, const char *path,
                                               const struct ern_video_codec *codec, int crf, const char *preset);

#endif
