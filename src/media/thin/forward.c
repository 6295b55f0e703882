/* SPDX-License-Identifier: MIT
 * The libernerf-media that programs link with: each function loads libernerf-media-impl, unless that is loaded already,
 * and calls the function in its table. */
#include <stdatomic.h>
#include <stddef.h>
#include <string.h>

#include "media/loaded_library.h"
#include "media/thin/functions.h"

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-media-impl.so." TEXT_OF(major)

/* The function table: NULL until the library is loaded, then constant, as a symbol that the dynamic loader binds. */
static _Atomic(const struct ern_media_functions *) bound;

/* Returns NULL where the library cannot be loaded; *status and the context's error have the reason. */
static const struct ern_media_functions *load(ern_context *context, const char *what, ern_status *status) {
  static const char *const first[] = {ERN_MEDIA_FIRST NULL}; /* "libopenvdb.so.10.0", "libgdal.so.32", */
  static const struct ern_loaded_library library = {SONAME(ERN_VERSION_MAJOR), "ern_media_functions",
                                                    "OpenImageIO, OpenCV and FFmpeg, and these libraries", first};
  const struct ern_media_functions *functions = atomic_load_explicit(&bound, memory_order_acquire);
  void *handle = NULL;
  const void *table = NULL;
  *status = ERN_OK;
  if (functions != NULL) return functions;
  *status = ern_library_load(context, what, &library, &handle, &table); /* stays loaded: RTLD_NODELETE */
  functions = table;
  if (*status == ERN_OK) atomic_store_explicit(&bound, functions, memory_order_release);
  return functions;
}

#define FORWARD_STATUS(name, parameters, arguments, context, empty)              \
  ern_status name parameters {                                                   \
    ern_status status = ERN_OK;                                                  \
    const struct ern_media_functions *functions = load(context, #name, &status); \
    if (functions != NULL) return functions->name arguments;                     \
    empty return status;                                                         \
  }
/* Where the library is not loaded, there is no object: what these two answer is what their headers say of NULL. */
#define FORWARD_VALUE(type, name, parameters, arguments, none)                \
  type name parameters {                                                      \
    ern_status status = ERN_OK;                                               \
    const struct ern_media_functions *functions = load(NULL, #name, &status); \
    return functions != NULL ? functions->name arguments : none;              \
  }
#define FORWARD_VOID(name, parameters, arguments, empty)                      \
  void name parameters {                                                      \
    ern_status status = ERN_OK;                                               \
    const struct ern_media_functions *functions = load(NULL, #name, &status); \
    if (functions != NULL) {                                                  \
      functions->name arguments;                                              \
      return;                                                                 \
    }                                                                         \
    empty                                                                     \
  }
/* Where the library is not loaded, there is nothing to free. */
#define FORWARD_FREE(name, parameters, arguments)                                                     \
  void name parameters {                                                                              \
    const struct ern_media_functions *functions = atomic_load_explicit(&bound, memory_order_acquire); \
    if (functions != NULL) functions->name arguments;                                                 \
  }

ERN_MEDIA_STATUS(FORWARD_STATUS)
ERN_MEDIA_VALUE(FORWARD_VALUE)
ERN_MEDIA_VOID(FORWARD_VOID)
ERN_MEDIA_FREE(FORWARD_FREE)
