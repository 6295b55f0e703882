/* SPDX-License-Identifier: MIT
 * Landmark files: 68 pairs, no more, no less, all in pixels. */
#include "../support.h"

#include "io/landmarks.h"

enum { TEXT_BYTES = 8192 };

/* `lines` lines "i i+0.5", with line `special` (from 1) replaced by `text`. */
static void make_text(char out[TEXT_BYTES], int lines, int special, const char *text) {
  size_t used = 0;
  for (int i = 0; i < lines; i++) {
    used += (size_t)(i + 1 == special ? snprintf(out + used, TEXT_BYTES - used, "%s\n", text)
                                      : snprintf(out + used, TEXT_BYTES - used, "%d.000000 %d.500000\n", i, i));
  }
  out[used] = 0;
}

static void test_good(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const char *const firsts[] = {"0 0.5", " \t0.0\t0.5 \r", "0e+00 5.000e-01", "-0 +.5",
                                       ("\xef\xbb\xbf"
                                        "0 .5")};
  for (size_t i = 0; i < sizeof firsts / sizeof firsts[0]; i++) {
    char text[TEXT_BYTES];
    float points[ERN_LANDMARKS][2];
    make_text(text, 68, 1, firsts[i]);
    if (i == 1) strcat(text, "\n \r\n");
    if (i == 2) text[strlen(text) - 1] = 0; /* no newline at the end */
    support_write_text("good.lms", text);
    support_expect(context, ern_landmarks_read(context, "good.lms", points), ERN_OK, NULL);
    for (int k = 0; k < ERN_LANDMARKS; k++) {
      assert_true(points[k][0] == (float)k);
      assert_true(points[k][1] == (float)k + 0.5f);
    }
  }
  ern_context_free(&context);
}

static void test_bad(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const struct {
    int lines;
    const char *fifth;
    ern_status status;
    const char *words[2];
  } cases[] = {{67, "1 1", ERN_E_SHAPE, {"has 67 landmarks", "expected 68"}},
               {69, "1 1", ERN_E_SHAPE, {"has 69 landmarks", "expected 68"}},
               {0, "", ERN_E_SHAPE, {"has 0 landmarks", "expected 68"}},
               {68, "1 nan", ERN_E_FORMAT, {"line 5 is \"1 nan\"", "within 1e6"}},
               {68, "inf 1", ERN_E_FORMAT, {"line 5 is \"inf 1\"", "within 1e6"}},
               {68, "1 1e39", ERN_E_FORMAT, {"line 5", "\"1 1e39\""}},
               {68, "-2e6 1", ERN_E_FORMAT, {"line 5 is \"-2e6 1\"", "within 1e6"}},
               {68, "1", ERN_E_FORMAT, {"line 5 is \"1\"", "\"x y\""}},
               {68, "1 2 3", ERN_E_FORMAT, {"line 5 is \"1 2 3\"", "two"}},
               {68, "1,2", ERN_E_FORMAT, {"line 5 is \"1,2\"", "two"}},
               {68, "1-2", ERN_E_FORMAT, {"line 5 is \"1-2\"", "two"}},
               {68, "", ERN_E_FORMAT, {"line 5 is \"\"", "two"}},
               {68, "# a comment", ERN_E_FORMAT, {"line 5", "a comment"}}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    char text[TEXT_BYTES];
    float points[ERN_LANDMARKS][2];
    make_text(text, cases[i].lines, 5, cases[i].fifth);
    support_write_text("bad.lms", text);
    support_expect(context, ern_landmarks_read(context, "bad.lms", points), cases[i].status, "bad.lms",
                   cases[i].words[0], cases[i].words[1], NULL);
  }
  float points[ERN_LANDMARKS][2];
  support_expect(context, ern_landmarks_read(context, "none.lms", points), ERN_E_MISSING, "none.lms", NULL);
  static const uint8_t zeros[64];
  support_write("zeros.lms", zeros, sizeof zeros);
  support_expect(context, ern_landmarks_read(context, "zeros.lms", points), ERN_E_FORMAT, "zeros.lms", "line 1", NULL);
  ern_context_free(&context);
}

static void test_real(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  char path[1024];
  float points[ERN_LANDMARKS][2];
  support_shared("real/presenter/ori_imgs/0.lms", path);
  assert_int_equal(ern_landmarks_read(context, path, points), ERN_OK);
  assert_true(points[0][0] == 176.667593f);
  assert_true(points[0][1] == 166.125180f);
  for (int k = 0; k < ERN_LANDMARKS; k++) assert_true(points[k][0] > 0 && points[k][0] < 472);
  support_shared("parity/clip/ori_imgs/0.lms", path);
  assert_int_equal(ern_landmarks_read(context, path, points), ERN_OK);
  assert_true(points[0][0] == 44.557555f);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_good), cmocka_unit_test(test_bad),
                                     cmocka_unit_test(test_real)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
