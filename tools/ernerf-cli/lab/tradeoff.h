/* SPDX-License-Identifier: MIT
 * The measurements of `ernerf tradeoff`: points, each with its settings, its time, and its PSNR against two references.
 */
#ifndef ERN_CLI_TRADEOFF_H
#define ERN_CLI_TRADEOFF_H

#include "evaluation/evaluate.h"
#include "session/pareto.h"
#include "session/portrait.h"
#include "session/session.h"
#include "session/settings.h"

enum {
  TRADEOFF_FRAMES = 16, /* at most, taken from the clip */
  TRADEOFF_POINTS = 64,
  TRADEOFF_TURNS = 64, /* most readings of a point */
  TRADEOFF_LEAST = 3,  /* fewest */
  TRADEOFF_UNITS = 8
};

enum reference { REFERENCE_EXACT, REFERENCE_CLIP, TRUTHS };

struct point {
  struct settings settings;
  char name[96]; /* differences from the default, as text */
  size_t changes;
  ern_renderer *renderer; /* NULL until its first picture */
  double first_ms;        /* milliseconds a frame, one reading: predicts the time of its turns */
  double prepared;        /* milliseconds to create its renderer */
  double readings[TRADEOFF_TURNS];
  size_t turns;
  struct quartiles ms;                /* of the readings, each the mean of the frames */
  double db[TRUTHS][TRADEOFF_FRAMES]; /* PSNR of each frame against a reference, 100 at most */
  double error;                       /* mean squared error against the exact render over all frames; colours 0..1 */
  double worst;                       /* largest difference of a colour from the exact render, 0..1 */
  struct place place[TRUTHS];
};

/* A compute unit that renders pictures. */
struct unit {
  char backend[16], isa[24];
  int device;
  ern_backend *made; /* NULL until its first use */
};

struct tradeoff {
  struct session session;
  struct portrait portrait;
  struct evaluation evaluation;
  struct frame_source speech; /* all frames of the split, used to find cells of low density */
  const char *folder;         /* of the results */
  bool made_folder;           /* this run created it */
  float seconds;              /* approximate time for the whole run */
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
  size_t not_reached[2]; /* points skipped for lack of time: single changes, combinations */
  size_t turns;
};

static inline size_t tradeoff_frames(const struct tradeoff *t) { return t->evaluation.frame_source.count; }
static inline size_t tradeoff_pixels(const struct tradeoff *t) {
  return (size_t)t->evaluation.info.width * (size_t)t->evaluation.info.height;
}
/* The points on the Pareto front against a reference, the fastest first. Returns their number. */
size_t tradeoff_front(const struct tradeoff *t, enum reference reference, size_t order[TRADEOFF_POINTS]);

#endif
