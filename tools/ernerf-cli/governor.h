/* SPDX-License-Identifier: MIT
 * A budget instead of knobs: settings of measured price and time, from the most accurate to the fastest, and the one
 * that holds a rate at the pace that the machine has now. */
#ifndef ERN_CLI_GOVERNOR_H
#define ERN_CLI_GOVERNOR_H

#include "front_read.h"
#include "portrait.h"

enum { GOVERNOR_OPTIONS = 4, GOVERNOR_RUNGS = 48, GOVERNOR_UNITS = 4 };

/* A setting that may be used. */
struct rung {
  char name[FRONT_NAME_BYTES];
  struct settings settings;
  double ms;     /* a frame, as measured, or between the rungs that were */
  double db;     /* PSNR against the exact render; of a quick look against the first rung's pictures, 100 at most */
  double price;  /* dB that it loses against the clip's frames to the best rung; NaN after a quick look */
  size_t frames; /* that were drawn so */
  ern_renderer *renderer; /* NULL: not made */
};

struct governor {
  /* from the command line */
  float hold_fps, budget; /* 0: not asked for */
  int quality;            /* -1: not asked for; exact, balanced, draft */
  const char *front;      /* NULL: MODEL's own, where there is one */
  /* made */
  struct session *session;
  const struct portrait *portrait;
  const struct shots *shots;
  const ern_features *features;
  struct rung rung[GOVERNOR_RUNGS]; /* the most accurate first */
  double cost[GOVERNOR_RUNGS];
  size_t count, changes;
  ern_pace pace;     /* of --quality: one rung, and no budget */
  char source[4096]; /* the file of the front; "": a quick look */
  struct {
    char backend[16], isa[24];
    int device;
    ern_backend *made;
  } unit[GOVERNOR_UNITS];
  size_t units;
};

/* --hold-fps --budget --quality --front. */
void governor_options(struct governor *governor, struct option options[GOVERNOR_OPTIONS]);
/* -1, or EXIT_USAGE after a sentence where words contradict each other. */
int governor_check(const struct governor *governor, const struct args *args);
/* Whether anything of it was asked for. */
bool governor_asked(const struct governor *governor);

/* Draws frame k of the shots with a renderer into 8-bit pixels of the output's size, and where rgb is not NULL its
 * colours [height][width][3]. Returns 0, or EXIT_FAILURE after a message. */
typedef int governor_draw(void *user, ern_renderer *renderer, size_t k, float *rgb);

/* Finds the settings: from the front that belongs to model, machine and size, else by a quick look at a few frames;
 * says which one it begins with and what it costs. Portrait (open), shots and features must outlive it. Returns 0, or
 * EXIT_FAILURE after a message, also where nothing holds the budget. governor_close in either case. */
int governor_open(struct governor *governor, struct session *session, const struct args *args,
                  const struct portrait *portrait, const struct shots *shots, const ern_features *features,
                  struct dimensions size, governor_draw *draw, void *user);
void governor_close(struct governor *governor);

/* What the next frame is drawn with. */
ern_renderer *governor_renderer(struct governor *governor);
/* The name of that setting. */
const char *governor_name(const struct governor *governor);
/* A frame took so long, all in all, milliseconds. */
void governor_took(struct governor *governor, double ms);
/* Says how it went. */
void governor_summary(const struct governor *governor, double ms_per_frame);
/* NULL without memory. */
json_t *governor_json(const struct governor *governor);

#endif
