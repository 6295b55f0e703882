/* SPDX-License-Identifier: MIT
 * The figures of two portraits: for each frame, as means, as JSON, as a table. */
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>

#include "lab/compare.h"

const char compare_letters[COMPARE_SIDES] = {'A', 'B'};
const char *const compare_shown_names[COMPARE_SHOWN] = {"best", "median", "worst"};
const struct compare_figure compare_figures[COMPARE_FIGURES] = {{"psnr", "PSNR", 3, false},
                                                                {"ssim", "SSIM", 5, false},
                                                                {"psnr_head", "PSNR head", 3, false},
                                                                {"psnr_mouth", "PSNR mouth", 3, false},
                                                                {"lpips", "LPIPS (smaller is better)", 5, true}};

size_t compare_figure_count(const struct compare *c) {
  return c->perceptual.weights.lpips != NULL ? COMPARE_FIGURES : COMPARE_FIGURES - 1;
}

size_t compare_frames(const struct compare *c) { return c->side[0].evaluation.frame_source.count; }

const struct source_frame *compare_frame(const struct compare *c, size_t k) {
  return &c->side[0].evaluation.frame_source.source_frame[k];
}

double compare_value(const struct compare *c, size_t side, size_t k, size_t figure) {
  const struct evaluated *e = &c->evaluated[side][k];
  const double values[COMPARE_FIGURES] = {e->psnr, e->ssim, e->has_head ? e->head : NAN, e->has_mouth ? e->mouth : NAN,
                                          c->lpips[side] != NULL ? c->lpips[side][k] : NAN};
  return values[figure];
}

double compare_difference(const struct compare *c, size_t k, size_t figure) {
  return compare_value(c, 1, k, figure) - compare_value(c, 0, k, figure);
}

/* ---- over the frames --------------------------------------------------------------------------------------------- */

/* The row of a side; side COMPARE_SIDES: of the differences. */
static json_t *row_of(const struct compare *c, size_t side, size_t k) {
  json_t *row = json_object();
  for (size_t f = 0; f < compare_figure_count(c); f++) {
    const double value = side < COMPARE_SIDES ? compare_value(c, side, k, f) : compare_difference(c, k, f);
    json_object_set_new(row, compare_figures[f].name, session_number(value));
  }
  return row;
}

int compare_make_rows(struct compare *c) {
  const size_t count = compare_frames(c);
  double *difference = malloc(count * sizeof *difference);
  bool made = difference != NULL;
  for (size_t side = 0; side <= COMPARE_SIDES; side++) {
    c->rows[side] = json_array();
    for (size_t k = 0; k < count; k++) made &= json_array_append_new(c->rows[side], row_of(c, side, k)) == 0;
  }
  for (size_t k = 0; k < count && made; k++) {
    const double psnr = compare_difference(c, k, 0);
    difference[k] = isnan(psnr) ? -INFINITY : psnr;
  }
  made = made && frame_figures_rank(difference, count, c->shown) == 0;
  free(difference);
  return made ? 0 : session_fail_with(&c->session, "no memory for the figures of %zu frames", count);
}

struct compare_summary compare_summarise(const struct compare *c, size_t figure) {
  const char *name = compare_figures[figure].name;
  const bool smaller = compare_figures[figure].smaller;
  struct compare_summary s = {.difference = 0};
  size_t n = 0;
  for (size_t k = 0; k < compare_frames(c); k++) {
    const double a = compare_value(c, 0, k, figure), b = compare_value(c, 1, k, figure);
    if (isnan(a) || isnan(b)) continue;
    n++;
    s.mean[0] += a;
    s.mean[1] += b;
    s.difference += b - a;
    s.wins[0] += smaller ? a < b : a > b;
    s.wins[1] += smaller ? b < a : b > a;
    s.equal += a == b;
  }
  for (size_t side = 0; side < COMPARE_SIDES; side++) {
    s.mean[side] = n > 0 ? s.mean[side] / (double)n : NAN;
    s.interval[side] = frame_figures_interval(c->rows[side], name);
  }
  s.difference = n > 0 ? s.difference / (double)n : NAN;
  s.difference_interval = frame_figures_interval(c->rows[COMPARE_SIDES], name);
  return s;
}

void compare_measures(const struct compare *c, struct compare_measure measures[COMPARE_MEASURES]) {
  static const struct {
    const char *title, *best;
  } rows[COMPARE_MEASURES] = {{"mouth: share of its motion", "1"},
                              {"mouth: correlation", "1"},
                              {"mouth: amplitude", "1"},
                              {"sharpness of the head", "1"},
                              {"sharpness of the mouth", "1"},
                              {"seam at the neck, of 255", "0"},
                              {"tremble: unevenness of the motion", "1"}};
  for (size_t i = 0; i < COMPARE_MEASURES; i++)
    measures[i] = (struct compare_measure){.title = rows[i].title, .best = rows[i].best};
  for (size_t side = 0; side < COMPARE_SIDES; side++) {
    const struct measures_figures f = measures_figures(&c->side[side].measures);
    const double values[COMPARE_MEASURES] = {f.mouth.known ? f.mouth.explained : NAN,
                                             f.mouth.known ? f.mouth.correlation : NAN,
                                             f.mouth.known ? f.mouth.amplitude : NAN,
                                             f.sharpness_head,
                                             f.sharpness_mouth,
                                             f.seam,
                                             f.tremble};
    for (size_t i = 0; i < COMPARE_MEASURES; i++) measures[i].value[side] = values[i];
  }
}

/* ---- JSON -------------------------------------------------------------------------------------------------------- */

static json_t *side_json(const struct compare *c, size_t side) {
  const struct measures_figures measures = measures_figures(&c->side[side].measures);
  json_t *made =
      json_pack("{s:o, s:s}", "file", session_text(c->path[side]), "kind", compare_side_kind(&c->side[side]));
  json_t *intervals = json_object();
  for (size_t f = 0; f < compare_figure_count(c); f++) {
    const struct compare_summary s = compare_summarise(c, f);
    json_object_set_new(made, compare_figures[f].name, session_number(s.mean[side]));
    json_object_set_new(intervals, compare_figures[f].name, session_number(s.interval[side]));
  }
  json_object_set_new(made, "interval95", intervals);
  json_object_set_new(made, "measures", measures_json(&measures));
  return made;
}

static json_t *difference_json(const struct compare *c) {
  json_t *made = json_object();
  for (size_t f = 0; f < compare_figure_count(c); f++) {
    const struct compare_summary s = compare_summarise(c, f);
    json_t *row = json_pack("{s:o, s:o, s:I, s:I, s:I}", "mean", session_number(s.difference), "interval95",
                            session_number(s.difference_interval), "frames_a_wins", (json_int_t)s.wins[0],
                            "frames_b_wins", (json_int_t)s.wins[1], "frames_equal", (json_int_t)s.equal);
    json_object_set_new(made, compare_figures[f].name, row);
  }
  return made;
}

static const char *split_of(const struct source_frame *frame) {
  return frame->split == ERN_SPLIT_VAL ? "val" : "train";
}

static json_t *frames_json(const struct compare *c) {
  json_t *made = json_array();
  for (size_t k = 0; k < compare_frames(c); k++) {
    const struct source_frame *frame = compare_frame(c, k);
    json_array_append_new(
        made, json_pack("{s:I, s:s, s:O, s:O, s:O}", "id", (json_int_t)frame->pose.img_id, "split", split_of(frame),
                        "a", json_array_get(c->rows[0], k), "b", json_array_get(c->rows[1], k), "difference",
                        json_array_get(c->rows[COMPARE_SIDES], k)));
  }
  return made;
}

json_t *compare_json(const struct compare *c) {
  static const char *const splits[] = {"train", "val", "all"};
  const ern_clip_info *info = &c->side[0].evaluation.info;
  const ern_backend_info *backend = &c->session.backend_info;
  const bool computed = c->session.backend != NULL;
  json_t *shown = json_object();
  for (size_t i = 0; i < COMPARE_SHOWN; i++)
    json_object_set_new(shown, compare_shown_names[i],
                        json_integer((json_int_t)compare_frame(c, c->shown[i])->pose.img_id));
  const ern_lpips *lpips = c->perceptual.weights.lpips;
  return json_pack("{s:s, s:i, s:o, s:s, s:s, s:i, s:i, s:I, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "format",
                   "ernerf.compare", "version", 1, "clip", session_text(c->asked.source.path), "against", "clip",
                   "split", splits[c->asked.split], "width", info->width, "height", info->height, "count",
                   (json_int_t)compare_frames(c), "a", side_json(c, 0), "b", side_json(c, 1), "lpips_network",
                   lpips != NULL ? json_string(ern_lpips_name(lpips)) : json_null(), "difference", difference_json(c),
                   "shown", shown, "backend", computed ? json_string(backend->name) : json_null(), "isa",
                   computed ? json_string(backend->isa) : json_null(), "frames", frames_json(c));
}

/* ---- text -------------------------------------------------------------------------------------------------------- */

void compare_csv(const struct compare *c, struct bytes *csv) {
  bytes_print(csv, "frame,split");
  for (size_t f = 0; f < compare_figure_count(c); f++) {
    const char *name = compare_figures[f].name;
    bytes_print(csv, ",%s_a,%s_b,%s_difference", name, name, name);
  }
  bytes_print(csv, "\n");
  for (size_t k = 0; k < compare_frames(c); k++) {
    const struct source_frame *frame = compare_frame(c, k);
    bytes_print(csv, "%" PRId64 ",%s", frame->pose.img_id, split_of(frame));
    for (size_t f = 0; f < compare_figure_count(c); f++) {
      const double values[] = {compare_value(c, 0, k, f), compare_value(c, 1, k, f), compare_difference(c, k, f)};
      for (size_t i = 0; i < sizeof values / sizeof *values; i++)
        if (isfinite(values[i]))
          bytes_print(csv, ",%.*f", compare_figures[f].digits + 1, values[i]);
        else
          bytes_print(csv, ",");
    }
    bytes_print(csv, "\n");
  }
}

static void add_number(struct bytes *text, double value, int digits) {
  if (isfinite(value))
    bytes_print(text, "  %10.*f", digits, value);
  else
    bytes_print(text, "  %10s", "-");
}

void compare_text(const struct compare *c, struct bytes *text) {
  struct compare_measure measures[COMPARE_MEASURES];
  compare_measures(c, measures);
  for (size_t side = 0; side < COMPARE_SIDES; side++)
    bytes_print(text, "%c: %s, %s\n", compare_letters[side], c->path[side], compare_side_kind(&c->side[side]));
  bytes_print(text, "\n%-34s  %10s  %10s  %10s  %10s  %8s  %8s  %8s\n", "", "A", "B", "B - A", "95 % +-", "A better",
              "B better", "equal");
  for (size_t f = 0; f < compare_figure_count(c); f++) {
    const struct compare_summary s = compare_summarise(c, f);
    const double values[] = {s.mean[0], s.mean[1], s.difference, s.difference_interval};
    bytes_print(text, "%-34s", compare_figures[f].title);
    for (size_t i = 0; i < sizeof values / sizeof *values; i++) add_number(text, values[i], compare_figures[f].digits);
    bytes_print(text, "  %8zu  %8zu  %8zu\n", s.wins[0], s.wins[1], s.equal);
  }
  for (size_t i = 0; i < COMPARE_MEASURES; i++) {
    const struct compare_measure *m = &measures[i];
    if (!isfinite(m->value[0]) && !isfinite(m->value[1])) continue;
    bytes_print(text, "%-34s", m->title);
    add_number(text, m->value[0], 3);
    add_number(text, m->value[1], 3);
    bytes_print(text, "   (the recorded frames have %s)\n", m->best);
  }
  bytes_print(text,
              "\nmeans of %zu frames; the last columns count frames\ncompared with the clip's pictures, "
              "gt_imgs\n%s/index.html\n",
              compare_frames(c), c->folder);
}
