/* SPDX-License-Identifier: MIT
 * Files that fail on demand. file_faults.c has functions of the C library's names, which every library in a test's
 * process then calls: they count the calls on files of one folder, and let one of them fail, do half, or end the
 * process. */
#ifndef ERN_TESTS_FILE_FAULTS_H
#define ERN_TESTS_FILE_FAULTS_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

enum fault_kind {
  FAULT_OPEN,
  FAULT_READ,
  FAULT_WRITE,
  FAULT_SYNC,
  FAULT_CLOSE,
  FAULT_RENAME,
  FAULT_MKDIR,
  FAULT_KINDS
};

enum fault_how {
  FAULT_NONE,
  FAULT_ERROR, /* it fails with `error` */
  FAULT_HALF,  /* reads and writes: half of the bytes, once; all others: as FAULT_ERROR */
  FAULT_FULL,  /* half of the bytes, and from then on every write fails with `error` */
  FAULT_KILL,  /* the process gets SIGKILL; a write has by then put down half of its bytes */
  FAULT_ACT    /* `act` is called, and then the call goes on */
};

/* What shall fail: call number `at` (from 1) of the kinds, on names with `folder` in them. */
struct fault {
  const char *folder;
  unsigned kinds; /* bits 1 << FAULT_... */
  size_t at;
  enum fault_how how;
  int error;
  void (*act)(const char *name);
};

/* What was seen, in memory that a parent shares with the process that is to fail. */
struct fault_seen {
  atomic_size_t calls;
  atomic_bool struck;
  char name[256]; /* of the file that was struck */
};

/* Begins; NULL ends. `seen` is zeroed. */
void faults_set(const struct fault *fault, struct fault_seen *seen);

#endif
