/* SPDX-License-Identifier: MIT
 * What `ernerf live` holds: the person, the sound that comes, and where frames go. */
#ifndef ERN_CLI_LIVE_JOB_H
#define ERN_CLI_LIVE_JOB_H

#include "ernerf/live.h"
#include "live/live_control.h"
#include "live/live_output.h"
#include "live/live_sound.h"
#include "output/label.h"
#include "output/provenance_output.h"
#include "output/watermark_output.h"
#include "session/background.h"
#include "session/control.h"
#include "session/portrait.h"
#include "session/rate_control.h"
#include "session/silence_pose.h"

/* Times are counted by the millisecond, up to this. */
enum { LIVE_MILLISECONDS = 5000 };

struct live_times {
  uint32_t bin[LIVE_MILLISECONDS + 1]; /* the last one: or more */
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
  const char *background_file;
  struct dimensions size;
  int fit; /* ern_fit */
  struct rate rate;
  int look_ahead;    /* frames at 25 a second */
  double seconds;    /* that it lasts; 0: without an end */
  double most_delay; /* seconds of sound that may wait; 0: any */
  bool as_fast;      /* a frame as soon as its sound is there, with the asked settings always */
  /* made */
  struct background background;
  struct frame_source poses;    /* of the clip, there and back, one period and its first frame again */
  struct frame_source now;      /* the one frame that is drawn; its `frame` is that of `poses` */
  struct source_frame place;    /* it */
  const ern_features *features; /* of the clip, to time settings on */
  float *windows;               /* likewise */
  uint8_t *look;
  ern_live *live;
  /* as it goes */
  uint64_t moved; /* frames in which the pose went on */
  bool held, quits;
  float eye;                                 /* below 0: the clip's */
  uint64_t frames, drawn, repeated, skipped; /* skipped: frames of sound that had waited too long */
  struct live_times to_frame;                /* from sound to its frame's being drawn */
  double began;
};

/* Draws and hands over frames until the sound has ended, a signal or "quit" comes, or the output has failed. Returns 0,
 * or EXIT_FAILURE after a message. */
int live_run(struct live_job *job);
/* Frame k of the clip's poses with the clip's speech, to time settings (rate_control_draw). */
int live_look(void *user, ern_renderer *renderer, size_t k, float *rgb);
/* What a line of --control asks for, and its answer. */
void live_command(struct live_job *job, const char *line);
/* The figures so far; NULL without memory. */
json_t *live_statistics(const struct live_job *job);

#endif
