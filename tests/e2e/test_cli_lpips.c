/* SPDX-License-Identifier: MIT
 * LPIPS from the command line, with an AlexNet of made weights: what eval says of a frame is the distance of its
 * pictures; a fine stage trains on it and goes on with it; weights that are none are refused in words. */
#include "../made_lpips.h"
#include "cli.h"

#include <math.h>

#include "ernerf/media.h"

static struct cli cli;

#if ERN_PERCEPTUAL
enum { SIDE = 64 };
#define WEIGHTS "--lpips-network a.safetensors --lpips-heads h.safetensors "

static int make_clip(void **state) {
  (void)state;
  static const char *const old[] = {"l.safetensors", "l.run",  "clip",  "m.safetensors", "m.run",
                                    "n.safetensors", "n.run",  "p.run", "p.safetensors", "t.csv",
                                    "f_%d.png",      "r.json", "x.pth"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  made_lpips("a.safetensors", "h.safetensors", 0);
  cli_shared_clip("short", "clip");
  cli_shared_model("short_head", "m");
  return 0;
}

#define HEAD "--rays 1100 --levels 2 --seed 5 --validate-every 0 --validate-frames 1 --quiet "
#define FINE "--fine-loss lpips " WEIGHTS

static void test_fine_stage_long(void **state) {
  (void)state;
  cli_run(&cli, "train clip -o l.safetensors " HEAD FINE "--iters 12 --set fine-steps=4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o n.safetensors " HEAD FINE "--iters 10 --set fine-steps=2");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o n.safetensors --resume --iters 12");
  cli_expect(&cli, 1, "fine_loss", "lpips-alexnet", "ssim", NULL);
  cli_run(&cli, "train clip -o n.safetensors -y " HEAD FINE "--iters 8");
  cli_expect(&cli, 2, "--fine-loss", "--stage fine", NULL);
  cli_run(&cli, "train clip -o n.safetensors -y " HEAD "--iters 8");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o n.safetensors --resume --stage fine " FINE "--iters 10 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o n.safetensors --resume " FINE "--iters 12 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o p.safetensors " HEAD "--iters 12 --set fine-steps=4"); /* with its own loss */
  cli_expect(&cli, 0, NULL);
  size_t first = 0, second = 0;
  uint8_t *lpips = cli_bytes("l.safetensors", &first), *ssim = cli_bytes("p.safetensors", &second);
  assert_true(first != second || memcmp(lpips, ssim, first) != 0);
  free(lpips);
  free(ssim);
}

/* --paper with the loss of the paper: its fine stage is the last fifth. */
static void test_paper(void **state) {
  (void)state;
  cli_run(&cli, "train clip -o p.safetensors -y --paper " HEAD FINE "--iters 10");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o n.safetensors -y " HEAD FINE
                "--iters 10 --set fine-steps=2 --set ray-sampling=uniform --set refresh-every=16 "
                "--set voice-fade=no");
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("p.safetensors", "n.safetensors");
  cli_run(&cli, "train clip -o p.safetensors -y --paper --set fine-weight=1 --iters 20");
  cli_expect(&cli, 2, "--set fine-weight", NULL);
  cli_run(&cli, "train clip -o p.safetensors -y --paper --stage fine --iters 20");
  cli_expect(&cli, 2, "--stage", "--paper", NULL);
}

/* [3][height][width] of 8-bit pixels. */
static void planes_of(const ern_image *image, float *planes) {
  const size_t n = (size_t)image->width * (size_t)image->height, step = (size_t)image->channels;
  for (size_t i = 0; i < n; i++)
    for (size_t c = 0; c < 3; c++) planes[c * n + i] = (float)image->data[step * i + c] / 255;
}

static void test_eval(void **state) {
  (void)state;
  static float drawn[3 * SIDE * SIDE], truth[3 * SIDE * SIDE];
  ern_context *context = support_context();
  ern_lpips *lpips = NULL;
  ern_image picture = {0}, frame = {0};
  double expected = -1;
  cli_run(&cli, "eval m.safetensors clip --json r.json --csv t.csv --quiet " WEIGHTS);
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, "r.json");
  const json_t *frames = json_object_get(report, "frames"), *first = json_array_get(frames, 0);
  const int id = (int)json_integer_value(json_object_get(first, "id"));
  const double found = json_number_value(json_object_get(first, "lpips"));
  double sum = 0;
  for (size_t i = 0; i < json_array_size(frames); i++)
    sum += json_number_value(json_object_get(json_array_get(frames, i), "lpips"));
  const json_t *mean = json_object_get(json_object_get(report, "metrics"), "lpips");
  assert_true(fabs(json_number_value(json_object_get(mean, "mean")) - sum / (double)json_array_size(frames)) < 1e-9);
  assert_string_equal(json_string_value(json_object_get(mean, "network")), "lpips-alexnet");
  assert_true(json_is_number(json_object_get(mean, "interval95")));
  cli_run(&cli, "render m.safetensors --clip clip --split all --frames %d:%d -o f_%%d.png -y --quiet", id, id + 1);
  cli_expect(&cli, 0, NULL);
  char name[64];
  snprintf(name, sizeof name, "f_%d.png", id);
  support_ok(context, ern_image_read(context, name, 3, &picture));
  snprintf(name, sizeof name, "clip/gt_imgs/%d.jpg", id);
  support_ok(context, ern_image_read(context, name, 3, &frame));
  planes_of(&picture, drawn);
  planes_of(&frame, truth);
  support_ok(context, ern_lpips_open(&lpips, context, "a.safetensors", "h.safetensors"));
  support_ok(context, ern_lpips_distance(lpips, drawn, truth, SIDE, SIDE, &expected, NULL));
  if (!(fabs(found - expected) < 0.02 * expected)) /* 8 bits of the picture */
    fail_msg("eval's LPIPS is %.6f, that of the pictures %.6f", found, expected);
  ern_lpips_free(&lpips);
  ern_image_free(context, &picture);
  ern_image_free(context, &frame);
  json_decref(report);
  cli_run(&cli, "eval m.safetensors clip --json r.json -y");
  cli_expect(&cli, 0, NULL);
  report = cli_json(&cli, "r.json");
  mean = json_object_get(report, "metrics");
  assert_true(json_is_null(json_object_get(mean, "lpips")));
  mean = json_object_get(json_object_get(mean, "not_computed"), "lpips");
  assert_non_null(strstr(json_string_value(mean), "--lpips-network"));
  json_decref(report);
  ern_context_free(&context);
}

static void refuse(const char *network, const char *heads, const char *first, const char *second) {
  cli_run(&cli, "eval m.safetensors clip --lpips-network %s --lpips-heads %s", network, heads);
  cli_expect(&cli, 1, first, second, NULL);
}

static void test_refused(void **state) {
  (void)state;
  made_lpips("b.safetensors", "g.safetensors", 1);
  refuse("b.safetensors", "g.safetensors", "g.safetensors: tensor lin2.model.1.weight is F32 of 1 383 1 1",
         "expected F32 of 1 384 1 1");
  made_lpips("b.safetensors", "g.safetensors", 2);
  refuse("b.safetensors", "h.safetensors", "b.safetensors: tensor features.6.weight", "not finite");
  made_lpips("b.safetensors", "g.safetensors", 3);
  refuse("b.safetensors", "h.safetensors", "b.safetensors", "features.10.bias");
  refuse("h.safetensors", "h.safetensors", "h.safetensors", "features.0.weight");
  refuse("a.safetensors", "m.safetensors", "m.safetensors", "lin0.model.1.weight");
  refuse("clip/aud.wav", "h.safetensors", "aud.wav", NULL);
  refuse("none.pth", "h.safetensors", "none.pth", NULL);
  cli_run(&cli, "convert a.safetensors x.pth --quiet");
  cli_expect(&cli, 0, NULL);
  size_t count = 0;
  uint8_t *bytes = cli_bytes("x.pth", &count);
  FILE *torn = fopen("x.pth", "wb");
  assert_int_equal(fwrite(bytes, 1, count / 2, torn), count / 2);
  fclose(torn);
  free(bytes);
  refuse("x.pth", "h.safetensors", "x.pth", "damaged");
  cli_run(&cli, "eval m.safetensors clip --lpips-network a.safetensors");
  cli_expect(&cli, 2, "--lpips-heads", NULL);
  cli_run(&cli, "train clip -o q.safetensors --set fine-steps=4 --fine-loss lpips");
  cli_expect(&cli, 2, "--lpips-network", NULL);
  cli_run(&cli, "train clip -o q.safetensors --set fine-steps=4 " WEIGHTS);
  cli_expect(&cli, 2, "--fine-loss lpips", NULL);
  cli_run(&cli, "train clip -o q.safetensors --set fine-steps=4 --patch-size 16 --rays 300 " FINE);
  cli_expect(&cli, 1, "lpips-alexnet", "16 x 16", "too small", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_fine_stage_long), cmocka_unit_test(test_paper),
                                     cmocka_unit_test(test_eval), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
#else
static void test_not_there(void **state) {
  (void)state;
  cli_shared_clip("short", "clip");
  cli_run(&cli, "train clip -o q.safetensors --set fine-steps=4 --fine-loss lpips --lpips-network a --lpips-heads b");
  cli_expect(&cli, 1, "libernerf-perceptual", "ERNERF_PERCEPTUAL", NULL);
}
int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_not_there)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
#endif
