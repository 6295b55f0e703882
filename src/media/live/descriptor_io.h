/* SPDX-License-Identifier: MIT
 * FFmpeg input and output (AVIOContext) over the file descriptor of a pipe or socket. A caller can interrupt its waits,
 * which FFmpeg's own pipe protocol does not allow. */
#ifndef ERN_MEDIA_DESCRIPTOR_IO_H
#define ERN_MEDIA_DESCRIPTOR_IO_H

#include <libavformat/avio.h>
#include <stdbool.h>

#include "core/status.h"
#include "media/truncation.h"

struct ern_descriptor_io {
  AVIOContext *io;
  int descriptor;
  bool owned;      /* ern_descriptor_io_close closes the descriptor */
  int patience_ms; /* a write that the other end does not take for so long fails with ETIMEDOUT; 0: none does */
  int (*stop)(void *user);
  int (*take)(void *user, const uint8_t *bytes, size_t count); /* takes what is written, in place of the descriptor */
  void *user;
  bool opens;                        /* a container is being opened: a WAV whose header has come is not waited for */
  uint8_t head[ERN_TRUNCATION_HEAD]; /* the first bytes that were read */
  size_t head_bytes;
};

/* path: "-" is standard input or output; any other path is opened, a FIFO once its other end is open. The struct must
 * not move. */
ERN_NODISCARD ern_status ern_descriptor_io_open(ern_context *context, const char *path, bool writes,
                                                struct ern_descriptor_io *made);
/* The same for a descriptor that is open for writing, and is owned from now on, also on failure. */
ERN_NODISCARD ern_status ern_descriptor_io_take(ern_context *context, const char *path, int descriptor,
                                                struct ern_descriptor_io *made);
/* The same for io->take, which the caller has set, and which returns 0 where it has taken all. */
ERN_NODISCARD ern_status ern_descriptor_io_call(ern_context *context, const char *path, struct ern_descriptor_io *made);
void ern_descriptor_io_close(struct ern_descriptor_io *io); /* accepts a zeroed one */

/* Whether the path is a FIFO, a socket or a device, so that no file can be renamed to it. */
bool ern_is_pipe(const char *path);

#endif
