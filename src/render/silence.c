/* SPDX-License-Identifier: MIT
 * Detects the silent frames of a speech from its features alone, and computes the weight of the silence code there.
 *
 * The kinds of features have no common sign of silence: DeepSpeech's have a space and a blank, HuBERT's have no
 * classes. So a classifier is learnt from a recording whose loud and quiet frames are known: Fisher's discriminant with
 * a diagonal covariance, w_i = (m1_i - m0_i)/(v_i), of the mean m0 of quiet frames and m1 of loud ones. The score of a
 * frame is scaled so that quiet frames have the mean -1 and loud ones +1. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/render.h"
#include "io/feature_range.h"

/* Frames, at 25 a second. QUIET_RUN: a shorter quiet time is the closure of a consonant, not silence. SILENCE_RUN: a
 * pause between words is shorter, 0.3 s. EASE: frames in which the weight rises. */
enum { QUIET_RUN = 5, SILENCE_RUN = 8, EASE = 4, FEWEST = 10, CENTRE = 4 };

/* LOUDNESS_GAP, STILLNESS_GAP: dB between the means of quiet and loud frames, at least: speech is 20 dB or more above
 * room noise; features move by a half more. WORST: least balanced accuracy, the mean over both kinds; guessing has
 * 0.5. */
static const double LOUDNESS_GAP = 12, STILLNESS_GAP = 3, WORST = 0.8, DEEPEST = 60;

struct ern_silence {
  ern_context *context;
  int width;
  double *weight;      /* [width] */
  double offset;       /* score = sum weight x - offset */
  double enter, leave; /* silence begins under the first and ends above the second */
};

enum kind { NEITHER, QUIET, LOUD };

/* x[width] = the mean of the up to CENTRE vectors in the middle of window t: 80 ms where there are 50 a second. */
static void middle(const ern_features *features, size_t t, double *x) {
  const int length = features->window_length, count = length < CENTRE ? length : CENTRE, first = (length - count) / 2;
  const float *vector = features->data + (t * (size_t)length + (size_t)first) * (size_t)features->width;
  for (int i = 0; i < features->width; i++) {
    x[i] = 0;
    for (int k = 0; k < count; k++) x[i] += (double)vector[(size_t)k * (size_t)features->width + (size_t)i] / count;
  }
}

/* ---- which frames of the recording are quiet --------------------------------------------------------------------- */

static int by_value(const void *left, const void *right) {
  const double a = *(const double *)left, b = *(const double *)right;
  return a < b ? -1 : a > b;
}

/* The value that splits `sorted` into the two parts whose means are farthest apart for their sizes (Otsu 1979); *gap is
 * the distance of the means. */
static double split(const double *sorted, size_t count, double *gap) {
  double total = 0, below = 0, best = -1, threshold = sorted[0];
  *gap = 0;
  for (size_t i = 0; i < count; i++) total += sorted[i];
  for (size_t i = 0; i + 1 < count; i++) {
    below += sorted[i];
    const double n = (double)(i + 1), m = (double)(count - i - 1);
    const double apart = (total - below) / m - below / n, between = n * m * apart * apart;
    if (between <= best) continue;
    best = between;
    *gap = apart;
    threshold = (sorted[i] + sorted[i + 1]) / 2;
  }
  return threshold;
}

/* kind[count] of frames of this level in dB. Frames at the border of a quiet run, and short runs, are neither. */
static ern_status sort_frames(ern_context *context, const double *level, size_t count, double least_gap,
                              unsigned char *kind) {
  double *sorted = NULL, gap = 0;
  ern_status status = ERN_NEW(context, count, &sorted);
  if (status != ERN_OK) return status;
  memcpy(sorted, level, count * sizeof *sorted);
  qsort(sorted, count, sizeof *sorted, by_value);
  const double floor = sorted[count - 1 - count / 10] - DEEPEST; /* DEEPEST dB below a loud frame */
  for (size_t i = 0; i < count; i++) sorted[i] = fmax(sorted[i], floor);
  const double threshold = split(sorted, count, &gap);
  ern_release(context, sorted);
  if (gap < least_gap)
    return ern_fail(context, ERN_E_STATE, "silence: quiet and loud frames differ by %.1f dB, expected %g at least", gap,
                    least_gap);
  for (size_t t = 0; t < count;) {
    size_t end = t;
    while (end < count && level[end] < threshold) end++;
    for (size_t i = t; i < end; i++) kind[i] = end - t >= QUIET_RUN && i > t && i + 1 < end ? QUIET : NEITHER;
    if (end < count) kind[end] = LOUD;
    t = end + 1;
  }
  return ERN_OK;
}

/* level[t] in dB: how much the features move around frame t, in the mean of five frames. */
static ern_status movement(ern_context *context, const ern_features *features, double *level) {
  enum { AROUND = 2 };
  const size_t width = (size_t)features->width, count = features->windows;
  double *now = NULL;
  const ern_status status = ERN_NEW(context, 2 * width + count, &now);
  if (status != ERN_OK) return status;
  double *before = now + width, *step = before + width;
  middle(features, 0, before);
  for (size_t t = 0; t < count; t++) {
    middle(features, t, now);
    for (size_t i = 0; i < width; i++) step[t] += (now[i] - before[i]) * (now[i] - before[i]);
    memcpy(before, now, width * sizeof *now);
  }
  for (size_t t = 0; t < count; t++) {
    const size_t from = t > AROUND ? t - AROUND : 0, to = t + AROUND < count ? t + AROUND + 1 : count;
    double sum = 0;
    for (size_t k = from; k < to; k++) sum += step[k];
    level[t] = 10 * log10(sum / (double)(to - from) + 1e-20);
  }
  ern_release(context, now);
  return ERN_OK;
}

/* ---- learning ---------------------------------------------------------------------------------------------------- */

/* Means of both kinds and the discriminant between them. mean[2][width], count[2]: quiet, loud. */
static ern_status discriminate(ern_silence *s, const ern_features *features, const unsigned char *kind) {
  const size_t width = (size_t)s->width;
  double count[2] = {0}, total = 0, apart = 0, *x = NULL;
  ern_status status = ERN_NEW(s->context, 4 * width, &x);
  if (status != ERN_OK) return status;
  double *mean[2] = {x + width, x + 2 * width}, *variance = x + 3 * width;
  for (int pass = 0; pass < 2; pass++) {
    for (size_t t = 0; t < features->windows; t++) {
      if (kind[t] == NEITHER) continue;
      const int k = kind[t] == LOUD;
      middle(features, t, x);
      for (size_t i = 0; i < width && pass == 0; i++) mean[k][i] += x[i];
      for (size_t i = 0; i < width && pass == 1; i++) variance[i] += (x[i] - mean[k][i]) * (x[i] - mean[k][i]);
      count[k] += pass == 0;
    }
    for (size_t i = 0; i < width && pass == 0; i++)
      for (int k = 0; k < 2; k++) mean[k][i] /= fmax(count[k], 1);
  }
  if (fmin(count[0], count[1]) < FEWEST)
    ERN_TRY(ern_fail(s->context, ERN_E_STATE, "silence: %g quiet and %g loud frames, expected %d of each at least",
                     count[0], count[1], FEWEST));
  for (size_t i = 0; i < width; i++) total += variance[i] / (double)width;
  for (size_t i = 0; i < width; i++) {
    s->weight[i] = (mean[1][i] - mean[0][i]) / (variance[i] + 0.1 * total + 1e-30);
    apart += s->weight[i] * (mean[1][i] - mean[0][i]) / 2;
  }
  for (size_t i = 0; i < width; i++) {
    s->weight[i] /= fmax(apart, 1e-30);
    s->offset += s->weight[i] * (mean[0][i] + mean[1][i]) / 2;
  }
fail:
  ern_release(s->context, x);
  return status;
}

/* score[windows]: about -1 in silence, about 1 in speech. */
static ern_status score_frames(const ern_silence *s, const ern_features *features, double *score) {
  double *x = NULL;
  const ern_status status = ERN_NEW(s->context, (size_t)s->width, &x);
  for (size_t t = 0; status == ERN_OK && t < features->windows; t++) {
    middle(features, t, x);
    score[t] = -s->offset;
    for (int i = 0; i < s->width; i++) score[t] += s->weight[i] * x[i];
  }
  ern_release(s->context, x);
  return status;
}

/* The threshold at which both kinds are equally many of their standard deviations from their means (-1 and 1); silence
 * begins half way from its mean to the threshold. */
static ern_status place_borders(ern_silence *s, const double *score, const unsigned char *kind, size_t count) {
  double square[2] = {0}, frames[2] = {0}, right[2] = {0};
  for (size_t t = 0; t < count; t++) {
    const int k = kind[t] == LOUD;
    if (kind[t] == NEITHER) continue;
    square[k] += (score[t] - (k ? 1 : -1)) * (score[t] - (k ? 1 : -1));
    frames[k] += 1;
  }
  const double quiet = sqrt(square[0] / frames[0]), loud = sqrt(square[1] / frames[1]);
  s->leave = quiet + loud > 0 ? (quiet - loud) / (quiet + loud) : 0;
  s->leave = fmin(fmax(s->leave, -0.5), 0.5);
  s->enter = (s->leave - 1) / 2;
  for (size_t t = 0; t < count; t++)
    if (kind[t] != NEITHER) right[kind[t] == LOUD] += (score[t] > s->leave) == (kind[t] == LOUD);
  const double share = (right[0] / frames[0] + right[1] / frames[1]) / 2;
  if (share >= WORST) return ERN_OK;
  return ern_fail(s->context, ERN_E_STATE,
                  "silence: the features classify %.0f %% of the frames correctly, expected %g at least", 100 * share,
                  100 * WORST);
}

ern_status ern_silence_learn(ern_context *context, const ern_features *features, const float *loudness,
                             ern_silence **silence) {
  ERN_PLAIN_FLOATS;
  if (silence != NULL) *silence = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, features);
  ERN_NEED(context, silence);
  const size_t count = features->windows;
  double *level = NULL;
  unsigned char *kind = NULL;
  ern_silence *made = NULL;
  ern_status status = ern_features_check(context, "silence", features);
  if (status == ERN_OK) status = ern_features_check_values(context, "silence", features);
  if (status != ERN_OK) return status;
  if (count < 2 * FEWEST)
    return ern_fail(context, ERN_E_STATE, "silence: %zu frames, expected %d at least", count, 2 * FEWEST);
  ERN_TRY(ERN_NEW(context, 1, &made));
  *made = (ern_silence){.context = context, .width = features->width};
  ERN_TRY(ERN_NEW(context, (size_t)features->width, &made->weight));
  ERN_TRY(ERN_NEW(context, count, &level));
  ERN_TRY(ERN_NEW(context, count, &kind));
  for (size_t t = 0; t < count && loudness != NULL; t++) level[t] = (double)loudness[t];
  if (loudness == NULL) ERN_TRY(movement(context, features, level));
  ERN_TRY(sort_frames(context, level, count, loudness != NULL ? LOUDNESS_GAP : STILLNESS_GAP, kind));
  ERN_TRY(discriminate(made, features, kind));
  ERN_TRY(score_frames(made, features, level));
  ERN_TRY(place_borders(made, level, kind, count));
fail:
  ern_release(context, level);
  ern_release(context, kind);
  if (status != ERN_OK) ern_silence_free(&made);
  *silence = made;
  return status;
}

void ern_silence_free(ern_silence **silence) {
  if (silence == NULL || *silence == NULL) return;
  ern_context *context = (*silence)->context;
  ern_release(context, (*silence)->weight);
  ern_release(context, *silence);
  *silence = NULL;
}

/* ---- a speech ---------------------------------------------------------------------------------------------------- */

/* Frames [begin, end) are silent. The first ones of the speech have weight 1 at once: no speech comes before them. */
static void ramp(float *weights, size_t begin, size_t end) {
  if (end - begin < SILENCE_RUN) return;
  for (size_t t = begin; t < end; t++) {
    const size_t into = t - begin;
    weights[t] = begin == 0 || into >= EASE ? 1.0f : (float)(into + 1) / (EASE + 1);
  }
}

ern_status ern_silence_weights(const ern_silence *silence, const ern_features *features, float *weights) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, silence);
  ERN_NEED(silence->context, features);
  ERN_NEED(silence->context, weights);
  const size_t count = features->windows;
  double *score = NULL;
  ern_status status = ern_features_check(silence->context, "silence", features);
  if (status == ERN_OK) status = ern_features_check_values(silence->context, "silence", features);
  if (status != ERN_OK) return status;
  if (features->width != silence->width)
    return ern_fail(silence->context, ERN_E_MISMATCH,
                    "silence: the features are %d wide, expected %d: it was learnt on features of another kind",
                    features->width, silence->width);
  ERN_TRY(ERN_NEW(silence->context, count, &score));
  ERN_TRY(score_frames(silence, features, score));
  memset(weights, 0, count * sizeof *weights);
  for (size_t t = 0; t < count;) {
    if (!(score[t] < silence->enter)) {
      t++;
      continue;
    }
    const size_t begin = t;
    while (t < count && score[t] < silence->leave) t++;
    ramp(weights, begin, t);
  }
fail:
  ern_release(silence->context, score);
  return status;
}
