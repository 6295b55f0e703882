/* SPDX-License-Identifier: MIT
 * Which names are files, addresses or devices. */
#include <string.h>

#include "ernerf/stream.h"
#include "media/live/address.h"

/* Protocols that lead to another machine, each by itself. */
static const char *const networks[] = {"http", "https", "rtmp", "rtmps", "rtmpt", "rtmpts", "rtp",
                                       "rtsp", "srt",   "tcp",  "tls",   "udp",   "icecast"};
static const char file_scheme[] = "file:";

size_t ern_scheme_length(const char *url) {
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

const char *ern_stream_file(const char *url) {
  if (url == NULL) return NULL;
  if (strncmp(url, file_scheme, sizeof file_scheme - 1) == 0) return url + sizeof file_scheme - 1;
  return is_network(url, ern_scheme_length(url)) ? NULL : url;
}

bool ern_sound_reader_is_device(const char *url) {
  if (url == NULL) return false;
  const char *colon = strchr(url, ':');
  return colon != NULL && colon != url && strchr(url, '/') == NULL && ern_stream_file(url) == url;
}
