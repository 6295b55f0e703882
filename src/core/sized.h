/* SPDX-License-Identifier: MIT
 * Public structs that may grow: copied between the caller's size and the library's own (docs/abi.md). */
#ifndef ERN_CORE_SIZED_H
#define ERN_CORE_SIZED_H

#include "core/status.h"

/* Input: copies the first `bytes` bytes of *theirs into *own, which holds zeros. ERN_E_UNSUPPORTED where the caller's
 * struct is larger. */
#define ERN_COPY_IN(context, type, own, theirs, bytes) \
  ern_struct_copy_in(context, #type, own, sizeof(type), theirs, bytes)
ERN_NODISCARD ern_status ern_struct_copy_in(ern_context *context, const char *type, void *own, size_t own_bytes,
                                            const void *theirs, size_t bytes);

/* The same for a struct that begins with `cookie` and `size`; *own holds the defaults. ERN_E_ARGUMENT where *theirs was
 * not made by its ..._default function. */
#define ERN_COPY_IN_CONFIG(context, type, own, theirs) ern_config_copy_in(context, #type, own, sizeof(type), theirs)
ERN_NODISCARD ern_status ern_config_copy_in(ern_context *context, const char *type, void *own, size_t own_bytes,
                                            const void *theirs);

/* Output: copies the first `bytes` bytes of *own into *theirs, zeros past the end of *own. theirs may be NULL. */
void ern_struct_copy_out(void *theirs, size_t bytes, const void *own, size_t own_bytes);

/* The same for a struct that begins with `cookie` and `size`; its `size` becomes `bytes`. */
void ern_config_copy_out(void *theirs, size_t bytes, const void *own, size_t own_bytes);

#endif
