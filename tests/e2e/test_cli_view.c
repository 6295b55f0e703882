/* SPDX-License-Identifier: MIT
 * A model is seen as it was trained, and a resume goes on as it began, without a word on the command line. */
#include "cli.h"

static struct cli cli;

#define UNUSUAL "--scale 3 --max-steps 24 --dt-gamma 0.01 "

static int train_head(void **state) {
  (void)state;
  static const char *const old[] = {"clip",  "m.safetensors", "m.run", "r.safetensors",
                                    "r.run", "t.safetensors", "t.run", "m.pth"};
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size 64 --frames 12 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o m.safetensors " UNUSUAL
                "--set audio-pad=zero --iters 40 --rays 256 --levels 6 --seed 7 --lr 0.02 --lr-net 0.004 --set "
                "refresh_every=8 --data-range 1:10 "
                "--save-every 20 --effects eye,codes,view --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static double eval_psnr(const char *words) {
  cli_run(&cli, "eval %s --json -", words);
  cli_expect(&cli, 0, NULL);
  json_t *object = cli_json(&cli, NULL);
  const double psnr = json_number_value(json_object_get(object, "psnr"));
  json_decref(object);
  return psnr;
}

static void test_seen_as_trained(void **state) {
  (void)state;
  const double plain = eval_psnr("m.safetensors clip");
  assert_null(strstr(cli.err, "was trained with"));
  assert_true(plain == eval_psnr("m.safetensors clip " UNUSUAL "--set audio-pad=zero"));
  assert_null(strstr(cli.err, "was trained with"));
  assert_true(plain != eval_psnr("m.safetensors clip --scale 4 --set audio-pad=edge"));
  cli_expect(
      &cli, 0,
      "m.safetensors was trained with --scale 3 --set audio-pad=zero; it is drawn with --scale 4 --set audio-pad=edge",
      NULL);
  assert_true(plain == eval_psnr("m.safetensors clip --max-steps 0 --dt-gamma -1 --torso-shrink 0")); /* as trained */
  assert_true(plain == eval_psnr("m.safetensors clip --dt-gamma 0.5"));
  cli_expect(&cli, 0, "--dt-gamma 0.5 changes nothing with 24 samples a ray", "--max-steps above 128", NULL);
  assert_null(strstr(cli.err, "was trained with"));
  cli_run(&cli, "convert m.safetensors m.pth");
  cli_expect(&cli, 0, "give the public program --scale 3 --dt_gamma 0.01 --max_steps 24", NULL);
  assert_true(plain == eval_psnr("m.pth clip"));
  cli_run(&cli, "info m.pth");
  cli_expect_out(&cli, 0, "scale 3, dt_gamma 0.01, 24 samples a ray, torso_shrink 0.8, audio-pad zero\n", NULL);
}

/* The state of step 20, as a training that was ended there would leave it. */
static void test_resumed_as_begun_long(void **state) {
  (void)state;
  size_t count = 0;
  uint8_t *bytes = cli_bytes("m.run/state.previous.safetensors", &count);
  assert_int_equal(mkdir("r.run", 0777), 0);
  support_write("r.run/state.safetensors", bytes, count);
  free(bytes);
  cli_run(&cli, "train clip -o r.safetensors --resume --scale 4");
  cli_expect(&cli, 1, "r.run/state.safetensors: scale is 3, this training has 4", NULL);
  cli_run(&cli, "train clip -o r.safetensors --resume --data-range 0:10");
  cli_expect(&cli, 1, "r.run/state.safetensors: data_begin is 1, this training has 0", NULL);
  cli_run(&cli, "train clip -o r.safetensors --resume");
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "warning"));
  cli_same_bytes("m.safetensors", "r.safetensors");
  cli_run(&cli, "train clip -o r.safetensors --resume --iters 42 --lr 0.01 --quiet");
  cli_expect(&cli, 0, "iters was 40, going on with 42", "lr was 0.02, going on with 0.01", NULL);
}

static void test_torso_as_its_head(void **state) {
  (void)state;
  cli_run(&cli, "train clip --torso --head m.safetensors -o t.safetensors --iters 2 --rays 64 --scale 4");
  cli_expect(&cli, 1, "the head", "scale is 3, this training has 4", NULL);
  cli_run(&cli,
          "train clip --torso --head m.safetensors -o t.safetensors --iters 2 --rays 64 --torso-shrink 0.5 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "info t.safetensors");
  cli_expect_out(&cli, 0, "scale 3, dt_gamma 0.01, 24 samples a ray, torso_shrink 0.5, audio-pad zero\n", NULL);
  const double recorded = eval_psnr("t.safetensors clip");
  assert_true(recorded == eval_psnr("t.safetensors clip --torso-shrink 0.7")); /* the clip's pictures are drawn */
  cli_expect(&cli, 0, "--torso-shrink changes nothing: below the head are the torso pictures of clip", NULL);
  assert_null(strstr(cli.err, "as asked"));
  eval_psnr("t.safetensors clip --torso model --torso-shrink 0.7");
  cli_expect(&cli, 0, "t.safetensors was trained with --torso-shrink 0.5; it is drawn with --torso-shrink 0.7", NULL);
}

/* A setting that changes nothing beside the others is not taken in silence, and the greatest rate is one. */
static void test_settings_without_effect(void **state) {
  (void)state;
#define SHORT "--iters 1 --rays 64 --validate-frames 1 -y "
  cli_run(&cli, "train clip -o u.safetensors " SHORT "--dt-gamma 0.5 --lr-net 1000");
  cli_expect(&cli, 0, "dt-gamma=0.5 changes nothing in this training, with 16 samples a ray", NULL);
  cli_run(&cli, "train clip -o u.safetensors " SHORT "--dt-gamma 0.5 --max-steps 129");
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "changes nothing"));
  cli_run(&cli, "train clip -o u.safetensors " SHORT "--lr 0.5 --set backbone=mlp --set step-parts=3");
  cli_expect(&cli, 1, "lr=0.5 is about hash grids", "mlp", "step_parts is 3", NULL); /* trains for seconds otherwise */
  cli_run(&cli, "train clip -o t.safetensors --torso --head m.safetensors --set lr-att=0.1");
  cli_expect(&cli, 2, "lr-att is about the head", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_settings_without_effect), cmocka_unit_test(test_seen_as_trained),
      cmocka_unit_test(test_resumed_as_begun_long), cmocka_unit_test(test_torso_as_its_head)};
  return cmocka_run_group_tests(tests, train_head, NULL);
}
