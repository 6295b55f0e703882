/* SPDX-License-Identifier: MIT
 * The output's rate: how it is read, and where its frames, and those of a recorded video, lie among a clip's. */
#include "dub/recorded_video.h"

#include <math.h>
#include <stdint.h>

#include "support.h"

static void test_read(void **state) {
  (void)state;
  static const struct {
    const char *text;
    int numerator, denominator;
    const char *words;
  } good[] = {{"25", 25, 1, "25"},           {"30", 30, 1, "30"},
              {"240", 240, 1, "240"},        {"1", 1, 1, "1"},
              {"12.5", 25, 2, "25/2"},       {"24000/1001", 24000, 1001, "24000/1001"},
              {"23.976", 24000, 1001, NULL}, {"29.97", 30000, 1001, "30000/1001"},
              {"59.94", 60000, 1001, NULL},  {"119.88", 120000, 1001, NULL},
              {"29.5", 59, 2, NULL},         {"50/2", 25, 1, "25"},
              {"25.000", 25, 1, "25"},       {"1.001", 1001, 1000, NULL}};
  static const char *const bad[] = {"",       "0",   "0.999",      "241",    "240.001", "25/0", "25/",
                                    "/25",    "-25", "+25",        "25 ",    " 25",     "2e1",  "25,",
                                    "25/1/1", "nan", "12.34567",   "25.5/1", "ntsc",    "0x19", "25/1.0",
                                    ".5",     "1/2", "99999999/9", "482/2"};
  for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
    struct rate rate = {0};
    char words[RATE_TEXT_BYTES];
    if (!rate_read(good[i].text, &rate)) fail_msg("\"%s\" is refused", good[i].text);
    if (rate.numerator != good[i].numerator || rate.denominator != good[i].denominator)
      fail_msg("\"%s\" is %d/%d", good[i].text, rate.numerator, rate.denominator);
    rate_words(rate, words);
    if (good[i].words != NULL) assert_string_equal(words, good[i].words);
    assert_true(rate_value(rate) == (double)good[i].numerator / good[i].denominator);
  }
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    struct rate rate = {7, 1};
    if (rate_read(bad[i], &rate)) fail_msg("\"%s\" is taken as %d/%d", bad[i], rate.numerator, rate.denominator);
    assert_int_equal(rate.numerator, 7);
  }
}

static void test_frames(void **state) {
  (void)state;
  static const struct {
    struct rate rate;
    size_t count, frames;
  } cases[] = {{{25, 1}, 60, 60}, {{50, 1}, 60, 120},      {{30, 1}, 60, 72},
               {{30, 1}, 61, 74}, {{30000, 1001}, 60, 72}, {{24000, 1001}, 100, 96},
               {{1, 1}, 1, 1},    {{1, 1}, 26, 2},         {{240, 1}, 1, 10}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    const size_t frames = rate_frames(cases[i].rate, cases[i].count);
    assert_int_equal(frames, cases[i].frames);
    /* they cover the duration, and none begins past it */
    assert_true((double)frames / rate_value(cases[i].rate) > (double)cases[i].count / RATE_CLIP - 1e-9);
    assert_true((double)(frames - 1) / rate_value(cases[i].rate) < (double)cases[i].count / RATE_CLIP);
  }
  assert_int_equal(rate_frames((struct rate){240, 1}, SIZE_MAX / 100), 0);
}

/* Against the plain definition: frame k is shown at 25 k / rate of the clip's frames. */
static void test_places(void **state) {
  (void)state;
  static const struct rate rates[] = {{25, 1},       {50, 1}, {30, 1},  {24000, 1001},
                                      {30000, 1001}, {1, 1},  {240, 1}, {59, 2}};
  enum { COUNT = 100 };
  for (size_t r = 0; r < sizeof rates / sizeof *rates; r++)
    for (size_t k = 0; k < rate_frames(rates[r], COUNT); k++) {
      const struct rate_place at = rate_at(rates[r], k, COUNT);
      const double expected = fmin(25 * (double)k / rate_value(rates[r]), COUNT - 1);
      assert_true(at.place < COUNT && at.toward >= 0 && at.toward < 1);
      if (fabs((double)at.place + at.toward - expected) > 1e-9 * COUNT)
        fail_msg("rate %zu, frame %zu: %zu + %g, expected %.9g", r, k, at.place, at.toward, expected);
      assert_true(at.place + 1 < COUNT || at.toward == 0);
    }
  for (size_t k = 0; k < COUNT; k++) { /* exact where a frame of the clip is met */
    const struct rate_place one = rate_at(rates[1], 2 * k, COUNT), five = rate_at(rates[2], k / 5 * 6, COUNT);
    assert_true(one.place == k && one.toward == 0);
    assert_true(five.place == k / 5 * 5 && five.toward == 0);
  }
  assert_true(rate_at(rates[1], 1000, 1).place == 0 && rate_at(rates[1], 1000, 1).toward == 0);
}

/* Against the plain definition: frame k of the clip is the video's frame nearest to its time, the later of two. */
static void test_recorded_places(void **state) {
  (void)state;
  static const struct rate rates[] = {{30, 1}, {30000, 1001}, {24, 1}, {25, 1}, {50, 1}, {60, 1}};
  static const double from[] = {0, 0.5, 1.13};
  enum { COUNT = 60 };
  for (size_t r = 0; r < sizeof rates / sizeof *rates; r++)
    for (size_t f = 0; f < sizeof from / sizeof *from; f++) {
      const double rate = rate_value(rates[r]);
      size_t shows[COUNT]; /* the video's frame that frame k of the clip is */
      for (size_t k = 0; k < COUNT; k++) shows[k] = (size_t)floor((from[f] + (double)k / 25) * rate + 0.5 + 1e-9);
      for (size_t i = shows[0] + 1, before = 0; i < shows[COUNT - 1]; i++) {
        struct recorded_frame window[] = {{.at = round(1000 * (double)(i - 1) / rate) / 1000},
                                          {.at = round(1000 * (double)i / rate) / 1000}};
        const struct recorded_video video = {
            .info = {.rate_numerator = rates[r].numerator, .rate_denominator = rates[r].denominator},
            .from = from[f],
            .shown = window[1].at,
            .window = window,
            .count = 2};
        const struct rate_place at = recorded_video_place(&video, COUNT);
        while (shows[before + 1] <= i) before++;
        const double step = (double)(shows[before + 1] - shows[before]), after = (double)(i - shows[before]);
        if (at.place != before || fabs(at.toward - after / step) > 1e-9)
          fail_msg("rate %g from %g: frame %zu lies at %zu + %g, expected %zu + %g / %g", rate, from[f], i, at.place,
                   at.toward, before, after, step);
      }
    }
}

/* Where frames do not follow each other at the rate, the time decides. */
static void test_unsteady_place(void **state) {
  (void)state;
  struct recorded_frame window[] = {{.at = 2.0}, {.at = 2.1}};
  const struct recorded_video video = {
      .info = {.rate_numerator = 30, .rate_denominator = 1}, .shown = 2.1, .window = window, .count = 2};
  const struct rate_place at = recorded_video_place(&video, 100);
  assert_int_equal(at.place, 52);
  assert_true(fabs(at.toward - 0.5) < 1e-6);
  assert_int_equal(recorded_video_place(&video, 10).place, 9);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_read), cmocka_unit_test(test_frames),
                                     cmocka_unit_test(test_places), cmocka_unit_test(test_recorded_places),
                                     cmocka_unit_test(test_unsteady_place)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
