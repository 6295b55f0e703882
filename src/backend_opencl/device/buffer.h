/* SPDX-License-Identifier: MIT
 * Errors, buffers and transfers. */
#ifndef ERN_OPENCL_BUFFER_H
#define ERN_OPENCL_BUFFER_H

#include "backend_opencl/device/backend.h"

/* ERN_OK, or the error with the device's name and what was being done ("run mlp_fwd"). Out of memory is
 * ERN_E_NO_MEMORY, all else ERN_E_DEVICE. Out of memory on a device that no longer responds is ERN_E_DEVICE too. */
ern_status ern_cl_check(struct ern_cl_backend *backend, cl_int code, const char *doing);
const char *ern_cl_error_name(cl_int code);

/* Whether the system has so many bytes for the process, as far as the limits of its addresses and data tell. */
bool ern_cl_memory_is_free(size_t bytes);

/* Blocking read of `count` floats or int32. */
ERN_NODISCARD ern_status ern_cl_read(struct ern_stream *stream, void *to, ern_span from, size_t count);

/* Frees the stream's staging memory, after the transfers from it. */
void ern_cl_staging_free(struct ern_cl_stream *stream);

/* Fills the slots of the table that make buffers and transfer data. */
void ern_cl_fill_memory(struct ern_backend *table);

#endif
