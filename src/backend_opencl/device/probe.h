/* SPDX-License-Identifier: MIT
 * Whether OpenCL devices can be used at all, tried in a process of its own (tools/probe-opencl): a driver that lacks
 * something may end the process that it is loaded into, and is not to end the program that links this library. */
#ifndef ERN_OPENCL_PROBE_H
#define ERN_OPENCL_PROBE_H

#include <stdbool.h>

#include "core/status.h"

/* Asks all drivers for their devices, and runs a kernel on those of the numbers first to last (none where last is below
 * first). *listed: the drivers may be asked for their devices; else no function of OpenCL may be called in this
 * process. *dead: the number of the first device that must not be used; last + 1 where there is none. Where something
 * ended the process, the result is ERN_E_DEVICE and the error says which device or platform, how, and the last words of
 * the driver. Where nothing can be tried (the program is not there) that is logged as a warning, and everything is
 * taken to be well. Costs 0.1 s, and seconds where the driver has to compile the kernel. */
ERN_NODISCARD ern_status ern_cl_probe(ern_context *context, int first, int last, bool *listed, int *dead);

#endif
