/* SPDX-License-Identifier: MIT
 * The validation curve of a training, quality over time: reads X.run/curve.csv and draws plots. */
#ifndef ERN_CLI_CURVE_H
#define ERN_CLI_CURVE_H

#include <stdint.h>

#include "session/session.h"

struct curve_point {
  uint64_t step;
  double seconds, psnr; /* training time so far, without validations and saves; dB, mean over the frames */
  double mouth;         /* explained share of the mouth's motion, 1 at most; NaN: not known */
};

/* In the order of the steps. Zeroed: empty. */
struct curve {
  struct curve_point *point;
  size_t count, capacity;
};

void curve_free(struct curve *curve);
/* Returns 0, or EXIT_FAILURE after a message, as the next ones do. First removes the points at or after the step of
 * `point`: a training that resumed from an earlier state has made these steps again. */
int curve_add(struct curve *curve, struct session *session, struct curve_point point);
/* Reads "step,seconds,psnr" and one line for each validation; `mouth` is then not known. A missing file gives an empty
 * curve. */
int curve_read(struct curve *curve, struct session *session, const char *path);

/* A curve with its name in the legend. */
struct curve_named {
  const char *name;
  const struct curve *curve;
};
/* Writes FOLDER/STEM_seconds.svg and .png, PSNR over the seconds of training, and STEM_steps.svg and .png, over the
 * steps. Omits points that are not finite. */
int curve_plot(const struct curve_named *curves, size_t count, struct session *session, const char *folder,
               const char *stem, const char *title);
/* The same for the mouth's motion over the seconds: FOLDER/STEM_mouth_seconds.svg and .png. */
int curve_plot_mouth(const struct curve_named *curves, size_t count, struct session *session, const char *folder,
                     const char *stem, const char *title);

#endif
