/* SPDX-License-Identifier: MIT
 * The function table of libernerf-media. The library itself is a thin wrapper: the first call of a function loads
 * libernerf-media-impl, which implements them all and depends on OpenImageIO, OpenCV and FFmpeg (some 265 libraries).
 * cmake/media_functions.cmake generates function_list.h from the headers. */
#ifndef ERN_MEDIA_THIN_FUNCTIONS_H
#define ERN_MEDIA_THIN_FUNCTIONS_H

#include "ernerf/live.h"
#include "ernerf/speech.h"
#include "ernerf/stream.h"
#include "media/speech_network.h"
#include "media/thin/function_list.h"

#define ERN_STATUS_MEMBER(name, parameters, arguments, context, empty) ern_status(*name) parameters;
#define ERN_VALUE_MEMBER(type, name, parameters, arguments, none) type(*name) parameters;
#define ERN_VOID_MEMBER(name, parameters, arguments, empty) void(*name) parameters;
#define ERN_FREE_MEMBER(name, parameters, arguments) void(*name) parameters;

struct ern_media_functions {
  const char *version; /* ERN_INTERFACE_VERSION */
  ERN_MEDIA_STATUS(ERN_STATUS_MEMBER)
  ERN_MEDIA_VALUE(ERN_VALUE_MEMBER)
  ERN_MEDIA_VOID(ERN_VOID_MEMBER)
  ERN_MEDIA_FREE(ERN_FREE_MEMBER)
};

/* The only exported symbol of libernerf-media-impl. */
extern ERN_API const struct ern_media_functions ern_media_functions;

#endif
