/* SPDX-License-Identifier: MIT
 * The cache folder. */
#ifndef ERN_OPENCL_CACHE_H
#define ERN_OPENCL_CACHE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/status.h"

enum { ERN_CL_KEY_BYTES = 65 };

/* Binaries of built programs, and what the tuner measured, in the user's cache folder ($XDG_CACHE_HOME/libernerf or
 * ~/.cache/libernerf). An entry that cannot be read, or whose checksum is wrong, counts as missing. key: 64 hex
 * digits. */
void ern_cl_cache_read(ern_context *context, const char *key, uint8_t **bytes, size_t *count); /* NULL: none */
bool ern_cl_cache_write(ern_context *context, const char *key, const void *bytes, size_t count);

#endif
