/* SPDX-License-Identifier: MIT
 * Plots of points and lines over two axes, with error bars and labels that keep out of each other's way: SVG or PNG,
 * drawn with cairo. */
#ifndef ERN_CLI_PLOT_H
#define ERN_CLI_PLOT_H

#include <stdbool.h>
#include <stddef.h>

#include "bytes.h"

enum plot_mark { PLOT_NONE, PLOT_DOT, PLOT_RING, PLOT_DIAMOND };

struct plot_series {
  const char *name;    /* in the legend; NULL: not there */
  const double *x, *y; /* [count]; a point that is not finite (or not above 0 on a logarithmic axis) is left out */
  const double *x_low, *x_high, *y_low, *y_high; /* [count] ends of error bars; NULL: none */
  const char *const *labels;                     /* [count] beside the points; NULL: none, also a single one */
  size_t count;
  unsigned colour; /* 0xRRGGBB */
  enum plot_mark mark;
  bool line; /* from point to point, in their order */
};

struct plot {
  const char *title, *x_label, *y_label; /* axes with their units */
  bool x_log, y_log;
  int width, height; /* pixels, points of the SVG */
  const struct plot_series *series;
  size_t count;
};

enum plot_form { PLOT_SVG, PLOT_PNG };
enum { PLOT_SHARPNESS = 2 /* pixels of a PNG to one of the plot */ };

/* Adds the file to `bytes`. Later series are drawn over earlier ones, and their labels find their places first. Returns
 * 0, or -1 without memory or where cairo fails. */
int plot_draw(const struct plot *plot, enum plot_form form, struct bytes *bytes);

/* Gives back what cairo and fontconfig keep from plot to plot; once, after the last one. */
void plot_end(void);

/* The PNG of a picture, rgb[height][width][3]. Returns as above. */
int plot_png(const unsigned char *rgb, int width, int height, struct bytes *bytes);

#endif
