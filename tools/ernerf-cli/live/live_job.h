/* SPDX-License-Identifier: MIT
 * The state of `ernerf live`: the portrait, the incoming sound, and the output of frames. */
#ifndef ERN_CLI_LIVE_JOB_H
#define ERN_CLI_LIVE_JOB_H

#include "ernerf/live.h"
#include "live/live_control.h"
#include "live/live_output.h"
#include "live/live_sound.h"
#include "live/live_video.h"
#include "output/label.h"
#include "output/provenance_output.h"
#include "output/watermark_output.h"
#include "session/background.h"
#include "session/control.h"
#include "session/portrait.h"
#include "session/rate_control.h"
#include "session/silence_pose.h"

/* Number of 1 ms bins of a histogram of times. */
enum { LIVE_MILLISECONDS = 5000 };

struct live_times {
  uint32_t bin[LIVE_MILLISECONDS + 1]; /* the last bin counts all longer times */
  uint64_t count;
};

struct live_job {
  struct session session;
  struct portrait portrait;
  struct control control;
  struct rate_control rate_control;
  struct silence_pose silence_pose;
  struct provenance provenance;
  struct label label;
  struct watermark watermark;
  /* from the command line */
  struct live_sound sound;
  struct live_output output;
  struct live_control commands;
  struct live_video video;
  const char *background_file;
  struct dimensions size; /* of the frames */
  int fit;                /* ern_fit */
  struct rate rate;
  int slow_reader;   /* 0: wait, 1: drop frames */
  int look_ahead;    /* frames at 25 fps */
  double seconds;    /* duration; 0: unlimited */
  double most_delay; /* seconds of sound that may be queued; 0: unlimited */
  bool unpaced; /* draw each frame as soon as its sound has arrived, always with the settings of the command line */
  /* made */
  struct background background;
  struct frame_source poses; /* the clip's poses forward and backward: one period, then its first frame again */
  struct frame_source now;   /* the one frame to draw; its `frame` is that of `poses`, with --video all of the clip */
  struct source_frame place; /* the frame of `now` */
  const ern_features *features; /* the clip's, to time settings on */
  float *windows;               /* scratch for live_calibration_draw */
  uint8_t *look;
  ern_live *live;
  /* running state */
  uint64_t moved; /* frames in which the pose advanced */
  bool held, quits;
  float eye;                                 /* fixed eye value; below 0: the clip's */
  uint64_t heard;                            /* samples of the frames so far */
  uint64_t frames, drawn, repeated, skipped; /* skipped: frames whose sound was queued for too long */
  uint64_t as_recorded;                      /* of those that were drawn, with --video: without a rendered mouth */
  struct live_times to_frame;                /* from the arrival of sound until its frame is drawn */
  double began;
};

/* Options of a live portrait, behind up to LIVE_OWN_OPTIONS of the verb's own in the first two tables. */
enum {
  LIVE_OWN_OPTIONS = 16,
  LIVE_SOURCE_OPTIONS = 3,
  LIVE_PICTURE_OPTIONS = 6,
  LIVE_OUT_OPTIONS =
      LIVE_PICTURE_OPTIONS + RATE_CONTROL_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS + WATERMARK_OPTIONS
};
struct live_tables {
  struct option in[LIVE_OWN_OPTIONS + LIVE_SOURCE_OPTIONS], out[LIVE_OWN_OPTIONS + LIVE_OUT_OPTIONS],
      shared[PORTRAIT_OPTIONS], control[CONTROL_OPTIONS + SILENCE_POSE_OPTIONS],
      common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
};
/* Sets defaults and args->groups. in, out: how many own options the first two tables begin with, which are there. */
void live_tables_fill(struct live_tables *tables, struct live_job *job, size_t in, size_t out, struct args *args);
/* Checks them. Returns -1, or EXIT_USAGE after a message. */
int live_check(struct live_job *job, const struct args *args);

/* Opens all but the session, and starts the threads of sound and output. Returns 0, or EXIT_FAILURE after a message;
 * live_close in either case. */
int live_open(struct live_job *job, const struct args *args);
void live_close(struct live_job *job); /* in any state */

/* Draws frames and passes them to the output until the sound ends, a signal or "quit" arrives, or the output fails.
 * Returns 0, or EXIT_FAILURE after a message. */
int live_run(struct live_job *job);
/* A rate_control_draw that times settings: draws frame k of the clip's poses with the clip's speech. */
int live_calibration_draw(void *user, ern_renderer *renderer, size_t k, float *rgb);
/* Executes a line of --control and answers it. */
void live_command(struct live_job *job, const char *line);
/* Statistics so far; NULL without memory. */
json_t *live_statistics(struct live_job *job);

#endif
