/* SPDX-License-Identifier: MIT */
#include "media/speech/cepstra.h"

#include <libavutil/mem.h>
#include <libavutil/tx.h>
#include <math.h>
#include <string.h>

#include "core/memory.h"

enum { FFT = 512, BINS = FFT / 2 + 1, BANDS = ERN_CEPSTRA_BANDS };

static const double pi = 3.14159265358979323846, lowest = 60, highest = 7600; /* Hz: the range of the mel bands */
/* The level that normalises the bands: the power of the loudest row so far, which decays with a time constant of 10 s
 * while the sound is within 30 dB of it. It is at least -50 dB of full scale, so that noise does not count as speech.
 */
static const float memory_seconds = 10, audible = 1e-3f, least_level = 1e-5f;
static const float band_floor = 1e-3f; /* relative to the level; lower powers count as silence */
/* Means and standard deviations of the coefficients over eight synthetic voices in three languages: they normalise the
 * values to about 0 and 1. */
static const float mean[ERN_CEPSTRA_WIDTH] = {-42.9f, 7.71f,  2.48f,  2.73f, -0.89f, -0.84f, -0.64f,
                                              -1.43f, -0.54f, -0.21f, 0.1f,  -0.32f, -0.42f};
static const float deviation[ERN_CEPSTRA_WIDTH] = {11.8f, 6.04f, 2.92f, 4.11f, 3.39f, 2.74f, 2.88f,
                                                   2.27f, 1.88f, 1.86f, 1.58f, 1.81f, 1.65f};

struct ern_cepstra {
  AVTXContext *transform;
  av_tx_fn run;
  float *time;              /* [FFT], aligned as the transform wants it */
  AVComplexFloat *spectrum; /* [BINS] */
  float window[ERN_CEPSTRA_FRAME];
  float band[BANDS][BINS]; /* triangles, each of sum 1 */
  int first[BANDS], end[BANDS];
  float cosine[ERN_CEPSTRA_WIDTH][BANDS]; /* DCT-II */
  float level, forget;
};

static double mel_of(double hertz) { return 2595 * log10(1 + hertz / 700); }
static double hertz_of(double mel) { return 700 * (pow(10, mel / 2595) - 1); }

/* Triangular filters with edges evenly spaced in mel and scaled by `warp`; bins above the Nyquist frequency are left
 * out. */
static void make_bands(struct ern_cepstra *c, double warp) {
  double edge[BANDS + 2];
  for (int i = 0; i < BANDS + 2; i++)
    edge[i] = warp * hertz_of(mel_of(lowest) + (mel_of(highest) - mel_of(lowest)) * i / (BANDS + 1));
  for (int b = 0; b < BANDS; b++) {
    double sum = 0;
    c->first[b] = BINS;
    for (int k = 0; k < BINS; k++) {
      const double f = (double)k * ERN_CEPSTRA_RATE / FFT;
      const double share =
          fmin((f - edge[b]) / (edge[b + 1] - edge[b]), (edge[b + 2] - f) / (edge[b + 2] - edge[b + 1]));
      c->band[b][k] = (float)fmax(share, 0);
      sum += fmax(share, 0);
      if (share <= 0) continue;
      if (c->first[b] == BINS) c->first[b] = k;
      c->end[b] = k + 1;
    }
    for (int k = c->first[b]; k < c->end[b]; k++) c->band[b][k] = (float)(c->band[b][k] / sum);
  }
}

ern_status ern_cepstra_check_warp(ern_context *context, float warp) {
  if (warp >= 0.5f && warp <= 2) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT, "speech: warp is %g, expected 0.5 to 2", (double)warp);
}

ern_status ern_cepstra_make(ern_context *context, float warp, struct ern_cepstra **cepstra) {
  struct ern_cepstra *c = NULL;
  ern_status status = ERN_OK;
  *cepstra = NULL;
  ERN_TRY(ERN_NEW(context, 1, &c));
  const float scale = 1;
  c->time = av_calloc(FFT, sizeof *c->time);
  c->spectrum = av_calloc(BINS, sizeof *c->spectrum);
  if (c->time == NULL || c->spectrum == NULL ||
      av_tx_init(&c->transform, &c->run, AV_TX_FLOAT_RDFT, 0, FFT, &scale, 0) < 0)
    ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "speech: no memory for a transform of %d samples", FFT));
  for (int i = 0; i < ERN_CEPSTRA_FRAME; i++)
    c->window[i] = (float)(0.5 - 0.5 * cos(2 * pi * i / ERN_CEPSTRA_FRAME)); /* Hann */
  make_bands(c, (double)warp);
  for (int q = 0; q < ERN_CEPSTRA_WIDTH; q++)
    for (int b = 0; b < BANDS; b++) c->cosine[q][b] = (float)(sqrt(2.0 / BANDS) * cos(pi * q * (b + 0.5) / BANDS));
  c->level = least_level;
  c->forget = expf(-(float)ERN_CEPSTRA_HOP / ERN_CEPSTRA_RATE / memory_seconds);
  *cepstra = c;
  return ERN_OK;
fail:
  ern_cepstra_free(context, c);
  return status;
}

void ern_cepstra_free(ern_context *context, struct ern_cepstra *cepstra) {
  if (cepstra == NULL) return;
  av_tx_uninit(&cepstra->transform);
  av_freep(&cepstra->time);
  av_freep(&cepstra->spectrum);
  ern_release(context, cepstra);
}

static float power_of(const float frame[ERN_CEPSTRA_FRAME], float middle) {
  double sum = 0;
  for (int i = 0; i < ERN_CEPSTRA_FRAME; i++) sum += pow((double)(frame[i] - middle), 2);
  return (float)(sum / ERN_CEPSTRA_FRAME);
}

static float middle_of(const float frame[ERN_CEPSTRA_FRAME]) {
  double sum = 0;
  for (int i = 0; i < ERN_CEPSTRA_FRAME; i++) sum += (double)frame[i];
  return (float)(sum / ERN_CEPSTRA_FRAME);
}

bool ern_cepstra_bands(struct ern_cepstra *c, const float frame[ERN_CEPSTRA_FRAME], float log_band[BANDS]) {
  const float middle = middle_of(frame), power = power_of(frame, middle);
  if (power > audible * c->level) c->level *= c->forget;
  c->level = fmaxf(fmaxf(power, c->level), least_level);
  memset(c->time, 0, FFT * sizeof *c->time);
  for (int i = 0; i < ERN_CEPSTRA_FRAME; i++) c->time[i] = (frame[i] - middle) * c->window[i];
  c->run(c->transform, c->spectrum, c->time, sizeof *c->time);
  const float unit = 1 / (0.375f * ERN_CEPSTRA_FRAME * c->level); /* the window's sum of squares */
  for (int b = 0; b < BANDS; b++) {
    float sum = 0;
    for (int k = c->first[b]; k < c->end[b]; k++)
      sum += c->band[b][k] * (c->spectrum[k].re * c->spectrum[k].re + c->spectrum[k].im * c->spectrum[k].im);
    log_band[b] = logf(sum * unit + band_floor);
  }
  return power > audible * c->level;
}

float ern_cepstra_silence(void) { return logf(band_floor); }

void ern_cepstra_row(const struct ern_cepstra *c, const float log_band[BANDS], float row[ERN_CEPSTRA_WIDTH]) {
  for (int q = 0; q < ERN_CEPSTRA_WIDTH; q++) {
    float sum = 0;
    for (int b = 0; b < BANDS; b++) sum += c->cosine[q][b] * log_band[b];
    row[q] = (sum - mean[q]) / deviation[q];
  }
}
