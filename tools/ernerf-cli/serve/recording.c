/* SPDX-License-Identifier: MIT */
#include "serve/recording.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

int recording_open(struct recording *r, struct session *session, const char *folder, const char *id) {
  char when[32];
  struct tm parts;
  const time_t now = time(NULL);
  r->file = -1;
  if (gmtime_r(&now, &parts) == NULL || strftime(when, sizeof when, "%Y%m%dT%H%M%SZ", &parts) == 0)
    return session_fail_with(session, "--record: the time is not known");
  const int bytes = snprintf(r->path, sizeof r->path, "%s/%s-%s.mp4", folder, id, when);
  if (bytes >= (int)sizeof r->path) return session_fail_with(session, "--record %s: the name is too long", folder);
  snprintf(r->temporary, sizeof r->temporary, "%s.ernerf-tmp", r->path);
  r->file = open(r->temporary, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (r->file >= 0) return 0;
  const int error = errno;
  r->path[0] = 0;
  return session_fail_with(session, "--record %s: cannot make a file: %s", folder, strerror(error));
}

static void end(struct recording *r, const char *why) {
  snprintf(r->failed, sizeof r->failed, "%s", why);
  if (ftruncate(r->file, (off_t)r->whole) != 0 && r->failed[0] == 0)
    snprintf(r->failed, sizeof r->failed, "%s", strerror(errno));
  (void)close(r->file);
  r->file = -1;
}

void recording_write(struct recording *r, const void *bytes, size_t count, ern_stream_piece piece) {
  for (size_t done = 0; r->file >= 0 && done < count;) {
    const ssize_t put = write(r->file, (const char *)bytes + done, count - done);
    if (put < 0 && errno == EINTR) continue;
    if (put < 0) end(r, strerror(errno));
    done += put > 0 ? (size_t)put : 0;
  }
  if (r->file < 0) return;
  r->bytes += count;
  if (piece == ERN_STREAM_KEY || piece == ERN_STREAM_FRAME) r->whole = r->bytes;
}

void recording_close(struct recording *r, struct session *session) {
  if (r->path[0] == 0) return;
  if (r->file >= 0) end(r, "");
  if (r->whole == 0)
    (void)unlink(r->temporary);
  else if (rename(r->temporary, r->path) != 0)
    session_warn(session, "%s: is whole, and cannot get its name: %s", r->temporary, strerror(errno));
  if (r->failed[0] != 0)
    session_warn(session, "%s: cannot write: %s; the recording is kept up to there: it is cut", r->path, r->failed);
  r->path[0] = 0;
}
