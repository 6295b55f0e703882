/* SPDX-License-Identifier: MIT */
#include "lab/tradeoff_files.h"

#include <math.h>

static const double colour_steps = 255; /* levels of 8 bits */

const char *tradeoff_standing(const struct point *point, enum reference reference) {
  static const char *const names[] = {"front", "dominated", "equal"};
  return names[point->place[reference].standing];
}

/* ---- table ------------------------------------------------------------------------------------------------------- */

void tradeoff_csv(const struct tradeoff *t, struct bytes *csv) {
  bytes_print(csv,
              "name,max_steps,transmittance_stop,occupancy_threshold,image_scale,backend,isa,device,threads,"
              "turns,ms_median,ms_quartile_1,ms_quartile_3,fps_of_median,"
              "exact_psnr_db_mean,exact_psnr_db_deviation,exact_worst_of_255,exact_standing,exact_by,"
              "clip_psnr_db_mean,clip_psnr_db_deviation,clip_standing,clip_by\n");
  for (size_t i = 0; i < t->count; i++) {
    const struct point *p = &t->points[i];
    const struct settings *s = &p->settings;
    bytes_print_csv(csv, p->name);
    bytes_print(csv, ",%d,%.6g,%.6g,%.6g,%s,%s,%d,%d,%zu,%.4f,%.4f,%.4f,%.3f", s->max_steps,
                (double)s->transmittance_stop, (double)s->occupancy_threshold, (double)s->image_scale, s->backend,
                s->isa, s->device, s->threads, p->turns, p->ms.median, p->ms.low, p->ms.high, 1000 / p->ms.median);
    for (enum reference reference = 0; reference < TRUTHS; reference++) {
      const struct mean_and_deviation m = mean_of(p->db[reference], tradeoff_frames(t));
      bytes_print(csv, ",%.4f,%.4f", m.mean, m.deviation);
      if (reference == REFERENCE_EXACT) bytes_print(csv, ",%.3f", p->worst * colour_steps);
      bytes_print(csv, ",%s,", tradeoff_standing(p, reference));
      bytes_print_csv(csv, t->points[p->place[reference].by].name);
    }
    bytes_print(csv, "\n");
  }
}

/* ---- JSON -------------------------------------------------------------------------------------------------------- */

static json_t *truth_json(const struct tradeoff *t, const struct point *p, enum reference reference) {
  const struct mean_and_deviation m = mean_of(p->db[reference], tradeoff_frames(t));
  json_t *db = json_array();
  for (size_t k = 0; k < tradeoff_frames(t); k++) json_array_append_new(db, json_real(p->db[reference][k]));
  return json_pack("{s:f, s:f, s:o, s:s, s:I}", "psnr_db_mean", m.mean, "psnr_db_deviation", m.deviation, "psnr_db", db,
                   "standing", tradeoff_standing(p, reference), "by", (json_int_t)p->place[reference].by);
}

static json_t *point_json(const struct tradeoff *t, const struct point *p) {
  json_t *readings = json_array();
  for (size_t k = 0; k < p->turns; k++) json_array_append_new(readings, json_real(p->readings[k]));
  json_t *ms = json_pack("{s:f, s:f, s:f, s:o}", "median", p->ms.median, "quartile_1", p->ms.low, "quartile_3",
                         p->ms.high, "turns", readings);
  return json_pack("{s:s, s:o, s:f, s:o, s:f, s:f, s:o, s:o}", "name", p->name, "settings", settings_json(&p->settings),
                   "prepare_ms", p->prepared, "ms_per_frame", ms, "fps", 1000 / p->ms.median, "exact_worst_of_255",
                   p->worst * colour_steps, "exact", truth_json(t, p, REFERENCE_EXACT), "clip",
                   truth_json(t, p, REFERENCE_CLIP));
}

static json_t *front_json(const struct tradeoff *t, enum reference reference) {
  size_t order[TRADEOFF_POINTS];
  const size_t count = tradeoff_front(t, reference, order);
  json_t *front = json_array();
  for (size_t i = 0; i < count; i++) json_array_append_new(front, json_integer((json_int_t)order[i]));
  return front;
}

json_t *tradeoff_json(const struct tradeoff *t) {
  static const char *const splits[] = {"train", "val", "all"};
  json_t *frames = json_array(), *points = json_array();
  for (size_t k = 0; k < tradeoff_frames(t); k++)
    json_array_append_new(frames, json_integer(t->evaluation.frame_source.source_frame[k].pose.img_id));
  for (size_t i = 0; i < t->count; i++) json_array_append_new(points, point_json(t, &t->points[i]));
  json_t *machine = json_pack("{s:s, s:i, s:s, s:s}", "cpu", t->cpu, "cores", t->cores, "instruction_sets",
                              t->instruction_sets, "opencl_device", t->device_name);
  json_t *model = json_pack("{s:o, s:s, s:s, s:s}", "file", session_text(t->portrait.model_path), "sha256",
                            t->model_sha256, "kind", portrait_kind(&t->portrait), "clip", t->portrait.info.clip);
  json_t *clip = json_pack("{s:o, s:s, s:i, s:i, s:s, s:o}", "folder", session_text(t->portrait.source.path),
                           "identity", t->evaluation.info.identity, "width", t->evaluation.info.width, "height",
                           t->evaluation.info.height, "split", splits[t->portrait.split], "frames", frames);
  json_t *measured =
      json_pack("{s:f, s:f, s:I, s:I, s:I}", "seconds", t->spent_seconds, "exact_seconds", t->exact_seconds, "turns",
                (json_int_t)t->turns, "settings_not_reached", (json_int_t)t->not_reached[0], "combinations_not_reached",
                (json_int_t)t->not_reached[1]);
  return json_pack("{s:s, s:i, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "format", "ernerf.tradeoff", "version", 1,
                   "machine", machine, "model", model, "clip", clip, "measured", measured, "points", points, "front",
                   front_json(t, REFERENCE_EXACT), "front_clip", front_json(t, REFERENCE_CLIP));
}

/* ---- plots ------------------------------------------------------------------------------------------------------- */

/* One series: arrays of its points. */
struct cloud {
  double x[TRADEOFF_POINTS], x_low[TRADEOFF_POINTS], x_high[TRADEOFF_POINTS];
  double y[TRADEOFF_POINTS], y_low[TRADEOFF_POINTS], y_high[TRADEOFF_POINTS];
  const char *label[TRADEOFF_POINTS];
  size_t count;
};

static void add_to(struct cloud *cloud, const struct tradeoff *t, size_t point, enum reference reference) {
  const struct point *p = &t->points[point];
  const struct mean_and_deviation m = mean_of(p->db[reference], tradeoff_frames(t));
  const size_t k = cloud->count++;
  cloud->x[k] = p->ms.median;
  cloud->x_low[k] = p->ms.low;
  cloud->x_high[k] = p->ms.high;
  cloud->y[k] = m.mean;
  cloud->y_low[k] = m.mean - m.deviation;
  cloud->y_high[k] = m.mean + m.deviation;
  cloud->label[k] = p->name;
}

static struct plot_series series_of(const struct cloud *cloud, const char *name, unsigned colour, enum plot_mark mark) {
  return (struct plot_series){.name = name,
                              .x = cloud->x,
                              .y = cloud->y,
                              .x_low = cloud->x_low,
                              .x_high = cloud->x_high,
                              .labels = cloud->label,
                              .count = cloud->count,
                              .colour = colour,
                              .mark = mark};
}

int tradeoff_plot(const struct tradeoff *t, enum reference reference, enum plot_form form, struct bytes *bytes) {
  static const char *const titles[] = {"What accuracy costs: against the exact render",
                                       "What accuracy costs: against the frames of the clip"};
  static const char *const labels[] = {"PSNR against the exact render, dB (mean of the frames)",
                                       "PSNR against the clip, dB (mean of the frames)"};
  struct cloud clouds[4] = {{.count = 0}};
  size_t order[TRADEOFF_POINTS];
  const size_t front = tradeoff_front(t, reference, order);
  for (size_t i = 1; i < t->count; i++) {
    const enum standing standing = t->points[i].place[reference].standing;
    if (standing != STANDING_FRONT) add_to(&clouds[standing == STANDING_DOMINATED ? 0 : 1], t, i, reference);
  }
  for (size_t i = 0; i < front; i++) add_to(&clouds[2], t, order[i], reference);
  add_to(&clouds[3], t, 0, reference);
  struct plot_series series[] = {series_of(&clouds[0], "measurably dominated", 0x9aa4ad, PLOT_DOT),
                                 series_of(&clouds[1], "no better than a point of the front", 0x5b9bd0, PLOT_RING),
                                 series_of(&clouds[2], "front", 0x0b4f8a, PLOT_DOT),
                                 series_of(&clouds[3], t->base_name, 0xc8501e, PLOT_DIAMOND)};
  series[2].line = true;
  series[1].labels = NULL; /* a labelled point lies at the same place */
  if (t->points[0].place[reference].standing == STANDING_FRONT) series[3].labels = NULL;
  const struct plot plot = {.title = titles[reference],
                            .x_label = "milliseconds a frame (median; bars: quartiles), logarithmic",
                            .y_label = labels[reference],
                            .x_log = true,
                            .width = 980,
                            .height = 580,
                            .series = series,
                            .count = sizeof series / sizeof *series};
  return plot_draw(&plot, form, bytes);
}
