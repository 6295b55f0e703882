/* SPDX-License-Identifier: MIT */
#include "lab/tradeoff_crops.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "evaluation/regions.h"
#include "lab/tradeoff_measure.h"
#include "output/plot.h"

enum { CROPS = 2, SHOWN_HEIGHT = 120 /* height on the page, pixels */, FACTOR = 16 /* gain of difference pictures */ };

struct crop {
  const char *name;
  ern_box box;
};

/* Chooses mouth and eyes by the frame's landmarks; without landmarks the centre of the picture. */
static size_t choose_crops(const struct tradeoff *t, struct crop crops[CROPS]) {
  const struct source_frame *source_frame = &t->evaluation.frame_source.source_frame[0];
  const ern_clip_frame *frame = ern_clip_frame_at(t->evaluation.clip, source_frame->split, source_frame->index);
  const int width = t->evaluation.info.width, height = t->evaluation.info.height;
  size_t count = 0;
  if (region_mouth(frame, width, height, &crops[count].box)) crops[count++].name = "mouth";
  if (region_eyes(frame, width, height, &crops[count].box)) crops[count++].name = "eyes";
  if (count == 0) {
    const ern_box middle = {
        .top = height / 4, .bottom = height - height / 4, .left = width / 4, .right = width - width / 4};
    crops[count++] = (struct crop){"middle", middle};
  }
  return count;
}

static unsigned char to_byte(double value) { return (unsigned char)lrint(255 * fmin(fmax(value, 0), 1)); }

/* Adds a crop of rgb[height][width][3] or, if `exact` is not NULL, FACTOR times its difference from `exact`. */
static int add_crop(struct tradeoff *t, const float *rgb, const float *exact, const struct crop *crop,
                    struct bytes *page) {
  const size_t left = (size_t)crop->box.left, top = (size_t)crop->box.top, across = (size_t)t->evaluation.info.width;
  const size_t width = (size_t)crop->box.right - left, height = (size_t)crop->box.bottom - top;
  unsigned char *bytes = malloc(3 * width * height);
  struct bytes png = {0};
  int status = bytes != NULL ? 0 : -1;
  for (size_t y = 0; y < height && status == 0; y++)
    for (size_t x = 0; x < 3 * width; x++) {
      const size_t i = 3 * ((top + y) * across + left) + x;
      bytes[3 * y * width + x] =
          to_byte(exact != NULL ? FACTOR * fabs((double)rgb[i] - (double)exact[i]) : (double)rgb[i]);
    }
  if (status == 0) status = plot_png(bytes, (int)width, (int)height, &png);
  bytes_print(page, "<td><img height=\"%d\" alt=\"%s%s\" src=\"data:image/png;base64,", SHOWN_HEIGHT, crop->name,
              exact != NULL ? ", difference" : "");
  bytes_print_base64(page, png.data, png.count);
  bytes_print(page, "\"></td>");
  bytes_free(&png);
  free(bytes);
  return status == 0 ? 0 : session_fail_with(&t->session, "no memory for a crop");
}

/* Adds a row of the table: `name`, then each crop of `rgb` and, for a point, its difference picture. */
static int add_row(struct tradeoff *t, const char *name, const struct point *point, const float *rgb,
                   const struct crop *crops, size_t count, struct bytes *page) {
  bytes_print(page, "<tr><td>");
  bytes_print_html(page, name);
  if (point != NULL)
    bytes_print(page, "<br><span class=\"q\">%.2f ms (%.2f&ndash;%.2f)<br>this frame: %.2f dB against exact</span>",
                point->ms.median, point->ms.low, point->ms.high, point->db[REFERENCE_EXACT][0]);
  bytes_print(page, "</td>");
  for (size_t c = 0; c < count; c++) {
    if (add_crop(t, rgb, NULL, &crops[c], page) != 0) return EXIT_FAILURE;
    if (point == NULL)
      bytes_print(page, "<td></td>");
    else if (add_crop(t, rgb, t->exact, &crops[c], page) != 0)
      return EXIT_FAILURE;
  }
  bytes_print(page, "</tr>\n");
  return 0;
}

static int add_clip(struct tradeoff *t, const struct crop *crops, size_t count, struct bytes *page) {
  const struct source_frame *source_frame = &t->evaluation.frame_source.source_frame[0];
  const size_t values = 3 * tradeoff_pixels(t);
  ern_image truth = {0};
  if (ern_clip_pixels(t->evaluation.clip, source_frame->split, source_frame->index, &truth, NULL) != ERN_OK)
    return session_fail(&t->session);
  for (size_t i = 0; i < values; i++) t->evaluation.rgb[i] = (float)truth.data[i] / 255;
  return add_row(t, "frame of the clip", NULL, t->evaluation.rgb, crops, count, page);
}

int page_crops(struct tradeoff *t, struct bytes *page) {
  struct crop crops[CROPS + 1];
  size_t order[TRADEOFF_POINTS];
  const size_t count = choose_crops(t, crops), front = tradeoff_front(t, REFERENCE_EXACT, order);
  bytes_print(page,
              "<h2>What that looks like</h2>\n<p>Frame %lld at each point of the front. Differences are those from the "
              "exact render, %d times as bright: one step of 255 is seen as %d.</p>\n"
              "<div class=\"wide\"><table class=\"crops\">\n<tr><th></th>",
              (long long)t->evaluation.frame_source.source_frame[0].pose.img_id, FACTOR, FACTOR);
  for (size_t c = 0; c < count; c++)
    bytes_print(page, "<th>%s</th><th>difference &times; %d</th>", crops[c].name, FACTOR);
  bytes_print(page, "</tr>\n");
  int status = add_clip(t, crops, count, page);
  if (status == 0) status = add_row(t, "exact render", NULL, t->exact, crops, count, page);
  for (size_t i = front; i-- > 0 && status == 0;) {
    struct point *point = &t->points[order[i]];
    status = tradeoff_measure_draw(t, point, 0);
    if (status == 0) status = add_row(t, point->name, point, t->evaluation.rgb, crops, count, page);
  }
  bytes_print(page, "</table></div>\n");
  return status;
}
