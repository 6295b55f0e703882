/* SPDX-License-Identifier: MIT
 * What the viewers of a session share: its pictures as they were coded, and its sound, coded as Opus once while
 * somebody watches. */
#include <stdlib.h>

#include "serve/webrtc/webrtc_shared.h"

GstCaps *webrtc_picture_caps(GstBuffer *avcc) {
  /* The payloader takes what the answer says or less; codec_data has the stream's own level. */
  static const char form[] = "video/x-h264,stream-format=avc,alignment=au,profile=constrained-baseline,level=(string)1";
  GstCaps *made = gst_caps_from_string(form);
  if (avcc != NULL) gst_caps_set_simple(made, "codec_data", GST_TYPE_BUFFER, avcc, NULL);
  return made;
}

static GstClockTime to_time(double seconds) { return (GstClockTime)(seconds * (double)GST_SECOND + 0.5); }

/* ---- handing on: the caller holds the source's lock ---------------------------------------------------------------
 */

/* The viewer's clock goes on as the stream does, from its first key frame on. */
static void push(struct ern_webrtc_viewer *v, GstElement *to, GstBuffer *shared, GstClockTime at) {
  GstBuffer *own = gst_buffer_copy(shared); /* the bytes are the same memory */
  if (own == NULL) return;
  GST_BUFFER_PTS(own) = GST_BUFFER_DTS(own) = at + v->shift;
  (void)gst_app_src_push_buffer(GST_APP_SRC(to), own);
}

static void begin(struct ern_webrtc_viewer *v, GstClockTime at) {
  GstClock *clock = gst_pipeline_get_clock(GST_PIPELINE(v->pipeline));
  const GstClockTime now = gst_clock_get_time(clock) - gst_element_get_base_time(v->pipeline);
  gst_object_unref(clock);
  v->begun = true;
  v->first = at;
  v->shift = now - at;
}

static GstBuffer *copy_of(const void *bytes, size_t count) {
  GstBuffer *made = gst_buffer_new_allocate(NULL, count, NULL);
  if (made != NULL) (void)gst_buffer_fill(made, 0, bytes, count);
  return made;
}

void webrtc_source_picture(struct ern_webrtc_source *s, const void *avcc, size_t avcc_bytes, const void *unit,
                           size_t bytes, bool key, double seconds) {
  (void)pthread_mutex_lock(&s->mutex);
  GstBuffer *shared = s->fed != NULL ? copy_of(unit, bytes) : NULL, *head = NULL;
  for (struct ern_webrtc_viewer *v = s->fed; v != NULL && shared != NULL; v = v->following_fed) {
    if (!v->begun && !key) continue;
    if (!v->begun && head == NULL) head = copy_of(avcc, avcc_bytes);
    if (!v->begun && head != NULL) {
      GstCaps *caps = webrtc_picture_caps(head);
      gst_app_src_set_caps(GST_APP_SRC(v->picture), caps);
      gst_caps_unref(caps);
      begin(v, to_time(seconds));
    }
    if (v->begun) push(v, v->picture, shared, to_time(seconds));
  }
  if (head != NULL) gst_buffer_unref(head);
  if (shared != NULL) gst_buffer_unref(shared);
  (void)pthread_mutex_unlock(&s->mutex);
}

/* A packet of Opus, on the coder's thread. */
static GstFlowReturn take_packet(GstAppSink *sink, void *user) {
  struct ern_webrtc_source *s = user;
  GstSample *sample = gst_app_sink_pull_sample(sink);
  GstBuffer *packet = sample != NULL ? gst_sample_get_buffer(sample) : NULL;
  (void)pthread_mutex_lock(&s->mutex);
  for (struct ern_webrtc_viewer *v = s->fed; v != NULL && packet != NULL; v = v->following_fed)
    if (v->begun && v->sound != NULL && GST_BUFFER_PTS_IS_VALID(packet) && GST_BUFFER_PTS(packet) >= v->first)
      push(v, v->sound, packet, GST_BUFFER_PTS(packet));
  (void)pthread_mutex_unlock(&s->mutex);
  if (sample != NULL) gst_sample_unref(sample);
  return GST_FLOW_OK;
}

void webrtc_source_sound(struct ern_webrtc_source *s, const float *samples, size_t frames, double seconds) {
  (void)pthread_mutex_lock(&s->mutex);
  GstBuffer *pcm = s->coder != NULL && frames > 0 ? copy_of(samples, frames * sizeof *samples) : NULL;
  if (pcm != NULL) {
    GST_BUFFER_PTS(pcm) = to_time(seconds);
    GST_BUFFER_DURATION(pcm) = to_time((double)frames / SOUND_RATE);
    (void)gst_app_src_push_buffer(GST_APP_SRC(s->coder_in), pcm);
  }
  (void)pthread_mutex_unlock(&s->mutex);
}

/* ---- viewers: on the library's thread ------------------------------------------------------------------------------
 */

static bool open_coder(struct ern_webrtc_source *s) {
  static const char form[] =
      "appsrc name=in format=time is-live=true block=false "
      "caps=audio/x-raw,format=F32LE,layout=interleaved,rate=48000,channels=1 ! "
      "audioconvert ! opusenc frame-size=20 bitrate=48000 ! appsink name=out sync=false";
  GstAppSinkCallbacks calls = {.new_sample = take_packet};
  GstElement *made = gst_parse_launch(form, NULL);
  GstElement *in = made != NULL ? gst_bin_get_by_name(GST_BIN(made), "in") : NULL;
  GstElement *out = made != NULL ? gst_bin_get_by_name(GST_BIN(made), "out") : NULL;
  const bool opened = in != NULL && out != NULL;
  if (opened) gst_app_sink_set_callbacks(GST_APP_SINK(out), &calls, s, NULL);
  if (opened) (void)gst_element_set_state(made, GST_STATE_PLAYING);
  if (in != NULL) gst_object_unref(in);
  if (out != NULL) gst_object_unref(out);
  if (!opened && made != NULL) gst_object_unref(made);
  if (!opened) return false;
  (void)pthread_mutex_lock(&s->mutex);
  s->coder = made;
  s->coder_in = in;
  (void)pthread_mutex_unlock(&s->mutex);
  return true;
}

static void close_coder(struct ern_webrtc_source *s) {
  (void)pthread_mutex_lock(&s->mutex);
  GstElement *coder = s->coder;
  s->coder = s->coder_in = NULL;
  (void)pthread_mutex_unlock(&s->mutex);
  if (coder == NULL) return;
  (void)gst_element_set_state(coder, GST_STATE_NULL); /* its thread takes the lock */
  gst_object_unref(coder);
}

bool webrtc_source_feed(struct ern_webrtc_source *s, struct ern_webrtc_viewer *v) {
  if (s->watched++ == 0 && !open_coder(s)) {
    s->watched--;
    return false;
  }
  (void)pthread_mutex_lock(&s->mutex);
  v->following_fed = s->fed;
  s->fed = v;
  (void)pthread_mutex_unlock(&s->mutex);
  return true;
}

void webrtc_source_starve(struct ern_webrtc_source *s, struct ern_webrtc_viewer *v) {
  bool found = false;
  (void)pthread_mutex_lock(&s->mutex);
  for (struct ern_webrtc_viewer **at = &s->fed; *at != NULL && !found; at = found ? at : &(*at)->following_fed)
    if (*at == v) {
      *at = v->following_fed;
      found = true;
    }
  (void)pthread_mutex_unlock(&s->mutex);
  if (found && --s->watched == 0) close_coder(s);
}

void webrtc_source_release(struct ern_webrtc_source *s) {
  if (atomic_fetch_sub(&s->users, 1) > 1) return;
  (void)pthread_mutex_destroy(&s->mutex);
  free(s);
}
