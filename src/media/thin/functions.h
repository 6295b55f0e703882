/* SPDX-License-Identifier: MIT
 * The functions of libernerf-media as a table. The library itself is thin: it opens libernerf-media-impl, which has
 * them and brings OpenImageIO, OpenCV and FFmpeg along (some 265 libraries), when the first is called.
 * cmake/media_functions.cmake makes function_list.h of the headers. */
#ifndef ERN_MEDIA_THIN_FUNCTIONS_H
#define ERN_MEDIA_THIN_FUNCTIONS_H

#include "ernerf/live.h"
#include "ernerf/speech.h"
#include "ernerf/stream.h"
#include "media/speech_network.h"
#include "media/thin/function_list.h"

#define ERN_STATUS_MEMBER(name, parameters, arguments, context, empty) ern_status(*name) parameters;
#define ERN_VALUE_MEMBER(type, name, parameters, arguments) type(*name) parameters;
#define ERN_VOID_MEMBER(name, parameters, arguments) void(*name) parameters;

struct ern_media_functions {
  const char *version; /* of the library: "0.1.0" */
  ERN_MEDIA_STATUS(ERN_STATUS_MEMBER)
  ERN_MEDIA_VALUE(ERN_VALUE_MEMBER)
  ERN_MEDIA_VOID(ERN_VOID_MEMBER)
  ERN_MEDIA_FREE(ERN_VOID_MEMBER)
};

/* The one symbol of libernerf-media-impl. */
extern ERN_API const struct ern_media_functions ern_media_functions;

#endif
