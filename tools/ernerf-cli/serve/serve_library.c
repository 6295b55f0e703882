/* SPDX-License-Identifier: MIT */
#include "serve/serve_library.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>

#include "core/interface_version.h"

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-serve.so." TEXT_OF(major)

int serve_library_load(const struct ern_http_functions **functions, struct session *session) {
  static const char name[] = SONAME(ERN_VERSION_MAJOR);
  void *library = dlopen(name, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  const struct ern_http_functions *found = library != NULL ? dlsym(library, "ern_http_functions") : NULL;
  if (found == NULL)
    return session_fail_with(session,
                             "%s cannot be loaded: %s; expected an ernerf that was built with ERNERF_SERVE and "
                             "libmicrohttpd",
                             name, dlerror());
  if (strcmp(found->version, ERN_INTERFACE_VERSION) != 0)
    return session_fail_with(session, "%s is of version %s, expected %s", name, found->version, ERN_INTERFACE_VERSION);
  *functions = found;
  return 0;
}
