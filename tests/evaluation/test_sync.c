/* SPDX-License-Identifier: MIT
 * What Sync is made of: cepstra against values computed elsewhere by their definition, and distances of embeddings
 * whose shift is known. */
#include "../support.h"

#include <math.h>

#include "evaluation/sync_cepstra.h"
#include "evaluation/sync_score.h"

static void expect(double found, double expected, double apart) {
  if (!(fabs(found - expected) <= apart)) fail_msg("%.12g, expected %.12g to %g", found, expected, apart);
}

/* Computed with complex exponentials in Python; 6 digits were written. */
static void test_cepstra(void **state) {
  (void)state;
  enum { SAMPLES = 1000, ROWS = 5 };
  static const struct {
    size_t row;
    double values[SYNC_CEPSTRA];
  } recorded[] = {{0,
                   {18.092047, -10.928212, 6.258255, -14.578931, -11.805580, 12.762616, 29.001057, 24.891008, 6.145395,
                    -17.893817, -27.134940, -25.038317, -6.759171}},
                  {3,
                   {18.081883, -9.616904, 6.772002, -12.584912, -10.382720, 10.589525, 26.607844, 34.144847, 12.635667,
                    -13.694910, -18.869459, -21.263979, -1.635797}},
                  {4,
                   {18.017736, -8.785307, 7.847997, -15.673288, -7.855431, 7.369707, 21.926869, 27.886594, 15.457061,
                    -22.310766, -25.461929, -18.562175, -5.234711}}};
  double wave[SAMPLES];
  uint32_t seed = 1;
  for (size_t i = 0; i < SAMPLES; i++) {
    seed = seed * 1664525u + 1013904223u;
    wave[i] = rint(3000 * sin(0.05 * (double)i) + 2000 * sin(0.31 * (double)i + 1) + (double)(seed >> 22) - 512);
  }
  assert_int_equal(sync_cepstra_rows(SAMPLES), ROWS);
  assert_int_equal(sync_cepstra_rows(400), 1);
  assert_int_equal(sync_cepstra_rows(401), 2);
  assert_int_equal(sync_cepstra_rows(640 * 25), 99);
  double *rows = sync_cepstra(wave, SAMPLES);
  assert_non_null(rows);
  for (size_t k = 0; k < sizeof recorded / sizeof *recorded; k++)
    for (size_t i = 0; i < SYNC_CEPSTRA; i++)
      expect(rows[recorded[k].row * SYNC_CEPSTRA + i], recorded[k].values[i], 2e-6); /* the written digits */
  free(rows);
  memset(wave, 0,
         sizeof wave); /* silence is finite: log 2^-52 in each filter, whose transform is 0 but for the first */
  rows = sync_cepstra(wave, SAMPLES);
  expect(rows[0], log(0x1p-52), 1e-12);
  expect(rows[5], 0, 1e-10);
  free(rows);
}

/* Embeddings that go round a circle: heard ones are the seen ones `late` frames later. */
static struct sync_score score_of(int late, size_t count) {
  enum { MOST = 200, WIDTH = 2 };
  static float seen[MOST * WIDTH], heard[MOST * WIDTH];
  for (size_t i = 0; i < count; i++) {
    const double at = (double)i - late;
    seen[2 * i] = (float)cos((double)i), seen[2 * i + 1] = (float)sin((double)i);
    heard[2 * i] = (float)cos(at), heard[2 * i + 1] = (float)sin(at);
  }
  return sync_score(seen, heard, count, WIDTH);
}

static void test_score(void **state) {
  (void)state;
  static const int late[] = {0, 3, -7, 15, -15};
  for (size_t k = 0; k < sizeof late / sizeof *late; k++) {
    const size_t count = 200;
    const struct sync_score score = score_of(late[k], count);
    double means[SYNC_SHIFTS], sorted[SYNC_SHIFTS];
    for (int s = 0; s < SYNC_SHIFTS; s++) { /* chords; 1 from the centre, where there is nothing to hear */
      const int shift = s - SYNC_SHIFT, there = (int)count - abs(shift);
      means[s] = (there * 2 * fabs(sin(0.5 * (shift - late[k]))) + abs(shift)) / (double)count;
      size_t place = (size_t)s;
      for (; place > 0 && sorted[place - 1] > means[s]; place--) sorted[place] = sorted[place - 1];
      sorted[place] = means[s];
    }
    assert_int_equal(score.offset, -late[k]);
    expect(score.distance, sorted[0], 3e-6); /* 1e-6 is added to each difference */
    expect(score.confidence, sorted[SYNC_SHIFT] - sorted[0], 6e-6);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_cepstra), cmocka_unit_test(test_score)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
