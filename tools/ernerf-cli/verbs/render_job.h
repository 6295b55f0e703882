/* SPDX-License-Identifier: MIT
 * A call of `render`, and the drawing of its frames. */
#ifndef ERN_CLI_RENDER_JOB_H
#define ERN_CLI_RENDER_JOB_H

#include "output/label.h"
#include "output/provenance_output.h"
#include "output/sink.h"
#include "output/watermark_output.h"
#include "session/background.h"
#include "session/control.h"
#include "session/frame_reuse.h"
#include "session/portrait.h"
#include "session/progress.h"
#include "session/rate_control.h"
#include "session/silence_pose.h"

struct render_job {
  struct session session;
  struct portrait portrait;
  struct rate_control rate_control;
  struct control control;
  struct silence_pose silence_pose;
  struct frame_reuse frame_reuse;
  struct provenance provenance;
  struct label label;
  struct watermark watermark;
  /* from the command line */
  const char *poses, *audio, *wav, *background_file, *out;
  struct dimensions size;
  int fit; /* ern_fit */
  struct rate rate;
  /* made */
  struct sink sink;
  struct frame_source frame_source;
  struct background background;
  ern_features own_features; /* of --audio */
  const ern_features *features;
  ern_sound sound;
  double sound_start; /* seconds */
  float *windows;
  uint8_t *look;          /* [height][width][4]: for the rate control's calibration; NULL: none */
  ern_frame_times stages; /* drawing time by stage, milliseconds, summed over the frames */
};

/* Whether the head is rendered over the torso pictures of the clip. */
bool render_is_behind(const struct render_job *job);
/* Bytes of a frame's windows. */
size_t render_window_bytes(const struct render_job *job);
/* Frame k over `torso`, which may be NULL. windows: scratch. */
ern_status render_frame(const struct render_job *job, ern_renderer *renderer, size_t k, const uint8_t *torso,
                        float *windows, const ern_frame_output *output, ern_frame_times *times);
/* Prints the error of frame k. Returns EXIT_FAILURE. */
int render_fail(struct render_job *job, size_t k);
/* Draws all frames and hands them to the sink. Returns 0, or EXIT_FAILURE after a message. */
int render_frames(struct render_job *job, struct progress *progress);

#endif
