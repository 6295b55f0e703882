/* SPDX-License-Identifier: MIT
 * Tests in a separate process (tools/probe-opencl) whether OpenCL devices can be used: a broken driver may crash the
 * process that loads it, and must not crash the program that links this library. */
#ifndef ERN_OPENCL_PROBE_H
#define ERN_OPENCL_PROBE_H

#include <stdbool.h>

#include "core/status.h"

/* Asks all drivers for their devices, and runs a kernel on those of the numbers first to last (none where last is below
 * first). *listed: the drivers may be asked for their devices; else no function of OpenCL may be called in this
 * process. *dead: the number of the first device that must not be used; last + 1 where there is none. Where the process
 * crashed, the result is ERN_E_DEVICE and the error says which device or platform, how, and the driver's last output.
 * Where the test program is missing, a warning is logged and all devices are taken to work. Costs 0.1 s, and seconds
 * where the driver has to compile the kernel. */
ERN_NODISCARD ern_status ern_cl_probe(ern_context *context, int first, int last, bool *listed, int *dead);

#endif
