/* SPDX-License-Identifier: MIT
 * Options by which the user overrides the clip's eye values and poses, and their application to the frames. */
#ifndef ERN_CLI_CONTROL_H
#define ERN_CLI_CONTROL_H

#include "session/portrait.h"

struct control {
  /* from the command line */
  float fix_eye;
  const char *eye; /* file of an eye curve */
  bool smooth_eye, smooth_path;
  int smooth_window;
  uint64_t hold;
  struct pair turn; /* yaw, pitch, degrees */
};

enum { CONTROL_OPTIONS = 7 };
/* The defaults, and --fix-eye --eye --smooth-eye --smooth-path --smooth-path-window --rotate, and --set hold-pose. */
void control_options(struct control *control, struct option options[CONTROL_OPTIONS]);
/* Refuses options that contradict each other. Returns -1, or EXIT_USAGE after a message. */
int control_check(const struct control *control, const struct args *args);

/* The next ones return 0, or an exit status after a message. */

/* Fails if the model does not support a given option. */
int control_check_model(const struct control *control, struct session *session, const struct args *args,
                        const struct portrait *portrait);
/* Changes poses and eye values of the clip, or of the poses' file, before they are replayed forward and backward. */
int control_clip(const struct control *control, struct session *session, const struct args *args,
                 struct frame_source *frame_source);
/* Changes the eye values of the output's frames. */
int control_output(const struct control *control, struct session *session, struct frame_source *frame_source);

#endif
