/* SPDX-License-Identifier: MIT
 * The video containers, chosen by a file name's extension, and the codecs that each can hold. */
#ifndef ERN_MEDIA_VIDEO_FORMS_H
#define ERN_MEDIA_VIDEO_FORMS_H

#include <libavcodec/avcodec.h>

#include "core/status.h"

enum { ERN_VIDEO_CODECS_MOST = 5 };

struct ern_video_codec {
  const char *name;    /* "h264" */
  const char *encoder; /* FFmpeg's name; where FFmpeg lacks it, any encoder of `id` that takes `format` */
  enum AVCodecID id;
  enum AVPixelFormat format;
  int most_crf;    /* 0: the codec has no quality setting */
  bool has_preset; /* those of x264 */
  const char *settings[3][2];
};

struct ern_video_form {
  const char *endings[3]; /* extensions, lower case */
  const char *muxer;
  const char *codecs[ERN_VIDEO_CODECS_MOST]; /* by name, the first is the default */
  enum AVCodecID sound;                      /* NONE: no sound */
};

/* By the extension of `path`; mp4 where the table does not have it. */
const struct ern_video_form *ern_video_form_of(const char *path);
/* *codec = the codec of that name; name NULL: the form's first. ERN_E_UNSUPPORTED where the form has no such codec. */
ERN_NODISCARD ern_status ern_video_codec_of(ern_context *context, const char *path, const struct ern_video_form *form,
                                            const char *name, const struct ern_video_codec **codec);
/* H.264, for live streams. */
const struct ern_video_codec *ern_video_codec_live(void);
/* ERN_E_ARGUMENT where the codec does not take them; preset NULL: its default. */
ERN_NODISCARD ern_status ern_video_codec_check(ern_context *context, const char *path,
                                               const struct ern_video_codec *codec, int crf, const char *preset);

#endif
