/* SPDX-License-Identifier: MIT */
#include "output/curve.h"

#include <errno.h>
#include <inttypes.h>
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
  if (curve->count == curve->room) {
    const size_t room = 2 * curve->room + 64;
    struct curve_point *larger = room > curve->room ? realloc(curve->point, room * sizeof *larger) : NULL;
    if (larger == NULL) return session_fail_with(session, "no memory for a curve of %zu points", room);
    curve->point = larger;
    curve->room = room;
  }
  curve->point[curve->count++] = point;
  return 0;
}

static bool parse(const char *line, struct curve_point *point) {
  int used = 0;
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

static int write_form(const struct plot *plot, enum plot_form form, struct session *session, const char *folder,
                      const char *stem, const char *over) {
  struct bytes bytes = {0};
  char path[PATH_BYTES];
  int status = EXIT_FAILURE;
  if (snprintf(path, sizeof path, "%s/%s_%s.%s", folder, stem, over, form == PLOT_SVG ? "svg" : "png") >=
      (int)sizeof path)
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

/* Values of all curves one behind the other: seconds, steps, PSNR. */
struct values {
  double *seconds, *steps, *psnr;
};

static int draw(const struct curve_named *curves, size_t count, const struct values *values, bool over_steps,
                struct session *session, const char *folder, const char *stem, const char *title) {
  /* Okabe and Ito's colours, told apart by all eyes */
  static const unsigned colours[] = {0x0072B2, 0xD55E00, 0x009E73, 0xCC79A7, 0xE69F00, 0x56B4E9, 0x000000};
  struct plot_series series[CURVES];
  size_t at = 0;
  for (size_t c = 0; c < count; c++) {
    const size_t points = curves[c].curve->count;
    series[c] = (struct plot_series){.name = count > 1 ? curves[c].name : NULL,
                                     .x = (over_steps ? values->steps : values->seconds) + at,
                                     .y = values->psnr + at,
                                     .count = points,
                                     .colour = colours[c % (sizeof colours / sizeof *colours)],
                                     .mark = PLOT_DOT,
                                     .line = true};
    at += points;
  }
  const struct plot plot = {.title = title,
                            .x_label = over_steps ? "training steps" : "training, seconds",
                            .y_label = "validation PSNR, dB",
                            .width = WIDTH,
                            .height = HEIGHT,
                            .series = series,
                            .count = count};
  const char *over = over_steps ? "steps" : "seconds";
  const int status = write_form(&plot, PLOT_SVG, session, folder, stem, over);
  return status != 0 ? status : write_form(&plot, PLOT_PNG, session, folder, stem, over);
}

int curve_plot(const struct curve_named *curves, size_t count, struct session *session, const char *folder,
               const char *stem, const char *title) {
  size_t points = 0, at = 0;
  if (count > CURVES) count = CURVES;
  for (size_t c = 0; c < count; c++) points += curves[c].curve->count;
  double *room = malloc((3 * points + 1) * sizeof *room);
  if (room == NULL) return session_fail_with(session, "no memory for a plot of %zu points", points);
  const struct values values = {room, room + points, room + 2 * points};
  for (size_t c = 0; c < count; c++)
    for (size_t i = 0; i < curves[c].curve->count; i++, at++) {
      const struct curve_point *point = &curves[c].curve->point[i];
      values.seconds[at] = point->seconds;
      values.steps[at] = (double)point->step;
      values.psnr[at] = point->psnr;
    }
  int status = 0;
  for (int over_steps = 0; over_steps < 2 && status == 0; over_steps++)
    status = draw(curves, count, &values, over_steps == 1, session, folder, stem, title);
  free(room);
  return status;
}
