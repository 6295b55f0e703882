/* SPDX-License-Identifier: MIT
 * --record: the parts of a session's stream, in a file too. What becomes of the file does not touch the viewers. */
#ifndef ERN_CLI_SERVE_RECORDING_H
#define ERN_CLI_SERVE_RECORDING_H

#include "ernerf/stream.h"
#include "session/session.h"

struct recording {
  char stem[4096];                            /* FOLDER/ID-TIME */
  char path[4096 + 32], temporary[4096 + 48]; /* of the file, and its name until it is whole; "": none is made */
  int file;                                   /* -1: none, or no longer */
  size_t bytes, whole;                        /* written; up to the end of the last part */
  char failed[512];                           /* why it ended; "": it did not */
};

/* Makes FOLDER/ID-TIME.mp4, with the time in UTC, or ID-TIME-2.mp4 and so on where that is there. Returns 0, or
 * EXIT_FAILURE after a message. */
int recording_open(struct recording *recording, struct session *session, const char *folder, const char *id);
/* Takes the bytes as ern_stream_options.write does. After a failure, such as a full disk, it does nothing. */
void recording_write(struct recording *recording, const void *bytes, size_t count, ern_stream_piece piece);
/* Gives the file its name, or removes it where it has no part, and warns where it is cut. In any state. */
void recording_close(struct recording *recording, struct session *session);

#endif
