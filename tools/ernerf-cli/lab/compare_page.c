/* SPDX-License-Identifier: MIT */
#include "lab/compare_page.h"

#include <inttypes.h>
#include <math.h>

static const char head[] =
    "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
    "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>Two portraits compared</title>\n"
    "<style>\n"
    "body{font:15px/1.5 system-ui,sans-serif;color:#22272b;background:#fff;max-width:1240px;margin:2em auto;padding:0 "
    "1em}\n"
    "h1{font-size:1.7em;margin-bottom:.2em}h2{font-size:1.2em;margin-top:2.2em}\n"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums}\n"
    "th,td{padding:.28em .8em .28em 0;text-align:right;border-bottom:1px solid #e3e7ea}\n"
    "th{font-weight:600;border-bottom:2px solid #9aa4ad}td.l,th.l{text-align:left}\n"
    ".q{color:#68737c;white-space:nowrap}.wide{overflow-x:auto}\n"
    "figure{margin:1em 0}img,video{width:100%;display:block}\n"
    "</style>\n</head>\n<body>\n<h1>Two portraits compared</h1>\n";

static void add_sides(const struct compare *c, struct bytes *page) {
  const struct evaluation *evaluation = &c->side[0].evaluation;
  static const char *const splits[] = {"training frames", "validation frames", "frames"};
  bytes_print(page, "<table>\n");
  for (size_t side = 0; side < COMPARE_SIDES; side++) {
    bytes_print(page, "<tr><td class=\"l\">%c</td><td class=\"l\">", compare_letters[side]);
    bytes_print_html(page, c->path[side]);
    bytes_print(page, "</td><td class=\"l\">%s</td></tr>\n", compare_side_kind(&c->side[side]));
  }
  bytes_print(page, "<tr><td class=\"l\">clip</td><td class=\"l\">");
  bytes_print_html(page, c->asked.source.path);
  bytes_print(page, "</td><td class=\"l\">%zu %s, %d &times; %d</td></tr>\n</table>\n", compare_frames(c),
              splits[c->asked.split], evaluation->info.width, evaluation->info.height);
}

static void add_cell(struct bytes *page, double value, double interval, int digits) {
  if (isfinite(value))
    bytes_print(page, "<td>%.*f", digits, value);
  else
    bytes_print(page, "<td>&ndash;");
  if (isfinite(value) && isfinite(interval))
    bytes_print(page, " <span class=\"q\">&plusmn; %.*f</span>", digits, interval);
  bytes_print(page, "</td>");
}

static void add_figures(const struct compare *c, struct bytes *page) {
  bytes_print(page,
              "<h2>Against the recorded frames (gt_imgs), frame by frame</h2>\n<div class=\"wide\"><table>\n<tr><th "
              "class=\"l\">mean "
              "&plusmn; half of its 95&nbsp;%% interval</th><th>A</th><th>B</th><th>B &minus; A</th><th>frames in "
              "which<br>A is better</th><th>B is better</th><th>both are equal</th></tr>\n");
  for (size_t f = 0; f < compare_figure_count(c); f++) {
    const struct compare_summary s = compare_summarise(c, f);
    bytes_print(page, "<tr><td class=\"l\">%s</td>", compare_figures[f].title);
    for (size_t side = 0; side < COMPARE_SIDES; side++)
      add_cell(page, s.mean[side], s.interval[side], compare_figures[f].digits);
    add_cell(page, s.difference, s.difference_interval, compare_figures[f].digits);
    bytes_print(page, "<td>%zu</td><td>%zu</td><td>%zu</td></tr>\n", s.wins[0], s.wins[1], s.equal);
  }
  bytes_print(page,
              "</table></div>\n<p>Larger is better but for LPIPS. PSNR is in dB. Head: the box of the 68 landmarks. "
              "Mouth: the square "
              "around landmarks 48 to 59. The intervals count frames as independent, which neighbours of a video are "
              "not, so they are too small by what neighbours have in common.</p>\n");
}

static void add_measures(const struct compare *c, struct bytes *page) {
  struct compare_measure measures[COMPARE_MEASURES];
  compare_measures(c, measures);
  bytes_print(page,
              "<h2>Over all frames</h2>\n<div class=\"wide\"><table>\n<tr><th class=\"l\"></th><th>A</th><th>B</th>"
              "<th>recorded</th></tr>\n");
  for (size_t i = 0; i < COMPARE_MEASURES; i++) {
    bytes_print(page, "<tr><td class=\"l\">");
    bytes_print_html(page, measures[i].title);
    bytes_print(page, "</td>");
    for (size_t side = 0; side < COMPARE_SIDES; side++) add_cell(page, measures[i].value[side], NAN, 3);
    bytes_print(page, "<td>%s</td></tr>\n", measures[i].best);
  }
  bytes_print(page,
              "</table></div>\n"
              "<p>Nearer to the recorded frames is better. Sharpness and tremble are divided by those of the recorded "
              "frames. A dash: this clip "
              "does not have what the measure needs.</p>\n");
}

static void add_pictures(const struct compare *c, struct bytes *page) {
  static const char *const words[COMPARE_SHOWN] = {"where B is best against A", "the median",
                                                   "where B is worst against A"};
  bytes_print(
      page,
      "<h2>Three frames, by the difference in PSNR</h2>\n<p>From left to right: A, B, the recorded frame, 4 times the "
      "difference of A from it, 4 times that of B.</p>\n");
  for (size_t i = 0; i < COMPARE_SHOWN; i++) {
    const size_t k = c->shown[i];
    const double a = compare_value(c, 0, k, 0), b = compare_value(c, 1, k, 0);
    bytes_print(page,
                "<figure><figcaption>Frame %" PRId64
                ", %s: A %.3f dB, B %.3f dB, B &minus; A %.3f dB</figcaption>"
                "<img src=\"%s.png\" alt=\"A, B, the recorded frame, and their differences\"></figure>\n",
                compare_frame(c, k)->pose.img_id, words[i], a, b, b - a, compare_shown_names[i]);
  }
}

void compare_page(const struct compare *c, struct bytes *page) {
  bytes_print(page, "%s", head);
  add_sides(c, page);
  add_figures(c, page);
  add_measures(c, page);
  add_pictures(c, page);
  bytes_print(page,
              "<h2>All frames</h2>\n<p>From left to right: A, B, the recorded frame. The figures of each frame are in "
              "<a href=\"frames.csv\">frames.csv</a>, all of it for programs in <a "
              "href=\"compare.json\">compare.json</a>.</p>\n"
              "<video controls preload=\"metadata\" src=\"compare.mp4\"></video>\n</body>\n</html>\n");
}
