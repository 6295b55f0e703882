/* SPDX-License-Identifier: MIT
 * Optional libraries of libernerf, loaded on first use (dlopen). Each exports one symbol: a table of functions that
 * begins with the library's version. */
#ifndef ERN_MEDIA_LOADED_LIBRARY_H
#define ERN_MEDIA_LOADED_LIBRARY_H

#include "core/status.h"

struct ern_loaded_library {
  const char *file;   /* "libernerf-vision.so.0" */
  const char *symbol; /* of the table */
  const char *option; /* for error messages: the build option, and what that needs */
  /* NULL, or the names of libraries that it needs, up to a NULL. Each is loaded by itself before it: the loader then
   * looks for their symbols in fewer libraries, which halves the time. One that is not there is left out. */
  const char *const *first;
};

/* `what`: what needs the library, for error messages. On success the caller closes *handle (dlclose). */
ERN_NODISCARD ern_status ern_library_load(ern_context *context, const char *what,
                                          const struct ern_loaded_library *library, void **handle, const void **table);

#endif
