/* SPDX-License-Identifier: MIT
 * The step "eyes": measures how far the eyelids are closed and writes au.csv with AU45_r in OpenFace's scale, 0 to 5.
 * The pose stabilises crops of both eyes. Their differences from a running median over 0.7 s are projected onto their
 * first principal component. A blink is a peak of both eyes that lasts less than half of the 0.7 s. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/format.h"
#include "ernerf/data.h"
#include "io/file.h"
#include "io/landmarks.h"
#include "prepare/head_shape.h"
#include "prepare/landmarks/openface.h"
#include "prepare/stabilized_crop.h"

enum {
  COLUMNS = 18,
  ROWS = 8,
  PIXELS = COLUMNS * ROWS,
  BOTH = 2 * PIXELS,
  AROUND = 8, /* frames before and after in the running median */
  POWER = 30  /* iterations of the power method */
};
static const double step = 0.0016; /* metres between pixels */
/* AU45_r of a blink of median strength; the model takes 2 as closed eyes (docs/formats.md). */
static const double closed = 2.0;
/* In standard deviations of the noise: below `quiet` a lid does not move, above `loud` it blinks. */
static const double quiet = 2.5, loud = 7.0;

struct eyes {
  struct ern_prepare_job *job;
  float (*crops)[BOTH]; /* [frames]: grey levels minus each eye's mean; later minus the running median */
  float *signal;        /* [frames] */
};

/* The centres of the eyes in the head's frame: the intersections of the face with the rays through the eye landmarks.
 */
static ern_status find_eyes(struct eyes *eyes, const struct ern_head_pose *poses, double at[2][2]) {
  ern_status status = ERN_OK;
  struct ern_prepare_job *job = eyes->job;
  const size_t looks = job->frames < 100 ? job->frames : 100;
  float *values[4] = {NULL};
  size_t n = 0;
  for (int i = 0; i < 4; i++) ERN_TRY(ERN_NEW(job->context, looks, &values[i]));
  for (size_t i = 0; i < looks; i++) {
    const size_t frame = i * job->frames / looks;
    char path[ERN_PREPARE_PATH];
    float points[ERN_LANDMARKS][2];
    double met[2][3];
    bool both = true;
    ERN_TRY(ern_prepare_path(job, path, "ori_imgs/%zu.lms", frame));
    ERN_TRY(ern_landmarks_read(job->context, path, points));
    for (int e = 0; e < 2 && both; e++) {
      double pixel[2] = {0, 0};
      for (int k = 0; k < 12; k++) pixel[k % 2] += (double)points[36 + 6 * e + k / 2][k % 2] / 6;
      both = ern_head_intersect(&poses[frame], job->focal, 0.5 * job->side, pixel, false, met[e]);
    }
    if (!both) continue;
    for (int k = 0; k < 4; k++) values[k][n] = (float)met[k / 2][k % 2];
    n++;
  }
  for (int k = 0; k < 4; k++) {
    const double usual = k % 2 != 0 ? ERN_HEAD_EYES_Y : (k < 2 ? -0.5 : 0.5) * ERN_HEAD_EYES;
    at[k / 2][k % 2] = n > 0 ? (double)ern_quantile(values[k], n, 0.5) : usual;
  }
fail:
  for (int i = 0; i < 4; i++) ern_release(job->context, values[i]);
  return status;
}

static ern_status take_crops(struct eyes *eyes) {
  ern_status status = ERN_OK;
  struct ern_prepare_job *job = eyes->job;
  struct ern_head_pose *poses = NULL;
  uint8_t *grey = NULL;
  double at[2][2];
  ERN_TRY(ERN_NEW(job->context, job->frames, &poses));
  ERN_TRY(ERN_NEW(job->context, (size_t)job->side * (size_t)job->side, &grey));
  ERN_TRY(ern_prepare_poses_read(job, poses));
  ERN_TRY(find_eyes(eyes, poses, at));
  for (size_t i = 0; i < job->frames; i++) {
    ERN_TRY(ern_frame_grey(job, i, grey));
    for (int e = 0; e < 2; e++) {
      const struct ern_stabilized_crop crop = {
          .x = at[e][0], .y = at[e][1], .step = step, .columns = COLUMNS, .rows = ROWS};
      float *values = eyes->crops[i] + e * PIXELS;
      double mean = 0;
      ern_stabilized_crop_take(&crop, &poses[i], job, grey, values);
      for (int k = 0; k < PIXELS; k++) mean += (double)values[k] / PIXELS;
      for (int k = 0; k < PIXELS; k++) values[k] -= (float)mean;
    }
    ERN_TRY(ern_prepare_progress(job, i + 1, job->frames));
  }
fail:
  ern_release(job->context, poses);
  ern_release(job->context, grey);
  return status;
}

/* crops -= their median over AROUND frames before and after. */
static ern_status take_median_away(struct eyes *eyes) {
  ern_status status = ERN_OK;
  const size_t frames = eyes->job->frames;
  float window[2 * AROUND + 1], *column = NULL;
  ERN_TRY(ERN_NEW(eyes->job->context, frames, &column));
  for (int k = 0; k < BOTH; k++) {
    for (size_t i = 0; i < frames; i++) column[i] = eyes->crops[i][k];
    for (size_t i = 0; i < frames; i++) {
      const size_t begin = i > AROUND ? i - AROUND : 0, end = i + AROUND + 1 < frames ? i + AROUND + 1 : frames;
      memcpy(window, column + begin, (end - begin) * sizeof *window);
      eyes->crops[i][k] = column[i] - ern_quantile(window, end - begin, 0.5);
    }
  }
fail:
  ern_release(eyes->job->context, column);
  return status;
}

/* signal = crops along their first principal component, with the sign that makes its extreme values positive. signal is
 * twice the smaller of both eyes' values, so that both eyes must move. */
static void project(struct eyes *eyes) {
  const size_t frames = eyes->job->frames;
  double way[BOTH], next[BOTH], third = 0;
  for (int k = 0; k < BOTH; k++) way[k] = 1 + 0.1 * (k % 7);
  for (int round = 0; round < POWER; round++) {
    double norm = 0;
    memset(next, 0, sizeof next);
    for (size_t i = 0; i < frames; i++) {
      double dot = 0;
      for (int k = 0; k < BOTH; k++) dot += way[k] * (double)eyes->crops[i][k];
      for (int k = 0; k < BOTH; k++) next[k] += dot * (double)eyes->crops[i][k];
    }
    for (int k = 0; k < BOTH; k++) norm += next[k] * next[k];
    if (norm <= 0) break;
    for (int k = 0; k < BOTH; k++) way[k] = next[k] / sqrt(norm);
  }
  for (int pass = 0; pass < 2; pass++) {
    const double sign = pass > 0 && third < 0 ? -1 : 1;
    third = 0;
    for (size_t i = 0; i < frames; i++) {
      double dot[2] = {0, 0};
      for (int k = 0; k < BOTH; k++) dot[k / PIXELS] += sign * way[k] * (double)eyes->crops[i][k];
      const double lesser = fabs(dot[0]) < fabs(dot[1]) ? dot[0] : dot[1];
      eyes->signal[i] = (float)(dot[0] * dot[1] > 0 ? 2 * lesser : 0);
      third += pow((double)eyes->signal[i], 3);
    }
  }
}

/* Scales signal to AU45_r; *count: the number of blinks. */
static ern_status scale(struct eyes *eyes, size_t *count) {
  ern_status status = ERN_OK;
  const size_t frames = eyes->job->frames;
  float *sorted = NULL, *peaks = NULL;
  size_t n = 0;
  *count = 0;
  ERN_TRY(ERN_NEW(eyes->job->context, frames, &sorted));
  ERN_TRY(ERN_NEW(eyes->job->context, frames, &peaks));
  for (size_t i = 0; i < frames; i++) sorted[i] = fabsf(eyes->signal[i]);
  const double noise = 1.4826 * fmax((double)ern_quantile(sorted, frames, 0.5), 1);
  ern_prepare_figure(eyes->job, "noise", noise);
  for (size_t i = 0; i < frames;) {
    size_t end = i;
    float peak = 0;
    for (; end < frames && (double)eyes->signal[end] > quiet * noise; end++) peak = fmaxf(peak, eyes->signal[end]);
    const bool blink = (double)peak > loud * noise && end - i <= ERN_PREPARE_RATE / 2;
    if (blink) peaks[n++] = peak;
    for (size_t k = i; k < end && !blink; k++) eyes->signal[k] = 0;
    if (end == i) eyes->signal[end++] = 0;
    i = end;
  }
  const double strength = n > 0 ? (double)ern_quantile(peaks, n, 0.5) : 1;
  for (size_t i = 0; i < frames; i++)
    eyes->signal[i] = (float)fmin(fmax(closed * (double)eyes->signal[i] / strength, 0), 5);
  *count = n;
fail:
  ern_release(eyes->job->context, sorted);
  ern_release(eyes->job->context, peaks);
  return status;
}

static ern_status write_table(struct ern_prepare_job *job, const float *values, size_t count) {
  static const char head[] = "frame, timestamp, confidence, success, AU45_r\n";
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], line[128];
  struct ern_file_writer file = {0};
  double from = 0, to = 0;
  ern_prepare_part(job, &from, &to); /* timestamps are of the video, as --au takes them */
  ERN_TRY(ern_prepare_register_output(job, "au.csv", path));
  ERN_TRY(ern_file_writer_open(job->context, path, ERN_EXISTING_REPLACE, &file));
  ERN_TRY(ern_file_writer_write(&file, head, strlen(head)));
  for (size_t i = 0; i < count; i++) {
    const int length = ern_format(line, sizeof line, "%zu, %.3f, 1.00, 1, %.2f\n", i + 1,
                                  from + (double)i / ERN_PREPARE_RATE, (double)values[i]);
    ERN_TRY(ern_file_writer_write(&file, line, (size_t)length));
  }
  return ern_file_writer_commit(&file);
fail:
  ern_file_writer_abandon(&file);
  return status;
}

/* The user's own table. */
static ern_status from_table(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  float *values = NULL;
  size_t held = 0;
  ERN_TRY(ERN_NEW(job->context, job->frames, &values));
  ERN_TRY(ern_openface_blinks(job, job->options->au, values, &held));
  ERN_TRY(write_table(job, values, job->frames));
  if (held > 0) ern_openface_check(job, job->options->au, held);
fail:
  ern_release(job->context, values);
  return status;
}

ern_status ern_prepare_eyes(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  struct eyes eyes = {.job = job};
  size_t count = 0;
  ERN_TRY(ern_prepare_remove_made(job, "au.csv")); /* an older au.csv, of other frames */
  if (job->options->au != NULL) return from_table(job);
  ERN_TRY(ERN_NEW(job->context, job->frames, &eyes.crops));
  ERN_TRY(ERN_NEW(job->context, job->frames, &eyes.signal));
  ERN_TRY(take_crops(&eyes));
  ERN_TRY(take_median_away(&eyes));
  project(&eyes);
  ERN_TRY(scale(&eyes, &count));
  ern_prepare_figure(job, "blinks", (double)count);
  const double minutes = (double)job->frames / ERN_PREPARE_RATE / 60;
  if (count > 0) {
    ERN_TRY(write_table(job, eyes.signal, job->frames));
    if ((double)count > 80 * minutes + 3)
      ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                             "%zu blinks in %.1f minutes are implausibly many; --au FILE.csv takes those of OpenFace",
                             count, minutes);
  } else {
    ern_prepare_add_reason(job, ERN_PREPARE_GOOD,
                           "no blink was found, so there is no au.csv and no blinking is learnt");
  }
fail:
  ern_release(job->context, eyes.crops);
  ern_release(job->context, eyes.signal);
  return status;
}

ern_status ern_prepare_eyes_check(struct ern_prepare_job *job) {
  float *values = NULL;
  size_t held = 0;
  if (job->options->au == NULL) return ERN_OK;
  ern_status status = ERN_NEW(job->context, job->frames, &values);
  if (status == ERN_OK) status = ern_openface_blinks(job, job->options->au, values, &held);
  ern_release(job->context, values);
  return status;
}
