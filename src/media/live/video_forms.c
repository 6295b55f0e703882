/* SPDX-License-Identifier: MIT */
#include "media/live/video_forms.h"

#include <string.h>
#include <strings.h>

/* VP9 and AV1 get speed settings that keep up with rendering on few cores; x265 writes to stderr unless its log is
 * disabled. */
static const struct ern_video_codec codecs[] = {
    {"h264", "libx264", AV_CODEC_ID_H264, AV_PIX_FMT_YUV420P, 51, true, {{NULL}}},
    {"hevc", "libx265", AV_CODEC_ID_HEVC, AV_PIX_FMT_YUV420P, 51, true, {{"x265-params", "log-level=none"}}},
    {"vp9",
     "libvpx-vp9",
     AV_CODEC_ID_VP9,
     AV_PIX_FMT_YUV420P,
     63,
     false,
     {{"deadline", "good"}, {"cpu-used", "4"}, {"row-mt", "1"}}},
    {"av1", "libaom-av1", AV_CODEC_ID_AV1, AV_PIX_FMT_YUV420P, 63, false, {{"cpu-used", "8"}, {"row-mt", "1"}}},
    {"ffv1", "ffv1", AV_CODEC_ID_FFV1, AV_PIX_FMT_0RGB32, 0, false, {{NULL}}},
    {"gif", "gif", AV_CODEC_ID_GIF, AV_PIX_FMT_BGR8, 0, false, {{NULL}}}};
enum { CODECS = sizeof codecs / sizeof *codecs };

static const struct ern_video_form forms[] = {
    {{".mp4", ".m4v", NULL}, "mp4", {"h264", "hevc", "vp9", "av1", NULL}, AV_CODEC_ID_AAC},
    {{".mov", NULL}, "mov", {"h264", "hevc", NULL}, AV_CODEC_ID_AAC},
    {{".mkv", NULL}, "matroska", {"h264", "hevc", "vp9", "av1", "ffv1"}, AV_CODEC_ID_AAC},
    {{".webm", NULL}, "webm", {"vp9", "av1", NULL}, AV_CODEC_ID_OPUS},
    {{".gif", NULL}, "gif", {"gif", NULL}, AV_CODEC_ID_NONE}};
enum { FORMS = sizeof forms / sizeof *forms };

const struct ern_video_form *ern_video_form_of(const char *path) {
  const char *dot = strrchr(path, '.');
  for (size_t i = 0; dot != NULL && i < FORMS; i++)
    for (size_t k = 0; forms[i].endings[k] != NULL; k++)
      if (strcasecmp(dot, forms[i].endings[k]) == 0) return &forms[i];
  return &forms[0];
}

const struct ern_video_codec *ern_video_codec_live(void) { return &codecs[0]; }

static bool has_codec(const struct ern_video_form *form, const char *name) {
  for (size_t k = 0; k < ERN_VIDEO_CODECS_MOST && form->codecs[k] != NULL; k++)
    if (strcmp(form->codecs[k], name) == 0) return true;
  return false;
}

ern_status ern_video_codec_of(ern_context *context, const char *path, const struct ern_video_form *form,
                              const char *name, const struct ern_video_codec **codec) {
  if (name == NULL) name = form->codecs[0];
  for (size_t i = 0; i < CODECS && has_codec(form, name); i++)
    if (strcmp(codecs[i].name, name) == 0) {
      *codec = &codecs[i];
      return ERN_OK;
    }
  char list[64] = "";
  for (size_t k = 0; k < ERN_VIDEO_CODECS_MOST && form->codecs[k] != NULL; k++) {
    strcat(list, k > 0 ? ", " : "");
    strcat(list, form->codecs[k]);
  }
  return ern_fail(context, ERN_E_UNSUPPORTED, "%s: codec is \"%s\", expected one that %s holds here: %s", path, name,
                  form->muxer, list);
}

ern_status ern_video_codec_check(ern_context *context, const char *path, const struct ern_video_codec *codec, int crf,
                                 const char *preset) {
  static const char *const presets[] = {"ultrafast", "superfast", "veryfast", "faster",   "fast",
                                        "medium",    "slow",      "slower",   "veryslow", "placebo"};
  if (codec->most_crf > 0 && (crf < 0 || crf > codec->most_crf))
    return ern_fail(context, ERN_E_ARGUMENT, "%s: crf is %d, expected 0 to %d, the range of %s", path, crf,
                    codec->most_crf, codec->name);
  if (preset == NULL) return ERN_OK;
  if (!codec->has_preset)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: preset is \"%s\", expected none: %s has no presets", path, preset,
                    codec->name);
  for (size_t i = 0; i < sizeof presets / sizeof *presets; i++)
    if (strcmp(preset, presets[i]) == 0) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT, "%s: preset is \"%s\", expected one of x264's, ultrafast to placebo", path,
                  preset);
}
