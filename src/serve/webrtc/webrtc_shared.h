/* SPDX-License-Identifier: MIT
 * What the files of libernerf-webrtc share. Viewers are made, looked at and ended on the library's own thread; the
 * caller's threads hand over pictures and sound, and two threads of each source send its packets to all viewers. */
#ifndef ERN_SERVE_WEBRTC_SHARED_H
#define ERN_SERVE_WEBRTC_SHARED_H

#include <gst/app/gstappsink.h>
#include <gst/app/gstappsrc.h>
#include <gst/gst.h>
#include <gst/sdp/sdp.h>
#include <pthread.h>
#include <stdatomic.h>

#include "serve/webrtc/webrtc.h"

enum { WEBRTC_REASON = 512, SOUND_RATE = 48000 };

struct ern_webrtc {
  struct ern_webrtc_events events;
  char *stun; /* NULL: none */
  int first_port, last_port;
  GMainContext *context;
  GMainLoop *loop;
  pthread_t thread;
  bool runs; /* the thread */
  /* the thread's */
  bool is_ready; /* GStreamer has all that is needed */
  struct ern_webrtc_viewer *viewers;
  gint64 joins; /* microseconds of GLib's monotonic clock: when all that came would have been made at an even pace */
};

struct ern_webrtc_source {
  struct ern_webrtc *webrtc;
  atomic_uint users; /* the caller, and each viewer */
  atomic_bool removed;
  unsigned watched; /* viewers that are not ended; of the library's thread */
  pthread_mutex_t mutex;
  GstElement *packer; /* makes packets of RTP of pictures and sound, while somebody watches; guarded by mutex */
  GstElement *pictures, *sounds; /* where they go in; likewise */
  bool has_key;                  /* a key frame went in; likewise */
  pthread_mutex_t fed_mutex;
  struct ern_webrtc_viewer *fed; /* guarded by fed_mutex: viewers that have packets, or soon get them */
};

/* A viewer's media. */
struct webrtc_track {
  GstPad *pad; /* from which its packets are pushed; NULL: the offer has none */
  guint8 type; /* of the payload, as the offer numbers it */
  guint32 ssrc;
};

/* What a viewer has sent. */
struct webrtc_reports {
  guint32 senders[16]; /* SSRCs that it has reported as; browsers have one or two */
  unsigned count;
  bool excess; /* they are more, each of which costs memory */
  gint64 due;  /* microseconds of GLib's monotonic clock: when all of it would have come at the pace that is admitted */
};

enum viewer_step { VIEWER_GATHERS, VIEWER_CONNECTS, VIEWER_WATCHES };

struct ern_webrtc_viewer {
  struct ern_webrtc_viewer *following, *following_fed;
  struct ern_webrtc_source *source;
  void *user;
  char *offer;
  unsigned char avcc[4]; /* of the stream, its beginning: version, profile, constraints, level */
  atomic_bool ends;      /* somebody asks for its end */
  size_t spare_files;    /* open files that others may still need */
  enum viewer_step step;
  gint64 since;                  /* microseconds of GLib's monotonic clock: when the step began */
  _Atomic gint64 reported;       /* likewise, when it last sent a report; 0: never */
  struct webrtc_reports reports; /* of the thread that receives them */
  GstElement *pipeline, *peer;
  struct webrtc_track picture, sound;
  /* guarded by the source's fed_mutex */
  bool begun;         /* it has had a key frame */
  GstClockTime first; /* time of the stream of that frame */
  GstClockTime shift; /* what is added to times of the stream, modulo 2^64 */
};

/* What an offer asks for. */
struct webrtc_offer {
  GstSDPMessage *message;
  int picture_line, sound_line; /* index of the media; -1: none */
  GstCaps *picture, *sound;     /* as RTP, with the offer's payload type */
};

/* ---- webrtc_offer.c ---- */

/* avcc: the beginning of the stream's. False: it is none that can be answered, and *reason has a sentence.
 * webrtc_offer_free in either case. */
bool webrtc_offer_read(struct webrtc_offer *offer, const char *text, const unsigned char avcc[4],
                       char reason[WEBRTC_REASON]);
void webrtc_offer_free(struct webrtc_offer *offer);

/* ---- webrtc_viewer.c: on the library's thread ---- */

/* Makes what the offer asks for. False: *status and reason say why not. webrtc_viewer_close in either case. */
bool webrtc_viewer_open(struct ern_webrtc_viewer *viewer, unsigned *status, char reason[WEBRTC_REASON]);
/* Looks how far it is. False: it has ended. */
bool webrtc_viewer_look(struct ern_webrtc_viewer *viewer);
void webrtc_viewer_close(struct ern_webrtc_viewer *viewer);

/* ---- webrtc_receiver.c ---- */

/* From now on only reports that are admitted come from the peer. False: it cannot be. */
bool webrtc_receiver_open(struct ern_webrtc_viewer *viewer);
/* Whether the certificates that came are those of the offer. */
bool webrtc_receiver_is_offered(struct ern_webrtc_viewer *viewer);

/* ---- webrtc_reports.c ---- */

/* The reports (RTCP) that GStreamer may have, at the beginning of `bytes`: their length, -1: all are refused. own: the
 * SSRCs of the viewer's tracks. */
ptrdiff_t webrtc_reports_filter(struct webrtc_reports *reports, guint8 *bytes, size_t count, const guint32 own[2],
                                gint64 now);

/* ---- webrtc_room.c ---- */

/* Whether there are open files and threads for one more viewer, and the files that others may still need. */
bool webrtc_room_is_there(size_t spare_files);

/* ---- webrtc_source.c ---- */

/* From now on the viewer is fed, from a key frame on. False: nothing can make packets. */
bool webrtc_source_feed(struct ern_webrtc_source *source, struct ern_webrtc_viewer *viewer);
void webrtc_source_starve(struct ern_webrtc_source *source, struct ern_webrtc_viewer *viewer);
void webrtc_source_picture(struct ern_webrtc_source *source, const void *avcc, size_t avcc_bytes, const void *unit,
                           size_t bytes, bool key, double seconds);
void webrtc_source_sound(struct ern_webrtc_source *source, const float *samples, size_t frames, double seconds);
void webrtc_source_release(struct ern_webrtc_source *source);

#endif
