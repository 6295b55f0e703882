/* SPDX-License-Identifier: MIT
 * What `ernerf tradeoff` measures: points, each with its settings, its time and its distance from two truths. */
#ifndef ERN_CLI_TRADEOFF_H
#define ERN_CLI_TRADEOFF_H

#include "evaluation/evaluate.h"
#include "session/pareto.h"
#include "session/portrait.h"
#include "session/session.h"
#include "session/settings.h"

enum {
  TRADEOFF_FRAMES = 16, /* at most, of the clip */
  TRADEOFF_POINTS = 64,
  TRADEOFF_TURNS = 64, /* readings of a point at most */
  TRADEOFF_LEAST = 3,  /* and at least */
  TRADEOFF_UNITS = 8
};

enum truth { TRUTH_EXACT, TRUTH_CLIP, TRUTHS };

struct point {
  struct settings settings;
  char name[96]; /* what is not the default's, in words */
  size_t changes;
  ern_renderer *renderer; /* NULL before its first picture */
  double first_ms;        /* milliseconds a frame, one reading: what its turns will take */
  double prepared;        /* milliseconds that its renderer took to make */
  double readings[TRADEOFF_TURNS];
  size_t turns;
  struct quartiles ms;                /* of the readings, each the mean of the frames */
  double db[TRUTHS][TRADEOFF_FRAMES]; /* PSNR of each frame against a truth, 100 at most */
  double error;                       /* mean squared error against the exact render, of all frames; colours 0..1 */
  double worst;                       /* largest difference of a colour from the exact render, 0..1 */
  struct place place[TRUTHS];
};

/* Where pictures are computed. */
struct unit {
  char backend[16], isa[24];
  int device;
  ern_backend *made; /* NULL before its first use */
};

struct tradeoff {
  struct session session;
  struct portrait portrait;
  struct evaluation evaluation;
  struct frame_source speech; /* all frames of the split: in which cells of low density are searched */
  const char *folder;         /* of the results */
  bool made_folder;           /* it was not there before */
  float seconds;              /* for all of it, about */
  struct settings base;
  const char *base_name; /* "default", or "as asked" */
  struct unit units[TRADEOFF_UNITS];
  size_t unit_count;
  char cpu[128], instruction_sets[128], device_name[128]; /* of the machine; device_name "" without OpenCL */
  int cores;
  char model_sha256[65];
  float *exact; /* [frames][height][width][3] */
  double exact_seconds, spent_seconds;
  struct point *points; /* [TRADEOFF_POINTS]; the first one is the base */
  size_t count;
  size_t not_reached[2]; /* points that were left out for want of time: single changes, combinations */
  size_t turns;
};

static inline size_t tradeoff_frames(const struct tradeoff *t) { return t->evaluation.frame_source.count; }
static inline size_t tradeoff_pixels(const struct tradeoff *t) {
  return (size_t)t->evaluation.info.width * (size_t)t->evaluation.info.height;
}
/* The points that stand on a truth's front, the fastest first. Returns how many. */
size_t tradeoff_front(const struct tradeoff *t, enum truth truth, size_t order[TRADEOFF_POINTS]);

#endif
