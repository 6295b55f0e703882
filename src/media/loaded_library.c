/* SPDX-License-Identifier: MIT */
#include "media/loaded_library.h"

#include <dlfcn.h>
#include <string.h>

#include "core/floats.h"
#include "core/interface_version.h"
#include "media/thin/load_trial.h"

ern_status ern_library_load(ern_context *context, const char *what, const struct ern_loaded_library *library,
                            void **handle, const void **table) {
  ERN_PLAIN_FLOATS; /* constructors of libraries compute, and some set the environment */
  *table = NULL;
  *handle = NULL;
  if (!ern_load_trial(library->file, library->first))
    return ern_fail(
        context, ERN_E_NO_MEMORY,
        "%s: is computed by %s, which cannot be loaded: the libraries that it needs end the process for want "
        "of memory or threads; expected higher limits (ulimit -v, -d, -u)",
        what, library->file);
  for (const char *const *name = library->first; name != NULL && *name != NULL; name++)
    (void)dlopen(*name, RTLD_LAZY | RTLD_LOCAL | RTLD_NODELETE);
  *handle = dlopen(library->file, RTLD_LAZY | RTLD_LOCAL | RTLD_NODELETE);
  if (*handle == NULL)
    return ern_fail(context, ERN_E_UNSUPPORTED,
                    "%s: is computed by %s, which cannot be loaded: %s; expected a libernerf that was built with %s",
                    what, library->file, dlerror(), library->option);
  const char *const *version = dlsym(*handle, library->symbol); /* the table's first member */
  if (version != NULL && strcmp(*version, ERN_INTERFACE_VERSION) == 0) {
    *table = version;
    return ERN_OK;
  }
  const ern_status status = ern_fail(context, ERN_E_UNSUPPORTED, "%s: %s is of version %s, expected %s", what,
                                     library->file, version != NULL ? *version : "unknown", ERN_INTERFACE_VERSION);
  (void)dlclose(*handle);
  *handle = NULL;
  return status;
}
