/* SPDX-License-Identifier: MIT */
#include "media/live/descriptor_io.h"

#include <errno.h>
#include <fcntl.h>
#include <libavutil/error.h>
#include <libavutil/mem.h>
#include <limits.h>
#include <poll.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { BUFFER_BYTES = 4096, LOOK_MS = 100 };

static bool asks_to_stop(const struct ern_descriptor_io *io) { return io->stop != NULL && io->stop(io->user) != 0; }

/* Waits until the descriptor is ready. Returns 0, or an FFmpeg error. */
static int await(const struct ern_descriptor_io *io, short events) {
  for (int waited = 0;; waited += LOOK_MS) {
    struct pollfd look = {.fd = io->descriptor, .events = events};
    if (asks_to_stop(io)) return AVERROR_EXIT;
    if (io->patience_ms > 0 && waited >= io->patience_ms) return AVERROR(ETIMEDOUT);
    const int ready = poll(&look, 1, LOOK_MS);
    if (ready > 0) return 0; /* also where the other end has closed: the next read or write then reports it */
    if (ready < 0 && errno != EINTR) return AVERROR(errno);
  }
}

static void keep_head(struct ern_descriptor_io *io, const uint8_t *bytes, size_t count) {
  const size_t room = sizeof io->head - io->head_bytes, taken = count < room ? count : room;
  memcpy(io->head + io->head_bytes, bytes, taken);
  io->head_bytes += taken;
}

/* FFmpeg would wait for 64 KiB of a WAV's sound before the first sample, to see whether it is coded sound (S/PDIF). */
static bool has_enough(const struct ern_descriptor_io *io) {
  struct pollfd look = {.fd = io->descriptor, .events = POLLIN};
  bool open_ended;
  return io->opens && ern_truncation_is_wav(io->head, io->head_bytes, &open_ended) && poll(&look, 1, 0) == 0;
}

static int read_some(void *user, uint8_t *bytes, int count) {
  for (;;) {
    if (has_enough(user)) return AVERROR_EOF; /* of what opens it; then it is read on */
    const int error = await(user, POLLIN);
    if (error < 0) return error;
    const ssize_t got = read(((struct ern_descriptor_io *)user)->descriptor, bytes, (size_t)count);
    if (got > 0) keep_head(user, bytes, (size_t)got);
    if (got > 0) return (int)got;
    if (got == 0) return AVERROR_EOF;
    if (errno != EINTR && errno != EAGAIN) return AVERROR(errno);
  }
}

/* A pipe that is ready takes PIPE_BUF bytes without blocking. */
static int write_all(void *user, uint8_t *bytes, int count) {
  const struct ern_descriptor_io *io = user;
  if (io->take != NULL) return io->take(io->user, bytes, (size_t)count) == 0 ? count : AVERROR(EIO);
  for (int done = 0; done < count;) {
    const int error = await(io, POLLOUT);
    const size_t left = (size_t)(count - done), part = left < PIPE_BUF ? left : PIPE_BUF;
    if (error < 0) return error;
    const ssize_t put = write(io->descriptor, bytes + done, part);
    if (put < 0 && errno != EINTR && errno != EAGAIN) return AVERROR(errno);
    if (put > 0) done += (int)put;
  }
  return count;
}

bool ern_is_pipe(const char *path) {
  struct stat there;
  return strcmp(path, "-") == 0 || (stat(path, &there) == 0 && !S_ISREG(there.st_mode) && !S_ISDIR(there.st_mode));
}

static bool is_fifo(const char *path) {
  struct stat there;
  return stat(path, &there) == 0 && S_ISFIFO(there.st_mode);
}

/* A non-blocking open of a FIFO for writing fails until a reader has opened it, so this retries. A socket fails alike.
 */
static ern_status open_descriptor(ern_context *context, const char *path, bool writes, struct ern_descriptor_io *io) {
  while (!asks_to_stop(io)) {
    io->descriptor = open(path, (writes ? O_WRONLY : O_RDONLY) | O_NONBLOCK | O_CLOEXEC);
    if (io->descriptor >= 0) {
      io->owned = true;
      return ERN_OK;
    }
    const int reason = errno;
    if (reason != EINTR && (reason != ENXIO || !is_fifo(path)))
      return ern_fail(context, reason == ENOENT ? ERN_E_MISSING : ERN_E_IO, "%s: cannot open: %s", path,
                      reason == ENXIO ? "a socket or device that nothing can be written to" : strerror(reason));
    (void)nanosleep(&(struct timespec){.tv_nsec = LOOK_MS * 1000000}, NULL);
  }
  return ern_fail(context, ERN_E_CANCELLED, "%s: stopped before its other side was there", path);
}

static ern_status make_io(ern_context *context, const char *path, bool writes, struct ern_descriptor_io *made) {
  uint8_t *buffer = av_malloc(BUFFER_BYTES);
  if (buffer != NULL) made->io = avio_alloc_context(buffer, BUFFER_BYTES, writes, made, read_some, write_all, NULL);
  if (made->io != NULL) return ERN_OK;
  av_free(buffer);
  ern_descriptor_io_close(made);
  return ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for a pipe", path);
}

ern_status ern_descriptor_io_open(ern_context *context, const char *path, bool writes, struct ern_descriptor_io *made) {
  ern_status status = ERN_OK;
  made->descriptor = writes ? STDOUT_FILENO : STDIN_FILENO;
  if (strcmp(path, "-") != 0) ERN_TRY(open_descriptor(context, path, writes, made));
  ERN_TRY(make_io(context, path, writes, made));
fail:
  return status;
}

ern_status ern_descriptor_io_take(ern_context *context, const char *path, int descriptor,
                                  struct ern_descriptor_io *made) {
  made->descriptor = descriptor;
  made->owned = true;
  return make_io(context, path, true, made);
}

ern_status ern_descriptor_io_call(ern_context *context, const char *path, struct ern_descriptor_io *made) {
  return make_io(context, path, true, made);
}

void ern_descriptor_io_close(struct ern_descriptor_io *io) {
  if (io->io != NULL) av_freep(&io->io->buffer);
  avio_context_free(&io->io);
  if (io->owned) (void)close(io->descriptor);
  io->owned = false;
}
