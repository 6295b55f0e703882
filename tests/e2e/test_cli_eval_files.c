/* SPDX-License-Identifier: MIT
 * What eval keeps of its frames: the table, intervals that follow from it, and the sheet, whose rows are the frames
 * that the table ranks so. */
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"

static struct cli cli;
enum { SIDE = 64, MOST = 64 };

static int train_head(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "m.safetensors", "m.run", "t.csv", "s.png", "r.json", "f_%d.png"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_shared_clip("long", "clip");
  cli_shared_model("long_head", "m");
  return 0;
}

struct table {
  size_t count;
  long frame[MOST];
  double psnr[MOST];
};

static struct table read_table(const char *path) {
  struct table table = {0};
  size_t bytes = 0;
  char *text = (char *)cli_bytes(path, &bytes), *rest = NULL;
  text[bytes] = 0;
  char *line = strtok_r(text, "\n", &rest);
  assert_string_equal(line, "frame,split,psnr,ssim,psnr_head,psnr_mouth,ms");
  while ((line = strtok_r(NULL, "\n", &rest)) != NULL && table.count < MOST) {
    assert_int_equal(sscanf(line, "%ld,val,%lf,", &table.frame[table.count], &table.psnr[table.count]), 2);
    table.count++;
  }
  free(text);
  return table;
}

static double half_interval(const double *values, size_t n) {
  double mean = 0, squares = 0;
  for (size_t i = 0; i < n; i++) mean += values[i] / (double)n;
  for (size_t i = 0; i < n; i++) squares += (values[i] - mean) * (values[i] - mean);
  return 1.96 * sqrt(squares / (double)(n - 1)) / sqrt((double)n);
}

/* The left part of a row of the sheet, as `render` draws that frame: where they are 8-bit, to the bit. */
static void expect_row(const ern_image *sheet, size_t row, long frame) {
  ern_context *context = support_context();
  ern_image drawn = {0};
  char name[32];
  cli_run(&cli, "render m.safetensors --clip clip --split all --frames %ld:%ld -o f_%%d.png -y --quiet", frame,
          frame + 1);
  cli_expect(&cli, 0, NULL);
  snprintf(name, sizeof name, "f_%ld.png", frame);
  support_ok(context, ern_image_read(context, name, 3, &drawn));
  double apart = 0;
  for (size_t y = 0; y < SIDE; y++)
    for (size_t x = 0; x < 3 * SIDE; x++)
      apart += fabs((double)sheet->data[3 * ((row * SIDE + y) * 3 * SIDE) + x] - drawn.data[3 * y * SIDE + x]);
  assert_true(apart / (3 * SIDE * SIDE) < 0.5);
  ern_image_free(context, &drawn);
  ern_context_free(&context);
}

static void test_table_and_sheet(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_image sheet = {0};
  cli_run(&cli, "eval m.safetensors clip --csv t.csv --sheet s.png --json r.json --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, "r.json");
  const json_t *interval = json_object_get(report, "interval95");
  const struct table table = read_table("t.csv");
  assert_int_equal(table.count, json_integer_value(json_object_get(report, "count")));
  assert_true(table.count >= 5);
  /* digits of the table */
  assert_true(fabs(json_number_value(json_object_get(interval, "psnr")) - half_interval(table.psnr, table.count)) <
              1e-3);
  size_t best = 0, worst = 0;
  for (size_t i = 1; i < table.count; i++) {
    if (table.psnr[i] > table.psnr[best]) best = i;
    if (table.psnr[i] < table.psnr[worst]) worst = i;
  }
  support_ok(context, ern_image_read(context, "s.png", 3, &sheet));
  assert_int_equal(sheet.width, 3 * SIDE);
  assert_int_equal(sheet.height, 3 * SIDE);
  for (size_t i = 0; i < 3 * SIDE; i++) { /* the difference is 4 times that of the two beside it, as far as bytes go */
    const uint8_t *row = sheet.data + 3 * 10 * 3 * SIDE;
    const int apart = 4 * abs(row[i] - row[3 * SIDE + i]);
    assert_int_equal(row[6 * SIDE + i], apart < 255 ? apart : 255);
  }
  expect_row(&sheet, 0, table.frame[best]);
  expect_row(&sheet, 2, table.frame[worst]);
  ern_image_free(context, &sheet);
  json_decref(report);
  ern_context_free(&context);
}

static void test_refused(void **state) {
  (void)state;
  cli_run(&cli, "eval m.safetensors clip --csv t.csv");
  cli_expect(&cli, 1, "t.csv", "--overwrite", NULL);
  cli_run(&cli, "eval m.safetensors clip --sheet s.bmp");
  cli_expect(&cli, 2, "s.bmp", ".png", NULL);
  cli_run(&cli, "eval m.safetensors clip --sheet t.csv.png --csv t.csv.png");
  cli_expect(&cli, 1, "t.csv.png", NULL);
  cli_run(&cli, "eval m.safetensors clip --sheet q.png --smooth-lips");
  cli_expect(&cli, 2, "--smooth-lips", NULL);
  assert_true(access("q.png", F_OK) != 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_table_and_sheet), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, train_head, NULL);
}
