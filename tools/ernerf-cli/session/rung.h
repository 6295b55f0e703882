/* SPDX-License-Identifier: MIT
 * The settings that a rate is held with, and their renderers. */
#ifndef ERN_CLI_RUNG_H
#define ERN_CLI_RUNG_H

#include "session/pareto_read.h"
#include "session/portrait.h"

enum { RATE_CONTROL_RUNGS = 48, RATE_CONTROL_UNITS = 4 };

/* A setting that may be used. */
struct rung {
  char name[PARETO_NAME_BYTES];
  struct settings settings;
  double ms;     /* a frame, as measured, or between the rungs that were */
  double db;     /* PSNR against the exact render; of a quick look against the first rung's pictures, 100 at most */
  double price;  /* dB that it loses against the clip's frames to the best rung; NaN after a quick look */
  size_t frames; /* that were drawn so */
  ern_renderer *renderer; /* NULL: not made */
};

struct rate_control {
  /* from the command line */
  float hold_fps, budget; /* 0: not asked for */
  int quality;            /* -1: not asked for; exact, balanced, draft */
  const char *front;      /* NULL: MODEL's own, where there is one */
  bool goes_on;           /* set by the verb: a budget that nothing holds is only told of */
  /* made */
  struct session *session;
  const struct portrait *portrait;
  const struct frame_source *frame_source;
  const ern_features *features;
  struct rung rung[RATE_CONTROL_RUNGS]; /* the most accurate first */
  double cost[RATE_CONTROL_RUNGS];
  size_t count, changes;
  ern_rate_controller controller; /* of --quality: one rung, and no budget */
  char source[4096];              /* the file of the front; "": a quick look */
  struct {
    char backend[16], isa[24];
    int device;
    ern_backend *made;
  } unit[RATE_CONTROL_UNITS];
  size_t units;
};

/* Draws frame k of the frames with a renderer into 8-bit pixels of the output's size, and where rgb is not NULL its
 * colours [height][width][3]. Returns 0, or EXIT_FAILURE after a message. */
typedef int rate_control_draw(void *user, ern_renderer *renderer, size_t k, float *rgb);

/* Makes the rung's renderer where it is not there yet. Returns 0, or EXIT_FAILURE after a message. */
int rung_make(struct rate_control *rate_control, struct rung *rung);

#endif
