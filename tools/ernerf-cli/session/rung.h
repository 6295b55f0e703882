/* SPDX-License-Identifier: MIT
 * The candidate settings of the rate control ("rungs"), and their renderers. */
#ifndef ERN_CLI_RUNG_H
#define ERN_CLI_RUNG_H

#include "session/pareto_read.h"
#include "session/portrait.h"

enum { RATE_CONTROL_RUNGS = 48, RATE_CONTROL_UNITS = 4 };

/* A candidate setting. */
struct rung {
  char name[PARETO_NAME_BYTES];
  struct settings settings;
  double ms;     /* time of a frame: measured, or interpolated between measured rungs */
  double db;     /* PSNR against the exact render; after a calibration against the first rung's pictures, 100 at most */
  double price;  /* dB of PSNR against the clip's frames that it loses to the best rung; NaN after a calibration */
  size_t frames; /* drawn with it */
  ern_renderer *renderer; /* NULL: not made */
};

struct rate_control {
  /* from the command line */
  float hold_fps;                  /* 0: not asked for */
  int quality;                     /* -1: not asked for; exact, balanced, draft */
  const char *front;               /* NULL: that stored beside MODEL, if any */
  bool warns_if_unreachable;       /* set by the verb: a budget that no setting holds causes only a warning */
  const struct rate_control *like; /* set by the verb: the settings and times of this one are taken, which was opened
                                      for the same portrait and size; NULL: they are found */
  bool no_stored_front;            /* set by the verb: its frames take other times than those of a stored front */
  /* made */
  struct session *session;
  const struct portrait *portrait;
  const struct frame_source *frame_source;
  const ern_features *features;
  struct rung rung[RATE_CONTROL_RUNGS]; /* the most accurate first */
  double cost[RATE_CONTROL_RUNGS];
  size_t count, changes;
  ern_rate_controller controller; /* with --quality: one rung, and no budget */
  char source[4096];              /* file of the stored front; "": a calibration */
  struct {
    char backend[16], isa[24];
    int device;
    ern_backend *made;
  } unit[RATE_CONTROL_UNITS];
  size_t units;
};

/* Draws frame k with a renderer into 8-bit pixels of the output's size and, if rgb is not NULL, the colours into
 * rgb[height][width][3]. Returns 0, or EXIT_FAILURE after a message. */
typedef int rate_control_draw(void *user, ern_renderer *renderer, size_t k, float *rgb);

/* Creates the rung's renderer if it does not exist yet. Returns 0, or EXIT_FAILURE after a message. */
int rung_make(struct rate_control *rate_control, struct rung *rung);

#endif
