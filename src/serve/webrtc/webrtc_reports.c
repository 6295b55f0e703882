/* SPDX-License-Identifier: MIT
 * Which reports (RTCP, RFC 3550 and 4585) of a viewer GStreamer may have. libsrtp and GStreamer keep memory for every
 * SSRC of a sender, and GStreamer sends a packet again as often as NACKs ask for it. */
#include <string.h>

#include "serve/webrtc/webrtc_shared.h"

enum {
  HEAD = 8 /* bytes: version and count, type, length in words less one, SSRC of the sender */,
  FIRST_LOST = 12,
  BLOCK = 24 /* bytes of a receiver report for each SSRC that it has received */,
  PADDED = 32,
  RECEIVER = 201,
  NACK = 205,
  GENERIC = 1,
  SHARE = 1000 /* reports and packets to send again, in a second on average */
};

static guint32 word(const guint8 *at) { return GST_READ_UINT32_BE(at); }

static bool is_known(struct webrtc_reports *r, guint32 sender) {
  for (unsigned k = 0; k < r->count; k++)
    if (r->senders[k] == sender) return true;
  r->excess = r->count == sizeof r->senders / sizeof *r->senders;
  if (r->excess) return false;
  r->senders[r->count++] = sender;
  return true;
}

/* Packets that a NACK asks for: a sequence number, and a mask of those behind it. */
static gint64 asked_again(const guint8 *report, size_t bytes) {
  gint64 asked = 0;
  if (report[1] != NACK) return 0;
  for (size_t at = FIRST_LOST; at + 4 <= bytes; at += 4) {
    asked++;
    for (guint32 mask = word(report + at) & 0xffff; mask != 0; mask &= mask - 1) asked++;
  }
  return asked;
}

/* Receiver reports and NACKs: some of the others, such as BYE, deadlock GStreamer. */
static bool is_passed_on(const guint8 *report, size_t bytes) {
  if (report[1] == RECEIVER) return bytes >= HEAD + BLOCK * (size_t)(report[0] & 31);
  return report[1] == NACK && (report[0] & 31) == GENERIC && bytes > FIRST_LOST;
}

ptrdiff_t webrtc_reports_filter(struct webrtc_reports *r, guint8 *bytes, size_t count, const guint32 own[2],
                                gint64 now) {
  gint64 cost = 1;
  size_t at = 0, length = 0, kept = 0;
  for (; at + 4 <= count; at += length) {
    length = 4 * ((size_t)bytes[at + 2] << 8 | bytes[at + 3]) + 4;
    if (bytes[at] >> 6 != 2 || length > count - at) return -1;
    if (length < HEAD) continue; /* of no SSRC */
    const guint32 sender = word(bytes + at + 4);
    if (sender == own[0] || sender == own[1] || !is_known(r, sender)) return -1;
    if ((bytes[at] & PADDED) != 0 || !is_passed_on(bytes + at, length)) continue;
    cost += asked_again(bytes + at, length);
    memmove(bytes + kept, bytes + at, length);
    kept += length;
  }
  const gint64 due = MAX(r->due, now);
  if (at != count || due > now + G_USEC_PER_SEC) return -1;
  r->due = due + cost * G_USEC_PER_SEC / SHARE;
  return (ptrdiff_t)kept;
}
