/* SPDX-License-Identifier: MIT
 * Plots of points and lines over two axes, with error bars and non-overlapping labels, as SVG or PNG, drawn with cairo.
 */
#ifndef ERN_CLI_PLOT_H
#define ERN_CLI_PLOT_H

#include <stdbool.h>
#include <stddef.h>

#include "bytes.h"

enum plot_mark { PLOT_NONE, PLOT_DOT, PLOT_RING, PLOT_DIAMOND };

struct plot_series {
  const char *name;    /* in the legend; NULL: not in the legend */
  const double *x, *y; /* [count]; a point that is not finite (or not above 0 on a logarithmic axis) is left out */
  const double *x_low, *x_high, *y_low, *y_high; /* [count] ends of error bars; NULL: none */
  const char *const *labels;                     /* [count] beside the points; NULL: none; each may be NULL */
  size_t count;
  unsigned colour; /* 0xRRGGBB */
  enum plot_mark mark;
  bool line; /* connects the points in their order */
};

struct plot {
  const char *title, *x_label, *y_label; /* labels of the axes include units */
  bool x_log, y_log;
  int width, height; /* pixels, points of the SVG */
  const struct plot_series *series;
  size_t count;
};

enum plot_form { PLOT_SVG, PLOT_PNG };
enum { PLOT_SHARPNESS = 2 /* pixels of a PNG for one pixel of the plot */ };

/* Adds the file to `bytes`. Later series are drawn over earlier ones, and their labels are placed first. Returns 0, or
 * -1 without memory or where cairo fails. */
int plot_draw(const struct plot *plot, enum plot_form form, struct bytes *bytes);

/* Frees the caches of cairo and fontconfig; call it once, after the last plot. */
void plot_end(void);

/* Encodes a picture, rgb[height][width][3], as PNG. Returns as above. */
int plot_png(const unsigned char *rgb, int width, int height, struct bytes *bytes);

#endif
