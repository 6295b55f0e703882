/* SPDX-License-Identifier: MIT */
#include "lab/tradeoff_page.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lab/tradeoff_crops.h"
#include "lab/tradeoff_files.h"
#include "lab/tradeoff_measure.h"
#include "output/plot.h"

static const char head[] =
    "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
    "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>What accuracy costs</title>\n"
    "<style>\n"
    "body{font:15px/1.5 system-ui,sans-serif;color:#22272b;background:#fff;max-width:1240px;margin:2em auto;padding:0 "
    "1em}\n"
    "h1{font-size:1.7em;margin-bottom:.2em}h2{font-size:1.2em;margin-top:2.2em}\n"
    "img.plot{width:100%;max-width:980px;display:block;margin:1em 0}\n"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums}\n"
    "th,td{padding:.28em .8em .28em 0;text-align:right;vertical-align:top;border-bottom:1px solid #e3e7ea}\n"
    "th{font-weight:600;border-bottom:2px solid #9aa4ad}\n"
    "td.l,th.l{text-align:left}td.n{min-width:15em}td code span{white-space:nowrap}tr.base td{background:#fdf3ee}\n"
    ".q{color:#68737c;white-space:nowrap}code{font-size:.85em}\n"
    ".wide{overflow-x:auto}\n"
    "table.crops td{border:0;padding:.3em .6em .3em 0;text-align:left}\n"
    "table.crops img{image-rendering:pixelated;display:block}\n"
    "table.crops th{text-align:left;border:0}\n"
    "</style>\n</head>\n<body>\n";

/* ---- tables ------------------------------------------------------------------------------------------------------ */

static void add_cells(const struct tradeoff *t, const struct point *p, struct bytes *page) {
  const struct mean_and_deviation exact = mean_of(p->db[REFERENCE_EXACT], tradeoff_frames(t));
  const struct mean_and_deviation clip = mean_of(p->db[REFERENCE_CLIP], tradeoff_frames(t));
  bytes_print(page, "<td>%.2f <span class=\"q\">(%.2f&ndash;%.2f)</span></td>", p->ms.median, p->ms.low, p->ms.high);
  bytes_print(page, "<td>%.1f <span class=\"q\">(%.1f&ndash;%.1f)</span></td>", 1000 / p->ms.median, 1000 / p->ms.high,
              1000 / p->ms.low);
  bytes_print(page, "<td>%.2f <span class=\"q\">&plusmn; %.2f</span></td><td>%.1f</td>", exact.mean, exact.deviation,
              255 * p->worst);
  bytes_print(page, "<td>%.3f <span class=\"q\">&plusmn; %.2f</span></td>", clip.mean, clip.deviation);
}

static const char columns[] =
    "<th class=\"l\">setting</th><th>ms a frame<br>median (quartiles)</th><th>frames a second<br>median "
    "(quartiles)</th>"
    "<th>dB against exact<br>mean &plusmn; deviation</th><th>worst colour<br>of 255</th>"
    "<th>dB against the clip<br>mean &plusmn; deviation</th>";

/* Adds options; each is kept on one line. */
static void add_words(char *words, struct bytes *page) {
  for (char *at = words + 1, *next; at != NULL; at = next) {
    next = strstr(at, " --");
    if (next != NULL) *next++ = 0;
    bytes_print(page, "<span>");
    bytes_print_html(page, at);
    bytes_print(page, "</span>%s", next != NULL ? " " : "");
  }
}

/* Begins the row of a point; `asked`: prints its command-line options below its name. */
static void open_row(const struct tradeoff *t, size_t i, bool asked, struct bytes *page) {
  struct bytes words = {0};
  bytes_print(page, "<tr%s><td class=\"l n\">", i == 0 ? " class=\"base\"" : "");
  bytes_print_html(page, t->points[i].name);
  settings_options(&t->points[i].settings, &t->base, &words);
  if (asked && words.data != NULL) {
    bytes_print(page, "<br><code>");
    add_words(words.data, page);
    bytes_print(page, "</code>");
  }
  bytes_print(page, "</td>");
  page->failed |= words.failed;
  bytes_free(&words);
}

static void add_front(const struct tradeoff *t, enum reference reference, struct bytes *page) {
  size_t order[TRADEOFF_POINTS];
  const size_t count = tradeoff_front(t, reference, order);
  bytes_print(page, "<div class=\"wide\"><table>\n<tr>%s</tr>\n", columns);
  for (size_t i = 0; i < count; i++) {
    open_row(t, order[i], true, page);
    add_cells(t, &t->points[order[i]], page);
    bytes_print(page, "</tr>\n");
  }
  bytes_print(page, "</table></div>\n");
}

static void add_standing(const struct tradeoff *t, const struct point *p, enum reference reference,
                         struct bytes *page) {
  static const char *const words[] = {"front", "dominated by ", "no better than "};
  const struct place *place = &p->place[reference];
  bytes_print(page, "<td class=\"l\">%s", words[place->standing]);
  if (place->standing != STANDING_FRONT) bytes_print_html(page, t->points[place->by].name);
  bytes_print(page, "</td>");
}

static void add_all(const struct tradeoff *t, struct bytes *page) {
  bytes_print(page,
              "<div class=\"wide\"><table>\n<tr>%s<th class=\"l\">against exact</th><th class=\"l\">against the "
              "clip</th></tr>\n",
              columns);
  for (size_t i = 0; i < t->count; i++) {
    open_row(t, i, false, page);
    add_cells(t, &t->points[i], page);
    add_standing(t, &t->points[i], REFERENCE_EXACT, page);
    add_standing(t, &t->points[i], REFERENCE_CLIP, page);
    bytes_print(page, "</tr>\n");
  }
  bytes_print(page, "</table></div>\n");
}

/* ---- words ------------------------------------------------------------------------------------------------------- */

static void add_fact(struct bytes *page, const char *name, const char *value) {
  bytes_print(page, "<tr><td class=\"l\">%s</td><td class=\"l\">", name);
  bytes_print_html(page, value);
  bytes_print(page, "</td></tr>\n");
}

static void add_machine(const struct tradeoff *t, struct bytes *page) {
  char text[160];
  bytes_print(page, "<h2>The machine, the model, the clip</h2>\n<table>\n");
  add_fact(page, "processor", t->cpu);
  snprintf(text, sizeof text, "%d", t->cores);
  add_fact(page, "cores", text);
  add_fact(page, "instruction sets", t->instruction_sets);
  if (t->device_name[0] != 0) add_fact(page, "OpenCL device", t->device_name);
  add_fact(page, "model", t->portrait.model_path);
  add_fact(page, "SHA-256 of the model", t->model_sha256);
  add_fact(page, "it draws", portrait_kind(&t->portrait));
  add_fact(page, "clip", t->portrait.source.path);
  snprintf(text, sizeof text, "%d x %d pixels; %zu frames, drawn at every point", t->evaluation.info.width,
           t->evaluation.info.height, tradeoff_frames(t));
  add_fact(page, "pictures", text);
  bytes_print(page, "</table>\n");
}

static void add_method(const struct tradeoff *t, struct bytes *page) {
  bytes_print(page,
              "<h2>How it was measured</h2>\n<p>%zu points took turns, each turn in another order, %zu times each in "
              "%.0f seconds; a "
              "reading is the mean of the %zu frames, drawn to 8-bit pixels without reading and encoding. ",
              t->count, t->turns, t->spent_seconds, tradeoff_frames(t));
  bytes_print(page,
              "The exact render is the same model in double precision (<code>--isa ref64</code>), up to 128 samples a "
              "ray, no cell left out, light followed to its end, at full size; it took %.1f seconds. ",
              t->exact_seconds);
  bytes_print(page,
              "PSNR is of the whole picture, 100 dB where nothing differs. A point is better in time where the mean "
              "ratio by turn is further from 1 than its standard error allows at 99&nbsp;%% and than a hundredth, "
              "and in quality where the mean difference by frame is further from 0 than its standard error allows at "
              "95&nbsp;%% and than 0.01 dB. Settings dominate others where they are better in time or quality and not "
              "worse in the other. The Pareto front holds the settings that no others dominate.");
  if (t->not_reached[0] > 0)
    bytes_print(page, " <b>For lack of time %zu settings were not tried.</b>", t->not_reached[0]);
  if (t->not_reached[1] > 0)
    bytes_print(page, " For lack of time %zu promising combinations were not tried.", t->not_reached[1]);
  bytes_print(
      page,
      "</p>\n<p><b>scale</b>: the head drawn at so many times the size and enlarged (<code>image_scale</code>). "
      "<b>samples</b>: of a ray at most (<code>--max-steps</code>). <b>stop</b>: light left at which a ray ends "
      "(<code>transmittance_stop</code>). <b>threshold</b>: density under which cells are left out "
      "(<code>occupancy_threshold</code>). Names of instruction sets: <code>--isa</code>; avx512bf16 "
      "multiplies pairs of bf16, the others are fp32. What a name does not mention is as in &ldquo;");
  bytes_print_html(page, t->base_name);
  bytes_print(page, "&rdquo;: <code>");
  settings_options(&t->base, NULL, page);
  bytes_print(page,
              "</code>. The words under a name go to <code>ernerf render</code> and <code>ernerf eval</code> "
              "beside those.</p>\n");
}

static int add_plot(const struct tradeoff *t, enum reference reference, const char *what, struct bytes *page) {
  struct bytes svg = {0};
  const int status = tradeoff_plot(t, reference, PLOT_SVG, &svg);
  bytes_print(page, "<img class=\"plot\" alt=\"%s\" src=\"data:image/svg+xml;base64,", what);
  bytes_print_base64(page, svg.data, svg.count);
  bytes_print(page, "\">\n");
  bytes_free(&svg);
  return status;
}

/* Summarises the front from the slowest to the fastest point. */
static void add_summary(const struct tradeoff *t, struct bytes *page) {
  size_t order[TRADEOFF_POINTS];
  const size_t count = tradeoff_front(t, REFERENCE_EXACT, order);
  const struct point *fast = &t->points[order[0]], *slow = &t->points[order[count - 1]];
  const struct mean_and_deviation low = mean_of(fast->db[REFERENCE_EXACT], tradeoff_frames(t));
  const struct mean_and_deviation high = mean_of(slow->db[REFERENCE_EXACT], tradeoff_frames(t));
  bytes_print(page, "<p>From %.2f ms a frame (quartiles %.2f&ndash;%.2f; ", slow->ms.median, slow->ms.low,
              slow->ms.high);
  bytes_print_html(page, slow->name);
  bytes_print(page, ") at %.1f &plusmn; %.1f dB against the exact render down to %.2f ms (%.2f&ndash;%.2f; ", high.mean,
              high.deviation, fast->ms.median, fast->ms.low, fast->ms.high);
  bytes_print_html(page, fast->name);
  bytes_print(page, ") at %.1f &plusmn; %.1f dB: %zu of %zu measured points are not bettered by another.</p>\n",
              low.mean, low.deviation, count, t->count);
}

int tradeoff_page_make(struct tradeoff *t, struct bytes *page) {
  bytes_print(page, "%s<h1>What accuracy costs</h1>\n", head);
  add_summary(t, page);
  int status = add_plot(t, REFERENCE_EXACT, "time against the distance from the exact render", page);
  bytes_print(page, "<h2>The front: nothing measured is better than these</h2>\n");
  add_front(t, REFERENCE_EXACT, page);
  if (status == 0)
    status = page_crops(t, page);
  else
    status = session_fail_with(&t->session, "no memory for a plot");
  if (status != 0) return status;
  bytes_print(page,
              "<h2>Against the frames of the clip</h2>\n<p>What a viewer could notice: a model is never its clip, and "
              "how it is drawn may matter less than how it was trained.</p>\n");
  status = add_plot(t, REFERENCE_CLIP, "time against the distance from the clip", page);
  if (status != 0) return session_fail_with(&t->session, "no memory for a plot");
  add_front(t, REFERENCE_CLIP, page);
  bytes_print(page, "<h2>All points</h2>\n");
  add_all(t, page);
  add_machine(t, page);
  add_method(t, page);
  bytes_print(page, "</body>\n</html>\n");
  return page->failed ? session_fail_with(&t->session, "no memory for the page") : 0;
}
