/* SPDX-License-Identifier: MIT
 * Columns of comma-separated files: headers as OpenFace and spreadsheets write them, and bad cells. */
#include "../support.h"

#include "core/memory.h"
#include "io/csv.h"

/* Reads column AU45_r of a file of this text and compares. */
static void expect_column(ern_context *context, const char *text, size_t count, const float *expected) {
  float *values = NULL;
  size_t found = 0;
  support_write_text("good.csv", text);
  support_expect(context, ern_csv_read_column(context, "good.csv", "AU45_r", &values, &found), ERN_OK, NULL);
  assert_int_equal(found, count);
  for (size_t i = 0; i < count; i++) assert_true(values[i] == expected[i]);
  ern_release(context, values);
}

static void test_good(void **state) {
  (void)state;
  ern_context *context = support_context();
  const float expected[] = {0.5f, 0.0f, 3.25f};
  expect_column(context, "frame, AU45_r\n1, 0.5\n2, 0\n3, 3.25\n", 3, expected);
  expect_column(context, "AU45_r,frame\r\n0.5,1\r\n0,2\r\n3.25,3\r\n\r\n \r\n", 3, expected);
  expect_column(context, "\xef\xbb\xbf\"AU45_r\" ,\"a,b\"\n\"0.5\",\"x,y\"\n 0.0 ,1\n+3.25,", 3, expected);
  expect_column(context, "AU45_c,xAU45_r,\t AU45_r\t,AU45_rr\n9,9,.5,9\n9,9,0e0,9\n9,9,325e-2,9", 3, expected);
  expect_column(context, "frame, AU45_r\n1, 0.5,\n2, 0, ,\n3, 3.25\n", 3, expected);
  expect_column(context, "frame, AU45_r\n", 0, NULL);
  expect_column(context, "AU45_r", 0, NULL);
  ern_context_free(&context);
}

static void test_bad(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const struct {
    const char *text;
    ern_status status;
    const char *words[2];
  } cases[] = {{"", ERN_E_FORMAT, {"is empty", "header"}},
               {"\n\n", ERN_E_FORMAT, {"is empty", "header"}},
               {"frame, AU01_r\n1, 2\n", ERN_E_MISSING, {"column AU45_r is missing", "found: frame, AU01_r"}},
               {"AU45_r, x,\"AU45_r\"\n1, 2, 3\n", ERN_E_FORMAT, {"two columns AU45_r", "expected one"}},
               {"frame, AU45_r, frame\n1, 2, 1\n", ERN_E_FORMAT, {"two columns frame", "expected one"}},
               {"frame; AU45_r\n1; 2\n", ERN_E_MISSING, {"column AU45_r is missing", "frame; AU45_r"}},
               {"frame, AU45_r\n1, nan\n", ERN_E_FORMAT, {"line 2, column AU45_r is \"nan\"", "finite number"}},
               {"frame, AU45_r\n1, 1\n2, -inf\n", ERN_E_FORMAT, {"line 3, column AU45_r is \"-inf\"", "finite"}},
               {"frame, AU45_r\n1, 1e39\n", ERN_E_FORMAT, {"line 2", "\"1e39\""}},
               {"frame, AU45_r\n1, 1.0x\n", ERN_E_FORMAT, {"line 2", "\"1.0x\""}},
               {"frame, AU45_r\n1, 0x10\n", ERN_E_FORMAT, {"line 2", "\"0x10\""}},
               {"frame, AU45_r\n1,\n", ERN_E_FORMAT, {"line 2", "is \"\", expected a finite number"}},
               {"frame, AU45_r\n1\n", ERN_E_FORMAT, {"line 2 has 1 cells", "column AU45_r is missing"}},
               {"frame, AU45_r\n1, 1.5\n2, 1,5\n", ERN_E_FORMAT, {"line 3 has more cells than the 2", "comma"}},
               {"AU45_r, x\n1,5,2,5\n", ERN_E_FORMAT, {"line 2 has more cells than the 2", "comma"}},
               {"frame, AU45_r\n4, 1\n6, 1\n", ERN_E_FORMAT, {"line 3, column frame is 6", "expected 5"}},
               {"AU45_r,frame\n1,0\n1,1\n1,1\n", ERN_E_FORMAT, {"line 4, column frame is 1", "expected 2"}},
               {"frame, AU45_r\n1, 1\n\n2, 1\n", ERN_E_FORMAT, {"line 3", "column AU45_r"}}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    float *values = NULL;
    size_t count = 9;
    support_write_text("bad.csv", cases[i].text);
    support_expect(context, ern_csv_read_column(context, "bad.csv", "AU45_r", &values, &count), cases[i].status,
                   "bad.csv", cases[i].words[0], cases[i].words[1], NULL);
    assert_null(values);
    assert_int_equal(count, 0);
  }
  float *values = NULL;
  size_t count = 0;
  support_expect(context, ern_csv_read_column(context, "none.csv", "AU45_r", &values, &count), ERN_E_MISSING,
                 "none.csv", NULL);
  support_write("zero.csv", "AU45_r\n1\0\n2\n", 12);
  support_expect(context, ern_csv_read_column(context, "zero.csv", "AU45_r", &values, &count), ERN_E_FORMAT, "zero.csv",
                 "line 2", NULL);
  ern_context_free(&context);
}

/* Column names that are thousands of characters long must not run past the list in the message. */
static void test_long_header(void **state) {
  (void)state;
  ern_context *context = support_context();
  enum { LENGTH = 100000 };
  float *values = NULL;
  size_t count = 0;
  static char text[LENGTH];
  for (size_t i = 0; i < LENGTH; i++) text[i] = i % 997 == 996 ? ',' : 'c';
  support_write("long.csv", text, sizeof text);
  support_expect(context, ern_csv_read_column(context, "long.csv", "AU45_r", &values, &count), ERN_E_MISSING,
                 "long.csv", "AU45_r", NULL);
  ern_context_free(&context);
}

static void test_real(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  char path[1024];
  float *values = NULL;
  size_t count = 0;
  support_shared("real/openface/au.csv", path);
  assert_int_equal(ern_csv_read_column(context, path, "AU45_r", &values, &count), ERN_OK);
  assert_int_equal(count, 8000);
  float most = 0;
  for (size_t i = 0; i < count; i++) {
    assert_true(values[i] >= 0 && values[i] <= 5);
    most = values[i] > most ? values[i] : most;
  }
  assert_true(most > 0.5f); /* somebody blinks */
  ern_release(context, values);
  support_expect(context, ern_csv_read_column(context, path, "AU99_r", &values, &count), ERN_E_MISSING, "au.csv",
                 "AU99_r", "AU45_r", "timestamp", NULL);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_good), cmocka_unit_test(test_bad),
                                     cmocka_unit_test(test_long_header), cmocka_unit_test(test_real)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
