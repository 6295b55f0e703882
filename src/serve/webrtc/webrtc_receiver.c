/* SPDX-License-Identifier: MIT
 * What comes from a viewer, and whether it is the one that offered. */
#include <string.h>

#include "serve/webrtc/webrtc_shared.h"

/* Calls `with` for each of the peer's elements of that kind, until one returns false; again where elements come or go
 * meanwhile. */
static bool for_each(struct ern_webrtc_viewer *v, const char *kind,
                     bool (*with)(GstElement *, struct ern_webrtc_viewer *)) {
  GstIterator *all = gst_bin_iterate_all_by_element_factory_name(GST_BIN(v->peer), kind);
  GValue item = G_VALUE_INIT;
  GstIteratorResult next;
  bool done = true;
  while (done && (next = gst_iterator_next(all, &item)) != GST_ITERATOR_DONE) {
    done = next == GST_ITERATOR_RESYNC || (next == GST_ITERATOR_OK && with(g_value_get_object(&item), v));
    if (next == GST_ITERATOR_RESYNC) gst_iterator_resync(all);
    if (next == GST_ITERATOR_OK) g_value_unset(&item);
  }
  gst_iterator_free(all);
  return done;
}

/* All that a viewer sends are reports (RTCP), for both tracks at least every 7.5 s. One that has gone without a word is
 * known by their absence: ICE itself would keep it. */
static GstPadProbeReturn take_report(GstPad *pad, GstPadProbeInfo *info, gpointer user) {
  struct ern_webrtc_viewer *v = user;
  const guint32 own[2] = {v->picture.ssrc, v->sound.ssrc};
  const gint64 now = g_get_monotonic_time();
  GstMapInfo map;
  (void)pad;
  if (!(info->type & GST_PAD_PROBE_TYPE_BUFFER)) return GST_PAD_PROBE_DROP;
  info->data = gst_buffer_make_writable(GST_PAD_PROBE_INFO_BUFFER(info));
  if (!gst_buffer_map(info->data, &map, GST_MAP_READWRITE)) return GST_PAD_PROBE_DROP;
  const ptrdiff_t kept = webrtc_reports_filter(&v->reports, map.data, map.size, own, now);
  gst_buffer_unmap(info->data, &map);
  if (kept >= 0) atomic_store(&v->reported, now);
  if (v->reports.excess) atomic_store(&v->ends, true);
  if (kept <= 0) return GST_PAD_PROBE_DROP;
  gst_buffer_set_size(info->data, kept);
  return GST_PAD_PROBE_OK;
}

/* Packets of RTP (RFC 5761, 4), which no viewer sends: libsrtp keeps memory for each SSRC, and GStreamer is
 * deadlocked, with all viewers, by one with the SSRC of what it sends itself. */
static GstPadProbeReturn drop_media(GstPad *pad, GstPadProbeInfo *info, gpointer user) {
  guint8 head[2];
  (void)pad;
  (void)user;
  if (!(info->type & GST_PAD_PROBE_TYPE_BUFFER) || gst_buffer_extract(info->data, 0, head, 2) < 2)
    return GST_PAD_PROBE_DROP;
  return head[0] >> 6 != 2 || (head[1] & 0x60) == 0x40 ? GST_PAD_PROBE_OK : GST_PAD_PROBE_DROP;
}

static bool probe(GstElement *element, const char *name, GstPadProbeCallback call, struct ern_webrtc_viewer *v) {
  GstPad *pad = gst_element_get_static_pad(element, name);
  if (pad == NULL) return false;
  (void)gst_pad_add_probe(pad, GST_PAD_PROBE_TYPE_BUFFER | GST_PAD_PROBE_TYPE_BUFFER_LIST, call, v, NULL);
  gst_object_unref(pad);
  return true;
}

static bool probe_line(GstElement *line, struct ern_webrtc_viewer *v) { return probe(line, "src", drop_media, v); }

static bool probe_receiver(GstElement *receiver, struct ern_webrtc_viewer *v) {
  return probe(receiver, "rtcp_src", take_report, v);
}

bool webrtc_receiver_open(struct ern_webrtc_viewer *v) {
  return for_each(v, "nicesrc", probe_line) && for_each(v, "dtlssrtpdec", probe_receiver);
}

/* The fingerprint of a certificate, as an offer has it, in capitals; NULL: there is none. */
static char *fingerprint_of(const char *pem) {
  static const char first[] = "-----BEGIN CERTIFICATE-----", last[] = "-----END CERTIFICATE-----";
  const char *from = pem != NULL ? strstr(pem, first) : NULL, *to = from != NULL ? strstr(from, last) : NULL;
  gsize bytes = 0;
  if (to == NULL) return NULL;
  char *base64 = g_strndup(from + sizeof first - 1, (gsize)(to - from) - sizeof first + 1);
  guchar *der = g_base64_decode(base64, &bytes);
  GChecksum *sum = g_checksum_new(G_CHECKSUM_SHA256);
  guint8 digest[32];
  gsize size = sizeof digest;
  g_checksum_update(sum, der, (gssize)bytes);
  g_checksum_get_digest(sum, digest, &size);
  GString *made = g_string_new(NULL);
  for (size_t k = 0; k < sizeof digest; k++) g_string_append_printf(made, k > 0 ? ":%02X" : "%02X", digest[k]);
  g_checksum_free(sum);
  g_free(der);
  g_free(base64);
  return g_string_free(made, FALSE);
}

/* GStreamer does not compare the certificate that came with the offer (RFC 8827, 6.5). A transport that is not used has
 * none. */
static bool is_offered(GstElement *receiver, struct ern_webrtc_viewer *v) {
  char *pem = NULL, *offer = g_ascii_strup(v->offer, -1);
  g_object_get(receiver, "peer-pem", &pem, NULL);
  char *found = fingerprint_of(pem);
  const bool same = found == NULL || strstr(offer, found) != NULL;
  g_free(found);
  g_free(pem);
  g_free(offer);
  return same;
}

bool webrtc_receiver_is_offered(struct ern_webrtc_viewer *v) { return for_each(v, "dtlssrtpdec", is_offered); }
