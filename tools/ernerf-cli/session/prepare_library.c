/* SPDX-License-Identifier: MIT */
#include "session/prepare_library.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-prepare.so." TEXT_OF(major)

int prepare_library_load(struct prepare_library *library, struct session *session) {
  static const char name[] = SONAME(ERN_VERSION_MAJOR);
  void (*fill)(ern_prepare_options * options, size_t bytes) = NULL;
  library->handle = dlopen(name, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  void *const symbols[2] = {library->handle != NULL ? dlsym(library->handle, "ern_prepare_options_fill") : NULL,
                            library->handle != NULL ? dlsym(library->handle, "ern_prepare_sized") : NULL};
  if (symbols[0] == NULL || symbols[1] == NULL)
    return session_fail_with(
        session, "%s cannot be loaded: %s; expected a libernerf that was built with ERNERF_PREPARE", name, dlerror());
  memcpy(&fill, &symbols[0], sizeof fill); /* ISO C has no cast from an object's address to a function's */
  memcpy(&library->run, &symbols[1], sizeof library->run);
  fill(&library->options, sizeof library->options);
  return EXIT_SUCCESS;
}
