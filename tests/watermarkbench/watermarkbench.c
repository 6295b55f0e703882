/* SPDX-License-Identifier: MIT
 * For the table of docs/watermark.md, which table.py makes:
 *   watermarkbench mark VIDEO KEY OUT.mp4    marks a clean video, and prints its PSNR against the clean frames
 *   watermarkbench keys VIDEO N FULL         searches a clean video for N wrong keys at all offsets of scale 1, and for
 *                                            the first FULL of them at all scales too
 * Each prints a JSON object. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/media.h"
#include "media/watermark.h"

#define NEED(call)                                            \
  do {                                                        \
    if ((call) != ERN_OK) {                                   \
      fprintf(stderr, "%s\n", ern_last_error(bench.context)); \
      exit(1);                                                \
    }                                                         \
  } while (0)

static struct bench {
  ern_context *context;
  ern_video_reader *reader;
  ern_video_info info;
  ern_image frame;
} bench;

static bool next_frame(void) {
  bool end;
  double seconds;
  NEED(ern_video_reader_frame(bench.reader, &bench.frame, &seconds, &end));
  return !end;
}

/* Marks the frame of `bench` by way of rgba, and returns the sum of squared differences. */
static double mark_frame(const ern_watermark *watermark, uint8_t *rgba) {
  const size_t pixels = (size_t)bench.info.width * (size_t)bench.info.height;
  double squares = 0;
  for (size_t i = 0; i < pixels; i++) memcpy(rgba + 4 * i, bench.frame.data + 3 * i, 3);
  NEED(ern_watermark_put(watermark, rgba));
  for (size_t i = 0; i < pixels; i++) {
    for (size_t c = 0; c < 3; c++) {
      const double d = rgba[4 * i + c] - bench.frame.data[3 * i + c];
      squares += d * d;
    }
  }
  return squares;
}

static void mark(const char *key, const char *out) {
  ern_video_options options = ern_video_options_default(bench.info.width, bench.info.height);
  ern_video_writer *writer = NULL;
  ern_watermark *watermark = NULL;
  const size_t pixels = (size_t)bench.info.width * (size_t)bench.info.height;
  uint8_t *rgba = calloc(pixels, 4);
  if (rgba == NULL) exit(1);
  options.rate_numerator = bench.info.rate_numerator;
  options.rate_denominator = bench.info.rate_denominator;
  NEED(ern_watermark_open(bench.context, key, bench.info.width, bench.info.height, &watermark));
  NEED(ern_video_writer_open(bench.context, out, &options, &writer));
  double squares = 0, values = 0;
  while (next_frame()) {
    squares += mark_frame(watermark, rgba);
    values += 3 * (double)pixels;
    NEED(ern_video_writer_frame(writer, rgba));
  }
  NEED(ern_video_writer_close(&writer));
  printf("{\"psnr\": %.3f}\n", 10 * log10(255 * 255 * values / squares));
  ern_watermark_free(&watermark);
  free(rgba);
}

/* The mean of the frames' luma, as the detector has it. */
static float *mean_of_frames(void) {
  const size_t pixels = (size_t)bench.info.width * (size_t)bench.info.height;
  float *mean = calloc(pixels, sizeof *mean);
  double *sum = calloc(pixels, sizeof *sum);
  size_t frames = 0;
  if (mean == NULL || sum == NULL) exit(1);
  for (; next_frame(); frames++) {
    for (size_t i = 0; i < pixels; i++) {
      const uint8_t *rgb = bench.frame.data + 3 * i;
      sum[i] += (54U * rgb[0] + 183U * rgb[1] + 19U * rgb[2]) >> 8;
    }
  }
  for (size_t i = 0; i < pixels; i++) mean[i] = (float)(sum[i] / (double)frames);
  free(sum);
  return mean;
}

static void keys(int count, int full) {
  enum { SCALES = ERN_WATERMARK_SCALES };
  static ern_watermark_spectrum spectra[SCALES];
  static struct ern_watermark_code code;
  double scales[SCALES], most = 0, most_full = 0, score;
  int above[3] = {0}, above_full[3] = {0};
  /* where the bound for all offsets and scales is 1e-6, 1e-4, 1e-2 */
  static const double bounds[3] = {1e-6, 1e-4, 1e-2};
  const double places = (double)SCALES * ERN_WATERMARK_CELLS * ERN_WATERMARK_CELLS;
  float *mean = mean_of_frames();
  for (int i = 0; i < SCALES; i++) scales[i] = ern_watermark_scale(i);
  NEED(ern_watermark_spectra(bench.context, mean, bench.info.width, bench.info.height, scales, SCALES, spectra));
  for (int k = 0; k < count; k++) {
    char key[32];
    snprintf(key, sizeof key, "wrong key %d", k);
    NEED(ern_watermark_code_make(bench.context, key, &code));
    NEED(ern_watermark_peak(bench.context, spectra[SCALES / 2], &code, &score));
    most = fmax(most, score);
    for (int b = 0; b < 3; b++) above[b] += ern_watermark_bound(score, places) <= bounds[b];
    if (k >= full) continue;
    double best = 0;
    for (int i = 0; i < SCALES; i++) {
      NEED(ern_watermark_peak(bench.context, spectra[i], &code, &score));
      best = fmax(best, score);
    }
    most_full = fmax(most_full, best);
    for (int b = 0; b < 3; b++) above_full[b] += ern_watermark_bound(best, places) <= bounds[b];
  }
  printf(
      "{\"keys\": %d, \"most\": %.3f, \"above\": [%d, %d, %d], \"full\": %d, \"most_full\": %.3f, "
      "\"above_full\": [%d, %d, %d]}\n",
      count, most, above[0], above[1], above[2], full, most_full, above_full[0], above_full[1], above_full[2]);
  free(mean);
}

int main(int argc, char **argv) {
  const bool marks = argc == 5 && strcmp(argv[1], "mark") == 0;
  if (!marks && (argc != 5 || strcmp(argv[1], "keys") != 0)) {
    fprintf(stderr, "usage: watermarkbench mark VIDEO KEY OUT.mp4 | watermarkbench keys VIDEO N FULL\n");
    return 2;
  }
  if (ern_context_create(&bench.context, NULL) != ERN_OK) return 1;
  NEED(ern_video_reader_open(bench.context, argv[2], &bench.reader));
  ern_video_reader_info(bench.reader, &bench.info);
  if (marks)
    mark(argv[3], argv[4]);
  else
    keys(atoi(argv[3]), atoi(argv[4]));
  ern_image_free(bench.context, &bench.frame);
  ern_video_reader_free(&bench.reader);
  ern_context_free(&bench.context);
  return 0;
}
