/* SPDX-License-Identifier: MIT
 * Writes report.html: one page without scripts; its pictures are in prepare/. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/format.h"
#include "io/csv.h"
#include "io/file.h"
#include "io/landmarks.h"
#include "prepare/report.h"

enum { SHOWN = 8, PLOT_WIDTH = 880, PLOT_HEIGHT = 110, LINE = 2048 };

struct page {
  struct ern_prepare_job *job;
  struct ern_file_writer file;
  ern_status status; /* of the first write that failed */
};

static void put(struct page *page, const char *format, ...) ERN_PRINTF(2, 3);
static void put(struct page *page, const char *format, ...) {
  char line[LINE];
  va_list list;
  va_start(list, format);
  const int length = ern_format_list(line, sizeof line, format, list);
  va_end(list);
  if (page->status == ERN_OK && length > 0)
    page->status = ern_file_writer_write(&page->file, line, length < LINE ? (size_t)length : LINE - 1);
}

/* Writes text, escaped for HTML. */
static void put_text(struct page *page, const char *text) {
  for (; *text != 0; text++) {
    if (*text == '<' || *text == '>' || *text == '&' || *text == '"')
      put(page, "&#%d;", *text);
    else
      put(page, "%c", *text);
  }
}

/* Plots a curve over the frames, with its largest value. A column of the plot shows the largest value of its frames. */
static void put_plot(struct page *page, const char *title, const char *unit, const float *values, size_t count) {
  const size_t columns = count < PLOT_WIDTH ? count : PLOT_WIDTH;
  float most = 0;
  for (size_t i = 0; i < count; i++)
    if (isfinite(values[i])) most = fmaxf(most, values[i]);
  put(page, "<h3>%s, 0 to %.3g %s</h3>\n<svg viewBox=\"0 0 %d %d\"><polyline points=\"", title, (double)most, unit,
      PLOT_WIDTH, PLOT_HEIGHT);
  for (size_t c = 0; c < columns; c++) {
    float value = 0;
    for (size_t i = c * count / columns; i < (c + 1) * count / columns; i++)
      if (isfinite(values[i])) value = fmaxf(value, values[i]);
    put(page, "%.1f,%.1f ", (double)c * PLOT_WIDTH / (double)columns,
        PLOT_HEIGHT - 2 - (PLOT_HEIGHT - 6) * (double)value / fmax((double)most, 1e-9));
  }
  put(page, "\"/></svg>\n");
}

static double turn_of(const struct ern_head_pose *a, const struct ern_head_pose *b, const struct ern_head_pose *c) {
  double square = 0; /* |R_a - 2 R_b + R_c|^2 (Frobenius) = 2 angle^2 */
  for (int i = 0; i < 9; i++) {
    const double change = a->rotation[i / 3][i % 3] - 2 * b->rotation[i / 3][i % 3] + c->rotation[i / 3][i % 3];
    square += change * change;
  }
  return sqrt(square / 2) * 57.29577951308232;
}

static double way_of(const struct ern_head_pose *a, const struct ern_head_pose *b, const struct ern_head_pose *c) {
  double square = 0;
  for (int i = 0; i < 3; i++) {
    const double change = a->translation[i] - 2 * b->translation[i] + c->translation[i];
    square += change * change;
  }
  return 1000 * sqrt(square);
}

static ern_status put_path(struct page *page, const struct ern_head_pose *poses) {
  const size_t frames = page->job->frames;
  float *values = NULL;
  const ern_status status = ERN_NEW(page->job->context, frames, &values);
  if (status != ERN_OK) return status;
  for (size_t i = 1; i + 1 < frames; i++) values[i] = (float)turn_of(&poses[i - 1], &poses[i], &poses[i + 1]);
  put_plot(page, "Tremble of the head's rotation (second difference)", "degrees a frame squared", values, frames);
  for (size_t i = 1; i + 1 < frames; i++) values[i] = (float)way_of(&poses[i - 1], &poses[i], &poses[i + 1]);
  put_plot(page, "Tremble of the head's position (second difference)", "mm a frame squared", values, frames);
  ern_release(page->job->context, values);
  return ERN_OK;
}

/* Plots a column of a step's table, if the file exists. */
static void put_column(struct page *page, const char *file, const char *column, const char *title, const char *unit) {
  char path[ERN_PREPARE_PATH], kept[ERN_ERROR_BYTES];
  float *values = NULL;
  size_t count = 0;
  ern_error_keep(page->job->context, kept);
  if (ern_prepare_path(page->job, path, "%s", file) == ERN_OK && access(path, F_OK) == 0 &&
      ern_csv_read_column(page->job->context, path, column, &values, &count) == ERN_OK)
    put_plot(page, title, unit, values, count);
  ern_error_restore(page->job->context, kept);
  ern_release(page->job->context, values);
}

/* Writes a frame with pose and landmarks drawn as prepare/shown_K.jpg. */
static ern_status draw_frame(struct ern_prepare_job *job, size_t shown, size_t frame,
                             const struct ern_head_pose *pose) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], name[64];
  float landmarks[ERN_LANDMARKS][2];
  ern_image picture = {0};
  snprintf(name, sizeof name, "ori_imgs/%zu.jpg", frame);
  ERN_TRY(ern_prepare_picture(job, name, 3, &picture));
  ERN_TRY(ern_prepare_path(job, path, "ori_imgs/%zu.lms", frame));
  const bool known = access(path, F_OK) == 0 && ern_landmarks_read(job->context, path, landmarks) == ERN_OK;
  ERN_TRY(ern_report_draw(job, &picture, pose, known ? (const float(*)[2])landmarks : NULL));
  snprintf(name, sizeof name, "prepare/shown_%zu.jpg", shown);
  ERN_TRY(ern_prepare_register_output(job, name, path));
  ERN_TRY(ern_image_write(job->context, path, &picture, 85));
fail:
  ern_image_free(job->context, &picture);
  return status;
}

static ern_status put_frames(struct page *page, const struct ern_head_pose *poses, bool layers) {
  ern_status status = ERN_OK;
  const size_t frames = page->job->frames;
  const size_t shown = frames < SHOWN ? frames : SHOWN;
  put(page, "<h2>Frames across the video</h2>\n<p>x of the head is red, y green, z blue.</p>\n");
  for (size_t i = 0; i < shown; i++) {
    const size_t frame = (2 * i + 1) * frames / (2 * shown);
    ERN_TRY(draw_frame(page->job, i, frame, &poses[frame]));
    put(page, "<figure><img src=\"prepare/shown_%zu.jpg\" alt=\"frame %zu\">", i, frame);
    if (layers)
      put(page, "<img src=\"parsing/%zu.png\" alt=\"its layers\"><img src=\"torso_imgs/%zu.png\" alt=\"its torso\">",
          frame, frame);
    put(page, "<figcaption>frame %zu, %.2f s</figcaption></figure>\n", frame, (double)frame / ERN_PREPARE_RATE);
  }
fail:
  return status;
}

static void put_verdicts(struct page *page, const ern_prepare_result *result) {
  static const char *const grades[] = {"good", "doubtful", "refused"};
  put(page, "<table><tr><th>step</th><th>verdict</th><th>why</th><th>figures</th></tr>\n");
  for (size_t i = 0; i < ERN_PREPARE_STEPS; i++) {
    const ern_prepare_verdict *verdict = &result->verdicts[i];
    if (verdict->step == NULL) continue;
    put(page, "<tr class=\"%s\"><td>%s</td><td>%s</td><td>", grades[verdict->grade], verdict->step,
        grades[verdict->grade]);
    put_text(page, verdict->words);
    put(page, "</td><td>");
    const json_t *steps = json_object_get(page->job->record, "steps");
    json_t *figures = json_object_get(json_object_get(steps, verdict->step), "figures");
    const char *name = NULL;
    json_t *value = NULL;
    json_object_foreach(figures, name, value) {
      put_text(page, name);
      put(page, " %.4g<br>", json_number_value(value));
    }
    put(page, "</td></tr>\n");
  }
  put(page, "</table>\n");
}

ern_status ern_report_write(struct ern_prepare_job *job, const ern_prepare_result *result) {
  ern_status status = ERN_OK;
  struct page page = {.job = job};
  struct ern_head_pose *poses = NULL;
  char path[ERN_PREPARE_PATH];
  ERN_TRY(ern_prepare_register_output(job, "report.html", path));
  ERN_TRY(ern_file_writer_open(job->context, path, ERN_EXISTING_REPLACE, &page.file));
  put(&page,
      "<!DOCTYPE html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>ernerf prepare</title>\n<style>body{font:15px "
      "sans-serif;max-width:60em;margin:2em auto}img{width:18em}figure{margin:1em 0}td{vertical-align:top;padding:.2em "
      "1em .2em "
      "0}svg{width:100%%;background:#f4f4f4}polyline{fill:none;stroke:#245;stroke-width:1}.doubtful{background:"
      "#fe9}.refused{background:#f99}</style>\n<h1>");
  put_text(&page, job->video);
  put(&page, "</h1>\n<p>%zu frames of %d x %d, 25 a second.</p>\n", job->frames, job->side, job->side);
  put_verdicts(&page, result);
  if (result->verdicts[1].step != NULL && result->verdicts[1].grade != ERN_PREPARE_REFUSED && job->frames > 0) {
    ERN_TRY(ERN_NEW(job->context, job->frames, &poses));
    ERN_TRY(ern_prepare_poses_read(job, poses));
    ERN_TRY(put_frames(&page, poses, result->verdicts[3].step != NULL));
    put(&page, "<h2>Curves</h2>\n");
    ERN_TRY(put_path(&page, poses));
    put_column(&page, "prepare/pose.csv", "residual", "Reprojection", "pixels of 512");
    put_column(&page, "prepare/pose.csv", "points", "Points that hold the pose", "");
    put_column(&page, "au.csv", "AU45_r", "Closed eyes (AU45_r)", "");
  }
  put(&page, "</html>\n");
  ERN_TRY(page.status);
  status = ern_file_writer_commit(&page.file);
fail:
  ern_file_writer_abandon(&page.file);
  ern_release(job->context, poses);
  return status;
}
