/* SPDX-License-Identifier: MIT */
#include "output/curve.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "output/plot.h"

enum { CURVES = 24, LINE_BYTES = 256, PATH_BYTES = 4096, WIDTH = 900, HEIGHT = 560 };

void curve_free(struct curve *curve) {
  free(curve->point);
  *curve = (struct curve){0};
}

int curve_add(struct curve *curve, struct session *session, struct curve_point point) {
  while (curve->count > 0 && curve->point[curve->count - 1].step >= point.step) curve->count--;
  if (curve->count == curve->capacity) {
    const size_t capacity = 2 * curve->capacity + 64;
    struct curve_point *larger = capacity > curve->capacity ? realloc(curve->point, capacity * sizeof *larger) : NULL;
    if (larger == NULL) return session_fail_with(session, "no memory for a curve of %zu points", capacity);
    curve->point = larger;
    curve->capacity = capacity;
  }
  curve->point[curve->count++] = point;
  return 0;
}

static bool parse(const char *line, struct curve_point *point) {
  int used = 0;
  point->mouth = NAN;
  return sscanf(line, "%" SCNu64 ",%lf,%lf%n", &point->step, &point->seconds, &point->psnr, &used) == 3 &&
         strcmp(line + used, "\n") == 0;
}

int curve_read(struct curve *curve, struct session *session, const char *path) {
  static const char head[] = "step,seconds,psnr\n";
  char line[LINE_BYTES];
  int status = 0;
  struct stat about;
  if (stat(path, &about) == 0 && !S_ISREG(about.st_mode)) return session_fail_with(session, "%s: is no file", path);
  FILE *file = fopen(path, "r");
  if (file == NULL && errno == ENOENT) return 0;
  if (file == NULL) return session_fail_with(session, "%s: cannot be opened: %s", path, strerror(errno));
  for (size_t number = 1; status == 0 && fgets(line, sizeof line, file) != NULL; number++) {
    struct curve_point point;
    if (number == 1 ? strcmp(line, head) != 0 : !parse(line, &point))
      status = session_fail_with(session, "%s: line %zu is \"%.*s\", expected %s", path, number,
                                 (int)strcspn(line, "\n"), line, number == 1 ? "step,seconds,psnr" : "three numbers");
    else if (number > 1)
      status = curve_add(curve, session, point);
  }
  if (status == 0 && ferror(file)) status = session_fail_with(session, "%s: cannot be read", path);
  fclose(file);
  return status;
}

/* ---- plots ------------------------------------------------------------------------------------------------------- */

enum figure { PSNR_OVER_SECONDS, PSNR_OVER_STEPS, MOUTH_OVER_SECONDS };
static const struct {
  const char *name, *x_label, *y_label;
} figures[] = {{"seconds", "training, seconds", "validation PSNR, dB"},
               {"steps", "training steps", "validation PSNR, dB"},
               {"mouth_seconds", "training, seconds", "share of the mouth's motion explained"}};

static double across(enum figure figure, const struct curve_point *point) {
  return figure == PSNR_OVER_STEPS ? (double)point->step : point->seconds;
}

static double up(enum figure figure, const struct curve_point *point) {
  return figure == MOUTH_OVER_SECONDS ? point->mouth : point->psnr;
}

static int write_form(const struct plot *plot, enum plot_form form, struct session *session, const char *folder,
                      const char *stem, enum figure figure) {
  struct bytes bytes = {0};
  char path[PATH_BYTES];
  int status = EXIT_FAILURE;
  if (snprintf(path, sizeof path, "%s/%s_%s.%s", folder, stem, figures[figure].name,
               form == PLOT_SVG ? "svg" : "png") >= (int)sizeof path)
    session_fail_with(session, "%s: the name is too long", folder);
  else if (plot_draw(plot, form, &bytes) != 0 || bytes.failed)
    session_fail_with(session, "%s: cannot be drawn: no memory", path);
  else if (session->rewrites && session_skips_link(session, path))
    status = 0;
  else
    status = session_write(session, path, bytes.data, bytes.count);
  bytes_free(&bytes);
  return status;
}

static int draw(const struct curve_named *curves, size_t count, enum figure figure, struct session *session,
                const char *folder, const char *stem, const char *title) {
  /* Okabe and Ito's colours, distinguishable with colour blindness; further curves repeat them with other marks */
  static const unsigned colours[] = {0x0072B2, 0xD55E00, 0x009E73, 0xCC79A7, 0xE69F00, 0x56B4E9, 0x000000};
  static const enum plot_mark marks[] = {PLOT_DOT, PLOT_RING, PLOT_DIAMOND};
  enum { COLOURS = sizeof colours / sizeof *colours, MARKS = sizeof marks / sizeof *marks };
  struct plot_series series[CURVES];
  size_t points = 0, at = 0;
  if (count > CURVES) count = CURVES;
  for (size_t c = 0; c < count; c++) points += curves[c].curve->count;
  double *x = malloc((2 * points + 1) * sizeof *x);
  if (x == NULL) return session_fail_with(session, "no memory for a plot of %zu points", points);
  double *y = x + points;
  for (size_t c = 0; c < count; c++) {
    const struct curve *curve = curves[c].curve;
    series[c] = (struct plot_series){.name = count > 1 ? curves[c].name : NULL,
                                     .x = x + at,
                                     .y = y + at,
                                     .count = curve->count,
                                     .colour = colours[c % COLOURS],
                                     .mark = marks[c / COLOURS % MARKS],
                                     .line = true};
    for (size_t i = 0; i < curve->count; i++, at++) {
      x[at] = across(figure, &curve->point[i]);
      y[at] = up(figure, &curve->point[i]);
    }
  }
  const struct plot plot = {.title = title,
                            .x_label = figures[figure].x_label,
                            .y_label = figures[figure].y_label,
                            .width = WIDTH,
                            .height = HEIGHT,
                            .series = series,
                            .count = count};
  int status = write_form(&plot, PLOT_SVG, session, folder, stem, figure);
  if (status == 0) status = write_form(&plot, PLOT_PNG, session, folder, stem, figure);
  free(x);
  return status;
}

int curve_plot(const struct curve_named *curves, size_t count, struct session *session, const char *folder,
               const char *stem, const char *title) {
  const int status = draw(curves, count, PSNR_OVER_SECONDS, session, folder, stem, title);
  return status != 0 ? status : draw(curves, count, PSNR_OVER_STEPS, session, folder, stem, title);
}

int curve_plot_mouth(const struct curve_named *curves, size_t count, struct session *session, const char *folder,
                     const char *stem, const char *title) {
  return draw(curves, count, MOUTH_OVER_SECONDS, session, folder, stem, title);
}
