/* SPDX-License-Identifier: MIT
 * A network that hears: features, a training, frames and figures from a sound through it, and what is refused. */
#include "../made_onnx.h"
#include "cli.h"

enum { WIDTH = 44, SPAN = 400, PIECE = 22400 };

static struct cli cli;
static const char network[] = "--speech-model eo.onnx", preset[] = "--speech-preset esperanto",
                  small[] = "--iters 4 --rays 64 --levels 2 --validate-frames 1";

/* A network of the sizes of the preset "esperanto": 44 filters of 400 samples. */
static void make_network(const char *path, uint32_t seed) {
  static float weight[WIDTH * SPAN];
  struct made_message graph = {0};
  for (size_t i = 0; i < WIDTH * SPAN; i++) {
    seed = seed * 1664525u + 1013904223u;
    weight[i] = (float)(seed >> 8) / (1 << 23) - 1;
  }
  made_convolve(&graph, &(struct made_convolution){PIECE, 320, SPAN, WIDTH, weight}, "rows");
  made_onnx(path, &graph);
}

static int make(void **state) {
  (void)state;
  cli_shared_clip("short", "clip");
  assert_int_equal(remove("clip/aud_ds.npy"), 0);
  make_network("eo.onnx", 1);
  make_network("other.onnx", 2);
  if (!ERN_VISION) return 0;
  cli_run(&cli, "train clip %s %s -o n.safetensors %s", network, preset, small);
  cli_expect(&cli, 0, "aud.wav (esperanto, 44 wide)", NULL);
  return 0;
}

static void test_features(void **state) {
  (void)state;
  cli_run(&cli, "features clip/aud.wav %s %s -o eo.npy --json made.json", network, preset);
  cli_expect(&cli, 0, "esperanto", "windows of 16 rows of 44 values", NULL);
  json_t *report = cli_json(&cli, "made.json");
  assert_string_equal(json_string_value(json_object_get(report, "kind")), "esperanto");
  json_decref(report);
  cli_run(&cli, "features clip/aud.wav %s -o none.npy", network);
  cli_expect(&cli, 1, "eo.onnx", "expected a preset", "eo.json", NULL);
  assert_false(cli_there("none.npy"));
  assert_int_equal(symlink("eo.onnx", "onnx.npy"), 0);
  cli_run(&cli, "features clip/aud.wav %s %s -o onnx.npy -y", network, preset);
  cli_expect(&cli, 1, "eo.onnx", "is an input", NULL);
  /* what says what the network needs is read too, named or not */
  static const char description[] =
      "{\"kind\":\"mine\",\"rate\":16000,\"normalisation\":\"piece\",\"piece_samples\":22400,"
      "\"context_samples\":3200,\"row_samples\":400,\"width\":44,\"window_rows\":16}";
  support_write_text("eo.json", description);
  static const char *const lines[] = {"features clip/aud.wav -o none.npy --json eo.json",
                                      "eval n.safetensors clip --json eo.json",
                                      "render n.safetensors --clip clip -o none.mp4 --json eo.json",
                                      "train clip -o none.safetensors --iters 1 --json eo.json"};
  for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
    cli_run(&cli, "%s %s -y", lines[i], network);
    cli_expect(&cli, 1, "eo.json", "is an input", NULL);
  }
  size_t bytes = 0;
  uint8_t *kept = cli_bytes("eo.json", &bytes);
  assert_string_equal((const char *)kept, description);
  free(kept);
  assert_int_equal(remove("eo.json"), 0);
  support_write_text("text.onnx", "no network");
  cli_run(&cli, "features clip/aud.wav --speech-model text.onnx %s -o none.npy", preset);
  cli_expect(&cli, 1, "text.onnx", "no ONNX file", NULL);
  assert_false(cli_there("none.npy"));
}

static void test_usage(void **state) {
  (void)state;
  cli_run(&cli, "features clip/aud.wav %s -o none.npy", preset);
  cli_expect(&cli, 2, "--speech-preset", "--speech-model", NULL);
  cli_run(&cli, "features clip/aud.wav %s --speech-preset wav2vec -o none.npy", network);
  cli_expect(&cli, 2, "\"wav2vec\"", "expected esperanto, hubert", NULL);
  cli_run(&cli, "features clip/aud.wav %s %s --warp 1.1 -o none.npy", network, preset);
  cli_expect(&cli, 2, "--warp", NULL);
  cli_run(&cli, "train clip %s %s --asr-model hubert -o none.safetensors", network, preset);
  cli_expect(&cli, 2, "--asr-model", NULL);
  cli_run(&cli, "render n.safetensors --clip clip %s --audio eo.npy -o none.mp4", network);
  cli_expect(&cli, 2, "eo.npy holds features", NULL);
}

/* A model says what it needs: the network's file is all that is asked for. */
static void test_model(void **state) {
  (void)state;
  cli_run(&cli, "info n.safetensors --json n.json");
  json_t *report = cli_json(&cli, "n.json"), *kept = json_object_get(report, "speech_network");
  assert_string_equal(json_string_value(json_object_get(report, "speech")), "esperanto");
  assert_int_equal(json_string_length(json_object_get(kept, "sha256")), 64);
  assert_int_equal(json_integer_value(json_object_get(kept, "piece_samples")), PIECE);
  json_decref(report);
  cli_run(&cli, "render n.safetensors --clip clip %s -o own.mp4", network);
  cli_expect(&cli, 0, "with sound", NULL);
  cli_run(&cli, "render n.safetensors --clip clip --audio clip/aud.wav %s -o said.mp4", network);
  cli_expect(&cli, 0, "with sound", NULL);
  cli_run(&cli, "eval n.safetensors clip %s --quiet", network);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip %s -o n.safetensors --resume --iters 6 --quiet", network);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip %s --torso --head n.safetensors -o t.safetensors %s --quiet", network,
          "--iters 2 --rays 64");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render t.safetensors --clip clip %s -o torso.mp4", network);
  cli_expect(&cli, 0, "with sound", NULL);
}

static void test_wrong_network(void **state) {
  (void)state;
  cli_run(&cli, "render n.safetensors --clip clip --speech-model other.onnx -o none.mp4");
  cli_expect(&cli, 1, "other.onnx: is another network than \"esperanto\"", "SHA-256", NULL);
  cli_run(&cli, "eval n.safetensors clip");
  cli_expect(&cli, 1, "n.safetensors", "expected --audio FILE.npy, or --speech-model FILE.onnx",
             "the network \"esperanto\" with the SHA-256", NULL);
  cli_run(&cli, "render n.safetensors --clip clip %s %s -o none.mp4", network, preset);
  cli_expect(&cli, 1, "n.safetensors", "expected no --speech-preset", NULL);
  cli_run(&cli, "train clip -o c.safetensors %s --quiet", small);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render c.safetensors --clip clip %s %s -o none.mp4", network, preset);
  cli_expect(&cli, 1,
             "c.safetensors: was trained on speech features of the kind articulatory-1, and eo.onnx computes esperanto",
             NULL);
  assert_false(cli_there("none.mp4"));
}

/* A model of the public scripts' features says their kind alone. */
static void test_public_features_long(void **state) {
  (void)state;
  cli_run(&cli, "features clip/aud.wav %s %s -o public.npy --quiet", network, preset);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train clip --audio public.npy -o p.safetensors %s", small);
  cli_expect(&cli, 0, "esperanto", NULL);
  cli_run(&cli, "render p.safetensors --clip clip --audio clip/aud.wav %s -o public.mp4", network);
  cli_expect(&cli, 0, "with sound", NULL);
  /* the clip's own file of them stands for its sound */
  cli_copy("clip", "both");
  assert_int_equal(rename("public.npy", "both/aud_eo.npy"), 0);
  remove("both/aud.wav");
  cli_run(&cli, "render p.safetensors --clip both --audio clip/aud.wav %s -o both.mp4", network);
  cli_expect(&cli, 0, "with sound", NULL);
}

/* A clip's file of features says its kind: another one of the same width is not what the model knows. */
static void test_other_kind_long(void **state) {
  (void)state;
  static const char with[] = "--speech-model eo.onnx --speech-preset mine.json";
  support_write_text("mine.json",
                     "{\"kind\":\"mine\",\"rate\":16000,\"normalisation\":\"piece\",\"piece_samples\":22400,"
                     "\"context_samples\":3200,\"row_samples\":400,\"width\":44,\"window_rows\":16}");
  cli_run(&cli, "train clip %s -o mine.safetensors %s --quiet", with, small);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "features clip/aud.wav %s %s -o named.npy --quiet", network, preset);
  cli_expect(&cli, 0, NULL);
  cli_copy("clip", "named");
  assert_int_equal(symlink("../named.npy", "named/aud_eo.npy"), 0);
  static const char *const lines[] = {"render mine.safetensors --clip named -o none.mp4",
                                      "render mine.safetensors --clip named --audio named/aud_eo.npy -o none.mp4",
                                      "eval mine.safetensors named",
                                      "eval mine.safetensors clip --audio named/aud_eo.npy",
                                      "train named --torso --head mine.safetensors -o none.safetensors --iters 1",
                                      "train named --from mine.safetensors -o none.safetensors --iters 1"};
  for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
    cli_run(&cli, "%s", lines[i]);
    cli_expect(&cli, 1, "mine.safetensors: was trained on speech features of the kind mine",
               "aud_eo.npy holds esperanto", "the network \"mine\"", NULL);
  }
  assert_false(cli_there("none.mp4") || cli_there("none.run"));
  cli_run(&cli, "eval mine.safetensors named --audio named.npy --quiet"); /* which may be of any kind */
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render mine.safetensors --clip named --audio named.npy -o any.mp4");
  cli_expect(&cli, 0, "holds esperanto", "silence cannot be recognised", NULL);
}

/* OpenCV's DNN module is loaded with the first network, not with the program. */
static void test_not_linked(void **state) {
  (void)state;
  assert_int_not_equal(system("ldd \"$ERNERF_BIN\" | grep -q opencv_dnn"), 0);
}

static void test_no_library(void **state) {
  (void)state;
  cli_run(&cli, "features clip/aud.wav %s %s -o none.npy", network, preset);
  cli_expect(&cli, 1, "libernerf-vision", "ERNERF_VISION", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_features),
                                     cmocka_unit_test(test_usage),
                                     cmocka_unit_test(test_model),
                                     cmocka_unit_test(test_wrong_network),
                                     cmocka_unit_test(test_public_features_long),
                                     cmocka_unit_test(test_other_kind_long),
                                     cmocka_unit_test(test_not_linked)},
                          without[] = {cmocka_unit_test(test_no_library), cmocka_unit_test(test_not_linked)};
  return ERN_VISION ? cmocka_run_group_tests(tests, make, NULL) : cmocka_run_group_tests(without, make, NULL);
}
