/* SPDX-License-Identifier: MIT
 * The library's thread, and what the server calls. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/interface_version.h"
#include "serve/webrtc/webrtc_shared.h"

enum { LOOK_MS = 50, BUSY = 503, MISSING = 501 };

/* ---- the thread -------------------------------------------------------------------------------------------------- */

/* Whether GStreamer has all elements; found out when somebody offers, as it may look through its plugins for seconds.
 */
static bool is_ready(struct ern_webrtc *w, char reason[WEBRTC_REASON]) {
  static const char *const needed[][2] = {
      {"webrtcbin", "gstreamer1.0-plugins-bad"},     {"nicesrc", "gstreamer1.0-nice"},
      {"dtlssrtpenc", "gstreamer1.0-plugins-bad"},   {"srtpenc", "gstreamer1.0-plugins-bad"},
      {"rtpbin", "gstreamer1.0-plugins-good"},       {"rtph264pay", "gstreamer1.0-plugins-good"},
      {"rtpopuspay", "gstreamer1.0-plugins-good"},   {"opusenc", "gstreamer1.0-plugins-base"},
      {"audioconvert", "gstreamer1.0-plugins-base"}, {"appsrc", "gstreamer1.0-plugins-base"}};
  GError *error = NULL;
  if (w->is_ready) return true;
  if (!gst_init_check(NULL, NULL, &error)) {
    snprintf(reason, WEBRTC_REASON, "GStreamer cannot start: %s",
             error != NULL ? error->message : "it gives no reason");
    g_clear_error(&error);
    return false;
  }
  for (size_t i = 0; i < sizeof needed / sizeof *needed; i++) {
    GstElementFactory *found = gst_element_factory_find(needed[i][0]);
    if (found == NULL) {
      snprintf(reason, WEBRTC_REASON, "no WebRTC here: GStreamer's element %s is not installed (Debian: %s)",
               needed[i][0], needed[i][1]);
      return false;
    }
    gst_object_unref(found);
  }
  w->is_ready = true;
  return true;
}

/* No address was found in time. */
static void answer_without(struct ern_webrtc_viewer *v) {
  const struct ern_webrtc *w = v->source->webrtc;
  char ports[WEBRTC_REASON];
  snprintf(ports, sizeof ports, "no port from %d to %d (--udp-ports) is free, or the server stops", w->first_port,
           w->last_port);
  w->events.answered(v->user, BUSY,
                     w->first_port > 0 ? ports : "the server found no address of its own in time, or stops");
}

/* Ends the viewer; `place` is what points to it. */
static void finish(struct ern_webrtc_viewer **place) {
  struct ern_webrtc_viewer *v = *place;
  struct ern_webrtc *w = v->source->webrtc;
  *place = v->following;
  webrtc_viewer_close(v);
  if (v->step == VIEWER_GATHERS) answer_without(v);
  w->events.ended(v->user);
  webrtc_source_release(v->source);
  g_free(v->offer);
  free(v);
}

static gboolean begin(void *user) {
  struct ern_webrtc_viewer *v = user;
  struct ern_webrtc *w = v->source->webrtc;
  char reason[WEBRTC_REASON];
  unsigned status = MISSING;
  v->following = w->viewers;
  w->viewers = v;
  if (is_ready(w, reason) && webrtc_viewer_open(v, &status, reason)) return G_SOURCE_REMOVE;
  w->events.answered(v->user, status, reason);
  v->step = VIEWER_CONNECTS; /* it is answered */
  finish(&w->viewers);
  return G_SOURCE_REMOVE;
}

static gboolean look(void *user) {
  struct ern_webrtc *w = user;
  for (struct ern_webrtc_viewer **at = &w->viewers; *at != NULL;)
    if (webrtc_viewer_look(*at))
      at = &(*at)->following;
    else
      finish(at);
  return G_SOURCE_CONTINUE;
}

static gboolean leave(void *user) {
  struct ern_webrtc *w = user;
  while (w->viewers != NULL) finish(&w->viewers);
  g_main_loop_quit(w->loop);
  return G_SOURCE_REMOVE;
}

static void *run(void *user) {
  struct ern_webrtc *w = user;
  g_main_context_push_thread_default(w->context);
  g_main_loop_run(w->loop);
  g_main_context_pop_thread_default(w->context);
  return NULL;
}

/* ---- what the server calls --------------------------------------------------------------------------------------- */

static void call(struct ern_webrtc *w, GSourceFunc what, void *user) {
  GSource *source = g_idle_source_new();
  g_source_set_priority(source, G_PRIORITY_DEFAULT);
  g_source_set_callback(source, what, user, NULL);
  (void)g_source_attach(source, w->context);
  g_source_unref(source);
}

static void close_webrtc(struct ern_webrtc **gone) {
  struct ern_webrtc *w = *gone;
  if (w == NULL) return;
  if (w->runs) {
    call(w, leave, w);
    (void)pthread_join(w->thread, NULL);
  }
  g_main_loop_unref(w->loop);
  g_main_context_unref(w->context);
  g_free(w->stun);
  free(w);
  *gone = NULL;
}

static struct ern_webrtc *open_webrtc(const struct ern_webrtc_events *events,
                                      const struct ern_webrtc_options *options) {
  struct ern_webrtc *w = calloc(1, sizeof *w);
  if (w == NULL) return NULL;
  w->events = *events;
  w->stun = g_strdup(options->stun);
  w->first_port = options->first_port;
  w->last_port = options->last_port;
  w->context = g_main_context_new();
  w->loop = g_main_loop_new(w->context, FALSE);
  GSource *timer = g_timeout_source_new(LOOK_MS);
  g_source_set_callback(timer, look, w, NULL);
  (void)g_source_attach(timer, w->context);
  g_source_unref(timer);
  w->runs = pthread_create(&w->thread, NULL, run, w) == 0;
  if (!w->runs) close_webrtc(&w);
  return w;
}

static struct ern_webrtc_source *add(struct ern_webrtc *w) {
  struct ern_webrtc_source *s = calloc(1, sizeof *s);
  if (s == NULL) return NULL;
  s->webrtc = w;
  atomic_store(&s->users, 1);
  (void)pthread_mutex_init(&s->mutex, NULL); /* does not fail on Linux */
  (void)pthread_mutex_init(&s->fed_mutex, NULL);
  return s;
}

static void remove_source(struct ern_webrtc_source **source) {
  struct ern_webrtc_source *s = *source;
  if (s == NULL) return;
  *source = NULL;
  atomic_store(&s->removed, true);
  webrtc_source_release(s);
}

static struct ern_webrtc_viewer *watch(struct ern_webrtc_source *s, const char *offer, const unsigned char avcc[4],
                                       size_t spare_files, void *user) {
  struct ern_webrtc_viewer *v = calloc(1, sizeof *v);
  if (v == NULL) return NULL;
  v->source = s;
  v->user = user;
  v->spare_files = spare_files;
  v->offer = g_strdup(offer);
  memcpy(v->avcc, avcc, sizeof v->avcc);
  atomic_fetch_add(&s->users, 1);
  call(s->webrtc, begin, v);
  return v;
}

static void end(struct ern_webrtc_viewer *v) { atomic_store(&v->ends, true); }

const struct ern_webrtc_functions ern_webrtc_functions = {.version = ERN_INTERFACE_VERSION,
                                                          .open = open_webrtc,
                                                          .close = close_webrtc,
                                                          .add = add,
                                                          .remove = remove_source,
                                                          .picture = webrtc_source_picture,
                                                          .sound = webrtc_source_sound,
                                                          .watch = watch,
                                                          .end = end};
