/* SPDX-License-Identifier: MIT */
#include "prepare/clip_sound.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "io/number.h"
#include "media/speech_network.h"
#include "prepare/footage.h"
#include "prepare/jaw_weights.h"

enum {
  RATE = ERN_PREPARE_SOUND_RATE,
  MOST_LAG = 30,   /* frames */
  PART_OF = 8,     /* the part of the frames that a lag has at most: the rest must tell it by itself */
  SECOND = 25,     /* frames */
  APART = 4,       /* frames between lags that compete */
  FEWEST = 4 * 25, /* frames for a measurement */
  ROWS = 16,
  WIDTH = 13 /* of a window of cepstra */
};
static const double least_correlation = 0.3, least_margin = 0.2;

ern_status ern_sound_offset_read(ern_context *context, const char *text, double *seconds, bool *automatic) {
  const char *at = text;
  *seconds = 0;
  *automatic = text == NULL || strcmp(text, "auto") == 0;
  if (*automatic || (ern_number_read(&at, text + strlen(text), seconds) && *at == 0 && fabs(*seconds) <= 2))
    return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT,
                  "prepare: sound_offset is \"%.60s\", expected \"auto\", or seconds of -2 to 2", text);
}

ern_status ern_prepare_sound_read(struct ern_prepare_job *job, size_t frames, double offset, ern_sound *sound,
                                  double *missing) {
  ern_status status = ERN_OK;
  struct ern_footage footage = {0};
  float *samples = NULL;
  size_t count = 0;
  *sound = (ern_sound){0};
  *missing = 0;
  ERN_TRY(ern_footage_open(job, &footage));
  if (!footage.info.has_sound) goto fail;
  ERN_TRY(ern_speech_wave(job->context, job->video, RATE, &samples, &count));
  const double begin = footage.first - footage.info.start + footage.from + offset;
  const long long first = llround(begin * RATE);
  const size_t length = frames * (RATE / ERN_PREPARE_RATE);
  *missing = fmax(0, (double)(first + (long long)length - (long long)count) / RATE);
  ERN_TRY(ERN_NEW(job->context, length, &sound->data));
  *sound = (ern_sound){.rate = RATE, .channels = 1, .frames = length, .data = sound->data};
  for (size_t i = 0; i < length; i++) {
    const long long at = first + (long long)i;
    const float value = at >= 0 && (size_t)at < count ? samples[at] : 0;
    sound->data[i] = (int16_t)lrintf(fminf(fmaxf(value, -1), 1) * 32767);
  }
fail:
  ern_release(job->context, samples);
  ern_footage_close(&footage);
  return status;
}

/* Subtracts the mean over a second around. */
static void keep_fast(const double *from, size_t count, double *to) {
  for (size_t i = 0; i < count; i++) {
    double sum = 0;
    size_t taken = 0;
    for (size_t k = i < SECOND / 2 ? 0 : i - SECOND / 2; k <= i + SECOND / 2 && k < count; k++, taken++) sum += from[k];
    to[i] = from[i] - sum / (double)taken;
  }
}

/* Correlation of a[i] with b[i + lag]. */
static double correlate(const double *a, const double *b, long count, long lag) {
  double aa = 0, bb = 0, ab = 0;
  for (long i = lag < 0 ? -lag : 0; i < count && i + lag < count; i++) {
    aa += a[i] * a[i];
    bb += b[i + lag] * b[i + lag];
    ab += a[i] * b[i + lag];
  }
  return aa > 0 && bb > 0 ? ab / sqrt(aa * bb) : 0;
}

static double jaw_of(const float *window) {
  double sum = 0;
  for (int i = 0; i < ROWS * WIDTH; i++) sum += (double)(window[i] * (&ern_jaw_weights[0][0])[i]);
  return sum;
}

/* The best of the correlations r[2 most + 1], by a parabola through its neighbours. */
static void find_best(const double *r, int most, struct ern_sound_lag *lag) {
  int best = 0;
  double other = -1;
  for (int k = 1; k <= 2 * most; k++)
    if (r[k] > r[best]) best = k;
  for (int k = 0; k <= 2 * most; k++)
    if (abs(k - best) >= APART) other = fmax(other, r[k]);
  double between = 0;
  if (best > 0 && best < 2 * most)
    between = 0.5 * (r[best - 1] - r[best + 1]) / fmin(r[best - 1] - 2 * r[best] + r[best + 1], -1e-9);
  *lag = (struct ern_sound_lag){
      .seconds = (best - most + between) / SECOND,
      .correlation = r[best],
      .certain = best > 0 && best < 2 * most && r[best] >= least_correlation && r[best] - other >= least_margin};
}

ern_status ern_sound_lag_measure(ern_context *context, const ern_features *cepstra, const float *opening, size_t frames,
                                 struct ern_sound_lag *lag) {
  ern_status status = ERN_OK;
  const size_t count = frames < cepstra->windows ? frames : cepstra->windows;
  const int most = (int)(count / PART_OF < MOST_LAG ? count / PART_OF : MOST_LAG);
  double *mouth = NULL, *jaw = NULL, *fast[2] = {NULL, NULL}, r[2 * MOST_LAG + 1];
  *lag = (struct ern_sound_lag){0};
  if (count < FEWEST) return ERN_OK;
  ERN_TRY(ERN_NEW(context, count, &mouth));
  ERN_TRY(ERN_NEW(context, count, &jaw));
  for (int k = 0; k < 2; k++) ERN_TRY(ERN_NEW(context, count, &fast[k]));
  for (size_t i = 0; i < count; i++) {
    mouth[i] = (double)opening[i];
    jaw[i] = jaw_of(cepstra->data + i * ROWS * WIDTH);
  }
  keep_fast(mouth, count, fast[0]);
  keep_fast(jaw, count, fast[1]);
  for (int k = 0; k <= 2 * most; k++) r[k] = correlate(fast[0], fast[1], (long)count, k - most);
  find_best(r, most, lag);
fail:
  ern_release(context, mouth);
  ern_release(context, jaw);
  for (int k = 0; k < 2; k++) ern_release(context, fast[k]);
  return status;
}
