/* SPDX-License-Identifier: MIT
 * Errors, buffers, and what moves bytes. */
#ifndef ERN_OPENCL_BUFFER_H
#define ERN_OPENCL_BUFFER_H

#include "backend_opencl/device/backend.h"

/* ERN_OK, or the error with the device's name and what was being done ("run mlp_fwd"). Out of memory is
 * ERN_E_NO_MEMORY, all else ERN_E_DEVICE; so is out of memory where the device no longer answers at all. */
ern_status ern_cl_check(struct ern_cl_backend *backend, cl_int code, const char *doing);
const char *ern_cl_error_name(cl_int code);

/* Blocking read of `count` floats or int32. */
ERN_NODISCARD ern_status ern_cl_read(struct ern_stream *stream, void *to, ern_span from, size_t count);

/* The part of the table that makes buffers and moves bytes. */
void ern_cl_fill_memory(struct ern_backend *table);

#endif
