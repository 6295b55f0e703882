/* SPDX-License-Identifier: MIT
 * How much of the machine this process may use: a container, a batch system or a service manager may allow it only a
 * part. */
#ifndef ERN_CORE_MACHINE_H
#define ERN_CORE_MACHINE_H

#include <stdint.h>

/* Cores that may be used at the same time, 1 or more: those of the affinity mask, at most the processor time that the
 * control groups allow, rounded up. */
int ern_machine_cores(void);

/* Bytes of memory: the machine's, at most what the control groups allow; 0 where the system does not say. */
uint64_t ern_machine_memory(void);

/* What control groups allow, both versions: the least of the process' group and of those above it. */
struct ern_machine_limits {
  double cores;    /* seconds of processor time a second; INFINITY: no limit */
  uint64_t memory; /* bytes; UINT64_MAX: no limit */
};

/* Reads the files below `root`, "": the real ones. A file that is missing or has another form sets no limit. */
void ern_machine_limits(const char *root, struct ern_machine_limits *limits);

#endif
