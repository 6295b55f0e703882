/* SPDX-License-Identifier: MIT */
#include "session/prepare_library.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-prepare.so." TEXT_OF(major)

/* Functions to look up by name. ISO C has no cast from an object pointer to a function pointer, so the pointers are
 * copied. */
struct wanted {
  const char *name;
  void *function; /* a pointer to one */
  size_t bytes;
};

static int load(struct session *session, const struct wanted *wanted, size_t count, void **handle) {
  static const char name[] = SONAME(ERN_VERSION_MAJOR);
  *handle = dlopen(name, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  for (size_t i = 0; i < count; i++) {
    void *const symbol = *handle != NULL ? dlsym(*handle, wanted[i].name) : NULL;
    if (symbol == NULL)
      return session_fail_with(
          session, "%s cannot be loaded: %s; expected a libernerf that was built with ERNERF_PREPARE", name, dlerror());
    memcpy(wanted[i].function, &symbol, wanted[i].bytes);
  }
  return EXIT_SUCCESS;
}

int prepare_library_load(struct prepare_library *library, struct session *session) {
  void (*fill)(ern_prepare_options * options, size_t bytes) = NULL;
  const struct wanted wanted[] = {{"ern_prepare_options_fill", &fill, sizeof fill},
                                  {"ern_prepare_sized", &library->run, sizeof library->run}};
  const int status = load(session, wanted, sizeof wanted / sizeof *wanted, &library->handle);
  if (status == EXIT_SUCCESS) fill(&library->options, sizeof library->options);
  return status;
}

int prepare_library_landmarks(struct landmark_library *library, struct session *session) {
  void *handle = NULL;
  const struct wanted wanted[] = {{"ern_landmark_network_open", &library->open, sizeof library->open},
                                  {"ern_landmark_network_free", &library->free, sizeof library->free},
                                  {"ern_landmark_network_learn", &library->learn, sizeof library->learn},
                                  {"ern_landmark_network_decide", &library->decide, sizeof library->decide},
                                  {"ern_landmark_network_find", &library->find, sizeof library->find}};
  return load(session, wanted, sizeof wanted / sizeof *wanted, &handle);
}
