/* SPDX-License-Identifier: MIT
 * What prepare does with NULL, with options out of range and with structures that nobody initialised (base.h). */
#include <math.h>
#include <unistd.h>

#include "arguments.h"
#include "ernerf/prepare.h"

static ern_context *context;
static const char *const junk = "no such file";

static int cancel(void *user, const char *step, size_t done, size_t total) {
  (void)user, (void)step, (void)done, (void)total;
  return 1;
}

CHECK(ern_prepare_options_fill) { FILLS(ern_prepare_options, ern_prepare_options_fill); }
CHECK(ern_prepare_options_default) {
  const ern_prepare_options options = ern_prepare_options_default();
  assert_true(options.side == 512 && options.focal == 0 && options.from == 0 && options.to == 0);
  assert_true(options.only == NULL && options.progress == NULL && !options.anew && !options.head_only);
}
CHECK(ern_prepare) {
  const ern_prepare_options good = ern_prepare_options_default();
  ern_prepare_options options = good;
  ern_prepare_result result;
  REFUSED_ALONE(ern_prepare(NULL, junk, "clip", &options, &result));
  REFUSED(context, "ern_prepare_sized: video is NULL", ern_prepare(context, NULL, "clip", &options, &result));
  REFUSED(context, "ern_prepare_sized: folder is NULL", ern_prepare(context, junk, NULL, &options, &result));
  REFUSED(context, "ern_prepare_sized: options is NULL", ern_prepare(context, junk, "clip", NULL, &result));
  REFUSED(context, "ern_prepare_sized: result is NULL", ern_prepare(context, junk, "clip", &options, NULL));
  REFUSED(context, "ern_prepare_options_default",
          ern_prepare(context, junk, "clip", &(ern_prepare_options){.side = 512}, &result));
#define WRONG(member, value, words)                                                      \
  do {                                                                                   \
    options = good;                                                                      \
    options.member = value;                                                              \
    REFUSED(context, words, ern_prepare(context, junk, "clip", &options, &result));      \
    assert_true(result.frames == 0 && result.verdicts[ERN_PREPARE_STEPS - 1].step == 0); \
  } while (0)
  WRONG(only, "mouth", "only is \"mouth\", expected face, pose");
  WRONG(only, "", "only is \"\"");
  WRONG(side, 127, "side is 127");
  WRONG(side, 1025, "side is 1025");
  WRONG(side, -1, "side is -1");
  WRONG(from, -1, "from -1");
  WRONG(from, NAN, "from nan");
  WRONG(from, INFINITY, "from inf");
  WRONG(to, -0.5, "to -0.5");
  WRONG(to, NAN, "to nan");
  WRONG(to, INFINITY, "to inf");
  WRONG(focal, 1, "focal is 1,");
  WRONG(focal, -1, "focal is -1");
  WRONG(focal, NAN, "focal is nan");
  WRONG(focal, 1e9, "focal is 1e+09");
  WRONG(detector, "", "detector is \"\"");
  WRONG(landmarks, "", "landmarks is \"\"");
  options = good;
  options.from = options.to = 2;
  REFUSED(context, "from 2 to 2", ern_prepare(context, junk, "clip", &options, &result));
  options = good;
  options.focal = 600;
  options.poses = "own.json";
  REFUSED(context, "focal is 600 beside poses", ern_prepare(context, junk, "clip", &options, &result));
  options = good;
  support_expect(context, ern_prepare(context, junk, "clip", &options, &result), ERN_E_MISSING, junk, NULL);
  static char longest[8192];
  memset(longest, 'a', sizeof longest - 1);
  assert_int_not_equal(ern_prepare(context, junk, longest, &options, &result), ERN_OK);
  assert_int_not_equal(access("clip", 0), 0); /* none of these made a folder */
}
CHECK(ern_prepare_sized) {
  ern_prepare_options options = ern_prepare_options_default();
  support_write_text("made.mp4", "no video");
  KEEPS_TO(ern_prepare_result, {
    assert_int_not_equal(ern_prepare_sized(context, "made.mp4", "clip", &options, it, bytes), ERN_OK);
    it->frames = bytes >= sizeof it->frames ? 7 : it->frames; /* it is 0 */
  });
  options.progress = cancel;
  ern_prepare_result result;
  support_expect(context, ern_prepare(context, "made.mp4", "clip", &options, &result), ERN_E_CANCELLED, "clip", "face",
                 NULL);
  assert_int_not_equal(access("clip", 0), 0);
  options = ern_prepare_options_default();
  options.size = sizeof options + 8;
  REFUSED_LATER(context, ern_prepare_options, ern_prepare(context, "made.mp4", "clip", &options, &result));
}

static const struct arguments_check table[] = {ROW(ern_prepare_options_fill), ROW(ern_prepare_options_default),
                                               ROW(ern_prepare), ROW(ern_prepare_sized)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("include/ernerf/prepare.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  context = support_context();
  arguments_run(table, CHECKS);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
