/* SPDX-License-Identifier: MIT
 * The step "landmarks": 68 points of every frame. Without a network they are a template, fitted to the eyes that the
 * cascades found and to the mouth, where the stabilised face changes most; jaw and lower lip follow the chin. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/format.h"
#include "io/file.h"
#include "prepare/head_shape.h"
#include "prepare/landmarks/landmark_network.h"
#include "prepare/landmarks/landmarks_supplied.h"
#include "prepare/landmarks/landmarks_template.h"
#include "prepare/landmarks/mouth_aside.h"
#include "prepare/landmarks/openface.h"
#include "prepare/stabilized_crop.h"

enum { LOOKS = 240, CHIN_LOOKS = 60, LOWER_COLUMNS = 61, LOWER_ROWS = 76, CHIN_COLUMNS = 88, CHIN_ROWS = 104 };
static const double lower_step = 0.001, chin_step = 0.0006; /* metres */
static const float most_drop = 0.03f;                       /* of the jaw, metres */
static const double most_opening = 25;                      /* millimetres; of fifteen people 8 to 19 */
/* How much a chin differs from that at rest, relative to the median over the frames (fourteen people: 3.4 at most, a
 * hand: 7), and the share of the frames that may differ more. */
static const float most_unlike = 4;
static const double most_hidden = 0.02;

struct fit {
  struct ern_prepare_job *job;
  struct ern_head_pose *poses; /* [frames] */
  uint8_t *grey;               /* [side][side] */
  double middle_x, eyes_y;     /* of the eyes, metres in the head's frame */
  double wide;                 /* width of this face relative to the template */
  double mouth;                /* metres below the eyes */
  double mouth_x;              /* metres from middle_x */
  float *opening;              /* [frames]: how far the jaw is lowered, metres */
};

/* Fits the eyes' midpoint and half distance in the head's frame: medians of the intersections of the face with the rays
 * through the eyes. */
static ern_status fit_eyes(struct fit *fit) {
  ern_status status = ERN_OK;
  struct ern_found_face *faces = NULL;
  float *values[3] = {NULL};
  size_t count = 0, n = 0;
  ERN_TRY(ern_prepare_faces_read(fit->job, &faces, &count));
  for (int i = 0; i < 3; i++) ERN_TRY(ERN_NEW(fit->job->context, count, &values[i]));
  for (size_t i = 0; i < count; i++) {
    double at[2][3];
    bool both = faces[i].has_eyes;
    for (int e = 0; e < 2 && both; e++) {
      const double pixel[2] = {(double)faces[i].eyes[e][0], (double)faces[i].eyes[e][1]};
      both =
          ern_head_intersect(&fit->poses[faces[i].frame], fit->job->focal, 0.5 * fit->job->side, pixel, false, at[e]);
    }
    if (!both) continue;
    values[0][n] = (float)(0.5 * (at[0][0] + at[1][0]));
    values[1][n] = (float)(0.5 * (at[0][1] + at[1][1]));
    values[2][n++] = (float)(at[1][0] - at[0][0]);
  }
  fit->middle_x = n > 0 ? (double)ern_quantile(values[0], n, 0.5) : 0;
  fit->eyes_y = n > 0 ? (double)ern_quantile(values[1], n, 0.5) : ERN_HEAD_EYES_Y;
  const double distance = n > 0 ? (double)ern_quantile(values[2], n, 0.5) : ERN_HEAD_EYES;
  fit->wide = fmin(fmax(distance / ERN_HEAD_EYES, 0.8), 1.2);
fail:
  for (int i = 0; i < 3; i++) ern_release(fit->job->context, values[i]);
  ern_release(fit->job->context, faces);
  return status;
}

/* variance[rows][columns]: of the grey levels over time. */
static ern_status variance_of(struct fit *fit, const struct ern_stabilized_crop *crop, double *variance) {
  ern_status status = ERN_OK;
  const size_t pixels = (size_t)crop->rows * (size_t)crop->columns, frames = fit->job->frames;
  const size_t looks = frames < LOOKS ? frames : LOOKS;
  float *values = NULL;
  double *sums = NULL;
  ERN_TRY(ERN_NEW(fit->job->context, pixels, &values));
  ERN_TRY(ERN_NEW(fit->job->context, 2 * pixels, &sums));
  for (size_t i = 0; i < looks; i++) {
    const size_t frame = i * frames / looks;
    double mean = 0;
    ERN_TRY(ern_frame_grey(fit->job, frame, fit->grey));
    ern_stabilized_crop_take(crop, &fit->poses[frame], fit->job, fit->grey, values);
    for (size_t k = 0; k < pixels; k++) mean += (double)values[k] / (double)pixels;
    for (size_t k = 0; k < pixels; k++) {
      const double v = (double)values[k] - mean; /* the light may change */
      sums[k] += v;
      sums[pixels + k] += v * v;
    }
    ERN_TRY(ern_prepare_progress(fit->job, i / 2, LOOKS + 2 * frames));
  }
  for (size_t k = 0; k < pixels; k++) {
    const double mean = sums[k] / (double)looks;
    variance[k] = fmax(sums[pixels + k] / (double)looks - mean * mean, 0);
  }
fail:
  ern_release(fit->job->context, values);
  ern_release(fit->job->context, sums);
  return status;
}

/* Fits the mouth: the middle of the band of rows whose variance is more than half of the greatest row's. */
static ern_status fit_mouth(struct fit *fit) {
  const struct ern_stabilized_crop crop = {
      .x = fit->middle_x, .y = fit->eyes_y - 0.070, .step = lower_step, .columns = LOWER_COLUMNS, .rows = LOWER_ROWS};
  static const int half = LOWER_COLUMNS / 2;
  double rows[LOWER_ROWS] = {0}, smooth[LOWER_ROWS], most = 0, sum = 0, weight = 0, aside = 0;
  double(*variance)[LOWER_COLUMNS] = NULL;
  float sorted[LOWER_ROWS];
  int peak = LOWER_ROWS / 2;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(fit->job->context, LOWER_ROWS, &variance));
  ERN_TRY(variance_of(fit, &crop, variance[0]));
  for (int r = 0; r < LOWER_ROWS; r++)
    for (int c = half - 22; c <= half + 22; c++) rows[r] += variance[r][c] / 45;
  for (int r = 0; r < LOWER_ROWS; r++) {
    smooth[r] = 0;
    for (int k = -4; k <= 4; k++) {
      const int at = r + k < 0 ? 0 : r + k >= LOWER_ROWS ? LOWER_ROWS - 1 : r + k;
      smooth[r] += rows[at] / 9;
    }
    sorted[r] = (float)smooth[r];
    /* 50 to 90 mm below the eyes: leaves out collar and nose */
    const double under = 0.070 + (r - 0.5 * (LOWER_ROWS - 1)) * lower_step;
    if (under > 0.050 && under < 0.090 && smooth[r] > most) {
      most = smooth[r];
      peak = r;
    }
  }
  int begin = peak, end = peak + 1;
  while (begin > 0 && smooth[begin - 1] > 0.5 * most) begin--;
  while (end < LOWER_ROWS && smooth[end] > 0.5 * most) end++;
  for (int r = begin; r < end; r++)
    for (int c = 0; c < LOWER_COLUMNS; c++) {
      sum += r * variance[r][c];
      aside += (c - half) * variance[r][c];
      weight += variance[r][c];
    }
  const double row = weight > 0 ? sum / weight : peak;
  fit->mouth = fmin(fmax(0.070 + (row - 0.5 * (LOWER_ROWS - 1)) * lower_step, 0.055), 0.085);
  fit->mouth_x = weight > 0 ? fmin(fmax(aside / weight * lower_step, -0.01), 0.01) : 0;
  const double contrast = most / fmax((double)ern_quantile(sorted, LOWER_ROWS, 0.25), 1);
  ern_prepare_figure(fit->job, "mouth_mm", 1000 * fit->mouth);
  ern_prepare_figure(fit->job, "mouth_contrast", contrast);
  if (contrast < 2)
    ern_prepare_add_reason(
        fit->job, ERN_PREPARE_DOUBTFUL,
        "the mouth changes %.1f times as much as the rest of the lower face, expected 2 or more of a "
        "person who speaks; --landmarks takes points of another program",
        contrast);
fail:
  ern_release(fit->job->context, variance);
  return status;
}

static bool is_chin(int r, int c) {
  const double under = (r - 0.5 * (CHIN_ROWS - 1)) * chin_step + 0.010; /* the mouth's line */
  const double aside = fabs(c - 0.5 * (CHIN_COLUMNS - 1)) * chin_step;
  return under > 0.012 && under < 0.028 && aside < 0.014;
}

/* Variance of the difference between the chin at rest and what a crop has so many rows below. */
static double chin_differs(const uint8_t *rest, const uint8_t *crop, int rows) {
  double sum = 0, square = 0, n = 0;
  for (int r = 0; r < CHIN_ROWS; r++)
    for (int c = 0; c < CHIN_COLUMNS; c++) {
      if (!is_chin(r, c) || r + rows < 0 || r + rows >= CHIN_ROWS) continue;
      const double apart = rest[r * CHIN_COLUMNS + c] - crop[(r + rows) * CHIN_COLUMNS + c];
      sum += apart;
      square += apart * apart;
      n++;
    }
  return n > 0 ? square / n - sum / n * (sum / n) : HUGE_VAL;
}

/* The frame's picture round the chin, `drop` metres below the chin at rest. */
static void take_chin(struct fit *fit, size_t frame, float drop, float *values, uint8_t *crop) {
  const struct ern_stabilized_crop chin = {.x = fit->middle_x + fit->mouth_x,
                                           .y = fit->eyes_y - fit->mouth - 0.010 - (double)drop,
                                           .step = chin_step,
                                           .columns = CHIN_COLUMNS,
                                           .rows = CHIN_ROWS};
  ern_stabilized_crop_take(&chin, &fit->poses[frame], fit->job, fit->grey, values);
  for (int i = 0; i < CHIN_COLUMNS * CHIN_ROWS; i++) crop[i] = (uint8_t)lrintf(fminf(fmaxf(values[i], 0), 255));
}

/* *drop: metres by which the chin is lower than at rest: the median flow below the lower lip. The flow does not find a
 * chin that is too far away, so it is also looked for from where it was in the frame before; the better match is
 * taken. */
static ern_status chin_drop(struct fit *fit, size_t frame, const uint8_t *rest, uint8_t *crop, float *flow,
                            float *values, float *drop) {
  const float starts[2] = {0, fminf(fmaxf(*drop, -most_drop), most_drop)};
  double least = HUGE_VAL;
  for (int i = 0; i < (starts[1] != 0 ? 2 : 1); i++) {
    size_t n = 0;
    take_chin(fit, frame, starts[i], values, crop);
    const ern_status status = ern_optical_flow(fit->job->context, rest, crop, CHIN_COLUMNS, CHIN_ROWS, flow);
    if (status != ERN_OK) return status;
    for (int r = 0; r < CHIN_ROWS; r++)
      for (int c = 0; c < CHIN_COLUMNS; c++)
        if (is_chin(r, c)) values[n++] = flow[2 * (r * CHIN_COLUMNS + c) + 1];
    const float rows = ern_quantile(values, n, 0.5);
    const double differs = chin_differs(rest, crop, (int)lrintf(rows));
    if (differs >= least) continue;
    least = differs;
    *drop = starts[i] + rows * (float)chin_step;
  }
  return ERN_OK;
}

/* The frame whose chin looks most like the mean: from a frame with a wide open mouth, the flow leads to another lip or
 * to the collar. */
static ern_status find_rest(struct fit *fit, float *values, uint8_t *crop, size_t *rest) {
  enum { PIXELS = CHIN_COLUMNS * CHIN_ROWS };
  const size_t frames = fit->job->frames, looks = frames < CHIN_LOOKS ? frames : CHIN_LOOKS;
  double *mean = NULL, least = HUGE_VAL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(fit->job->context, PIXELS, &mean));
  for (size_t k = 0; k < 2 * looks; k++) {
    const size_t frame = k % looks * frames / looks;
    double differs = 0;
    ERN_TRY(ern_frame_grey(fit->job, frame, fit->grey));
    take_chin(fit, frame, 0, values, crop);
    for (int i = 0; i < PIXELS; i++) {
      if (k < looks)
        mean[i] += (double)values[i] / (double)looks;
      else
        differs += fabs((double)values[i] - mean[i]);
    }
    if (k < looks || differs >= least) continue;
    least = differs;
    *rest = frame;
  }
fail:
  ern_release(fit->job->context, mean);
  return status;
}

/* Grey levels by which the face from 6 mm below the mouth's line on differs from that at rest. crop: the chin where it
 * was found. */
static float chin_unlike(const uint8_t *rest, const uint8_t *crop) {
  enum { FIRST = (CHIN_ROWS / 2 - 7) * CHIN_COLUMNS, COUNT = CHIN_ROWS * CHIN_COLUMNS - FIRST };
  int sum = 0;
  for (int i = FIRST; i < FIRST + COUNT; i++) sum += abs(rest[i] - crop[i]);
  return (float)sum / COUNT;
}

/* Detects chins that something hides. unlike[frames]: of chin_unlike(); sorted[frames] is overwritten. */
static void check_hidden(struct ern_prepare_job *job, const float *unlike, float *sorted) {
  size_t hidden = 0, first = 0;
  for (size_t i = 0; i < job->frames; i++) sorted[i] = unlike[i];
  const float usual = fmaxf(ern_quantile(sorted, job->frames, 0.5), 1);
  for (size_t i = job->frames; i-- > 0;)
    if (unlike[i] > most_unlike * usual) {
      first = i;
      hidden++;
    }
  ern_prepare_figure(job, "chin_hidden", (double)hidden / (double)job->frames);
  if ((double)hidden > most_hidden * (double)job->frames)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "the chin looks otherwise in %zu of %zu frames, the first is %zu, as behind a hand or in "
                           "other light, expected %.0f %% of them at most: a model learns it as a part of speech; "
                           "--from and --to choose a part without it",
                           hidden, job->frames, first, 100 * most_hidden);
}

/* Measures the openings of all frames, relative to the lowest tenth of them, which counts as a closed mouth. */
static ern_status follow_chin(struct fit *fit) {
  enum { PIXELS = CHIN_COLUMNS * CHIN_ROWS };
  ern_status status = ERN_OK;
  ern_context *context = fit->job->context;
  const size_t frames = fit->job->frames;
  uint8_t *rest = NULL, *crop = NULL;
  float *values = NULL, *flow = NULL, *sorted = NULL, *unlike = NULL;
  ERN_TRY(ERN_NEW(context, PIXELS, &rest));
  ERN_TRY(ERN_NEW(context, PIXELS, &crop));
  ERN_TRY(ERN_NEW(context, PIXELS, &values));
  ERN_TRY(ERN_NEW(context, 2 * PIXELS, &flow));
  ERN_TRY(ERN_NEW(context, frames, &sorted));
  ERN_TRY(ERN_NEW(context, frames, &unlike));
  size_t at_rest = 0;
  ERN_TRY(find_rest(fit, values, crop, &at_rest));
  ERN_TRY(ern_frame_grey(fit->job, at_rest, fit->grey));
  take_chin(fit, at_rest, 0, values, rest);
  for (size_t i = 0; i < frames; i++) {
    ERN_TRY(ern_frame_grey(fit->job, i, fit->grey));
    fit->opening[i] = i > 0 ? fit->opening[i - 1] : 0;
    ERN_TRY(chin_drop(fit, i, rest, crop, flow, values, &fit->opening[i]));
    sorted[i] = fit->opening[i];
    take_chin(fit, i, fit->opening[i], values, crop);
    unlike[i] = chin_unlike(rest, crop);
    ERN_TRY(ern_prepare_progress(fit->job, LOOKS / 2 + i, LOOKS + 2 * frames));
  }
  const float closed = ern_quantile(sorted, frames, 0.1), wide = ern_quantile(sorted, frames, 0.95);
  for (size_t i = 0; i < frames; i++) fit->opening[i] = fminf(fmaxf(fit->opening[i] - closed, 0), most_drop);
  const double opens = 1000 * (double)(wide - closed);
  ern_prepare_figure(fit->job, "opening_mm", opens);
  if (opens > most_opening)
    ern_prepare_add_reason(
        fit->job, ERN_PREPARE_DOUBTFUL,
        "the mouth opens by %.0f mm, expected %g mm at most of a person who speaks: the landmarks of "
        "lower lip and chin are probably wrong (overlay.mp4 shows them), for example because the chin leaves the "
        "picture or is hidden; --landmarks takes points of another program",
        opens, most_opening);
  check_hidden(fit->job, unlike, sorted);
fail:
  ern_release(context, rest);
  ern_release(context, crop);
  ern_release(context, values);
  ern_release(context, flow);
  ern_release(context, sorted);
  ern_release(context, unlike);
  return status;
}

/* The share of the jaw's motion that a landmark follows. */
static double follows_jaw(int point) {
  static const double jaw[] = {0.3, 0.6, 0.85, 0.95, 1, 0.95, 0.85, 0.6, 0.3}; /* 4..12 */
  if (point >= 4 && point <= 12) return jaw[point - 4];
  if ((point >= 55 && point <= 59) || point >= 65) return 1;
  return point == 48 || point == 54 || point == 60 || point == 64 ? 0.3 : 0;
}

static ern_status write_points(struct ern_prepare_job *job, size_t frame, const float points[ERN_LANDMARKS][2]) {
  char path[ERN_PREPARE_PATH], name[64], text[ERN_LANDMARKS * 32];
  size_t length = 0;
  for (int k = 0; k < ERN_LANDMARKS; k++)
    length += (size_t)ern_format(text + length, sizeof text - length, "%.2f %.2f\n",
                                 fmin(fmax((double)points[k][0], -9999), 9999),
                                 fmin(fmax((double)points[k][1], -9999), 9999));
  snprintf(name, sizeof name, "ori_imgs/%zu.lms", frame);
  const ern_status status = ern_prepare_register_output(job, name, path);
  return status == ERN_OK ? ern_file_write(job->context, path, text, length, ERN_EXISTING_REPLACE) : status;
}

static ern_status write_frame(struct fit *fit, size_t frame) {
  float points[ERN_LANDMARKS][2];
  for (int i = 0; i < ERN_LANDMARKS; i++) {
    const double *t = ern_landmarks_template[i];
    /* below the eyes the template is stretched, so that its mouth meets this face's mouth */
    const double y = t[1] < -10 ? -10 + (t[1] + 10) * (1000 * fit->mouth - 10) / (ERN_TEMPLATE_MOUTH - 10) : t[1];
    const double lower = t[1] < 0 ? fmin(-t[1] / ERN_TEMPLATE_MOUTH, 1) : 0; /* share of the mouth's lateral offset */
    const double point[3] = {fit->middle_x + 0.001 * t[0] * fit->wide + lower * fit->mouth_x,
                             fit->eyes_y + 0.001 * y - follows_jaw(i) * (double)fit->opening[frame],
                             ERN_HEAD_EYES_Z + 0.001 * t[2]};
    double pixel[2] = {0, 0};
    (void)ern_head_project(&fit->poses[frame], fit->job->focal, 0.5 * fit->job->side, point, pixel);
    for (int c = 0; c < 2; c++) points[i][c] = (float)fmin(fmax(pixel[c], -9999), 9999);
  }
  return write_points(fit->job, frame, (const float(*)[2])points);
}

static ern_status from_template(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  struct fit fit = {.job = job};
  ERN_TRY(ERN_NEW(job->context, job->frames, &fit.poses));
  ERN_TRY(ERN_NEW(job->context, job->frames, &fit.opening));
  ERN_TRY(ERN_NEW(job->context, (size_t)job->side * (size_t)job->side, &fit.grey));
  ERN_TRY(ern_prepare_poses_read(job, fit.poses));
  ERN_TRY(fit_eyes(&fit));
  ERN_TRY(fit_mouth(&fit));
  ERN_TRY(follow_chin(&fit));
  ERN_TRY(ern_landmarks_check_aside(job, fit.poses, fit.middle_x + fit.mouth_x, fit.eyes_y - fit.mouth,
                                    LOOKS / 2 + job->frames, LOOKS + 2 * job->frames));
  for (size_t i = 0; i < job->frames; i++) ERN_TRY(write_frame(&fit, i));
fail:
  ern_release(job->context, fit.poses);
  ern_release(job->context, fit.opening);
  ern_release(job->context, fit.grey);
  return status;
}

/* Checks the supplied landmarks' distance from the heads. */
static ern_status check_supplied(struct ern_prepare_job *job, const struct ern_head_pose *poses,
                                 const float (*points)[ERN_LANDMARKS][2]) {
  ern_status status = ERN_OK;
  float *apart = NULL, guess[ERN_LANDMARKS][2];
  size_t mismatches = 0;
  ERN_TRY(ERN_NEW(job->context, job->frames, &apart));
  for (size_t i = 0; i < job->frames; i++) {
    apart[i] = HUGE_VALF;
    if (ern_landmarks_at_pose(job, &poses[i], guess))
      apart[i] = (float)ern_landmarks_distance(points[i], (const float(*)[2])guess);
    mismatches += apart[i] > 0.5f;
  }
  const double share = (double)mismatches / (double)job->frames;
  ern_prepare_figure(job, "apart", (double)ern_quantile(apart, job->frames, 0.5));
  ern_prepare_figure(job, "astray", share);
  if (share > 0.02)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "the landmarks of %s lie more than half an eye distance from where the poses have the head in %.0f "
        "%% of the frames, expected 2 %% at most; overlay.mp4 shows them",
        job->options->landmarks, 100 * share);
fail:
  ern_release(job->context, apart);
  return status;
}

/* Checks the user's landmarks and writes them as the step's own. */
static ern_status from_user(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  struct ern_head_pose *poses = NULL;
  float(*points)[ERN_LANDMARKS][2] = NULL;
  size_t held = 0;
  const bool files = ern_landmarks_are_files(job);
  ERN_TRY(ERN_NEW(job->context, job->frames, &poses));
  ERN_TRY(ERN_NEW(job->context, job->frames, &points));
  if (!files) ERN_TRY(ern_prepare_poses_read(job, poses));
  ERN_TRY(ern_landmarks_supplied(job, NULL, poses, job->frames, points, &held));
  for (size_t i = 0; i < job->frames; i++) ERN_TRY(write_points(job, i, (const float(*)[2])points[i]));
  if (held > 0) ern_openface_check(job, job->options->landmarks, held);
  if (!files) ERN_TRY(check_supplied(job, poses, (const float(*)[ERN_LANDMARKS][2])points));
fail:
  ern_release(job->context, poses);
  ern_release(job->context, points);
  return status;
}

ern_status ern_prepare_landmarks(struct ern_prepare_job *job) {
  return job->options->landmarks != NULL ? from_user(job) : from_template(job);
}
