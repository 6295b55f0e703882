/* SPDX-License-Identifier: MIT
 * FFmpeg's input and output over a descriptor of a pipe, whose waits a caller can end: FFmpeg's own cannot be. */
#ifndef ERN_MEDIA_DESCRIPTOR_IO_H
#define ERN_MEDIA_DESCRIPTOR_IO_H

#include <libavformat/avio.h>
#include <stdbool.h>

#include "core/status.h"

struct ern_descriptor_io {
  AVIOContext *io;
  int descriptor;
  bool owned; /* the descriptor is closed with it */
  int (*stop)(void *user);
  void *user;
};

/* path: "-", standard input or output; else opened, a FIFO once its other side is there. The struct must not move. */
ERN_NODISCARD ern_status ern_descriptor_io_open(ern_context *context, const char *path, bool writes,
                                                struct ern_descriptor_io *made);
void ern_descriptor_io_close(struct ern_descriptor_io *io); /* accepts a zeroed one */

/* Whether it is a FIFO, a socket or a device, and no file that could be put at a place. */
bool ern_is_pipe(const char *path);

#endif
