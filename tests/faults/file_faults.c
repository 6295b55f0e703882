/* SPDX-License-Identifier: MIT
 * The C library's calls on files, with a look at whether this one is to fail. Flushes to the disk are left out where
 * they are not: a test has no power cut, and many files. */
#undef _FORTIFY_SOURCE
#define _GNU_SOURCE /* RTLD_NEXT, open64 */
#include "file_faults.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { DESCRIPTORS = 1024 };

static struct fault fault;
static struct fault_seen *seen;      /* NULL: nothing is watched */
static bool full;                    /* since FAULT_FULL struck */
static char names[DESCRIPTORS][256]; /* of watched files that are open, "" elsewhere */

void faults_set(const struct fault *next, struct fault_seen *where) {
  memset(names, 0, sizeof names);
  full = false;
  seen = NULL;
  if (next == NULL) return;
  fault = *next;
  memset(where, 0, sizeof *where);
  seen = where;
}

/* The C library's own function. */
#define REAL(name, result, arguments)     \
  static result(*real) arguments;         \
  if (real == NULL) {                     \
    void *found = dlsym(RTLD_NEXT, name); \
    memcpy(&real, &found, sizeof real);   \
  }

static const char *watched(int descriptor) {
  if (seen == NULL || descriptor < 0 || descriptor >= DESCRIPTORS || names[descriptor][0] == 0) return NULL;
  return names[descriptor];
}

/* What this call shall do. */
static enum fault_how strike(enum fault_kind kind, const char *name) {
  if (seen == NULL || name == NULL || strstr(name, fault.folder) == NULL) return FAULT_NONE;
  if (full && kind == FAULT_WRITE) {
    errno = fault.error;
    return FAULT_ERROR;
  }
  if ((fault.kinds & (1u << kind)) == 0 || atomic_fetch_add(&seen->calls, 1) + 1 != fault.at) return FAULT_NONE;
  atomic_store(&seen->struck, true);
  snprintf(seen->name, sizeof seen->name, "%s", name);
  enum fault_how how = fault.how;
  if (how == FAULT_ACT) {
    fault.act(name);
    return FAULT_NONE;
  }
  if (how == FAULT_KILL && kind != FAULT_WRITE) raise(SIGKILL);
  if (how == FAULT_FULL) full = true;
  if (how == FAULT_ERROR || (kind != FAULT_READ && kind != FAULT_WRITE)) {
    errno = fault.error;
    return FAULT_ERROR;
  }
  return how;
}

/* ---- descriptors ------------------------------------------------------------------------------------------------- */

static int remember(int descriptor, const char *name) {
  if (seen != NULL && descriptor >= 0 && descriptor < DESCRIPTORS && strstr(name, fault.folder) != NULL)
    snprintf(names[descriptor], sizeof names[descriptor], "%s", name);
  return descriptor;
}

int open(const char *name, int flags, ...) {
  REAL("open", int, (const char *, int, ...))
  va_list more;
  va_start(more, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(more, mode_t) : 0;
  va_end(more);
  return strike(FAULT_OPEN, name) == FAULT_NONE ? remember(real(name, flags, mode), name) : -1;
}

int open64(const char *name, int flags, ...) {
  REAL("open64", int, (const char *, int, ...))
  va_list more;
  va_start(more, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(more, mode_t) : 0;
  va_end(more);
  return strike(FAULT_OPEN, name) == FAULT_NONE ? remember(real(name, flags, mode), name) : -1;
}

ssize_t read(int descriptor, void *bytes, size_t count) {
  REAL("read", ssize_t, (int, void *, size_t))
  const enum fault_how how = count > 0 ? strike(FAULT_READ, watched(descriptor)) : FAULT_NONE;
  if (how == FAULT_ERROR) return -1;
  return real(descriptor, bytes, how == FAULT_NONE ? count : (count + 1) / 2);
}

ssize_t write(int descriptor, const void *bytes, size_t count) {
  REAL("write", ssize_t, (int, const void *, size_t))
  const enum fault_how how = count > 0 ? strike(FAULT_WRITE, watched(descriptor)) : FAULT_NONE;
  if (how == FAULT_ERROR) return -1;
  const ssize_t done = real(descriptor, bytes, how == FAULT_NONE ? count : (count + 1) / 2);
  if (how == FAULT_KILL) raise(SIGKILL);
  return done;
}

int fsync(int descriptor) {
  REAL("fsync", int, (int))
  if (watched(descriptor) == NULL) return real(descriptor);
  return strike(FAULT_SYNC, watched(descriptor)) == FAULT_NONE ? 0 : -1;
}

int close(int descriptor) {
  REAL("close", int, (int))
  const char *name = watched(descriptor);
  const bool fails = strike(FAULT_CLOSE, name) != FAULT_NONE;
  const int error = errno;
  if (name != NULL) names[descriptor][0] = 0;
  if (!fails) return real(descriptor);
  (void)real(descriptor);
  errno = error;
  return -1;
}

/* ---- streams ----------------------------------------------------------------------------------------------------- */

static FILE *remember_stream(FILE *file, const char *name) {
  if (file != NULL) remember(fileno(file), name);
  return file;
}

FILE *fopen(const char *name, const char *mode) {
  REAL("fopen", FILE *, (const char *, const char *))
  return strike(FAULT_OPEN, name) == FAULT_NONE ? remember_stream(real(name, mode), name) : NULL;
}

FILE *fopen64(const char *name, const char *mode) {
  REAL("fopen64", FILE *, (const char *, const char *))
  return strike(FAULT_OPEN, name) == FAULT_NONE ? remember_stream(real(name, mode), name) : NULL;
}

size_t fread(void *bytes, size_t size, size_t count, FILE *file) {
  REAL("fread", size_t, (void *, size_t, size_t, FILE *))
  const enum fault_how how = strike(FAULT_READ, watched(fileno(file)));
  if (how == FAULT_NONE) return real(bytes, size, count, file);
  return how == FAULT_ERROR ? 0 : real(bytes, 1, (size * count + 1) / 2, file) / size;
}

size_t fwrite(const void *bytes, size_t size, size_t count, FILE *file) {
  REAL("fwrite", size_t, (const void *, size_t, size_t, FILE *))
  const char *name = watched(fileno(file));
  const enum fault_how how = strike(FAULT_WRITE, name);
  if (how == FAULT_NONE) return real(bytes, size, count, file);
  if (how == FAULT_ERROR) return 0;
  const size_t done = real(bytes, 1, size * count / 2, file) / (size > 0 ? size : 1);
  fflush(file);
  if (how == FAULT_KILL) raise(SIGKILL);
  errno = fault.error; /* a stream that writes less has failed */
  return done;
}

int fclose(FILE *file) {
  REAL("fclose", int, (FILE *))
  const int descriptor = fileno(file);
  const char *name = watched(descriptor);
  const bool fails = strike(FAULT_CLOSE, name) != FAULT_NONE;
  const int error = errno;
  if (name != NULL) names[descriptor][0] = 0;
  const int closed = real(file);
  if (!fails) return closed;
  errno = error;
  return EOF;
}

/* ---- names ------------------------------------------------------------------------------------------------------- */

int rename(const char *from, const char *to) {
  REAL("rename", int, (const char *, const char *))
  return strike(FAULT_RENAME, to) == FAULT_NONE ? real(from, to) : -1;
}

int link(const char *from, const char *to) {
  REAL("link", int, (const char *, const char *))
  return strike(FAULT_RENAME, to) == FAULT_NONE ? real(from, to) : -1;
}

int mkdir(const char *name, mode_t mode) {
  REAL("mkdir", int, (const char *, mode_t))
  return strike(FAULT_MKDIR, name) == FAULT_NONE ? real(name, mode) : -1;
}
