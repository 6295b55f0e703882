/* SPDX-License-Identifier: MIT
 * The last seconds of a coded stream, which viewers read at their own pace. The caller holds a lock. */
#ifndef ERN_SERVE_BROADCAST_H
#define ERN_SERVE_BROADCAST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "serve/http_server.h"

/* BROADCAST_PARTS: some 4 s at 25 frames a second; BROADCAST_BYTES: most that are kept. */
enum { BROADCAST_PARTS = 128, BROADCAST_BYTES = 32 << 20 };

struct part {
  uint8_t *bytes;
  size_t count;
  bool key; /* it begins with a key frame */
};

struct broadcast {
  struct part head, coming;           /* coming: of which more follows */
  size_t room;                        /* bytes that `coming` has memory for */
  struct part parts[BROADCAST_PARTS]; /* part number k is at k % BROADCAST_PARTS */
  uint64_t first, next;               /* numbers of the oldest part, and of the next one */
  size_t bytes;
  bool ended;
};

/* As ern_stream_options.write. Returns 1 without memory. */
int broadcast_write(struct broadcast *broadcast, const void *bytes, size_t count, ern_stream_piece piece);
/* Copies up to `most` of the viewer's next bytes, the first ones being the head and the newest part with a key frame.
 * Returns their number; 0: none yet; -1: the stream has ended, or the viewer was so slow that its place is gone. */
ssize_t broadcast_read(const struct broadcast *broadcast, struct ern_http_place *viewer, void *to, size_t most);
void broadcast_free(struct broadcast *broadcast);

#endif
