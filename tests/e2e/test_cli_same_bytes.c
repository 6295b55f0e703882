/* SPDX-License-Identifier: MIT
 * Same seed, same bytes, of the files that the program writes: for any number of threads, on every run, for several
 * kinds of head, and a torso. unit/test_same_bytes has every backbone. */
#include "cli.h"

static struct cli cli;

static int make_clip(void **state) {
  (void)state;
  support_clear("clip");
  cli_run(&cli, "synth clip --size 64 --frames 8 --seed 3 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* Trains twice, with other numbers of threads, and draws with each. */
static void twice(const char *words, const char *line) {
  static const char *const old[] = {"a.safetensors", "a.run", "b.safetensors", "b.run", "a.mp4", "b.mp4"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  cli_run(&cli, "train clip -o a.safetensors --rays 64 --seed 9 --threads 1 --quiet %s %s", words, line);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip -o b.safetensors --rays 64 --seed 9 --threads 4 --quiet %s %s", words, line);
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("a.safetensors", "b.safetensors");
}

static void test_kinds(void **state) {
  (void)state;
  static const char *const kinds[] = {
      "--set backbone=hash3d --set attention=feature --levels 3 --set eye-attention=concat",
      "--set backbone=triplane --set attention=concat --ind-num 0 --effects none"};
  for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) twice(kinds[i], "--iters 1 --validate-frames 1");
}

static void test_portrait(void **state) {
  (void)state;
  cli_run(&cli, "train clip -o head.safetensors --iters 2 --rays 64 --levels 3 --quiet");
  cli_expect(&cli, 0, NULL);
  twice("--torso --head head.safetensors", "--iters 2 --validate-frames 1");
  cli_run(&cli, "render a.safetensors --clip clip --frames 0:4 --threads 1 -o a.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render b.safetensors --clip clip --frames 0:4 --threads 4 -y -o b.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("a.mp4", "b.mp4");
  cli_run(&cli, "render b.safetensors --clip clip --frames 0:4 --threads 2 -y -o b.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_same_bytes("a.mp4", "b.mp4");
  for (int threads = 1; threads <= 4; threads += 3) {
    cli_run(&cli, "render a.safetensors --clip clip --frames 0:1 --threads %d -o %d_%%d.png --quiet", threads, threads);
    cli_expect(&cli, 0, NULL);
  }
  cli_same_bytes("1_0.png", "4_0.png");
}

/* A training, a video and what live writes, in the folder NAME. The names of files stand in some of them. */
static void write_all(const char *name) {
  static const char *const files[] = {"m.safetensors", "m.run", "v.mp4", "v.mp4.provenance.json", "live.ts"};
  char path[64];
  support_clear(name);
  assert_int_equal(mkdir(name, 0777), 0);
  cli_run(&cli,
          "train clip -o m.safetensors --iters 2 --rays 64 --levels 3 --asr-model cepstra --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render m.safetensors --clip clip --frames 0:2 -o v.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "live m.safetensors --clip clip --audio clip/aud.wav --as-fast -o live.ts --quiet");
  cli_expect(&cli, 0, NULL);
  for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
    snprintf(path, sizeof path, "%s/%s", name, files[i]);
    if (cli_there(files[i])) assert_int_equal(rename(files[i], path), 0);
  }
}

/* Libraries whose host writes 0,5 give the bytes that they give anywhere. The program never takes the locale of its
 * environment, so there the environment alone has it: its tables keep their columns. */
static void test_comma_locale(void **state) {
  (void)state;
  static const char *const files[] = {"m.safetensors", "v.mp4", "live.ts"};
  char paths[2][64];
  if (!support_comma_locale()) skip();
  write_all("point");
  assert_non_null(setlocale(LC_NUMERIC, "comma_XX"));
  write_all("comma");
  setlocale(LC_NUMERIC, "C");
  for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
    for (int k = 0; k < 2; k++) snprintf(paths[k], sizeof *paths, "%s/%s", k == 0 ? "point" : "comma", files[i]);
    cli_same_bytes(paths[0], paths[1]);
  }
  assert_int_equal(
      system("export LC_ALL=comma_XX; cd comma && \"$ERNERF_BIN\" eval m.safetensors ../clip >eval.txt 2>&1"
             " && ! grep '[0-9],[0-9]' eval.txt && \"$ERNERF_BIN\" tradeoff m.safetensors ../clip --split"
             " train --frames 0:2 --seconds 1 -o tradeoff --quiet >tradeoff.txt 2>&1"
             " && awk -F , 'FNR == 1 { n = NF } NF != n { exit 1 }' m.run/curve.csv tradeoff/*.csv"),
      0);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_kinds), cmocka_unit_test(test_portrait),
                                     cmocka_unit_test(test_comma_locale)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
