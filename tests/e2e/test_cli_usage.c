/* SPDX-License-Identifier: MIT
 * The words of the command line: help, names, ranges, what does not go together, exit status. */
#include "cli.h"

static const char *const verbs[] = {"train", "render", "eval", "check",    "info",   "synth",
                                    "bench", "ablate", "soak", "tradeoff", "compare"};
enum { VERBS = sizeof verbs / sizeof verbs[0] };
static struct cli cli;

static void test_help(void **state) {
  (void)state;
  cli_run(&cli, "--help");
  cli_expect_out(&cli, 0, "train", "render", "eval", "check", "info", "synth", "bench", "ablate", "soak", "tradeoff",
                 "compare", NULL);
  assert_non_null(strstr(cli.out, "convert"));
  for (int i = 0; i < VERBS; i++) {
    cli_run(&cli, "%s --help", verbs[i]);
    cli_expect_out(&cli, 0, verbs[i], "--quiet", "--json", NULL);
    assert_string_equal(cli.err, "");
  }
  cli_run(&cli, "train word --quiet -h"); /* wherever it stands */
  cli_expect(&cli, 0, NULL);
  char version[64];
  snprintf(version, sizeof version, "ernerf %s\n", ern_version());
  static const char *const asks[] = {"--version", "-V"};
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "%s", asks[i]);
    cli_expect(&cli, 0, NULL);
    assert_string_equal(cli.out, version);
  }
  cli_run(&cli, "render --help");
  char *expected = strdup(cli.out);
  assert_non_null(expected);
  cli_run(&cli, "help render");
  /* range and default: the help's own default, the program's, a range that the help tells, a bound too large to tell */
  cli_expect_out(&cli, 0, "(default 0; 0 to 256)", "(0.01 to 10000)", "PITCH > 0 up\n", "--set NAME=VALUE", NULL);
  assert_string_equal(cli.out, expected);
  free(expected);
  cli_run(&cli, "render --set help");
  cli_expect_out(&cli, 0, "(default 7; 1 to 9999)", "0: none)", "smooth-eye=yes|no", NULL);
  cli_run(&cli, "train --set help");
  cli_expect_out(&cli, 0, "  memory=BYTES ", "  refine-poses ", "yes or no (default no)", NULL);
  cli_run(&cli, "help");
  cli_expect_out(&cli, 0, "train", "convert", "130", "143", NULL);
  cli_run(&cli, "help rendr");
  cli_expect(&cli, 2, "nearest is render", NULL);
}

static void test_verbs(void **state) {
  (void)state;
  cli_run(&cli, "%s", "");
  cli_expect(&cli, 2, "  train  ", "  render  ", "  convert  ", "ernerf VERB --help", NULL);
  assert_string_equal(cli.out, "");
  cli_run(&cli, "rendr head.safetensors");
  cli_expect(&cli, 2, "rendr", "nearest is render", NULL);
  cli_run(&cli, "nonsense");
  cli_expect(&cli, 2, "unknown verb", "nonsense", NULL);
  assert_null(strstr(cli.err, "nearest"));
}

/* A line, and two words that its refusal holds. */
static const char *const refused[][3] = {
    {"info a.npy --tune", "--tune", "info devices"},
    {"info devices --device 1", "--device", "--tune"},
    {"train", "CLIP is missing", "--help"},
    {"train clip", "-o", "missing"},
    {"train clip -o x.pth", "x.pth", ".safetensors"},
    {"train clip -o x.safetensors --iter 5", "unknown option --iter", "nearest is --iters"},
    {"train clip -o x.safetensors --torso", "--torso needs", "--head"},
    {"train clip -o x.safetensors --refine-poses", "--refine-poses is --set refine-poses=VALUE", ""},
    {"render m.safetensors --clip c --set front=a.json --set front=b.json", "--set front is given twice", "b.json"},
    {"train clip -o x.safetensors --head h.safetensors", "--head", "needs --torso"},
    {"train clip -o x.safetensors --torso --head h.safetensors --levels 12", "--levels", "--torso"},
    {"train clip -o x.safetensors --resume --from y.safetensors", "--from", "--resume"},
    {"convert a.pth", "OUT", "missing"},
    {"train clip -o x.safetensors --device 1", "--device", "--backend opencl"},
    {"train clip -o x.safetensors --audio a.npy --asr-model hubert", "--asr-model", "--audio"},
    {"render m.safetensors -o x.mp4", "--clip", "neither"},
    {"render m.safetensors --clip c --poses p.json -o x.mp4", "--poses", "both"},
    {"render --clip c -o x.mp4", "MODEL", "missing"},
    {"render m.safetensors --clip c -o x.avi", "x.avi", ".mp4"},
    {"render m.safetensors --clip c -o x.png", "x.png", "%d"},
    {"render m.safetensors --clip c -o x%d%d.png", "x%d%d.png", "%05d"},
    {"render m.safetensors --clip c -o %d/x.png", "%d/x.png", "%05d"},
    {"render m.safetensors --poses p.json -o x.mp4", "--poses", "--audio"},
    {"render m.safetensors --poses p.json --audio a.npy --split val -o x.mp4", "--split", "--clip"},
    {"render m.safetensors --clip c --wav w.wav -o x%d.png", "--wav", "has none"},
    {"render m.safetensors --clip c --smooth-path-window 5 -o x.mp4", "--smooth-path-window", "--smooth-path"},
    {"render m.safetensors --clip c --smooth-path --smooth-path-window 4 -o x.mp4", "4", "odd"},
    {"render m.safetensors --clip c --fix-eye 0.5 --smooth-eye -o x.mp4", "--smooth-eye", "--fix-eye"},
    {"render m.safetensors --clip c --fix-eye 0.5 --eye e.csv -o x.mp4", "--eye", "--fix-eye"},
    {"render m.safetensors --clip c --eye e.csv --smooth-eye -o x.mp4", "--smooth-eye", "--eye"},
    {"render m.safetensors --clip c --set hold-pose=3 --smooth-path -o x.mp4", "--smooth-path", "--set hold-pose"},
    {"render m.safetensors --clip c -o - --json", "--json", "standard output"},
    {"render m.safetensors --clip c --json x.txt -o x.mp4", "\"x.txt\"", "expected 1 at most"},
    {"eval m.safetensors", "CLIP", "missing"},
    {"eval m.safetensors clip --fix-eye 0.5", "--fix-eye is an option of", "`ernerf render`"},
    {"eval m.safetensors clip --set hold-pose=5", "--set hold-pose: there is no such setting",
     "`ernerf eval --help`"}, /* nothing is near */
    {"check clip --threads 2", "unknown option --threads\n", "`ernerf check"},
    {"check clip --json=there.txt", "there.txt", ".json"},
    {"synth", "DIR", "missing"},
    {"tradeoff m.safetensors", "CLIP is missing", "--help"},
    {"tradeoff m.safetensors clip", "-o DIR", "missing"},
    {"tradeoff m.safetensors clip -o x --set image-scale=2", "--set image-scale", "0.25 to 1"},
    {"compare a.safetensors b.safetensors -o x", "CLIP is missing", "--help"},
    {"compare a.safetensors b.safetensors clip", "-o DIR", "missing"},
    {"compare a.safetensors b.safetensors clip -o x --smooth-lips", "--smooth-lips", "drawn again"},
    {"compare a.safetensors b.safetensors clip -o x --audio a.npy --asr-model hubert", "--asr-model", "--audio"},
    {"compare a.mp4 b.MKV clip -o x --threads 2", "--threads", "both videos"},
    {"compare a.mp4 b.mov clip -o x --audio a.npy", "--audio", "both videos"},
    {"bench m.safetensors", "CLIP is missing", "--help"},
    {"bench m.safetensors clip --size 64x64", "--size", "made-up"},
    {"bench m.safetensors clip more", "\"more\"", "expected 2 at most"},
    {"bench --force", "--force", "MODEL CLIP"},
    {"bench --rays 0", "--rays", "1 to 1048576"},
    {"bench --only kernels --frames 3", "--frames", "--only"},
    {"bench --only frame --rays 64", "--rays", "--only"},
    {"bench --only kernels --rays 64", "--rays", "--only"},
    {"bench --only frame --backend all --rays 64", "--rays", "--only"},
    {"bench --only nothing", "nothing", "kernels"},
    {"bench --seconds -1", "--seconds", "from 0"},
    {"bench --backend cuda", "cuda", "cpu|opencl|all"},
    {"bench --device 0", "--device", "--backend opencl"},
    {"bench --backend all --device 256", "--device", "0 to 255"},
    {"bench --backend opencl --isa avx2", "--isa", "--backend opencl leaves out"},
    {"bench --backend opencl --threads 2", "--threads", "--backend opencl leaves out"},
    {"render m.safetensors --clip clip -o x.mp4 --backend opencl --isa nonsense", "--isa",
     "--backend opencl leaves out"},
    {"eval m.safetensors clip --backend opencl --threads 2", "--threads", "--backend opencl leaves out"},
    {"train clip -o x.safetensors --backend opencl --isa avx2", "--isa", "--backend opencl leaves out"},
    {"synth there --no-blink=yes", "--no-blink", "switch"},
    {"synth there --crf 20", "--crf", "is of --video"},
    {"synth there --fault smoke:3", "smoke:3", "camera, occlude"},
    {"synth there --fault camera:6", "camera:6", "0.1 to 5"},
    {"synth there --fault cut:", "cut:", "0.1 to 99"},
    {"synth there --video x.avi", "x.avi", "NAME.mp4"},
    {"synth there --static-camera --turn 8", "--turn", "--static-camera"},
};

static void test_refused(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof refused / sizeof refused[0]; i++) {
    cli_run(&cli, "%s", refused[i][0]);
    cli_expect(&cli, 2, refused[i][1], refused[i][2], "--help", NULL);
    assert_string_equal(cli.out, "");
  }
}

/* Verb and option, a value that is refused, what is expected instead. */
static const char *const out_of_range[][4] = {
    {"train", "iters", "0", "from 1"},
    {"train", "rays", "1048577", "from 1 to 1048576"},
    {"train", "levels", "25", "from 0 to 24"},
    {"train", "lr_net", "1001", "number from 0 to 1000"},
    {"train", "torso_shrink", "1.5", "to 1"},
    {"train", "data_range", "5 2", "A < B"},
    {"train", "set memory=99999999999G", "", "number of bytes"},
    {"train", "backend", "cuda", "auto|cpu|opencl"},
    {"render", "frames", "4:2", "A < B"},
    {"render", "size", "64x8193", "from 1 to 8192"},
    {"render", "fix_eye", "1.01", "from 0 to 1"},
    {"render", "rotate", "91,0", "-90 to 90"},
    {"render", "rotate", "20", "A,B"},
    {"render", "rotate", "20,nan", "A,B"},
    {"render", "rotate", "20,5,1", "A,B"},
    {"render", "split", "test", "train|val|all"},
    {"synth", "size", "1081", "from 64 to 1080"},
    {"synth", "frames", "7", "from 8"},
    {"synth", "turn", "41", "from 1 to 40"},
    {"synth", "room", "empty", "books|plain|cluttered"},
};

static void test_ranges(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof out_of_range / sizeof out_of_range[0]; i++) {
    const char *const *row = out_of_range[i];
    char found[64], *space = NULL;
    cli_run(&cli, "%s a --%s %s", row[0], row[1], row[2]);
    snprintf(found, sizeof found, "%s", row[2]);
    if ((space = strchr(found, ' ')) != NULL) *space = ':'; /* two words are told as one range */
    cli_expect(&cli, 2, found, "expected", row[3], NULL);
  }
  cli_run(&cli, "train clip -o --iters 5");
  cli_expect(&cli, 2, "needs a value", NULL);
}

/* Every name that users of the public code know is understood, with dashes or underscores, with '=' or without: the
 * clip that is missing is then the only thing to say. */
static void test_public_names(void **state) {
  (void)state;
  static const char *const lines[] = {
      ("train nowhere -o x.safetensors --iters 10 --lr 0.01 --lr_net 0.001 --num_rays 64 --seed 3 --asr_model "
       "deepspeech --data_range 0 -1 --max_steps 16 --ind_num 100 --dt_gamma 0.004 --bound 1 --scale 4"),
      ("train nowhere -o x.safetensors --iters=10 --lr=0.01 --lr-net=0.001 --num-rays=64 --seed=3 --aud a.npy "
       "--data-range=2:5 --max-steps=16 --ind-num=100 --dt-gamma=0.004 --set audio-pad=zero --save-every=5"),
      "train nowhere --set memory=1G --output=x.safetensors --data-range 3 7 --validate-every 10 --set ema-every=2 "
      "--set "
      "ema=yes",
  };
  for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
    cli_run(&cli, "%s", lines[i]);
    cli_expect(&cli, 1, "nowhere", "missing", NULL);
  }
  cli_run(&cli,
          "render nowhere.safetensors --clip c -ox.mp4 --aud a.npy --smooth_path --smooth_path_window 7 --fix_eye 0.2 "
          "--smooth_lips --bg_img white --max_steps 16 --torso_shrink 0.8 --size 64X32 --frames 2:");
  cli_expect(&cli, 1, "nowhere.safetensors", NULL);
  cli_run(
      &cli,
      "render nowhere.safetensors --clip c --output=x.mp4 --smooth-eye --smooth-path --asr-model=hubert --split=val");
  cli_expect(&cli, 1, "nowhere.safetensors", NULL);
  cli_run(&cli, "eval nowhere.safetensors c --smooth-lips --force --frames :5 --set audio-pad=zero");
  cli_expect(&cli, 1, "nowhere.safetensors", NULL);
  assert_false(cli_there("x.safetensors") || cli_there("x.run") || cli_there("x.mp4"));
}

/* Options of the public programs that are not here say what is: in each of the verbs that stand for their main.py. */
static void test_public_options(void **state) {
  (void)state;
  static const char *const options[][2] = {{"-O", "not needed"},
                                           {"--path data/may", "the clip is an argument"},
                                           {"--test", "`ernerf eval MODEL CLIP`"},
                                           {"--test_train", "--split train"},
                                           {"--test-train", "--split train"},
                                           {"--workspace trial", "-o X.safetensors"},
                                           {"--ckpt latest", "--resume"},
                                           {"--fp16", "--isa"},
                                           {"--cuda_ray", "empty space"},
                                           {"--num_steps 16", "--max-steps"},
                                           {"--max_ray_batch 4096", "memory"},
                                           {"--lambda_amb=0.1", "docs/maths.md"},
                                           {"--exp_eye", "au.csv"},
                                           {"--preload 0", "--set memory"},
                                           {"--init_lips", "--stage fine"},
                                           {"--finetune_lips", "--stage fine"},
                                           {"--gui", "draws a video"},
                                           {"--fovy 21", "draws a video"},
                                           {"-W 450", "--size WxH"},
                                           {"--W 450", "--size WxH"},
                                           {"--emb", "vectors"},
                                           {"--part", "--data-range A:B"},
                                           {"--part2", "--data-range 0:375"},
                                           {"--asr", "ernerf live"},
                                           {"--asr_play", "ernerf live"},
                                           {"-l 10", "ernerf live"},
                                           {"-m8", "unknown option -m8"}};
  static const char *const public_verbs[] = {"train clip -o x.safetensors", "render m.safetensors --clip clip -o x.mp4",
                                             "eval m.safetensors clip"};
  for (size_t v = 0; v < sizeof public_verbs / sizeof *public_verbs; v++)
    for (size_t i = 0; i < sizeof options / sizeof *options; i++) {
      cli_run(&cli, "%s %s", public_verbs[v], options[i][0]);
      cli_expect(&cli, 2, options[i][1], "--help", NULL);
      assert_null(strstr(cli.err, "nearest"));
    }
  static const char *const others[][2] = {{"render m.safetensors --iters 5", "option of `ernerf train`"},
                                          {"eval m.safetensors clip --ind-num 5", "option of `ernerf train`"},
                                          {"render m.safetensors --seed 1", "drawing takes no random numbers"},
                                          {"eval m.safetensors clip --seed 1", "drawing takes no random numbers"},
                                          {"train clip --smooth-eye", "option of `ernerf render`"},
                                          {"train clip --fps 50", "option of `ernerf render`"},
                                          {"check clip --test", "unknown option --test"}};
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    cli_run(&cli, "%s", others[i][0]);
    cli_expect(&cli, 2, others[i][1], NULL);
  }
}

static void test_json(void **state) {
  (void)state;
  support_clear("said.json");
  cli_run(&cli, "info devices --json");
  json_decref(cli_json(&cli, NULL));
  cli_run(&cli, "info --json devices"); /* the next word is taken only if it is - or ends in .json */
  json_decref(cli_json(&cli, NULL));
  cli_run(&cli, "info devices --json said.json");
  cli_expect_out(&cli, 0, "cpu", NULL);
  json_decref(cli_json(&cli, "said.json"));
  support_clear("said.json");
  cli_run(&cli, "info devices --json=said.json");
  cli_expect(&cli, 0, NULL);
  json_decref(cli_json(&cli, "said.json"));
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_help),         cmocka_unit_test(test_verbs),
                                     cmocka_unit_test(test_refused),      cmocka_unit_test(test_ranges),
                                     cmocka_unit_test(test_public_names), cmocka_unit_test(test_public_options),
                                     cmocka_unit_test(test_json)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
