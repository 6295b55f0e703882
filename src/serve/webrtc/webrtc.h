/* SPDX-License-Identifier: MIT
 * libernerf-webrtc: passes coded pictures and sound on to viewers by WebRTC, through GStreamer. libernerf-serve opens
 * the library when the first viewer offers, and looks up one table of functions. */
#ifndef ERN_SERVE_WEBRTC_H
#define ERN_SERVE_WEBRTC_H

#include <stdbool.h>
#include <stddef.h>

#include "ernerf/base.h"

struct ern_webrtc;
struct ern_webrtc_source; /* of a session */
struct ern_webrtc_viewer;

/* Called on a thread of the library that holds no lock. `user` is the viewer's. */
struct ern_webrtc_events {
  /* Once. status: of HTTP, 201 with the answer's SDP, else with the reason. */
  void (*answered)(void *user, unsigned status, const char *text);
  /* Once, as the last call; the viewer's memory goes with it. */
  void (*ended)(void *user);
};

struct ern_webrtc_options {
  const char *stun;          /* the address of a STUN server, "stun://HOST:PORT"; NULL: none */
  int first_port, last_port; /* of UDP; 0: those that the system chooses */
};

struct ern_webrtc_functions {
  const char *version; /* ERN_INTERFACE_VERSION */
  /* Starts the thread. NULL without memory. */
  struct ern_webrtc *(*open)(const struct ern_webrtc_events *events, const struct ern_webrtc_options *options);
  /* Ends all viewers. The sources were removed before. */
  void (*close)(struct ern_webrtc **webrtc);
  struct ern_webrtc_source *(*add)(struct ern_webrtc *webrtc); /* NULL without memory */
  /* Its viewers end soon. No other call of the source is under way. */
  void (*remove)(struct ern_webrtc_source **source);
  /* The next picture: an access unit in the form of mp4, with the avcC that belongs to it. Both it and sound are at
   * `seconds` of one clock, and one thread at a time calls with them. */
  void (*picture)(struct ern_webrtc_source *source, const void *avcc, size_t avcc_bytes, const void *unit, size_t bytes,
                  bool key, double seconds);
  /* samples: [frames], mono, 48000 a second */
  void (*sound)(struct ern_webrtc_source *source, const float *samples, size_t frames, double seconds);
  /* Takes an offer, of which `events` tell. avcc: the beginning of the stream's. spare_files: open files that are left
   * to others. NULL without memory. */
  struct ern_webrtc_viewer *(*watch)(struct ern_webrtc_source *source, const char *offer, const unsigned char avcc[4],
                                     size_t spare_files, void *user);
  void (*end)(struct ern_webrtc_viewer *viewer); /* asks for its end; before `ended` returns */
};

extern ERN_API const struct ern_webrtc_functions ern_webrtc_functions;

#endif
