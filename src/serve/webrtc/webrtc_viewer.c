/* SPDX-License-Identifier: MIT
 * A viewer: a pipeline of its own, so that one which fails touches no other. */
#define GST_USE_UNSTABLE_API
#include <gst/webrtc/webrtc.h>
#include <stdio.h>
#include <string.h>

#include "serve/webrtc/webrtc_shared.h"

enum {
  JOINS = 10, /* viewers that are made in a second */
  BAD_REQUEST = 400,
  TOO_MANY = 429,
  BROKEN = 500,
  BUSY = 503
};

static const gint64 patience[] = {[VIEWER_GATHERS] = 5 * G_USEC_PER_SEC,
                                  [VIEWER_CONNECTS] = 10 * G_USEC_PER_SEC,
                                  [VIEWER_WATCHES] = 15 * G_USEC_PER_SEC};

/* ---- opening ----------------------------------------------------------------------------------------------------- */

/* The times of RTCP need the latency of what the packets come from: none. */
static gboolean answer_query(GstPad *pad, GstObject *parent, GstQuery *query) {
  if (GST_QUERY_TYPE(query) != GST_QUERY_LATENCY) return gst_pad_query_default(pad, parent, query);
  gst_query_set_latency(query, TRUE, 0, GST_CLOCK_TIME_NONE);
  return TRUE;
}

static GstPad *open_pad(GstPad *to, GstCaps *rtp) {
  GstPad *pad = gst_pad_new(NULL, GST_PAD_SRC);
  GstSegment segment;
  gst_segment_init(&segment, GST_FORMAT_TIME);
  gst_pad_set_query_function(pad, answer_query);
  (void)gst_pad_set_active(pad, TRUE);
  if (gst_pad_link(pad, to) != GST_PAD_LINK_OK) {
    gst_object_unref(pad);
    return NULL;
  }
  (void)gst_pad_push_event(pad, gst_event_new_stream_start(GST_PAD_NAME(pad)));
  (void)gst_pad_push_event(pad, gst_event_new_caps(rtp));
  (void)gst_pad_push_event(pad, gst_event_new_segment(&segment));
  return pad;
}

/* The peer's media of that number. */
static bool open_track(struct ern_webrtc_viewer *v, struct webrtc_track *track, GstCaps *rtp, int line) {
  char name[32];
  int type = 0;
  snprintf(name, sizeof name, "sink_%d", line);
  (void)gst_structure_get_int(gst_caps_get_structure(rtp, 0), "payload", &type);
  track->type = (guint8)type;
  track->ssrc = g_random_int(); /* known now, so that the answer says whose lost packets are sent again */
  gst_caps_set_simple(rtp, "ssrc", G_TYPE_UINT, track->ssrc, NULL);
  GstPadTemplate *form = gst_element_get_pad_template(v->peer, "sink_%u");
  GstPad *to = gst_element_request_pad(v->peer, form, name, rtp);
  GstWebRTCRTPTransceiver *transceiver = NULL;
  if (to == NULL) return false;
  track->pad = open_pad(to, rtp);
  g_object_get(to, "transceiver", &transceiver, NULL);
  if (transceiver != NULL) {
    g_object_set(transceiver, "direction", GST_WEBRTC_RTP_TRANSCEIVER_DIRECTION_SENDONLY, "codec-preferences", rtp,
                 "do-nack", TRUE, NULL);
    gst_object_unref(transceiver);
  }
  gst_object_unref(to);
  return track->pad != NULL;
}

/* Calls the peer's action and waits for its reply; *reply: NULL, or where it goes. False: it has failed. */
static bool ask_peer(struct ern_webrtc_viewer *v, const char *action, void *argument, GstPromise **reply,
                     char reason[WEBRTC_REASON]) {
  GstPromise *promise = gst_promise_new();
  GError *error = NULL;
  g_signal_emit_by_name(v->peer, action, argument, promise);
  const bool replied = gst_promise_wait(promise) == GST_PROMISE_RESULT_REPLIED;
  const GstStructure *answer = replied ? gst_promise_get_reply(promise) : NULL;
  if (answer != NULL && gst_structure_has_field(answer, "error"))
    (void)gst_structure_get(answer, "error", G_TYPE_ERROR, &error, NULL);
  if (error != NULL || !replied)
    snprintf(reason, WEBRTC_REASON, "the offer: %s: %s", action, error != NULL ? error->message : "no reply");
  const bool done = replied && error == NULL;
  g_clear_error(&error);
  if (done && reply != NULL)
    *reply = promise;
  else
    gst_promise_unref(promise);
  return done;
}

static bool set_remote(struct ern_webrtc_viewer *v, struct webrtc_offer *offer, char reason[WEBRTC_REASON]) {
  GstWebRTCSessionDescription *remote = gst_webrtc_session_description_new(GST_WEBRTC_SDP_TYPE_OFFER, offer->message);
  offer->message = NULL; /* taken over */
  const bool done = ask_peer(v, "set-remote-description", remote, NULL, reason);
  gst_webrtc_session_description_free(remote);
  return done;
}

/* The answer's candidates are found while the peer is looked at. */
static bool answer(struct ern_webrtc_viewer *v, char reason[WEBRTC_REASON]) {
  GstWebRTCSessionDescription *local = NULL;
  GstPromise *reply = NULL;
  if (!ask_peer(v, "create-answer", NULL, &reply, reason)) return false;
  const GstStructure *answer = gst_promise_get_reply(reply);
  if (answer != NULL) (void)gst_structure_get(answer, "answer", GST_TYPE_WEBRTC_SESSION_DESCRIPTION, &local, NULL);
  gst_promise_unref(reply);
  snprintf(reason, WEBRTC_REASON, "the offer: no answer was made");
  const bool done = local != NULL && ask_peer(v, "set-local-description", local, NULL, reason);
  if (local != NULL) gst_webrtc_session_description_free(local);
  return done;
}

static bool make_peer(struct ern_webrtc_viewer *v) {
  const struct ern_webrtc *w = v->source->webrtc;
  GObject *ice = NULL, *agent = NULL;
  v->pipeline = gst_pipeline_new(NULL);
  v->peer = gst_element_factory_make("webrtcbin", NULL);
  if (v->pipeline == NULL || v->peer == NULL || !gst_bin_add(GST_BIN(v->pipeline), v->peer)) return false;
  gst_util_set_object_arg(G_OBJECT(v->peer), "bundle-policy", "max-bundle");
  if (w->stun != NULL) g_object_set(v->peer, "stun-server", w->stun, NULL);
  g_object_get(v->peer, "ice-agent", &ice, NULL);
  if (ice != NULL) {
    g_object_set(ice, "ice-tcp", FALSE, NULL);
    if (w->first_port > 0) g_object_set(ice, "min-rtp-port", w->first_port, "max-rtp-port", w->last_port, NULL);
    g_object_get(ice, "agent", &agent, NULL);
    g_object_unref(ice);
  }
  if (agent != NULL) {
    g_object_set(agent, "upnp", FALSE, NULL); /* asks no router to open ports */
    g_object_unref(agent);
  }
  GstClock *clock = gst_system_clock_obtain();
  gst_pipeline_use_clock(GST_PIPELINE(v->pipeline), clock);
  gst_object_unref(clock);
  return gst_element_set_state(v->pipeline, GST_STATE_PLAYING) != GST_STATE_CHANGE_FAILURE;
}

/* Making a viewer takes 7 ms of a core, 50 times another request: a burst of JOINS, else so many in a second. */
static bool may_join(struct ern_webrtc *w) {
  const gint64 now = g_get_monotonic_time(), step = G_USEC_PER_SEC / JOINS, at = MAX(w->joins, now);
  if (at > now + (JOINS - 1) * step) return false;
  w->joins = at + step;
  return true;
}

bool webrtc_viewer_open(struct ern_webrtc_viewer *v, unsigned *status, char reason[WEBRTC_REASON]) {
  struct webrtc_offer offer;
  *status = BAD_REQUEST;
  bool done = webrtc_offer_read(&offer, v->offer, v->avcc, reason);
  if (done && !may_join(v->source->webrtc)) {
    *status = TOO_MANY;
    snprintf(reason, WEBRTC_REASON, "more than %d viewers by WebRTC have come within a second", JOINS);
    done = false;
  }
  if (done && !webrtc_room_is_there(v->spare_files)) {
    *status = BUSY;
    snprintf(reason, WEBRTC_REASON,
             "the system has too few open files or threads, or too little memory, for one more viewer by WebRTC");
    done = false;
  }
  if (done) {
    *status = BROKEN;
    snprintf(reason, WEBRTC_REASON, "no peer could be made");
    done = make_peer(v);
  }
  if (done) {
    *status = BAD_REQUEST;
    done = set_remote(v, &offer, reason);
  }
  if (done) {
    snprintf(reason, WEBRTC_REASON, "the offer: no track could be made for it");
    done = open_track(v, &v->picture, offer.picture, offer.picture_line);
  }
  if (done && offer.sound != NULL) done = open_track(v, &v->sound, offer.sound, offer.sound_line);
  done = done && answer(v, reason) && webrtc_receiver_open(v);
  if (done && gst_element_set_state(v->pipeline, GST_STATE_PLAYING) == GST_STATE_CHANGE_FAILURE) done = false;
  webrtc_offer_free(&offer);
  v->step = VIEWER_GATHERS;
  v->since = g_get_monotonic_time();
  return done;
}

/* ---- looking ----------------------------------------------------------------------------------------------------- */

static void send_answer(struct ern_webrtc_viewer *v) {
  GstWebRTCSessionDescription *local = NULL;
  g_object_get(v->peer, "local-description", &local, NULL);
  char *text = local != NULL ? gst_sdp_message_as_text(local->sdp) : NULL;
  if (text != NULL && strstr(text, "a=candidate:") != NULL)
    v->source->webrtc->events.answered(v->user, 201, text);
  else
    v->source->webrtc->events.answered(v->user, 503, "no WebRTC now: this machine has no address but that of itself");
  g_free(text);
  if (local != NULL) gst_webrtc_session_description_free(local);
}

static bool has_failed(struct ern_webrtc_viewer *v) {
  GstBus *bus = gst_element_get_bus(v->pipeline);
  GstMessage *message = gst_bus_pop_filtered(bus, GST_MESSAGE_ERROR);
  const bool failed = message != NULL;
  if (failed) gst_message_unref(message);
  while ((message = gst_bus_pop(bus)) != NULL) gst_message_unref(message);
  gst_object_unref(bus);
  return failed;
}

static bool gathers(struct ern_webrtc_viewer *v) {
  GstWebRTCICEGatheringState state;
  g_object_get(v->peer, "ice-gathering-state", &state, NULL);
  if (state != GST_WEBRTC_ICE_GATHERING_STATE_COMPLETE) return g_get_monotonic_time() < v->since + patience[v->step];
  send_answer(v);
  v->step = VIEWER_CONNECTS;
  v->since = g_get_monotonic_time();
  return true;
}

bool webrtc_viewer_look(struct ern_webrtc_viewer *v) {
  GstWebRTCPeerConnectionState state;
  if (atomic_load(&v->ends) || atomic_load(&v->source->removed) || has_failed(v)) return false;
  if (v->step == VIEWER_GATHERS) return gathers(v);
  g_object_get(v->peer, "connection-state", &state, NULL);
  if (state == GST_WEBRTC_PEER_CONNECTION_STATE_FAILED || state == GST_WEBRTC_PEER_CONNECTION_STATE_CLOSED)
    return false;
  if (v->step == VIEWER_CONNECTS && state == GST_WEBRTC_PEER_CONNECTION_STATE_CONNECTED) {
    v->step = VIEWER_WATCHES;
    v->since = g_get_monotonic_time();
    if (!webrtc_receiver_is_offered(v)) return false;
    (void)gst_bin_recalculate_latency(GST_BIN(v->pipeline)); /* else RTCP does not tell the time of packets exactly */
    return webrtc_source_feed(v->source, v);
  }
  const gint64 reported = atomic_load(&v->reported);
  return g_get_monotonic_time() < MAX(v->since, reported) + patience[v->step];
}

void webrtc_viewer_close(struct ern_webrtc_viewer *v) {
  if (v->pipeline != NULL) (void)gst_element_set_state(v->pipeline, GST_STATE_NULL); /* ends what is being sent to it */
  webrtc_source_starve(v->source, v);
  if (v->picture.pad != NULL) gst_object_unref(v->picture.pad);
  if (v->sound.pad != NULL) gst_object_unref(v->sound.pad);
  if (v->pipeline != NULL) gst_object_unref(v->pipeline);
  v->pipeline = v->peer = NULL;
  v->picture.pad = v->sound.pad = NULL;
}
