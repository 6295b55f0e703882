/* SPDX-License-Identifier: MIT */
#include "output/plot.h"

#include <cairo-svg.h>
#include <cairo.h>
#include <fontconfig/fontconfig.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "output/plot_axis.h"

enum {
  LEFT = 74,
  RIGHT = 24,
  TOP = 62,
  BOTTOM = 58,
  LEGEND_ROW = 18,
  TEXT_BYTES = 1024,
  TICKS_ACROSS = 9,
  TICKS_DOWN = 7
};
static const double text_size = 13, small_size = 11.5, title_size = 15, mark_radius = 4.5, cap = 3.5;
static const unsigned ink = 0x22272b, faint = 0xe3e7ea;

struct box {
  double left, top, right, bottom;
};

struct drawing {
  cairo_t *cairo;
  const struct plot *plot;
  struct plot_axis x, y;
  struct box *taken; /* areas closed to labels: marks, error bars, lines, placed labels */
  size_t taken_count, taken_capacity;
  bool no_memory;
};

static void set_colour(cairo_t *cairo, unsigned rgb, double alpha) {
  cairo_set_source_rgba(cairo, (rgb >> 16 & 255) / 255.0, (rgb >> 8 & 255) / 255.0, (rgb & 255) / 255.0, alpha);
}

/* ---- text -------------------------------------------------------------------------------------------------------- */

/* Names of files may be of any bytes; cairo draws nothing more after one that is not UTF-8. */
static void measure_text(cairo_t *cairo, const char *text, cairo_text_extents_t *text_box) {
  char valid[TEXT_BYTES];
  bytes_utf8(valid, sizeof valid, text);
  cairo_text_extents(cairo, valid, text_box);
}

/* across, down: anchor of the text at (x, y): 0 left or top, 0.5 centre, 1 right or bottom. */
static void put_text(cairo_t *cairo, const char *text, double x, double y, double across, double down) {
  cairo_text_extents_t text_box;
  cairo_font_extents_t font;
  char valid[TEXT_BYTES];
  bytes_utf8(valid, sizeof valid, text);
  cairo_text_extents(cairo, valid, &text_box);
  cairo_font_extents(cairo, &font);
  cairo_move_to(cairo, x - across * text_box.x_advance, y + font.ascent - down * (font.ascent + font.descent));
  cairo_show_text(cairo, valid);
}

static void tick_text(double value, char text[32]) {
  snprintf(text, 32, fabs(value) >= 1e6 || (value != 0 && fabs(value) < 1e-4) ? "%.3g" : "%.10g", value);
  if (fabs(value) < 1e-12) snprintf(text, 32, "0");
}

/* ---- axes -------------------------------------------------------------------------------------------------------- */

static void draw_ticks(struct drawing *d) {
  double ticks[PLOT_MOST_TICKS];
  char text[32];
  cairo_set_font_size(d->cairo, small_size);
  cairo_set_line_width(d->cairo, 1);
  for (int axis = 0; axis < 2; axis++) {
    const struct plot_axis *along = axis == 0 ? &d->x : &d->y;
    const size_t count = plot_axis_ticks(along, axis == 0 ? TICKS_ACROSS : TICKS_DOWN, ticks);
    for (size_t i = 0; i < count; i++) {
      const double at = plot_axis_at(along, ticks[i]);
      set_colour(d->cairo, faint, 1);
      cairo_move_to(d->cairo, axis == 0 ? at : d->x.begin, axis == 0 ? d->y.begin : at);
      cairo_line_to(d->cairo, axis == 0 ? at : d->x.end, axis == 0 ? d->y.end : at);
      cairo_stroke(d->cairo);
      set_colour(d->cairo, ink, 1);
      tick_text(ticks[i], text);
      if (axis == 0)
        put_text(d->cairo, text, at, d->y.begin + 6, 0.5, 0);
      else
        put_text(d->cairo, text, d->x.begin - 7, at, 1, 0.5);
    }
  }
}

static void draw_frame(struct drawing *d) {
  const struct plot *plot = d->plot;
  cairo_t *cairo = d->cairo;
  set_colour(cairo, 0xffffff, 1);
  cairo_paint(cairo);
  draw_ticks(d);
  set_colour(cairo, ink, 1);
  cairo_rectangle(cairo, d->x.begin, d->y.end, d->x.end - d->x.begin, d->y.begin - d->y.end);
  cairo_stroke(cairo);
  cairo_set_font_size(cairo, text_size);
  put_text(cairo, plot->x_label, (d->x.begin + d->x.end) / 2, plot->height - 10, 0.5, 1);
  cairo_save(cairo);
  cairo_translate(cairo, 8, (d->y.begin + d->y.end) / 2);
  cairo_rotate(cairo, -acos(0));
  put_text(cairo, plot->y_label, 0, 0, 0.5, 0);
  cairo_restore(cairo);
  cairo_set_font_size(cairo, title_size);
  put_text(cairo, plot->title, d->x.begin, 12, 0, 0);
}

/* ---- marks ------------------------------------------------------------------------------------------------------- */

static bool is_shown(const struct drawing *d, const struct plot_series *s, size_t i) {
  return plot_axis_shows(&d->x, s->x[i]) && plot_axis_shows(&d->y, s->y[i]);
}

static void draw_mark(cairo_t *cairo, enum plot_mark mark, double x, double y, unsigned colour) {
  const double r = mark == PLOT_DIAMOND ? 1.5 * mark_radius : mark_radius;
  cairo_new_path(cairo);
  if (mark == PLOT_DIAMOND) {
    cairo_move_to(cairo, x - r, y);
    cairo_line_to(cairo, x, y - r);
    cairo_line_to(cairo, x + r, y);
    cairo_line_to(cairo, x, y + r);
    cairo_close_path(cairo);
  } else {
    cairo_arc(cairo, x, y, r, 0, 4 * acos(0));
  }
  set_colour(cairo, mark == PLOT_RING ? 0xffffff : colour, 1);
  cairo_fill_preserve(cairo);
  set_colour(cairo, colour, 1);
  cairo_stroke(cairo);
}

static void take(struct drawing *d, struct box box) {
  if (d->taken_count == d->taken_capacity) {
    const size_t capacity = 2 * d->taken_capacity + 64;
    struct box *grown = realloc(d->taken, capacity * sizeof *grown);
    d->no_memory |= grown == NULL;
    if (grown == NULL) return;
    d->taken = grown;
    d->taken_capacity = capacity;
  }
  d->taken[d->taken_count++] = box;
}

/* Reserves the line from (x, y) to the next point as small boxes. */
static void take_line(struct drawing *d, double x, double y, double to_x, double to_y) {
  const int steps = (int)ceil(hypot(to_x - x, to_y - y) / 6);
  for (int k = 1; k < steps; k++) {
    const double at_x = x + (to_x - x) * k / steps, at_y = y + (to_y - y) * k / steps;
    take(d, (struct box){at_x - 1.5, at_y - 1.5, at_x + 1.5, at_y + 1.5});
  }
}

/* Draws an error bar from `low` to `high` of one axis, with caps. */
static void draw_bar(struct drawing *d, bool upright, double x, double y, double low, double high) {
  const struct plot_axis *axis = upright ? &d->y : &d->x;
  if (!plot_axis_shows(axis, low) || !plot_axis_shows(axis, high)) return;
  const double ends[2] = {plot_axis_at(axis, low), plot_axis_at(axis, high)};
  cairo_move_to(d->cairo, upright ? x : ends[0], upright ? ends[0] : y);
  cairo_line_to(d->cairo, upright ? x : ends[1], upright ? ends[1] : y);
  for (int e = 0; e < 2; e++) {
    cairo_move_to(d->cairo, upright ? x - cap : ends[e], upright ? ends[e] : y - cap);
    cairo_line_to(d->cairo, upright ? x + cap : ends[e], upright ? ends[e] : y + cap);
  }
  cairo_stroke(d->cairo);
  take_line(d, upright ? x : ends[0], upright ? ends[0] : y, upright ? x : ends[1], upright ? ends[1] : y);
}

static void draw_line(struct drawing *d, const struct plot_series *s) {
  bool open = false;
  double last[2] = {0, 0};
  cairo_set_line_width(d->cairo, 1.6);
  cairo_new_path(d->cairo);
  for (size_t i = 0; i < s->count; i++) {
    if (!is_shown(d, s, i)) continue;
    const double x = plot_axis_at(&d->x, s->x[i]), y = plot_axis_at(&d->y, s->y[i]);
    if (open) {
      cairo_line_to(d->cairo, x, y);
      take_line(d, last[0], last[1], x, y);
    } else {
      cairo_move_to(d->cairo, x, y);
    }
    last[0] = x;
    last[1] = y;
    open = true;
  }
  cairo_stroke(d->cairo);
}

static void draw_series(struct drawing *d, const struct plot_series *s) {
  set_colour(d->cairo, s->colour, 1);
  if (s->line) draw_line(d, s);
  cairo_set_line_width(d->cairo, 1.2);
  for (size_t i = 0; i < s->count && s->mark != PLOT_NONE; i++) {
    if (!is_shown(d, s, i)) continue;
    const double x = plot_axis_at(&d->x, s->x[i]), y = plot_axis_at(&d->y, s->y[i]), r = mark_radius + 1.5;
    set_colour(d->cairo, s->colour, 0.55);
    if (s->x_low != NULL) draw_bar(d, false, x, y, s->x_low[i], s->x_high[i]);
    if (s->y_low != NULL) draw_bar(d, true, x, y, s->y_low[i], s->y_high[i]);
    draw_mark(d->cairo, s->mark, x, y, s->colour);
    take(d, (struct box){x - r, y - r, x + r, y + r});
  }
}

/* ---- labels ------------------------------------------------------------------------------------------------------ */

static bool overlap(const struct box *a, const struct box *b) {
  return a->left < b->right && b->left < a->right && a->top < b->bottom && b->top < a->bottom;
}

static bool is_free(const struct drawing *d, const struct box *box) {
  if (box->left < d->x.begin + 2 || box->right > d->x.end - 2 || box->top < d->y.end + 2 ||
      box->bottom > d->y.begin - 2)
    return false;
  for (size_t i = 0; i < d->taken_count; i++)
    if (overlap(box, &d->taken[i])) return false;
  return true;
}

/* Finds a free place for a label near (x, y), the nearest first; false: none, and the label is omitted. */
static bool find_place(const struct drawing *d, double x, double y, double width, double height, struct box *box) {
  static const double ways[][2] = {{1, 0}, {-1, 0}, {0, -1}, {0, 1}, {1, -1}, {1, 1}, {-1, -1}, {-1, 1}};
  for (int distance = 8; distance < 140; distance += 6)
    for (size_t k = 0; k < sizeof ways / sizeof *ways; k++) {
      const double dx = ways[k][0], dy = ways[k][1];
      const double left = x + dx * distance - (dx > 0 ? 0 : dx < 0 ? width : width / 2);
      const double top = y + dy * distance - (dy > 0 ? 0 : dy < 0 ? height : height / 2);
      *box = (struct box){left, top, left + width, top + height};
      if (is_free(d, box)) return true;
    }
  return false;
}

static void draw_label(struct drawing *d, const char *text, double x, double y, unsigned colour) {
  cairo_text_extents_t text_box;
  cairo_font_extents_t font;
  struct box box;
  cairo_set_font_size(d->cairo, small_size);
  measure_text(d->cairo, text, &text_box);
  cairo_font_extents(d->cairo, &font);
  if (!find_place(d, x, y, text_box.x_advance + 4, font.ascent + font.descent, &box)) return;
  take(d, box);
  /* the nearest point of the label */
  const double to_x = fmin(fmax(x, box.left), box.right), to_y = fmin(fmax(y, box.top), box.bottom);
  if (hypot(to_x - x, to_y - y) > 14) {
    set_colour(d->cairo, colour, 0.5);
    cairo_set_line_width(d->cairo, 0.8);
    cairo_move_to(d->cairo, x, y);
    cairo_line_to(d->cairo, to_x, to_y);
    cairo_stroke(d->cairo);
  }
  set_colour(d->cairo, 0xffffff, 0.8);
  cairo_rectangle(d->cairo, box.left, box.top, box.right - box.left, box.bottom - box.top);
  cairo_fill(d->cairo);
  set_colour(d->cairo, colour, 1);
  put_text(d->cairo, text, box.left + 2, box.top, 0, 0);
}

static void draw_labels(struct drawing *d) {
  for (size_t k = d->plot->count; k-- > 0;) {
    const struct plot_series *s = &d->plot->series[k];
    for (size_t i = 0; i < s->count && s->labels != NULL; i++)
      if (s->labels[i] != NULL && is_shown(d, s, i))
        draw_label(d, s->labels[i], plot_axis_at(&d->x, s->x[i]), plot_axis_at(&d->y, s->y[i]), s->colour);
  }
}

/* Draws a legend entry; x, y: centre of its mark. */
static void draw_entry(struct drawing *d, const struct plot_series *s, double x, double y) {
  set_colour(d->cairo, ink, 1);
  put_text(d->cairo, s->name, x + 12, y, 0, 0.5);
  cairo_set_line_width(d->cairo, 1.4);
  set_colour(d->cairo, s->colour, 1);
  cairo_move_to(d->cairo, x - 9, y);
  cairo_line_to(d->cairo, x + 9, y);
  if (s->line) cairo_stroke(d->cairo);
  if (s->mark != PLOT_NONE) draw_mark(d->cairo, s->mark, x, y, s->colour);
}

/* Lays out the legend as right-aligned rows above the frame; entries that do not fit go to the row above. Returns the
 * number of rows. */
static int lay_legend(struct drawing *d, bool draws) {
  double right = d->x.end;
  int row = 0;
  cairo_text_extents_t text_box;
  cairo_set_font_size(d->cairo, small_size);
  for (size_t k = d->plot->count; k-- > 0;) {
    const struct plot_series *s = &d->plot->series[k];
    if (s->name == NULL || s->count == 0) continue;
    measure_text(d->cairo, s->name, &text_box);
    const double begin = right - text_box.x_advance - 21;
    if (begin < LEFT && right < d->x.end) {
      right = d->x.end;
      row++;
    }
    right -= text_box.x_advance + 12;
    if (draws) draw_entry(d, s, right, d->y.end - 14 - row * LEGEND_ROW);
    right -= 26;
  }
  return row + 1;
}

/* ---- the whole --------------------------------------------------------------------------------------------------- */

static void reach(double range[2], const double *values, size_t i, bool log) {
  if (values == NULL || !isfinite(values[i]) || (log && values[i] <= 0)) return;
  range[0] = fmin(range[0], values[i]);
  range[1] = fmax(range[1], values[i]);
}

/* Chooses the ends of the axes around all points and their error bars. */
static void lay_out(struct drawing *d) {
  const struct plot *plot = d->plot;
  double across[2] = {INFINITY, -INFINITY}, down[2] = {INFINITY, -INFINITY};
  d->x.log = plot->x_log;
  d->y.log = plot->y_log;
  for (size_t k = 0; k < plot->count; k++)
    for (size_t i = 0; i < plot->series[k].count; i++) {
      const struct plot_series *s = &plot->series[k];
      if (!is_shown(d, s, i)) continue;
      reach(across, s->x, i, plot->x_log);
      reach(across, s->x_low, i, plot->x_log);
      reach(across, s->x_high, i, plot->x_log);
      reach(down, s->y, i, plot->y_log);
      reach(down, s->y_low, i, plot->y_log);
      reach(down, s->y_high, i, plot->y_log);
    }
  d->x = plot_axis_around(across[0], across[1], plot->x_log);
  d->y = plot_axis_around(down[0], down[1], plot->y_log);
  d->x.begin = LEFT;
  d->x.end = plot->width - RIGHT;
  d->y.begin = plot->height - BOTTOM;
  d->y.end = TOP;
}

static cairo_status_t add_bytes(void *user, const unsigned char *data, unsigned count) {
  struct bytes *bytes = user;
  bytes_add(bytes, data, count);
  return bytes->failed ? CAIRO_STATUS_NO_MEMORY : CAIRO_STATUS_SUCCESS;
}

static void draw_all(struct drawing *d) {
  cairo_select_font_face(d->cairo, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
  d->y.end += LEGEND_ROW * (lay_legend(d, false) - 1);
  draw_frame(d);
  for (size_t k = 0; k < d->plot->count; k++) draw_series(d, &d->plot->series[k]);
  draw_labels(d);
  (void)lay_legend(d, true);
}

int plot_draw(const struct plot *plot, enum plot_form form, struct bytes *bytes) {
  struct drawing d = {.plot = plot};
  lay_out(&d);
  cairo_surface_t *surface =
      form == PLOT_SVG
          ? cairo_svg_surface_create_for_stream(add_bytes, bytes, plot->width, plot->height)
          : cairo_image_surface_create(CAIRO_FORMAT_RGB24, PLOT_SHARPNESS * plot->width, PLOT_SHARPNESS * plot->height);
  d.cairo = cairo_create(surface);
  if (form == PLOT_PNG) cairo_scale(d.cairo, PLOT_SHARPNESS, PLOT_SHARPNESS);
  draw_all(&d);
  bool good = !d.no_memory && cairo_status(d.cairo) == CAIRO_STATUS_SUCCESS;
  cairo_destroy(d.cairo);
  if (form == PLOT_PNG)
    good = good && cairo_surface_write_to_png_stream(surface, add_bytes, bytes) == CAIRO_STATUS_SUCCESS;
  cairo_surface_finish(surface);
  good = good && cairo_surface_status(surface) == CAIRO_STATUS_SUCCESS && !bytes->failed;
  cairo_surface_destroy(surface);
  free(d.taken);
  return good ? 0 : -1;
}

void plot_end(void) {
  cairo_debug_reset_static_data();
  FcFini();
}

int plot_png(const unsigned char *rgb, int width, int height, struct bytes *bytes) {
  cairo_surface_t *surface = cairo_image_surface_create(CAIRO_FORMAT_RGB24, width, height);
  bool good = cairo_surface_status(surface) == CAIRO_STATUS_SUCCESS;
  if (good) {
    unsigned char *data = cairo_image_surface_get_data(surface);
    const size_t stride = (size_t)cairo_image_surface_get_stride(surface);
    for (size_t y = 0; y < (size_t)height; y++)
      for (size_t x = 0; x < (size_t)width; x++) {
        const unsigned char *from = rgb + 3 * (y * (size_t)width + x);
        const uint32_t word = (uint32_t)from[0] << 16 | (uint32_t)from[1] << 8 | from[2];
        memcpy(data + y * stride + 4 * x, &word, sizeof word);
      }
    cairo_surface_mark_dirty(surface);
    good = cairo_surface_write_to_png_stream(surface, add_bytes, bytes) == CAIRO_STATUS_SUCCESS && !bytes->failed;
  }
  cairo_surface_destroy(surface);
  return good ? 0 : -1;
}
