/* SPDX-License-Identifier: MIT
 * An offer (SDP) of a viewer: what it can receive of H.264 and Opus. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "serve/webrtc/webrtc_shared.h"

enum { LINES = 8 /* most media of an offer */, CANDIDATES = 128, TYPES = 128 /* that RTP has */, ATTRIBUTES = 1024 };

static bool is_there(const GstSDPMessage *message, const GstSDPMedia *media, const char *name) {
  return gst_sdp_media_get_attribute_val(media, name) != NULL ||
         gst_sdp_message_get_attribute_val(message, name) != NULL;
}

/* The fmtp of a payload type, NULL: it has none. */
static char *format_of(const GstSDPMedia *media, int type) {
  for (guint k = 0; k < media->attributes->len; k++) {
    const GstSDPAttribute *a = &g_array_index(media->attributes, GstSDPAttribute, k);
    if (strcmp(a->key, "fmtp") == 0 && a->value != NULL && atoi(a->value) == type) return a->value;
  }
  return NULL;
}

/* Where "NAME=" ends in the format, with `bytes` or more behind it; NULL: it is not there. */
static char *parameter(char *format, const char *name, size_t bytes) {
  char *place = format != NULL ? strstr(format, name) : NULL;
  if (place == NULL || place[strlen(name)] != '=') return NULL;
  place += strlen(name) + 1;
  return strlen(place) >= bytes ? place : NULL;
}

/* H.264 of the constrained baseline profile, which all receivers have (RFC 7742), in packets of any size. The format
 * then asks for the stream's own level, so that the answer names that: the payloader of GStreamer takes nothing else.
 */
static bool fits_picture(const GstStructure *s, char *format, const unsigned char avcc[4]) {
  const char *name = gst_structure_get_string(s, "encoding-name"), *mode = parameter(format, "packetization-mode", 1);
  char *profile = parameter(format, "profile-level-id", 6),
       *asymmetry = parameter(format, "level-asymmetry-allowed", 1);
  char own[7];
  if (name == NULL || g_ascii_strcasecmp(name, "H264") != 0 || mode == NULL || mode[0] != '1' || profile == NULL)
    return false;
  const unsigned long bits = strtoul(profile, NULL, 16);
  if (bits >> 16 != 0x42 || !(bits & 0x4000)) return false;
  snprintf(own, sizeof own, "%02x%02x%02x", avcc[1], avcc[2], avcc[3]);
  memcpy(profile, own, 6);
  if (asymmetry != NULL) *asymmetry = '0';
  return true;
}

static bool fits_sound(const GstStructure *s, char *format, const unsigned char avcc[4]) {
  const char *name = gst_structure_get_string(s, "encoding-name");
  (void)format;
  (void)avcc;
  return name != NULL && g_ascii_strcasecmp(name, "OPUS") == 0;
}

/* The first payload type of the media that fits, with what the answer repeats of it; NULL: none. */
static GstCaps *choose(const GstSDPMedia *media, const unsigned char avcc[4],
                       bool (*fits)(const GstStructure *, char *, const unsigned char *)) {
  static const char *const kept[] = {"media",           "payload", "clock-rate", "encoding-name", "packetization-mode",
                                     "profile-level-id"};
  for (guint k = 0; k < gst_sdp_media_formats_len(media); k++) {
    const int type = atoi(gst_sdp_media_get_format(media, k));
    GstCaps *all = type >= 0 && type < 128 ? gst_sdp_media_get_caps_from_media(media, type) : NULL;
    const bool found = all != NULL && fits(gst_caps_get_structure(all, 0), format_of(media, type), avcc);
    if (all != NULL) gst_caps_unref(all);
    all = found ? gst_sdp_media_get_caps_from_media(media, type) : NULL; /* of the format as it is now */
    if (all == NULL) continue;
    GstStructure *some = gst_structure_new_empty("application/x-rtp");
    const GstStructure *s = gst_caps_get_structure(all, 0);
    for (size_t i = 0; i < sizeof kept / sizeof *kept; i++)
      if (gst_structure_has_field(s, kept[i]))
        gst_structure_set_value(some, kept[i], gst_structure_get_value(s, kept[i]));
    gst_caps_unref(all);
    return gst_caps_new_full(some, NULL);
  }
  return NULL;
}

static bool receives(const GstSDPMedia *media) {
  return gst_sdp_media_get_attribute_val(media, "sendonly") == NULL &&
         gst_sdp_media_get_attribute_val(media, "inactive") == NULL &&
         (gst_sdp_media_get_port(media) != 0 || gst_sdp_media_get_attribute_val(media, "bundle-only") != NULL);
}

/* Nothing is received: an offer to send as well is one to receive. Without the attribute it is both. */
static void receive_alone(GstSDPMedia *media) {
  for (guint k = media->attributes->len; k > 0; k--)
    if (strcmp(g_array_index(media->attributes, GstSDPAttribute, k - 1).key, "sendrecv") == 0)
      (void)gst_sdp_media_remove_attribute(media, k - 1);
  if (gst_sdp_media_get_attribute_val(media, "recvonly") == NULL)
    (void)gst_sdp_media_add_attribute(media, "recvonly", "");
}

static const char *check_media(const GstSDPMessage *message, const GstSDPMedia *media) {
  static const char *const needed[] = {"ice-ufrag", "ice-pwd", "fingerprint", "setup"};
  const char *fingerprint = gst_sdp_media_get_attribute_val(media, "fingerprint");
  if (gst_sdp_media_get_attribute_val(media, "mid") == NULL) return "a media without mid";
  for (size_t i = 0; i < sizeof needed / sizeof *needed; i++)
    if (!is_there(message, media, needed[i])) return "a media without ice-ufrag, ice-pwd, fingerprint or setup";
  if (fingerprint == NULL) fingerprint = gst_sdp_message_get_attribute_val(message, "fingerprint");
  if (g_ascii_strncasecmp(fingerprint, "sha-256 ", 8) != 0) return "a fingerprint that is not of sha-256";
  if (gst_sdp_media_formats_len(media) > TYPES) return "more than 128 payload types of a media";
  if (gst_sdp_media_attributes_len(media) > ATTRIBUTES) return "more than 1024 attributes of a media";
  guint candidates = 0;
  for (guint k = 0; k < gst_sdp_media_attributes_len(media); k++)
    candidates += strcmp(gst_sdp_media_get_attribute(media, k)->key, "candidate") == 0;
  return candidates > CANDIDATES ? "more than 128 candidates" : NULL;
}

static const char *check(struct webrtc_offer *offer, const char *text, const unsigned char avcc[4]) {
  if (!g_str_has_prefix(text, "v=0") || gst_sdp_message_new_from_text(text, &offer->message) != GST_SDP_OK)
    return "no session description";
  const guint lines = gst_sdp_message_medias_len(offer->message);
  if (lines == 0 || lines > LINES) return "no media, or more than 8";
  for (guint k = 0; k < lines; k++) {
    const GstSDPMedia *media = gst_sdp_message_get_media(offer->message, k);
    const char *kind = gst_sdp_media_get_media(media), *why = check_media(offer->message, media);
    if (why != NULL) return why;
    if (!receives(media)) continue;
    receive_alone(&g_array_index(offer->message->medias, GstSDPMedia, k));
    if (offer->picture == NULL && strcmp(kind, "video") == 0) {
      offer->picture = choose(media, avcc, fits_picture);
      offer->picture_line = (int)k;
    }
    if (offer->sound == NULL && strcmp(kind, "audio") == 0) {
      offer->sound = choose(media, avcc, fits_sound);
      offer->sound_line = (int)k;
    }
  }
  return offer->picture == NULL ? "no video that is received as H.264, constrained baseline, packetization-mode 1"
                                : NULL;
}

bool webrtc_offer_read(struct webrtc_offer *offer, const char *text, const unsigned char avcc[4],
                       char reason[WEBRTC_REASON]) {
  *offer = (struct webrtc_offer){.picture_line = -1, .sound_line = -1};
  const char *why = check(offer, text, avcc);
  if (why != NULL)
    snprintf(reason, WEBRTC_REASON, "the offer: found %s, expected the SDP of a receiver of H.264 and Opus by WebRTC",
             why);
  return why == NULL;
}

void webrtc_offer_free(struct webrtc_offer *offer) {
  if (offer->message != NULL) gst_sdp_message_free(offer->message);
  if (offer->picture != NULL) gst_caps_unref(offer->picture);
  if (offer->sound != NULL) gst_caps_unref(offer->sound);
  *offer = (struct webrtc_offer){0};
}
