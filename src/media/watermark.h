/* SPDX-License-Identifier: MIT
 * The watermark's pattern, shared by the code that embeds it and the code that detects it (docs/watermark.md). */
#ifndef ERN_MEDIA_WATERMARK_H
#define ERN_MEDIA_WATERMARK_H

#include "core/status.h"
#include "ernerf/media.h"

/* Unit of length: 1/TILE of the shorter side; that side is the period of the pattern. Wave (x, y) has x periods a tile
 * to the right and y down. Its length (frequency) is LOW to HIGH. x > 0, or x = 0 and y > 0: one of each pair of
 * opposite waves. */
enum { ERN_WATERMARK_TILE = 512, ERN_WATERMARK_LOW = 24, ERN_WATERMARK_HIGH = 64, ERN_WATERMARK_WAVES = 5532 };

/* The waves in the order of a code: by x, then by y. */
struct ern_watermark_waves {
  int16_t x[ERN_WATERMARK_WAVES], y[ERN_WATERMARK_WAVES];
};
void ern_watermark_list(struct ern_watermark_waves *waves);

/* The amplitudes of the waves, re + i im, each part 1 or -1 by a bit of SHA-256 over a number and the key. */
struct ern_watermark_code {
  int8_t re[ERN_WATERMARK_WAVES], im[ERN_WATERMARK_WAVES];
};
/* ERN_E_ARGUMENT where the key is "" or has ERN_WATERMARK_KEY_BYTES bytes or more. */
ERN_NODISCARD ern_status ern_watermark_code_make(ern_context *context, const char *key,
                                                 struct ern_watermark_code *code);

/* Scales that a search tries: 1.005^i, i from -SCALES/2 to SCALES/2. CELLS: samples, and offsets tried, a tile side.
 * LEAST: the smallest picture. */
enum { ERN_WATERMARK_SCALES = 89, ERN_WATERMARK_CELLS = 256, ERN_WATERMARK_LEAST = 64 /* pixels a side */ };
double ern_watermark_scale(int index);

/* The picture's waves at a scale, [WAVES][2]: a unit complex number each, or 0 where the picture does not have the
 * wave. */
typedef float ern_watermark_spectrum[ERN_WATERMARK_WAVES][2];

/* By OpenCV. mean: [height][width], 0..255; both sides at least LEAST. spectra: [count], of scales[count],
 * the smallest first. */
ERN_NODISCARD ern_status ern_watermark_spectra(ern_context *context, const float *mean, int width, int height,
                                               const double *scales, size_t count, ern_watermark_spectrum *spectra);
/* *score: over all offsets the greatest of sqrt(2/n) Re sum_k spectrum_k conj(code_k/sqrt 2) e^(i offset k), n the
 * number of waves that are not 0; 0 without any. *score's square is at most 2 n. */
ERN_NODISCARD ern_status ern_watermark_peak(ern_context *context, const ern_watermark_spectrum spectrum,
                                            const struct ern_watermark_code *code, double *score);

/* The bound on the probability that a wrong key reaches `score` at one of `places` offsets and scales.
 * At one of them the score is sqrt(2/n) times a sum of n independent cosines, each of one of four phases a quarter turn
 * apart with the same probability. E e^(t cos) <= e^(t^2/4) for these, so P(sum >= s) <= e^(-s^2/n) (Chernoff), which
 * is e^(-score^2/2); and the probability of a union is at most the sum. */
double ern_watermark_bound(double score, double places);

#endif
