/* SPDX-License-Identifier: MIT
 * What espeak-ng speaks: phonemes in time, the mouth that follows, and a made-up clip of it. */
#include "../support.h"

#include <math.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf-lab/synth.h"
#include "io/csv.h"

static const ern_spoken_options plain = {.voice = "en-us", .words_per_minute = 165};

/* Skips where espeak-ng is not there. */
static ern_context *context_with_voice(ern_spoken *spoken, const char *text, const ern_spoken_options *options) {
  ern_context *context = support_context();
  const ern_status status = ern_spoken_make(context, text, options, spoken);
  if (status == ERN_E_UNSUPPORTED) {
    print_message("%s\n", ern_last_error(context));
    ern_context_free(&context);
    skip();
  }
  support_ok(context, status);
  return context;
}

static double middle_of(const ern_spoken *spoken, char letter) {
  for (size_t i = 0; i < spoken->count; i++)
    if (spoken->phoneme[i].name[0] == letter) return 0.5 * (spoken->phoneme[i].start + spoken->phoneme[i].end);
  fail_msg("no phoneme %c", letter);
  return 0;
}

static void test_phonemes(void **state) {
  (void)state;
  ern_spoken spoken, fast;
  float closed = 0, open = 0, round = 0, spread = 0, any = 0;
  ern_context *context = context_with_voice(&spoken, "Mama sees you.", &plain);
  assert_int_equal(spoken.sound.channels, 1);
  const double seconds = (double)spoken.sound.frames / spoken.sound.rate;
  for (size_t i = 0; i < spoken.count; i++) {
    const ern_phoneme *p = &spoken.phoneme[i];
    assert_true(p->start <= p->end && p->end <= seconds + 1e-9 && strlen(p->name) > 0);
    if (i > 0) assert_true(p->start == p[-1].end);
  }
  ern_spoken_mouth(&spoken, middle_of(&spoken, 'm'), &closed, &any);
  ern_spoken_mouth(&spoken, middle_of(&spoken, 'A'), &open, &any);
  ern_spoken_mouth(&spoken, middle_of(&spoken, 'u'), &any, &round);
  ern_spoken_mouth(&spoken, middle_of(&spoken, 'i'), &any, &spread);
  assert_true(closed < 0.2f && open > 0.8f && round < -0.5f && spread > 0.5f);
  ern_spoken_mouth(&spoken, seconds + 1, &open, &any);
  assert_true(open == 0 && any == 0);
  /* 20 % faster takes less time */
  support_ok(context, ern_spoken_make(context, "Mama sees you.",
                                      &(ern_spoken_options){.voice = "en-us", .words_per_minute = 198}, &fast));
  assert_true(fast.sound.frames < spoken.sound.frames && fast.count == spoken.count);
  ern_spoken_free(context, &fast);
  ern_spoken_free(context, &spoken);
  ern_context_free(&context);
}

/* By numbers: the targets in time, times a Gaussian of 20 ms. */
static void test_mouth(void **state) {
  (void)state;
  ern_phoneme phoneme[] = {{0, 0.1, "p"}, {0.1, 0.3, "aI"}, {0.3, 0.33, "t"}, {0.33, 0.5, "_"}};
  const ern_spoken spoken = {.phoneme = phoneme, .count = 4};
  for (double t = -0.1; t < 0.6; t += 0.0137) {
    double sum = 0, wide = 0;
    for (double s = 0.00005; s < 0.5; s += 0.0001) {
      const double jaw = s < 0.1 ? 0 : s < 0.2 ? 1 : s < 0.3 ? 0.4 : s < 0.33 ? 0.2 : 0;
      const double width = s < 0.1 ? 0 : s < 0.2 ? 0.15 : s < 0.3 ? 0.5 : s < 0.33 ? 0.1 : 0;
      const double weight = exp(-0.5 * pow((t - s) / 0.02, 2)) / (0.02 * sqrt(2 * 3.14159265358979)) * 0.0001;
      sum += weight * jaw;
      wide += weight * width;
    }
    float jaw = 0, width = 0;
    ern_spoken_mouth(&spoken, t, &jaw, &width);
    assert_true(fabs((double)jaw - sum) < 1e-4 && fabs((double)width - wide) < 1e-4);
  }
}

static void test_refused(void **state) {
  (void)state;
  ern_spoken spoken;
  ern_context *context = context_with_voice(&spoken, "Yes.", &plain);
  ern_spoken_free(context, &spoken);
  const struct {
    const char *text, *voice, *said;
    int words;
  } rows[] = {{"Yes.", "no-such-voice", "no-such-voice", 165},
              {"", "en-us", "nothing that can be spoken", 165},
              {" \n", "en-us", "nothing that can be spoken", 165},
              {"Yes.", "en-us", "79 words", 79}};
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    const ern_spoken_options options = {.voice = rows[i].voice, .words_per_minute = rows[i].words};
    assert_int_equal(ern_spoken_make(context, rows[i].text, &options, &spoken), ERN_E_ARGUMENT);
    assert_non_null(strstr(ern_last_error(context), rows[i].said));
    assert_null(spoken.phoneme);
    assert_null(spoken.sound.data);
  }
  ern_context_free(&context);
}

/* A clip of a text: its sound, a jaw that follows the phonemes, the person of the seed, and no file of features. */
static void test_clip_long(void **state) {
  (void)state;
  static const char text[] = "Mama opened a big brown box of apples.";
  ern_spoken spoken;
  ern_sound sound;
  float *jaws = NULL;
  size_t rows = 0;
  ern_context *context = context_with_voice(&spoken, text, &plain);
  support_clear("said");
  support_write_text("said.txt", text);
  ern_synth_options options = ern_synth_options_default();
  options.size = 64;
  options.frames = 0;
  options.text_file = "said.txt";
  support_ok(context, ern_synth_write(context, "said", &options));
  support_ok(context, ern_sound_read(context, "said/aud.wav", &sound));
  assert_int_equal(sound.rate, spoken.sound.rate);
  assert_true(sound.frames >= spoken.sound.frames && sound.frames < spoken.sound.frames + (size_t)sound.rate / 25);
  assert_memory_equal(sound.data, spoken.sound.data, spoken.sound.frames * sizeof *sound.data);
  support_ok(context, ern_csv_read_column(context, "said/curves.csv", "jaw", &jaws, &rows));
  assert_int_equal(rows, sound.frames * 25 / (size_t)sound.rate);
  double most = 0;
  for (size_t t = 0; t < rows; t++) {
    float jaw = 0, width = 0;
    ern_spoken_mouth(&spoken, (double)t / 25, &jaw, &width);
    assert_true(fabsf(jaws[t] - jaw) < 1e-5f);
    most = fmax(most, (double)jaws[t]);
  }
  assert_true(most > 0.7);
  assert_true(access("said/aud_ds.npy", F_OK) != 0);
  /* shorter than the text: cut; longer: silence behind it; another seed: another person */
  support_clear("cut");
  options.frames = 8;
  support_ok(context, ern_synth_write(context, "cut", &options));
  assert_int_equal(system("cmp said/bc.jpg cut/bc.jpg && cmp said/gt_imgs/0.jpg cut/gt_imgs/0.jpg"), 0);
  const char *const bad[] = {"missing.txt", "nul.txt"};
  assert_int_equal(system("printf 'a\\0b' > nul.txt"), 0);
  for (size_t i = 0; i < 2; i++) {
    options.text_file = bad[i];
    assert_int_not_equal(ern_synth_write(context, "none", &options), ERN_OK);
    assert_non_null(strstr(ern_last_error(context), bad[i]));
    assert_true(access("none", F_OK) != 0);
  }
  ern_sound_free(context, &sound);
  ern_release(context, jaws);
  ern_spoken_free(context, &spoken);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_phonemes), cmocka_unit_test(test_mouth),
                                     cmocka_unit_test(test_refused), cmocka_unit_test(test_clip_long)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
