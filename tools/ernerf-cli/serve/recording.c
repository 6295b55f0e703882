/* SPDX-License-Identifier: MIT */
#include "serve/recording.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* Number of names that are tried: of several recordings that one second begins, or that a clock set back repeats. */
enum { NAMES = 100 };

static void name(struct recording *r, int k) {
  char number[16] = "";
  if (k > 1) snprintf(number, sizeof number, "-%d", k);
  snprintf(r->path, sizeof r->path, "%s%s.mp4", r->stem, number);
}

int recording_open(struct recording *r, struct session *session, const char *folder, const char *id) {
  char when[32];
  struct tm parts;
  struct stat there;
  const time_t now = time(NULL);
  r->file = -1;
  if (gmtime_r(&now, &parts) == NULL || strftime(when, sizeof when, "%Y%m%dT%H%M%SZ", &parts) == 0)
    return session_fail_with(session, "--record: the time is not known");
  const int bytes = snprintf(r->stem, sizeof r->stem, "%s/%s-%s", folder, id, when);
  if (bytes >= (int)sizeof r->stem) return session_fail_with(session, "--record %s: the name is too long", folder);
  errno = EEXIST;
  for (int k = 1; k <= NAMES && r->file < 0 && errno == EEXIST; k++) {
    name(r, k);
    snprintf(r->temporary, sizeof r->temporary, "%s.ernerf-tmp", r->path);
    errno = EEXIST;
    if (lstat(r->path, &there) != 0) r->file = open(r->temporary, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  }
  if (r->file >= 0) return 0;
  const int error = errno;
  r->path[0] = 0;
  return session_fail_with(session, "--record %s: cannot make a file: %s", folder, strerror(error));
}

/* Gives the file its name, or the next one that is free: link() never replaces a file. Where the file system has no
 * links, a check precedes the rename. */
static bool put_in_place(struct recording *r) {
  struct stat there;
  for (int k = 1; k <= NAMES; k++) {
    if (k > 1) name(r, k);
    if (link(r->temporary, r->path) == 0) return unlink(r->temporary) == 0;
    if (errno != EEXIST && lstat(r->path, &there) != 0) return rename(r->temporary, r->path) == 0;
  }
  return false;
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
  else if (!put_in_place(r))
    session_warn(session, "%s: is whole, and cannot get its name: %s", r->temporary, strerror(errno));
  if (r->failed[0] != 0)
    session_warn(session, "%s: cannot write: %s; the recording is kept up to there: it is cut", r->path, r->failed);
  r->path[0] = 0;
}
