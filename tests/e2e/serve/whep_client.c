/* SPDX-License-Identifier: MIT
 * A viewer by WebRTC, for tests: writes its offer to standard output, behind a line with its length, reads the answer
 * in the same form, and then writes a line for each picture and piece of sound that it has decoded, "picture SECONDS
 * NOW WIDTH HEIGHT" and "sound SECONDS NOW SAMPLES"; NOW is of the machine's monotonic clock. With FOLDER, luma and
 * samples (float) are appended to FOLDER/pictures and FOLDER/sound. It goes on until standard input ends. "--elements":
 * whether GStreamer has what it needs, by the exit status. Usage: whep_client [--elements | FOLDER] */
#define GST_USE_UNSTABLE_API
#include <gst/app/gstappsink.h>
#include <gst/gst.h>
#include <gst/webrtc/webrtc.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define H264                                                                                                          \
  "application/"                                                                                                      \
  "x-rtp,media=video,encoding-name=H264,payload=102,clock-rate=90000,packetization-mode=(string)1,profile-level-id=(" \
  "string)42e01f"
#define OPUS "application/x-rtp,media=audio,encoding-name=OPUS,payload=111,clock-rate=48000,encoding-params=(string)2"

static FILE *pictures, *sounds; /* NULL: not kept */

static double seconds(void) {
  struct timespec now;
  (void)clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int fail(const char *what) {
  fprintf(stderr, "whep_client: %s\n", what);
  return EXIT_FAILURE;
}

static void keep_luma(const GstMapInfo *map, int width, int height) {
  const size_t stride = (size_t)(width + 3) / 4 * 4; /* of I420 */
  for (int y = 0; pictures != NULL && y < height; y++)
    (void)fwrite(map->data + (size_t)y * stride, 1, (size_t)width, pictures);
}

static GstFlowReturn take(GstAppSink *sink, gpointer user) {
  GstSample *sample = gst_app_sink_pull_sample(sink);
  GstBuffer *buffer = sample != NULL ? gst_sample_get_buffer(sample) : NULL;
  const GstStructure *about = sample != NULL ? gst_caps_get_structure(gst_sample_get_caps(sample), 0) : NULL;
  GstMapInfo map;
  int width = 0, height = 0;
  if (buffer != NULL && gst_buffer_map(buffer, &map, GST_MAP_READ)) {
    const double at = 1e-9 * (double)GST_BUFFER_PTS(buffer);
    if (user != NULL && gst_structure_get_int(about, "width", &width) &&
        gst_structure_get_int(about, "height", &height)) {
      printf("picture %.6f %.6f %d %d\n", at, seconds(), width, height);
      keep_luma(&map, width, height);
    } else {
      printf("sound %.6f %.6f %zu\n", at, seconds(), map.size / sizeof(float));
      if (sounds != NULL) (void)fwrite(map.data, 1, map.size, sounds);
    }
    gst_buffer_unmap(buffer, &map);
  }
  if (sample != NULL) gst_sample_unref(sample);
  return GST_FLOW_OK;
}

static void add_track(GstElement *peer, GstPad *pad, gpointer pipeline) {
  static const char picture[] =
      "rtph264depay ! h264parse ! openh264dec ! videoconvert ! video/x-raw,format=I420 ! appsink name=out sync=false";
  static const char sound[] =
      "rtpopusdepay ! opusdec ! audioconvert ! audioresample ! audio/x-raw,format=F32LE,rate=48000,channels=1 ! "
      "appsink name=out sync=false";
  if (GST_PAD_DIRECTION(pad) != GST_PAD_SRC) return;
  GstCaps *caps = gst_pad_get_current_caps(pad);
  const char *media = gst_structure_get_string(gst_caps_get_structure(caps, 0), "media");
  const bool sees = strcmp(media, "video") == 0;
  GstElement *made = gst_parse_bin_from_description(sees ? picture : sound, TRUE, NULL);
  GstElement *out = gst_bin_get_by_name(GST_BIN(made), "out");
  GstAppSinkCallbacks calls = {.new_sample = take};
  (void)peer;
  gst_app_sink_set_callbacks(GST_APP_SINK(out), &calls, sees ? made : NULL, NULL);
  gst_object_unref(out);
  (void)gst_bin_add(GST_BIN(pipeline), made);
  (void)gst_element_sync_state_with_parent(made);
  GstPad *in = gst_element_get_static_pad(made, "sink");
  if (gst_pad_link(pad, in) != GST_PAD_LINK_OK) (void)fail("a track cannot be linked");
  gst_object_unref(in);
  gst_caps_unref(caps);
}

static GstPromise *ask(GstElement *peer, const char *action, void *argument) {
  GstPromise *promise = gst_promise_new();
  g_signal_emit_by_name(peer, action, argument, promise);
  (void)gst_promise_wait(promise);
  return promise;
}

static char *offer(GstElement *peer) {
  GstWebRTCSessionDescription *made = NULL;
  GstWebRTCICEGatheringState state = GST_WEBRTC_ICE_GATHERING_STATE_NEW;
  GstWebRTCRTPTransceiver *transceiver = NULL;
  const char *const forms[] = {H264, OPUS};
  for (int i = 0; i < 2; i++) {
    GstCaps *caps = gst_caps_from_string(forms[i]);
    g_signal_emit_by_name(peer, "add-transceiver", GST_WEBRTC_RTP_TRANSCEIVER_DIRECTION_RECVONLY, caps, &transceiver);
    g_object_set(transceiver, "do-nack", TRUE, NULL);
    gst_object_unref(transceiver);
    gst_caps_unref(caps);
  }
  GstPromise *promise = ask(peer, "create-offer", NULL);
  (void)gst_structure_get(gst_promise_get_reply(promise), "offer", GST_TYPE_WEBRTC_SESSION_DESCRIPTION, &made, NULL);
  gst_promise_unref(promise);
  if (made == NULL) return NULL;
  gst_promise_unref(ask(peer, "set-local-description", made));
  gst_webrtc_session_description_free(made);
  for (int k = 0; k < 500 && state != GST_WEBRTC_ICE_GATHERING_STATE_COMPLETE; k++) {
    g_usleep(10000);
    g_object_get(peer, "ice-gathering-state", &state, NULL);
  }
  g_object_get(peer, "local-description", &made, NULL);
  char *text = gst_sdp_message_as_text(made->sdp);
  gst_webrtc_session_description_free(made);
  return text;
}

/* Reads the answer and takes it. */
static bool connect(GstElement *peer) {
  static char text[1 << 17];
  size_t bytes = 0;
  GstSDPMessage *message = NULL;
  if (scanf("%zu", &bytes) != 1 || getchar() != '\n' || bytes >= sizeof text || fread(text, 1, bytes, stdin) != bytes)
    return false;
  if (gst_sdp_message_new_from_text(text, &message) != GST_SDP_OK) return false;
  GstWebRTCSessionDescription *remote = gst_webrtc_session_description_new(GST_WEBRTC_SDP_TYPE_ANSWER, message);
  gst_promise_unref(ask(peer, "set-remote-description", remote));
  gst_webrtc_session_description_free(remote);
  return true;
}

static int check_elements(void) {
  static const char *const needed[] = {"webrtcbin",    "nicesrc",       "dtlssrtpdec", "srtpdec",
                                       "rtpbin",       "rtph264depay",  "h264parse",   "openh264dec",
                                       "videoconvert", "rtpopusdepay",  "opusenc",     "opusdec",
                                       "audioconvert", "audioresample", "rtph264pay",  "rtpopuspay"};
  for (size_t i = 0; i < sizeof needed / sizeof *needed; i++) {
    GstElementFactory *found = gst_element_factory_find(needed[i]);
    if (found == NULL) {
      printf("GStreamer's %s is not installed\n", needed[i]);
      return EXIT_FAILURE;
    }
    gst_object_unref(found);
  }
  return EXIT_SUCCESS;
}

static FILE *open_in(const char *folder, const char *name) {
  char path[4096];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  return fopen(path, "wb");
}

int main(int argc, char **argv) {
  gst_init(NULL, NULL);
  if (argc > 1 && strcmp(argv[1], "--elements") == 0) return check_elements();
  if (argc > 1) pictures = open_in(argv[1], "pictures");
  if (argc > 1) sounds = open_in(argv[1], "sound");
  setvbuf(stdout, NULL, _IOLBF, 0);
  GstElement *pipeline = gst_pipeline_new(NULL), *peer = gst_element_factory_make("webrtcbin", NULL);
  if (peer == NULL) return fail("no webrtcbin");
  gst_util_set_object_arg(G_OBJECT(peer), "bundle-policy", "max-bundle");
  g_object_set(peer, "latency", 200, NULL); /* with less GStreamer drops pictures where it may ask for lost packets */
  (void)gst_bin_add(GST_BIN(pipeline), peer);
  g_signal_connect(peer, "pad-added", G_CALLBACK(add_track), pipeline);
  (void)gst_element_set_state(pipeline, GST_STATE_PLAYING);
  char *text = offer(peer);
  if (text == NULL) return fail("no offer");
  printf("%zu\n%s", strlen(text), text);
  (void)fflush(stdout);
  if (!connect(peer)) return fail("no answer");
  while (getchar() != EOF) continue;
  (void)gst_element_set_state(pipeline, GST_STATE_NULL);
  gst_object_unref(pipeline);
  g_free(text);
  if (pictures != NULL) (void)fclose(pictures);
  if (sounds != NULL) (void)fclose(sounds);
  return EXIT_SUCCESS;
}
