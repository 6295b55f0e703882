/* SPDX-License-Identifier: MIT
 * The tables of settings (ernerf/setting.h): they describe whole configurations, and text and values are the same. */
#include <locale.h>
#include <math.h>
#include <string.h>

#include "core/setting_table.h"
#include "ernerf/live.h"
#include "ernerf/render.h"
#include "ernerf/train.h"
#include "support.h"

static const size_t sizes[] = {
    [ERN_SETTING_BOOL] = sizeof(bool),   [ERN_SETTING_INT] = sizeof(int),     [ERN_SETTING_UINT64] = sizeof(uint64_t),
    [ERN_SETTING_SIZE] = sizeof(size_t), [ERN_SETTING_FLOAT] = sizeof(float), [ERN_SETTING_DOUBLE] = sizeof(double),
    [ERN_SETTING_WORD] = sizeof(int),    [ERN_SETTING_TEXT] = sizeof(char *), [ERN_SETTING_POINTER] = sizeof(void *)};

/* No member is missing: each begins where the one before ends, but for its alignment. `begin`: behind `size`. */
static void expect_all_members(const ern_setting *(*row)(size_t index), size_t begin, size_t bytes) {
  const ern_setting *s;
  size_t end = begin, count = 0;
  for (; (s = row(count)) != NULL; count++) {
    const size_t size = sizes[s->type], at = (end + size - 1) / size * size;
    if (s->at != at) fail_msg("%s begins at %zu, expected %zu: a member before it has no row", s->name, s->at, at);
    end = s->at + size;
  }
  assert_true(bytes - end < 8);
  assert_true(count <= 64); /* bits of struct setting_choice */
  assert_null(row(SIZE_MAX));
}

static void test_all_members(void **state) {
  (void)state;
  const size_t begin = offsetof(ern_train_config, size) + sizeof(uint32_t);
  assert_int_equal(begin, offsetof(ern_render_options, size) + sizeof(uint32_t));
  expect_all_members(ern_train_setting, begin, sizeof(ern_train_config));
  expect_all_members(ern_live_setting, begin, sizeof(ern_live_options));
  for (size_t i = 0; ern_train_setting(i) != NULL; i++) assert_non_null(ern_train_setting(i)->group);
  expect_all_members(ern_render_setting, begin, sizeof(ern_render_options));
}

/* The ends of a float's range are the floats nearest to them: 0.99 is above the float that 0.99 becomes. */
static void test_float_ends(void **state) {
  (void)state;
  const ern_setting *s;
  ern_render_options options = ern_render_options_default();
  for (size_t i = 0; (s = ern_render_setting(i)) != NULL; i++) {
    char text[ERN_SETTING_TEXT_BYTES];
    if (s->type != ERN_SETTING_FLOAT) continue;
    for (int high = 0; high < 2; high++) {
      snprintf(text, sizeof text, "%g", high ? s->most : s->least);
      if (!ern_setting_read(s, text, &options)) fail_msg("%s: %s is refused", s->name, text);
    }
  }
  assert_true(options.transmittance_stop == 0.99f);
}

static bool is_value(const ern_setting *s) { return s->type != ERN_SETTING_TEXT && s->type != ERN_SETTING_POINTER; }

/* The default and both ends of each range pass through text unchanged, whatever the locale. */
static void test_text(void **state) {
  (void)state;
  const ern_setting *s;
  const char *const locales[] = {"C", "de_DE.UTF-8"};
  for (size_t l = 0; l < 2; l++) {
    if (setlocale(LC_ALL, locales[l]) == NULL) continue;
    for (size_t i = 0; (s = ern_train_setting(i)) != NULL; i++) {
      ern_train_config config = ern_train_config_default(), read = config;
      char text[ERN_SETTING_TEXT_BYTES], again[ERN_SETTING_TEXT_BYTES], number[64];
      const double ends[] = {s->least, s->most, s->fallback};
      if (!is_value(s)) continue;
      for (size_t e = 0; e < 3 && s->type != ERN_SETTING_BOOL && s->type != ERN_SETTING_WORD; e++) {
        snprintf(number, sizeof number, "%.0f", ends[e]);
        if (ends[e] != floor(ends[e]) || ends[e] >= 1.8e19 || !ern_setting_read(s, number, &config)) continue;
        ern_setting_write(s, &config, text);
        assert_true(ern_setting_read(s, text, &read));
        ern_setting_write(s, &read, again);
        assert_string_equal(text, again);
        assert_memory_equal((char *)&config + s->at, (char *)&read + s->at, sizes[s->type]);
      }
      config = ern_train_config_default();
      ern_setting_write(s, &config, text);
      assert_true(strlen(text) > 0 && strchr(text, ',') == NULL);
      assert_true(ern_setting_read(s, text, &read));
      assert_memory_equal((char *)&config + s->at, (char *)&read + s->at, sizes[s->type]);
    }
  }
  assert_non_null(setlocale(LC_ALL, "C"));
}

static const ern_setting *named(const char *name) {
  const ern_setting *s;
  for (size_t i = 0; (s = ern_train_setting(i)) != NULL; i++)
    if (strcmp(s->name, name) == 0) return s;
  fail_msg("no setting %s", name);
  return NULL;
}

static void test_values(void **state) {
  (void)state;
  ern_train_config config = ern_train_config_default();
  char text[ERN_SETTING_TEXT_BYTES];
  assert_true(ern_setting_read(named("seed"), "18446744073709551615", &config) && config.seed == UINT64_MAX);
  ern_setting_write(named("seed"), &config, text);
  assert_string_equal(text, "18446744073709551615");
  assert_true(ern_setting_read(named("codes"), "-1", &config) && config.codes == -1);
  assert_true(ern_setting_read(named("lr"), "-0", &config));
  ern_setting_write(named("lr"), &config, text);
  assert_string_equal(text, "0"); /* the same value as 0 has the same text */
  assert_true(ern_setting_read(named("ray_sampling"), "dub", &config) && config.ray_sampling == ERN_RAY_SAMPLING_DUB);
  assert_true(ern_setting_read(named("ema"), "yes", &config) && config.ema);
  assert_true(ern_setting_read(named("ema"), "no", &config) && !config.ema);
  assert_true(ern_setting_read(named("dt_gamma"), "3.90625e-3", &config) && config.dt_gamma == 1.0f / 256);
  static const char *const wrong[][2] = {{"seed", "18446744073709551616"},
                                         {"seed", "-1"},
                                         {"seed", ""},
                                         {"codes", "-2"},
                                         {"codes", "1000001"},
                                         {"codes", "1.5"},
                                         {"rays", "0"},
                                         {"rays", "99999999999"},
                                         {"lr", "nan"},
                                         {"lr", "inf"},
                                         {"lr", "0x1p-3"},
                                         {"lr", "0,01"},
                                         {"lr", "1001"},
                                         {"lr", "-0.1"},
                                         {"lr", "0.1 "},
                                         {"lr", " 0.1"},
                                         {"ema", "maybe"},
                                         {"ema", ""},
                                         {"ema", "1"},
                                         {"audio_pad", ""},
                                         {"audio_pad", "edge|zero"},
                                         {"audio_pad", "edg"},
                                         {"output", "a.safetensors"},
                                         {"head", "0"}};
  for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
    const ern_train_config before = config;
    if (ern_setting_read(named(wrong[i][0]), wrong[i][1], &config))
      fail_msg("%s takes \"%s\"", wrong[i][0], wrong[i][1]);
    assert_memory_equal(&before, &config, sizeof config);
  }
}

static void test_expected(void **state) {
  (void)state;
  char text[64], few[8];
  ern_setting_expected(named("max_steps"), text, sizeof text);
  assert_string_equal(text, "a whole number from 1 to 1024");
  ern_setting_expected(named("dt_gamma"), text, sizeof text);
  assert_string_equal(text, "a number from 0 to 1");
  ern_setting_expected(named("seed"), text, sizeof text);
  assert_string_equal(text, "a whole number, 0 or more");
  ern_setting_expected(named("audio_pad"), text, sizeof text);
  assert_string_equal(text, "one of edge|zero");
  ern_setting_expected(named("ema"), few, sizeof few);
  assert_string_equal(few, "yes or ");
  ern_setting_expected(named("output"), text, sizeof text);
  assert_string_equal(text, "nothing");
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_all_members), cmocka_unit_test(test_float_ends),
                                     cmocka_unit_test(test_text), cmocka_unit_test(test_values),
                                     cmocka_unit_test(test_expected)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
