/* SPDX-License-Identifier: MIT
 * The step "pose": estimates the head's pose in every frame without a face model. It tracks points from reference
 * frames (flow_tracks.h) and solves for poses and points by bundle adjustment with a generic head as prior (bundle.h).
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/format.h"
#include "io/file.h"
#include "prepare/head_shape.h"
#include "prepare/pose/bundle.h"
#include "prepare/pose/flow_tracks.h"
#include "prepare/pose/pose_align.h"
#include "prepare/prepare_job.h"
#include "prepare/stabilized_crop.h"

enum { REFERENCES = 9, CHOSEN = 90, WINDOW = 400, OVERLAP = 25, ROUNDS = 3, PASSES = 2 + ERN_POSE_ALIGN_ROUNDS };
/* A frame whose head is turned further than this from every reference's becomes a reference itself, degrees. */
static const double reference_turn = 12;
/* Tracks that fit a rigid head to this many pixels of 512 tell its pose better than pictures (docs/results.md). */
static const double well_tracked = 0.6;

/* The state of the step. */
struct tracking {
  struct ern_prepare_job *job;
  double centre;
  struct ern_head_pose *poses;     /* [frames] */
  struct ern_bundle_pose *bundled; /* [frames] */
  uint8_t *grey;                   /* [side][side] */
  size_t count;                    /* of references */
  size_t at[REFERENCES];           /* their frames */
  struct ern_flow_reference *references[REFERENCES];
  size_t first[REFERENCES + 1];  /* their first points */
  float shares[REFERENCES];      /* 0..1: the weight of each reference in the present frame */
  struct ern_observations *seen; /* [frames] */
  float (*found)[2];             /* [points]: of the present frame; NaN: not seen */
  float *weights;                /* [points] */
  double (*prior)[3], (*shape)[3];
  double residual; /* median reprojection error, pixels of a picture of 512 a side */
};

static struct ern_bundle bundle_of(struct tracking *t) {
  return (struct ern_bundle){.context = t->job->context,
                             .focal = t->job->focal,
                             .centre = t->centre,
                             .frames = t->job->frames,
                             .points = t->first[t->count],
                             .seen = t->seen,
                             .weights = t->weights,
                             .prior = (const double(*)[3])t->prior,
                             .shape = t->shape,
                             .poses = t->bundled};
}

/* Selects points of the reference frame on the rigid head: on its ellipsoid, not at the rim, and not on eyes, mouth or
 * chin. */
struct wanted {
  const struct tracking *tracking;
  struct ern_head_pose pose;
};

static bool is_rigid(const void *user, float x, float y) {
  const struct wanted *wanted = user;
  const struct tracking *t = wanted->tracking;
  const double pixel[2] = {(double)x, (double)y};
  double p[3];
  if (!ern_head_intersect(&wanted->pose, t->job->focal, t->centre, pixel, false, p)) return false;
  const double out[3] = {p[0] / (ERN_HEAD_WIDE * ERN_HEAD_WIDE), p[1] / (ERN_HEAD_TALL * ERN_HEAD_TALL),
                         p[2] / (ERN_HEAD_DEEP * ERN_HEAD_DEEP)}; /* along the normal */
  const double *back = wanted->pose.rotation[2];
  const double facing = (back[0] * out[0] + back[1] * out[1] + back[2] * out[2]) /
                        sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]);
  const bool eye = fabs(fabs(p[0]) - 0.5 * ERN_HEAD_EYES) < 0.020 && fabs(p[1] - ERN_HEAD_EYES_Y) < 0.013;
  const bool mouth = p[1] < ERN_HEAD_EYES_Y - 0.052 && fabs(p[0]) < 0.045;
  return facing > 0.4 && !eye && !mouth && p[1] > -0.095;
}

static ern_status add_reference(struct tracking *t, size_t frame) {
  struct wanted wanted = {.tracking = t, .pose = t->poses[frame]};
  double box[4];
  char where[4096];
  ern_status status = ERN_OK;
  ern_format(where, sizeof where, "%s: frame %zu", t->job->folder, frame);
  ERN_TRY(ern_frame_grey(t->job, frame, t->grey));
  ern_head_box(&wanted.pose, t->job->focal, t->centre, box);
  const struct ern_flow_region region = {(float)box[0], (float)box[1], (float)(box[2] - box[0]),
                                         (float)(box[3] - box[1])};
  ERN_TRY(ern_flow_reference_make(t->job->context, where, t->grey, t->job->side, region, is_rigid, &wanted,
                                  &t->references[t->count]));
  const float(*points)[2] = NULL;
  t->at[t->count] = frame;
  t->first[t->count + 1] = t->first[t->count] + ern_flow_reference_points(t->references[t->count], &points);
  t->count++;
fail:
  return status;
}

/* Allocates memory for the present points and sets the priors of the last reference's points. */
static ern_status lay_out(struct tracking *t, size_t before) {
  ern_context *context = t->job->context;
  const size_t points = t->first[t->count], old = t->first[before];
  ern_status status = ERN_OK;
  double(*prior)[3] = NULL, (*shape)[3] = NULL;
  float *weights = NULL;
  ern_release(context, t->found);
  t->found = NULL;
  ERN_TRY(ERN_NEW(context, points, &t->found));
  ERN_TRY(ERN_NEW(context, points, &prior));
  ERN_TRY(ERN_NEW(context, points, &shape));
  ERN_TRY(ERN_NEW(context, points, &weights));
  if (old > 0) {
    memcpy(prior, t->prior, old * sizeof *prior);
    memcpy(shape, t->shape, old * sizeof *shape);
    memcpy(weights, t->weights, old * sizeof *weights);
  }
  for (size_t r = before; r < t->count; r++) {
    const float(*at)[2] = NULL;
    const size_t count = ern_flow_reference_points(t->references[r], &at);
    for (size_t k = 0; k < count; k++) {
      const double pixel[2] = {(double)at[k][0], (double)at[k][1]};
      const size_t to = t->first[r] + k;
      (void)ern_head_intersect(&t->poses[t->at[r]], t->job->focal, t->centre, pixel, true, prior[to]);
      memcpy(shape[to], prior[to], sizeof shape[to]);
      weights[to] = 1;
    }
  }
  ern_release(context, t->prior);
  ern_release(context, t->shape);
  ern_release(context, t->weights);
  t->prior = prior;
  t->shape = shape;
  t->weights = weights;
  return ERN_OK;
fail:
  ern_release(context, prior);
  ern_release(context, shape);
  ern_release(context, weights);
  return status;
}

/* The similarity transform from the reference's head to the head in the frame's pose: by the bridge of the nose, scale
 * and roll. */
static void warp_of(const struct tracking *t, size_t reference, size_t frame, double warp[4]) {
  static const double bridge[3] = {0, ERN_HEAD_EYES_Y - 0.02, 0.09};
  const struct ern_head_pose *a = &t->poses[t->at[reference]], *b = &t->poses[frame];
  double from[2] = {0, 0}, to[2] = {0, 0};
  (void)ern_head_project(a, t->job->focal, t->centre, bridge, from);
  (void)ern_head_project(b, t->job->focal, t->centre, bridge, to);
  const double turn = atan2(b->rotation[1][0], b->rotation[0][0]) - atan2(a->rotation[1][0], a->rotation[0][0]);
  const double scale = a->translation[2] / b->translation[2];
  warp[0] = scale * cos(turn);
  warp[1] = -scale * sin(turn); /* y is down in the picture */
  warp[2] = to[0] - (warp[0] * from[0] - warp[1] * from[1]);
  warp[3] = to[1] - (warp[1] * from[0] + warp[0] * from[1]);
}

static ern_status find_points(struct tracking *t, size_t reference, double warp[4]) {
  return ern_flow_reference_find(t->references[reference], t->grey, warp, t->found + t->first[reference]);
}

static void forget_points(struct tracking *t) {
  for (size_t k = 0; k < t->first[t->count]; k++) t->found[k][0] = t->found[k][1] = NAN;
}

/* Stores the found points of a frame as a list, as a frame shows at most half of all points. */
static ern_status keep_points(struct tracking *t, size_t frame) {
  struct ern_observations *seen = &t->seen[frame];
  const size_t points = t->first[t->count];
  size_t count = 0;
  for (size_t k = 0; k < points; k++) count += isnan(t->found[k][0]) ? 0 : 1;
  ern_release(t->job->context, seen->list);
  *seen = (struct ern_observations){0};
  const ern_status status = ERN_NEW(t->job->context, count, &seen->list);
  for (size_t r = 0; r < t->count && status == ERN_OK; r++)
    for (size_t k = t->first[r]; k < t->first[r + 1]; k++)
      if (!isnan(t->found[k][0]))
        seen->list[seen->count++] =
            (struct ern_observation){(uint32_t)k, t->shares[r], {t->found[k][0], t->found[k][1]}};
  return status;
}

/* One frame of the first pass: the neighbour's warp and pose are the start values for tracking and pose. */
static ern_status follow(struct tracking *t, size_t frame, size_t neighbour, double warp[4]) {
  ern_status status = ERN_OK;
  size_t seen = 0;
  struct ern_bundle bundle = bundle_of(t);
  ERN_TRY(ern_frame_grey(t->job, frame, t->grey));
  t->shares[0] = 1;
  ERN_TRY(find_points(t, 0, warp));
  ERN_TRY(keep_points(t, frame));
  t->bundled[frame] = t->bundled[neighbour];
  ERN_TRY(ern_bundle_one(&bundle, frame, &seen));
  ern_bundle_pose_to(&t->bundled[frame], &t->poses[frame]);
fail:
  return status;
}

/* The first pass: from the first reference to both ends of the video. */
static ern_status follow_all(struct tracking *t) {
  const double none[4] = {1, 0, 0, 0};
  const size_t reference = t->at[0], frames = t->job->frames;
  ern_status status = ERN_OK;
  double warp[4];
  size_t done = 0;
  memcpy(warp, none, sizeof warp);
  for (size_t i = reference; i < frames; i++) {
    ERN_TRY(follow(t, i, i > reference ? i - 1 : reference, warp));
    ERN_TRY(ern_prepare_progress(t->job, ++done, PASSES * frames));
  }
  memcpy(warp, none, sizeof warp);
  for (size_t i = reference; i-- > 0;) {
    ERN_TRY(follow(t, i, i + 1, warp));
    ERN_TRY(ern_prepare_progress(t->job, ++done, PASSES * frames));
  }
fail:
  return status;
}

/* The second pass: tracks every frame from all references near it, with the approximate poses. References disagree a
 * little on depth, so a reference's weight fades as the head turns away from it; without that the pose would jump where
 * the reference drops out. */
static ern_status find_all(struct tracking *t) {
  ern_status status = ERN_OK;
  const size_t frames = t->job->frames;
  for (size_t i = 0; i < frames; i++) {
    ERN_TRY(ern_frame_grey(t->job, i, t->grey));
    forget_points(t);
    for (size_t r = 0; r < t->count; r++) {
      double warp[4];
      const double turn = ern_head_turn(&t->poses[i], &t->poses[t->at[r]]) / reference_turn;
      if (turn > 2) continue;
      t->shares[r] = (float)fmin(2 - turn, 1);
      warp_of(t, r, i, warp);
      ERN_TRY(find_points(t, r, warp));
    }
    ERN_TRY(keep_points(t, i));
    ERN_TRY(ern_prepare_progress(t->job, frames + i + 1, PASSES * frames));
  }
fail:
  return status;
}

/* Lowers the weight of points that do not move rigidly with the others, as cheeks and jaw in speech: 1 / (1 + (r / 1.5
 * m)^4), r being the point's median residual over chosen[count <= CHOSEN] frames and m that of all points. */
static ern_status weigh(struct tracking *t, const size_t *chosen, size_t count) {
  ern_status status = ERN_OK;
  ern_context *context = t->job->context;
  struct ern_bundle bundle = bundle_of(t);
  float(*values)[CHOSEN] = NULL, *medians = NULL, *sorted = NULL;
  size_t *counts = NULL, known = 0;
  ERN_TRY(ERN_NEW(context, bundle.points, &values));
  ERN_TRY(ERN_NEW(context, bundle.points, &counts));
  ERN_TRY(ERN_NEW(context, bundle.points, &medians));
  ERN_TRY(ERN_NEW(context, bundle.points, &sorted));
  for (size_t i = 0; i < count; i++)
    for (size_t k = 0; k < bundle.seen[chosen[i]].count; k++) {
      const struct ern_observation *seen = &bundle.seen[chosen[i]].list[k];
      values[seen->point][counts[seen->point]++] = (float)ern_bundle_residual(&bundle, chosen[i], seen);
    }
  for (size_t k = 0; k < bundle.points; k++) {
    const size_t n = counts[k];
    medians[k] = n >= 3 && 20 * n >= count ? ern_quantile(values[k], n, 0.5) : NAN;
    if (!isnan(medians[k])) sorted[known++] = medians[k];
  }
  const float middle = fmaxf(ern_quantile(sorted, known, 0.5), 0.05f);
  for (size_t k = 0; k < bundle.points; k++) {
    const float ratio = medians[k] / (1.5f * middle);
    t->weights[k] = isnan(ratio) ? 0 : 1 / (1 + ratio * ratio * ratio * ratio);
  }
fail:
  ern_release(context, values);
  ern_release(context, counts);
  ern_release(context, medians);
  ern_release(context, sorted);
  return status;
}

/* Adjusts shape and poses of frames across the video, alternating with the points' weights. */
static ern_status adjust(struct tracking *t, int rounds) {
  const size_t frames = t->job->frames, count = frames < CHOSEN ? frames : CHOSEN;
  size_t chosen[CHOSEN + REFERENCES], seen = 0;
  struct ern_bundle bundle = bundle_of(t);
  ern_status status = ERN_OK;
  for (size_t i = 0; i < count; i++) chosen[i] = i * frames / count;
  size_t nearest = 0; /* the first reference replaces the chosen frame nearest to it */
  for (size_t i = 0; i < count; i++)
    if (llabs((long long)chosen[i] - (long long)t->at[0]) < llabs((long long)chosen[nearest] - (long long)t->at[0]))
      nearest = i;
  chosen[nearest] = t->at[0];
  for (int round = 0; round < rounds; round++) {
    ERN_TRY(ern_bundle_adjust(&bundle, chosen, count, t->at[0]));
    ERN_TRY(weigh(t, chosen, count));
  }
  for (size_t i = 0; i < frames; i++) ERN_TRY(ern_bundle_one(&bundle, i, &seen));
  for (size_t i = 0; i < frames; i++) ern_bundle_pose_to(&t->bundled[i], &t->poses[i]);
fail:
  return status;
}

/* Adjusts all poses with smoothing in time. */
static ern_status smooth(struct tracking *t) {
  struct ern_bundle bundle = bundle_of(t);
  const size_t frames = t->job->frames;
  ern_status status = ERN_OK;
  for (size_t begin = 0; begin < frames; begin += WINDOW) {
    const size_t end = begin + WINDOW + OVERLAP < frames ? begin + WINDOW + OVERLAP : frames;
    ERN_TRY(ern_bundle_path(&bundle, begin, end));
    if (end == frames) break;
  }
  for (size_t i = 0; i < frames; i++) ern_bundle_pose_to(&t->bundled[i], &t->poses[i]);
fail:
  return status;
}

/* Adds references until the head of each frame is within reference_turn of one. */
static ern_status add_references(struct tracking *t) {
  ern_status status = ERN_OK;
  const size_t before = t->count;
  while (t->count < REFERENCES) {
    double worst = 0;
    size_t frame = 0;
    for (size_t i = 0; i < t->job->frames; i++) {
      double least = HUGE_VAL;
      for (size_t r = 0; r < t->count; r++) least = fmin(least, ern_head_turn(&t->poses[i], &t->poses[t->at[r]]));
      if (least > worst) {
        worst = least;
        frame = i;
      }
    }
    if (worst <= reference_turn) break;
    ERN_TRY(add_reference(t, frame));
  }
  ERN_TRY(lay_out(t, before));
fail:
  return status;
}

/* Chooses the first reference: the frame whose eyes are level, in the middle of the face's box, and at their median
 * distance. */
static bool choose_reference(struct tracking *t, const struct ern_found_face *faces, size_t count, float *distances,
                             size_t *chosen) {
  size_t n = 0;
  double best = HUGE_VAL;
  for (size_t i = 0; i < count; i++)
    if (faces[i].has_eyes)
      distances[n++] = hypotf(faces[i].eyes[1][0] - faces[i].eyes[0][0], faces[i].eyes[1][1] - faces[i].eyes[0][1]);
  if (n == 0) return false;
  const double middle = (double)ern_quantile(distances, n, 0.5);
  for (size_t i = 0; i < count; i++) {
    const struct ern_found_face *f = &faces[i];
    if (!f->has_eyes) continue;
    const double dx = (double)(f->eyes[1][0] - f->eyes[0][0]), dy = (double)(f->eyes[1][1] - f->eyes[0][1]);
    const double aside = (double)(0.5f * (f->eyes[0][0] + f->eyes[1][0]) - (f->x + 0.5f * f->width)) / middle;
    const double cost = fabs(hypot(dx, dy) / middle - 1) + 2 * fabs(aside) + fabs(dy) / middle +
                        0.1 * fabs((double)f->frame / (double)t->job->frames - 0.5);
    if (cost < best) {
      best = cost;
      *chosen = i;
    }
  }
  return true;
}

static ern_status track(struct tracking *t, const struct ern_found_face *face) {
  ern_status status = ERN_OK;
  ern_head_pose_of_eyes(face->eyes, t->job->focal, t->centre, &t->poses[face->frame]);
  ern_bundle_pose_from(&t->poses[face->frame], &t->bundled[face->frame]);
  ERN_TRY(add_reference(t, face->frame));
  ERN_TRY(lay_out(t, 0));
  ERN_TRY(follow_all(t));
  ERN_TRY(adjust(t, ROUNDS));
  ERN_TRY(add_references(t));
  ERN_TRY(find_all(t));
  ERN_TRY(adjust(t, ROUNDS));
  ERN_TRY(smooth(t));
fail:
  return status;
}

/* How well a frame's points support its pose. */
struct support {
  float residual; /* median, pixels of a picture of 512 a side; NaN without points */
  size_t seen;
};

static ern_status measure(struct tracking *t, struct support *support) {
  struct ern_bundle bundle = bundle_of(t);
  float *values = NULL;
  const ern_status status = ERN_NEW(t->job->context, bundle.points, &values);
  for (size_t i = 0; i < bundle.frames && status == ERN_OK; i++) {
    size_t n = 0;
    for (size_t k = 0; k < bundle.seen[i].count; k++) {
      const struct ern_observation *seen = &bundle.seen[i].list[k];
      if (bundle.weights[seen->point] > 0.3f)
        values[n++] = (float)ern_bundle_residual(&bundle, i, seen) * 512 / (float)t->job->side;
    }
    support[i] = (struct support){ern_quantile(values, n, 0.5), n};
  }
  ern_release(t->job->context, values);
  return status;
}

/* Writes prepare/pose.csv, which the report plots. */
static ern_status write_support(struct tracking *t, const struct support *support) {
  static const char head[] = "frame,residual,points\n";
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], line[128];
  struct ern_file_writer file = {0};
  ERN_TRY(ern_prepare_register_output(t->job, "prepare/pose.csv", path));
  ERN_TRY(ern_file_writer_open(t->job->context, path, ERN_EXISTING_REPLACE, &file));
  ERN_TRY(ern_file_writer_write(&file, head, strlen(head)));
  for (size_t i = 0; i < t->job->frames; i++) {
    const float residual = isnan(support[i].residual) ? 99 : support[i].residual;
    const int length = ern_format(line, sizeof line, "%zu,%.3f,%zu\n", i, (double)residual, support[i].seen);
    ERN_TRY(ern_file_writer_write(&file, line, (size_t)length));
  }
  return ern_file_writer_commit(&file);
fail:
  ern_file_writer_abandon(&file);
  return status;
}

/* Jitter: the mean change, in degrees, of the head's rotation from a frame to the next. */
static double jitter_of(const struct tracking *t) {
  double sum = 0;
  for (size_t i = 1; i + 1 < t->job->frames; i++) {
    double square = 0;
    for (int c = 0; c < 3; c++) {
      const double change = t->bundled[i - 1].values[c] - 2 * t->bundled[i].values[c] + t->bundled[i + 1].values[c];
      square += change * change;
    }
    sum += sqrt(square) * 57.29577951308232;
  }
  return t->job->frames > 2 ? sum / (double)(t->job->frames - 2) : 0;
}

/* The measurements for the verdict. */
struct findings {
  double residual;      /* median, pixels of 512 */
  double points;        /* median number of points seen */
  double hidden;        /* share of frames that see less than 0.65 of that */
  double lost;          /* share of frames with too few points for a pose */
  double tremble, turn; /* degrees */
};

/* Up to these the PSNR of seven people's heads does not fall with them (docs/prepare.md). */
static const double most_residual = 1.2, most_tremble = 1.2, most_hidden = 0.12;

/* False where the value is within its bound; else the grade. */
static bool is_beyond(double value, double doubtful, double refused, ern_prepare_grade *grade) {
  *grade = value > refused ? ERN_PREPARE_REFUSED : ERN_PREPARE_DOUBTFUL;
  return value > doubtful;
}

static void give_verdict(struct ern_prepare_job *job, const struct findings *f) {
  ern_prepare_grade grade;
  bool followed = true;
  if (is_beyond(f->residual, most_residual, 4, &grade)) {
    ern_prepare_add_reason(job, grade, "the head's points are %.1f pixels off, expected %g at most", f->residual,
                           most_residual);
    followed = false;
  }
  if (is_beyond(f->lost, 0.02, 0.3, &grade)) {
    ern_prepare_add_reason(job, grade, "%.1f %% of the frames show too few of the head's points, expected 2 %% at most",
                           100 * f->lost);
    followed = false;
  }
  if (is_beyond(f->tremble, most_tremble, 1.5, &grade)) {
    ern_prepare_add_reason(job, grade,
                           "the head's turning changes by %.2f degrees from frame to frame, expected %g at most",
                           f->tremble, most_tremble);
    followed = false;
  }
  if (f->points < 150)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "the face shows %.0f points that can be followed, expected 150 or more: it is small, smooth or "
        "partly hidden",
        f->points);
  if (f->hidden > most_hidden) {
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "a third of the face's points are gone in %.0f %% of the frames, as with a hand or hair before "
        "the face, or a profile view",
        100 * f->hidden);
    followed = false;
  }
  ern_prepare_check_turn(job, f->turn);
  if (!followed)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "--landmarks or --poses take the results of other programs, --from and --to choose a part");
}

static ern_status check_tracking(struct tracking *t) {
  enum { FEW = 25 }; /* fewer points hardly determine a pose */
  ern_status status = ERN_OK;
  const size_t frames = t->job->frames;
  struct support *support = NULL;
  float *residuals = NULL, *counts = NULL;
  size_t held = 0, lost = 0, hidden = 0;
  struct findings f = {.tremble = jitter_of(t)};
  ERN_TRY(ERN_NEW(t->job->context, frames, &support));
  ERN_TRY(ERN_NEW(t->job->context, frames, &residuals));
  ERN_TRY(ERN_NEW(t->job->context, frames, &counts));
  ERN_TRY(measure(t, support));
  ERN_TRY(write_support(t, support));
  for (size_t i = 0; i < frames; i++) {
    if (support[i].seen > 0) residuals[held++] = support[i].residual;
    counts[i] = (float)support[i].seen;
    lost += support[i].seen < FEW;
    f.turn = fmax(f.turn, ern_head_turn(&t->poses[i], &t->poses[t->at[0]]));
  }
  f.residual = held > 0 ? (double)ern_quantile(residuals, held, 0.5) : 99;
  f.points = (double)ern_quantile(counts, frames, 0.5);
  for (size_t i = 0; i < frames; i++) hidden += (double)support[i].seen < 0.65 * f.points;
  f.hidden = (double)hidden / (double)frames;
  f.lost = (double)lost / (double)frames;
  t->residual = f.residual;
  ern_prepare_figure(t->job, "reprojection", f.residual);
  ern_prepare_figure(t->job, "points", f.points);
  ern_prepare_figure(t->job, "hidden", f.hidden);
  ern_prepare_figure(t->job, "lost", f.lost);
  ern_prepare_figure(t->job, "references", (double)t->count);
  ern_prepare_figure(t->job, "tremble", f.tremble);
  give_verdict(t->job, &f);
fail:
  ern_release(t->job->context, support);
  ern_release(t->job->context, residuals);
  ern_release(t->job->context, counts);
  return status;
}

ern_status ern_prepare_pose(struct ern_prepare_job *job) {
  if (job->options->poses != NULL) return ern_prepare_poses_take(job);
  ern_context *context = job->context;
  struct tracking t = {.job = job, .centre = 0.5 * job->side};
  struct ern_found_face *faces = NULL;
  float *distances = NULL;
  size_t count = 0, chosen = 0;
  ern_status status = ERN_OK;
  ERN_TRY(ern_prepare_faces_read(job, &faces, &count));
  ERN_TRY(ERN_NEW(context, count, &distances));
  ERN_TRY(ERN_NEW(context, (size_t)job->side * (size_t)job->side, &t.grey));
  ERN_TRY(ERN_NEW(context, job->frames, &t.poses));
  ERN_TRY(ERN_NEW(context, job->frames, &t.bundled));
  ERN_TRY(ERN_NEW(context, job->frames, &t.seen));
  if (choose_reference(&t, faces, count, distances, &chosen)) {
    ERN_TRY(track(&t, &faces[chosen]));
    ERN_TRY(check_tracking(&t));
    if (t.residual > well_tracked)
      ERN_TRY(ern_pose_align_frames(job, t.at[0], t.poses, 2 * job->frames, PASSES * job->frames));
    ERN_TRY(ern_prepare_poses_write(job, t.poses));
  } else {
    ern_prepare_add_reason(
        job, ERN_PREPARE_REFUSED,
        "no frame shows a face with both eyes open, expected one that looks into the camera now and then; --poses "
        "FILE takes poses of another program");
  }
fail:
  for (size_t r = 0; r < REFERENCES; r++) ern_flow_reference_free(&t.references[r]);
  ern_release(context, faces);
  ern_release(context, distances);
  ern_release(context, t.grey);
  ern_release(context, t.poses);
  ern_release(context, t.bundled);
  for (size_t i = 0; i < job->frames && t.seen != NULL; i++) ern_release(context, t.seen[i].list);
  ern_release(context, t.seen);
  ern_release(context, t.found);
  ern_release(context, t.weights);
  ern_release(context, t.prior);
  ern_release(context, t.shape);
  return status;
}
