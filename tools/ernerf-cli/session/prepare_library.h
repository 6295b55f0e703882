/* SPDX-License-Identifier: MIT
 * libernerf-prepare, loaded when a verb needs it: other verbs wait for neither Ceres Solver nor OpenCV's trackers. */
#ifndef ERN_CLI_PREPARE_LIBRARY_H
#define ERN_CLI_PREPARE_LIBRARY_H

#include "ernerf/prepare.h"
#include "session/session.h"

struct prepare_library {
  void *handle;
  ern_prepare_options options; /* the defaults */
  ern_status (*run)(ern_context *context, const char *video, const char *folder, const ern_prepare_options *options,
                    ern_prepare_result *result, size_t bytes);
};

/* Returns 0, or EXIT_FAILURE after a message. It stays loaded until the program ends. */
int prepare_library_load(struct prepare_library *library, struct session *session);

#endif
