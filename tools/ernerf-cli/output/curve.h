/* SPDX-License-Identifier: MIT
 * Quality over time: how a training's validations went, as X.run/curve.csv holds them, and plots of it. */
#ifndef ERN_CLI_CURVE_H
#define ERN_CLI_CURVE_H

#include <stdint.h>

#include "session/session.h"

struct curve_point {
  uint64_t step;
  double seconds, psnr; /* of training behind it, without validations and saves; dB, the mean of the frames */
  double mouth;         /* share of the mouth's motion that is explained, 1 at most; NaN: not known */
};

/* In the order of the steps. Zeroed: empty. */
struct curve {
  struct curve_point *point;
  size_t count, capacity;
};

void curve_free(struct curve *curve);
/* Returns 0, or EXIT_FAILURE after a message, as the next ones do. Points that are not before `point` go: a training
 * that went on from an earlier state has taken other steps since. */
int curve_add(struct curve *curve, struct session *session, struct curve_point point);
/* Reads "step,seconds,psnr" and a line a validation, which does not tell `mouth`. A file that is not there has none. */
int curve_read(struct curve *curve, struct session *session, const char *path);

/* A curve among others. */
struct curve_named {
  const char *name;
  const struct curve *curve;
};
/* Writes FOLDER/STEM_seconds.svg and .png, PSNR over the seconds of training, and STEM_steps.svg and .png, over the
 * steps. Points that are not finite are left out. */
int curve_plot(const struct curve_named *curves, size_t count, struct session *session, const char *folder,
               const char *stem, const char *title);
/* The same of the mouth's motion over the seconds: FOLDER/STEM_mouth_seconds.svg and .png. */
int curve_plot_mouth(const struct curve_named *curves, size_t count, struct session *session, const char *folder,
                     const char *stem, const char *title);

#endif
