/* SPDX-License-Identifier: MIT */
#include "media/live/address.h"

#include <libavformat/avio.h>
#include <string.h>

#include "ernerf/stream.h"

/* Whether a scheme, or the first of nested ones ("crypto+file"), is a protocol of FFmpeg's. */
static bool is_protocol(const char *scheme, size_t length) {
  const char *nested = memchr(scheme, '+', length), *name = NULL;
  const size_t own = nested != NULL ? (size_t)(nested - scheme) : length;
  for (int output = 0; output < 2; output++) {
    void *at = NULL;
    while ((name = avio_enum_protocols(&at, output)) != NULL)
      if (strlen(name) == own && strncmp(name, scheme, own) == 0) return true;
  }
  return false;
}

ern_status ern_address_parse(ern_context *context, const char *url, const char **path) {
  const size_t length = ern_scheme_length(url);
  *path = ern_stream_file(url);
  if (*path != url || length == 0) return ERN_OK;
  if (!is_protocol(url, length) && strncmp(url + length, "://", 3) != 0) return ERN_OK;
  return ern_fail(context, ERN_E_UNSUPPORTED,
                  "%s: begins with \"%.*s\", expected a file, or an address of http, https, rtmp, rtsp, rtp, srt, tcp, "
                  "tls, udp or icecast; ./ before the name of a file makes it one",
                  url, (int)length, url);
}
