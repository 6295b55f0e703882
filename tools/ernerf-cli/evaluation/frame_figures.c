/* SPDX-License-Identifier: MIT */
#include "evaluation/frame_figures.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { COLUMNS = 3, GAIN = 4 /* factor of the shown difference */ };

static void print_number(struct bytes *csv, const json_t *number, int digits) {
  if (json_is_number(number))
    bytes_print(csv, ",%.*f", digits, json_number_value(number));
  else
    bytes_print(csv, ",");
}

void frame_figures_csv(const json_t *frames, struct bytes *csv) {
  size_t index;
  json_t *frame;
  const json_t *first = json_array_get(frames, 0);
  const bool landmarks = json_object_get(first, "lmd_mouth") != NULL, lpips = json_object_get(first, "lpips") != NULL;
  bytes_print(csv, "frame,split,psnr,ssim,psnr_head,psnr_mouth,ms%s%s\n", lpips ? ",lpips" : "",
              landmarks ? ",lmd_mouth,lmd_face" : "");
  json_array_foreach((json_t *)frames, index, frame) {
    bytes_print(csv, "%" JSON_INTEGER_FORMAT ",%s", json_integer_value(json_object_get(frame, "id")),
                json_string_value(json_object_get(frame, "split")));
    print_number(csv, json_object_get(frame, "psnr"), 4);
    print_number(csv, json_object_get(frame, "ssim"), 6);
    print_number(csv, json_object_get(frame, "psnr_head"), 4);
    print_number(csv, json_object_get(frame, "psnr_mouth"), 4);
    print_number(csv, json_object_get(frame, "ms"), 3);
    if (lpips) print_number(csv, json_object_get(frame, "lpips"), 6);
    if (landmarks) {
      print_number(csv, json_object_get(frame, "lmd_mouth"), 4);
      print_number(csv, json_object_get(frame, "lmd_face"), 4);
    }
    bytes_print(csv, "\n");
  }
}

double frame_figures_interval(const json_t *frames, const char *name) {
  double sum = 0, squares = 0, n = 0;
  size_t index;
  json_t *frame;
  json_array_foreach((json_t *)frames, index, frame) {
    const json_t *value = json_object_get(frame, name);
    if (!json_is_number(value)) continue;
    sum += json_number_value(value);
    n++;
  }
  if (n < 2) return NAN;
  json_array_foreach((json_t *)frames, index, frame) {
    const json_t *value = json_object_get(frame, name);
    if (json_is_number(value)) squares += pow(json_number_value(value) - sum / n, 2);
  }
  return 1.96 * sqrt(squares / (n - 1) / n);
}

/* ---- the sheet --------------------------------------------------------------------------------------------------- */

struct ranked {
  double value;
  size_t place;
};

/* Sorts by descending value; of equal values the earlier frame first. */
static int by_value(const void *left, const void *right) {
  const struct ranked *a = left, *b = right;
  if (a->value != b->value) return a->value > b->value ? -1 : 1;
  return a->place < b->place ? -1 : a->place > b->place;
}

int frame_figures_rank(const double *values, size_t count, size_t place[FRAME_FIGURES_SHOWN]) {
  const size_t wanted[FRAME_FIGURES_SHOWN] = {0, count / 2, count - 1};
  struct ranked *ranked = malloc(count * sizeof *ranked);
  if (ranked == NULL) return -1;
  for (size_t k = 0; k < count; k++) ranked[k] = (struct ranked){values[k], k};
  qsort(ranked, count, sizeof *ranked, by_value);
  for (size_t i = 0; i < FRAME_FIGURES_SHOWN; i++) place[i] = ranked[wanted[i]].place;
  free(ranked);
  return 0;
}

/* By PSNR. */
static int rank_frames(const json_t *frames, size_t place[FRAME_FIGURES_SHOWN]) {
  const size_t count = json_array_size(frames);
  double *psnr = malloc(count * sizeof *psnr);
  if (psnr == NULL) return -1;
  for (size_t k = 0; k < count; k++) {
    const json_t *number = json_object_get(json_array_get(frames, k), "psnr"); /* null: infinite */
    psnr[k] = json_is_number(number) ? json_number_value(number) : INFINITY;
  }
  const int status = frame_figures_rank(psnr, count, place);
  free(psnr);
  return status;
}

void frame_figures_row(uint8_t *rgb, const uint8_t *const *drawn, size_t count, const uint8_t *truth, size_t width,
                       size_t height) {
  const size_t columns = 2 * count + 1;
  for (size_t y = 0; y < height; y++)
    for (size_t x = 0; x < width; x++)
      for (size_t c = 0; c < 3; c++) {
        uint8_t *to = rgb + 3 * (y * columns * width + x) + c;
        const int b = truth[3 * (y * width + x) + c];
        to[3 * count * width] = (uint8_t)b;
        for (size_t i = 0; i < count; i++) {
          const int a = drawn[i][4 * (y * width + x) + c], d = GAIN * abs(a - b);
          to[3 * i * width] = (uint8_t)a;
          to[3 * (count + 1 + i) * width] = (uint8_t)(d < 255 ? d : 255);
        }
      }
}

int frame_figures_sheet(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model,
                        const json_t *frames, const char *path) {
  struct session *session = evaluation->session;
  const size_t width = (size_t)evaluation->info.width, height = (size_t)evaluation->info.height;
  const size_t row = 3 * COLUMNS * width * height;
  size_t place[FRAME_FIGURES_SHOWN] = {0};
  uint8_t *rgb = malloc(FRAME_FIGURES_SHOWN * row);
  const uint8_t *drawn = evaluation->rgba;
  int status = 0;
  if (rgb == NULL || rank_frames(frames, place) != 0)
    status =
        session_fail_with(session, "no memory for a sheet of %zu x %zu", COLUMNS * width, FRAME_FIGURES_SHOWN * height);
  for (size_t i = 0; i < FRAME_FIGURES_SHOWN && status == 0; i++) {
    const struct source_frame *frame = &evaluation->frame_source.source_frame[place[i]];
    struct evaluated evaluated;
    ern_image truth = {0};
    status = evaluate_draw(evaluation, renderer, model, place[i], &evaluated);
    if (status == 0) status = evaluate_truth(evaluation, frame, &truth);
    if (status == 0) frame_figures_row(rgb + i * row, &drawn, 1, truth.data, width, height);
  }
  const ern_image sheet = {
      .width = (int)(COLUMNS * width), .height = (int)(FRAME_FIGURES_SHOWN * height), .channels = 3, .data = rgb};
  const ern_provenance made = ern_provenance_default(); /* drawn frames beside true ones */
  if (status == 0 && ern_image_write_provenance(session->context, path, &sheet, 100, &made) != ERN_OK)
    status = session_fail(session);
  free(rgb);
  return status;
}
