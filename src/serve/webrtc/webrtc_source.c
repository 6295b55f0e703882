/* SPDX-License-Identifier: MIT
 * What the viewers of a session share: packets of its pictures and sound, which is coded as Opus, made once while
 * somebody watches. */
#include <stdlib.h>
#include <string.h>

#include "serve/webrtc/webrtc_shared.h"

enum { SSRC_AT = 8, HEADER = 12 /* bytes of RTP */, MARKER = 128 };

static GstClockTime to_time(double seconds) { return (GstClockTime)(seconds * (double)GST_SECOND + 0.5); }

/* ---- packets, on a thread of the packer -------------------------------------------------------------------------- */

/* The viewer's clock goes on as the stream does, from its first key frame on. */
static void begin(struct ern_webrtc_viewer *v, GstClockTime at) {
  GstClock *clock = gst_pipeline_get_clock(GST_PIPELINE(v->pipeline));
  const GstClockTime now = gst_clock_get_time(clock) - gst_element_get_base_time(v->pipeline);
  gst_object_unref(clock);
  v->begun = true;
  v->first = at;
  v->shift = now - at;
}

struct addressee {
  const struct ern_webrtc_viewer *viewer;
  const struct webrtc_track *track;
};

/* The packet as the viewer has it: its payload type, source and clock; the payload is the same memory. */
static gboolean address(GstBuffer **packet, guint number, void *user) {
  const struct addressee *to = user;
  GstMapInfo map;
  (void)number;
  *packet = gst_buffer_make_writable(*packet);
  if (!gst_buffer_map_range(*packet, 0, 1, &map, GST_MAP_READWRITE)) return FALSE;
  if (map.size >= HEADER) {
    map.data[1] = (guint8)((map.data[1] & MARKER) | to->track->type);
    GST_WRITE_UINT32_BE(map.data + SSRC_AT, to->track->ssrc);
  }
  gst_buffer_unmap(*packet, &map);
  GST_BUFFER_PTS(*packet) += to->viewer->shift;
  GST_BUFFER_DTS(*packet) = GST_BUFFER_PTS(*packet);
  return TRUE;
}

/* The packets of one picture, or one of sound, for all viewers. */
static GstFlowReturn send_packets(GstAppSink *sink, void *user) {
  struct ern_webrtc_source *s = user;
  GstSample *sample = gst_app_sink_pull_sample(sink);
  GstBufferList *packets = sample != NULL ? gst_sample_get_buffer_list(sample) : NULL;
  GstBuffer *first = packets != NULL  ? gst_buffer_list_get(packets, 0)
                     : sample != NULL ? gst_sample_get_buffer(sample)
                                      : NULL;
  const bool seen = strcmp(GST_OBJECT_NAME(sink), "picture") == 0;
  (void)pthread_mutex_lock(&s->fed_mutex);
  for (struct ern_webrtc_viewer *v = s->fed; v != NULL && first != NULL; v = v->following_fed) {
    struct addressee to = {v, seen ? &v->picture : &v->sound};
    if (!v->begun && seen && !GST_BUFFER_FLAG_IS_SET(first, GST_BUFFER_FLAG_DELTA_UNIT))
      begin(v, GST_BUFFER_PTS(first));
    if (!v->begun || to.track->pad == NULL || GST_BUFFER_PTS(first) < v->first) continue;
    GstBufferList *own = packets != NULL ? gst_buffer_list_copy(packets) : gst_buffer_list_new_sized(1);
    if (packets == NULL) gst_buffer_list_add(own, gst_buffer_ref(first));
    (void)gst_buffer_list_foreach(own, address, &to);
    (void)gst_pad_push_list(to.track->pad, own);
  }
  (void)pthread_mutex_unlock(&s->fed_mutex);
  if (sample != NULL) gst_sample_unref(sample);
  return GST_FLOW_OK;
}

/* ---- what goes in: on the thread that codes ---------------------------------------------------------------------- */

static GstBuffer *copy_of(const void *bytes, size_t count, GstClockTime at) {
  GstBuffer *made = gst_buffer_new_allocate(NULL, count, NULL);
  if (made == NULL) return NULL;
  (void)gst_buffer_fill(made, 0, bytes, count);
  GST_BUFFER_PTS(made) = GST_BUFFER_DTS(made) = at;
  return made;
}

static void set_head(struct ern_webrtc_source *s, const void *avcc, size_t bytes) {
  GstBuffer *head = copy_of(avcc, bytes, GST_CLOCK_TIME_NONE);
  GstCaps *caps = gst_caps_from_string("video/x-h264,stream-format=avc,alignment=au");
  gst_caps_set_simple(caps, "codec_data", GST_TYPE_BUFFER, head, NULL);
  gst_app_src_set_caps(GST_APP_SRC(s->pictures), caps);
  gst_caps_unref(caps);
  if (head != NULL) gst_buffer_unref(head);
  s->has_key = true;
}

void webrtc_source_picture(struct ern_webrtc_source *s, const void *avcc, size_t avcc_bytes, const void *unit,
                           size_t bytes, bool key, double seconds) {
  (void)pthread_mutex_lock(&s->mutex);
  if (s->packer != NULL && key && !s->has_key) set_head(s, avcc, avcc_bytes);
  GstBuffer *picture = s->packer != NULL && s->has_key ? copy_of(unit, bytes, to_time(seconds)) : NULL;
  if (picture != NULL && !key) GST_BUFFER_FLAG_SET(picture, GST_BUFFER_FLAG_DELTA_UNIT);
  if (picture != NULL) (void)gst_app_src_push_buffer(GST_APP_SRC(s->pictures), picture);
  (void)pthread_mutex_unlock(&s->mutex);
}

void webrtc_source_sound(struct ern_webrtc_source *s, const float *samples, size_t frames, double seconds) {
  (void)pthread_mutex_lock(&s->mutex);
  GstBuffer *pcm =
      s->packer != NULL && frames > 0 ? copy_of(samples, frames * sizeof *samples, to_time(seconds)) : NULL;
  if (pcm != NULL) {
    GST_BUFFER_DURATION(pcm) = to_time((double)frames / SOUND_RATE);
    (void)gst_app_src_push_buffer(GST_APP_SRC(s->sounds), pcm);
  }
  (void)pthread_mutex_unlock(&s->mutex);
}

/* ---- viewers: on the library's thread ---------------------------------------------------------------------------- */

static bool send_from(GstElement *packer, const char *name, struct ern_webrtc_source *s) {
  GstAppSinkCallbacks calls = {.new_sample = send_packets};
  GstElement *sink = gst_bin_get_by_name(GST_BIN(packer), name);
  if (sink == NULL) return false;
  gst_app_sink_set_callbacks(GST_APP_SINK(sink), &calls, s, NULL);
  gst_object_unref(sink);
  return true;
}

/* Sound comes with each picture, so packets of 40 ms come no later than shorter ones, and are fewer. */
static bool open_packer(struct ern_webrtc_source *s) {
  static const char form[] =
      "appsrc name=pictures format=time is-live=true block=false max-bytes=0 ! "
      "rtph264pay config-interval=-1 ! appsink name=picture sync=false buffer-list=true "
      "appsrc name=sounds format=time is-live=true block=false "
      "caps=audio/x-raw,format=F32LE,layout=interleaved,rate=48000,channels=1 ! "
      "audioconvert ! opusenc frame-size=40 bitrate=48000 ! rtpopuspay ! appsink name=sound sync=false";
  GstElement *made = gst_parse_launch(form, NULL);
  if (made == NULL) return false;
  if (!send_from(made, "picture", s) || !send_from(made, "sound", s) ||
      gst_element_set_state(made, GST_STATE_PLAYING) == GST_STATE_CHANGE_FAILURE) {
    (void)gst_element_set_state(made, GST_STATE_NULL);
    gst_object_unref(made);
    return false;
  }
  (void)pthread_mutex_lock(&s->mutex);
  s->packer = made;
  s->pictures = gst_bin_get_by_name(GST_BIN(made), "pictures");
  s->sounds = gst_bin_get_by_name(GST_BIN(made), "sounds");
  s->has_key = false;
  (void)pthread_mutex_unlock(&s->mutex);
  return true;
}

static void close_packer(struct ern_webrtc_source *s) {
  (void)pthread_mutex_lock(&s->mutex);
  GstElement *const gone[] = {s->packer, s->pictures, s->sounds};
  s->packer = s->pictures = s->sounds = NULL;
  (void)pthread_mutex_unlock(&s->mutex);
  (void)gst_element_set_state(gone[0], GST_STATE_NULL); /* its threads take fed_mutex */
  for (size_t k = 0; k < sizeof gone / sizeof *gone; k++) gst_object_unref(gone[k]);
}

bool webrtc_source_feed(struct ern_webrtc_source *s, struct ern_webrtc_viewer *v) {
  if (s->watched == 0 && !open_packer(s)) return false;
  s->watched++;
  (void)pthread_mutex_lock(&s->fed_mutex);
  v->following_fed = s->fed;
  s->fed = v;
  (void)pthread_mutex_unlock(&s->fed_mutex);
  return true;
}

void webrtc_source_starve(struct ern_webrtc_source *s, struct ern_webrtc_viewer *v) {
  bool found = false;
  (void)pthread_mutex_lock(&s->fed_mutex);
  for (struct ern_webrtc_viewer **at = &s->fed; *at != NULL && !found; at = found ? at : &(*at)->following_fed)
    if (*at == v) {
      *at = v->following_fed;
      found = true;
    }
  (void)pthread_mutex_unlock(&s->fed_mutex);
  if (found && --s->watched == 0) close_packer(s);
}

void webrtc_source_release(struct ern_webrtc_source *s) {
  if (atomic_fetch_sub(&s->users, 1) > 1) return;
  (void)pthread_mutex_destroy(&s->mutex);
  (void)pthread_mutex_destroy(&s->fed_mutex);
  free(s);
}
