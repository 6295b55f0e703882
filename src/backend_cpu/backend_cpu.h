/* SPDX-License-Identifier: MIT
 * The CPU as a backend. */
#ifndef ERN_BACKEND_CPU_H
#define ERN_BACKEND_CPU_H

#include "core/backend.h"
#include "core/cpu.h"

/* Precondition: ern_isa_available(isa). */
ERN_NODISCARD ern_status ern_cpu_backend_make(ern_context *context, ern_isa isa, struct ern_backend **backend);

/* Whether this machine multiplies pairs of bf16 faster than floats. Measures it, which takes 0.1 ms. */
bool ern_cpu_bf16_is_faster(void);

#endif
