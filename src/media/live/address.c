/* SPDX-License-Identifier: MIT */
#include "media/live/address.h"

#include <libavformat/avio.h>
#include <string.h>

#include "ernerf/stream.h"

/* Protocols that lead to another machine, each by itself. */
static const char *const networks[] = {"http", "https", "rtmp", "rtmps", "rtmpt", "rtmpts", "rtp",
                                       "rtsp", "srt",   "tcp",  "tls",   "udp",   "icecast"};
static const char file_scheme[] = "file:";

/* The bytes of a scheme at the beginning of `url`, as FFmpeg finds it: up to ":", or up to "," in
 * "subfile,,start,...:". 0: there is none. */
static size_t scheme_length(const char *url) {
  const size_t length = strspn(url, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+-.");
  const bool has_options = url[length] == ',' && strchr(url + length, ':') != NULL;
  return url[length] == ':' || has_options ? length : 0;
}

static bool is_network(const char *url, size_t length) {
  for (size_t i = 0; i < sizeof networks / sizeof *networks; i++)
    if (strlen(networks[i]) == length && strncmp(url, networks[i], length) == 0)
      return strncmp(url + length, "://", 3) == 0;
  return false;
}

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

const char *ern_stream_file(const char *url) {
  if (url == NULL) return NULL;
  if (strncmp(url, file_scheme, sizeof file_scheme - 1) == 0) return url + sizeof file_scheme - 1;
  return is_network(url, scheme_length(url)) ? NULL : url;
}

ern_status ern_address_parse(ern_context *context, const char *url, const char **path) {
  const size_t length = scheme_length(url);
  *path = ern_stream_file(url);
  if (*path != url || length == 0) return ERN_OK;
  if (!is_protocol(url, length) && strncmp(url + length, "://", 3) != 0) return ERN_OK;
  return ern_fail(context, ERN_E_UNSUPPORTED,
                  "%s: begins with \"%.*s\", expected a file, or an address of http, https, rtmp, rtsp, rtp, srt, tcp, "
                  "tls, udp or icecast; ./ before the name of a file makes it one",
                  url, (int)length, url);
}
