/* SPDX-License-Identifier: MIT
 * How much of the machine this process may use: a container, a batch system or a service manager may allow it less than
 * there is. */
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

/* `root` stands in front of every path that is read, "" for the real ones. What is not there, or is no such file,
 * limits nothing. */
void ern_machine_limits(const char *root, struct ern_machine_limits *limits);

#endif
