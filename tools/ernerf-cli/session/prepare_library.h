/* SPDX-License-Identifier: MIT
 * Loads libernerf-prepare only when a verb needs it, so that other verbs do not load Ceres Solver and OpenCV's
 * trackers. */
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

/* Returns 0, or EXIT_FAILURE after a message. The library stays loaded until the program ends. */
int prepare_library_load(struct prepare_library *library, struct session *session);

/* The functions of prepare.h with these names. */
struct landmark_library {
  ern_status (*open)(ern_context *context, const char *path, ern_landmark_network **network);
  void (*free)(ern_landmark_network **network);
  ern_status (*learn)(ern_landmark_network *network, const uint8_t *rgb, int width, int height,
                      const float guess[68][2]);
  ern_status (*decide)(ern_landmark_network *network);
  ern_status (*find)(ern_landmark_network *network, const uint8_t *rgb, int width, int height, const float guess[68][2],
                     float points[68][2]);
};

/* As prepare_library_load. */
int prepare_library_landmarks(struct landmark_library *library, struct session *session);

#endif
