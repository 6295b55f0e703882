/* SPDX-License-Identifier: MIT */
#include "serve/broadcast.h"

#include <stdlib.h>
#include <string.h>

enum { LEAST_ROOM = 4096 };

static int append(struct broadcast *b, const void *bytes, size_t count) {
  struct part *part = &b->coming;
  if (count > BROADCAST_BYTES - part->count) return 1;
  if (part->count + count > b->room) {
    const size_t room = 2 * (part->count + count) + LEAST_ROOM;
    uint8_t *more = realloc(part->bytes, room);
    if (more == NULL) return 1;
    part->bytes = more;
    b->room = room;
  }
  memcpy(part->bytes + part->count, bytes, count);
  part->count += count;
  return 0;
}

static void drop_oldest(struct broadcast *b) {
  struct part *part = &b->parts[b->first++ % BROADCAST_PARTS];
  b->bytes -= part->count;
  free(part->bytes);
  *part = (struct part){0};
}

int broadcast_write(struct broadcast *b, const void *bytes, size_t count, ern_stream_piece piece) {
  if (count > 0 && append(b, bytes, count) != 0) return 1;
  if (piece == ERN_STREAM_MORE) return 0;
  struct part whole = b->coming;
  uint8_t *fits = realloc(whole.bytes, whole.count > 0 ? whole.count : 1);
  if (fits != NULL) whole.bytes = fits;
  b->coming = (struct part){0};
  b->room = 0;
  if (piece == ERN_STREAM_HEAD) {
    free(b->head.bytes);
    b->head = whole;
    return 0;
  }
  whole.key = piece == ERN_STREAM_KEY;
  while (b->next - b->first == BROADCAST_PARTS || (b->next > b->first && b->bytes + whole.count > BROADCAST_BYTES))
    drop_oldest(b);
  b->parts[b->next++ % BROADCAST_PARTS] = whole;
  b->bytes += whole.count;
  return 0;
}

static bool find_key(const struct broadcast *b, uint64_t *part) {
  for (uint64_t k = b->next; k > b->first; k--) {
    *part = k - 1;
    if (b->parts[*part % BROADCAST_PARTS].key) return b->head.bytes != NULL;
  }
  return false;
}

ssize_t broadcast_read(const struct broadcast *b, struct ern_http_place *viewer, void *to, size_t most) {
  size_t done = 0;
  if (!viewer->begun && !find_key(b, &viewer->part)) return b->ended ? -1 : 0;
  viewer->begun = true;
  while (done < most) {
    if (viewer->has_head && viewer->part < b->first) return -1;
    if (viewer->has_head && viewer->part == b->next) break;
    const struct part *part = viewer->has_head ? &b->parts[viewer->part % BROADCAST_PARTS] : &b->head;
    const size_t left = part->count - viewer->at, count = left < most - done ? left : most - done;
    memcpy((uint8_t *)to + done, part->bytes + viewer->at, count);
    done += count;
    viewer->at += count;
    if (viewer->at < part->count) break;
    viewer->at = 0;
    if (viewer->has_head) viewer->part++;
    viewer->has_head = true;
  }
  return done > 0 ? (ssize_t)done : b->ended ? -1 : 0;
}

void broadcast_free(struct broadcast *b) {
  while (b->next > b->first) drop_oldest(b);
  free(b->head.bytes);
  free(b->coming.bytes);
  *b = (struct broadcast){0};
}
