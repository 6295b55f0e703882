/* SPDX-License-Identifier: MIT
 * Libraries of libernerf that are opened when something of them is asked for: one symbol, a table of functions that
 * begins with the library's version. */
#ifndef ERN_MEDIA_LOADED_LIBRARY_H
#define ERN_MEDIA_LOADED_LIBRARY_H

#include "core/status.h"

struct ern_loaded_library {
  const char *file;   /* "libernerf-vision.so.0" */
  const char *symbol; /* of the table */
  const char *option; /* of the build, and what it needs, in an error's words */
};

/* `what` needs it, in an error's words. On success the caller closes *handle (dlclose). */
ERN_NODISCARD ern_status ern_library_load(ern_context *context, const char *what,
                                          const struct ern_loaded_library *library, void **handle, const void **table);

#endif
