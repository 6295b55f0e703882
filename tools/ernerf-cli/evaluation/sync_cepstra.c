/* SPDX-License-Identifier: MIT */
#include "evaluation/sync_cepstra.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

enum { WINDOW = 400, STEP = 160, TURN = 512, BINS = TURN / 2 + 1, FILTERS = 26, LIFTER = 22 };
static const double pi = 3.14159265358979323846, emphasis = 0.97;

/* Tables of a call. */
struct tables {
  double cosine[TURN], sine[TURN];         /* of 2 pi k/TURN */
  double filter[FILTERS][BINS];            /* triangles, evenly spaced in mel from 0 to half the rate */
  double transform[SYNC_CEPSTRA][FILTERS]; /* orthonormal DCT-II, times the lifter */
};

size_t sync_cepstra_rows(size_t samples) { return samples <= WINDOW ? 1 : 1 + (samples - WINDOW + STEP - 1) / STEP; }

static void fill_tables(struct tables *t) {
  int place[FILTERS + 2];
  const double top = 2595 * log10(1 + SYNC_RATE / 2 / 700.0);
  for (int k = 0; k < TURN; k++) {
    t->cosine[k] = cos(2 * pi * k / TURN);
    t->sine[k] = sin(2 * pi * k / TURN);
  }
  for (int k = 0; k < FILTERS + 2; k++)
    place[k] = (int)floor((TURN + 1) * 700 * (pow(10, top * k / (FILTERS + 1) / 2595) - 1) / SYNC_RATE);
  for (int j = 0; j < FILTERS; j++) {
    for (int i = 0; i < BINS; i++) t->filter[j][i] = 0;
    for (int i = place[j]; i < place[j + 1]; i++)
      t->filter[j][i] = (double)(i - place[j]) / (double)(place[j + 1] - place[j]);
    for (int i = place[j + 1]; i < place[j + 2]; i++)
      t->filter[j][i] = (double)(place[j + 2] - i) / (double)(place[j + 2] - place[j + 1]);
  }
  for (int k = 0; k < SYNC_CEPSTRA; k++)
    for (int j = 0; j < FILTERS; j++)
      t->transform[k][j] = cos(pi * k * (2 * j + 1) / (2 * FILTERS)) * sqrt((k == 0 ? 1.0 : 2.0) / FILTERS) *
                           (1 + 0.5 * LIFTER * sin(pi * k / LIFTER));
}

/* A logarithm that is also defined for silence. */
static double logarithm(double value) { return log(value > 0 ? value : DBL_EPSILON); }

/* power[i] = |X_i|^2/512 of the window, zero-padded and without a window function. */
static void power_of(const struct tables *t, const double window[WINDOW], double power[BINS]) {
  for (size_t i = 0; i < BINS; i++) {
    double real = 0, imaginary = 0;
    for (size_t k = 0; k < WINDOW; k++) {
      real += window[k] * t->cosine[i * k % TURN];
      imaginary += window[k] * t->sine[i * k % TURN];
    }
    power[i] = (real * real + imaginary * imaginary) / TURN;
  }
}

double *sync_cepstra(const double *wave, size_t samples) {
  const size_t rows = sync_cepstra_rows(samples);
  double *made = malloc(rows * SYNC_CEPSTRA * sizeof *made), window[WINDOW], power[BINS], loud[FILTERS];
  struct tables *t = malloc(sizeof *t);
  if (made == NULL || t == NULL) {
    free(made);
    free(t);
    return NULL;
  }
  fill_tables(t);
  for (size_t r = 0; r < rows; r++) {
    double energy = 0, *row = made + r * SYNC_CEPSTRA;
    for (size_t k = 0; k < WINDOW; k++) {
      const size_t at = r * STEP + k;
      window[k] = at >= samples ? 0 : wave[at] - (at > 0 ? emphasis * wave[at - 1] : 0);
    }
    power_of(t, window, power);
    for (size_t i = 0; i < BINS; i++) energy += power[i];
    for (size_t j = 0; j < FILTERS; j++) {
      double sum = 0;
      for (size_t i = 0; i < BINS; i++) sum += t->filter[j][i] * power[i];
      loud[j] = logarithm(sum);
    }
    for (size_t k = 0; k < SYNC_CEPSTRA; k++) {
      row[k] = 0;
      for (size_t j = 0; j < FILTERS; j++) row[k] += t->transform[k][j] * loud[j];
    }
    row[0] = logarithm(energy);
  }
  free(t);
  return made;
}
