/* SPDX-License-Identifier: MIT
 * Fault injection for file operations. file_faults.c interposes functions of the C library for all libraries in the
 * test's process. They count the calls on files of one folder, and make one call fail, do half of its work, or kill the
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
  FAULT_ERROR, /* the call fails with `error` */
  FAULT_HALF,  /* reads and writes: half of the bytes, once; all others: as FAULT_ERROR */
  FAULT_FULL,  /* half of the bytes, and from then on every write fails with `error` */
  FAULT_KILL,  /* the process gets SIGKILL; a write has written half of its bytes before */
  FAULT_ACT    /* calls `act`, then performs the call */
};

/* The fault: hits call number `at` (from 1) of the kinds, on paths that contain `folder`. */
struct fault {
  const char *folder;
  unsigned kinds; /* bits 1 << FAULT_... */
  size_t at;
  enum fault_how how;
  int error;
  void (*act)(const char *name);
};

/* The observed calls, in memory that the parent shares with the failing process. */
struct fault_seen {
  atomic_size_t calls;
  atomic_bool struck;
  char name[256]; /* of the file that the fault hit */
};

/* Starts the fault injection; fault NULL ends it. Zeroes `seen`. */
void faults_set(const struct fault *fault, struct fault_seen *seen);

#endif
