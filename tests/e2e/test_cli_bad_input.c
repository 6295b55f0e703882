/* SPDX-License-Identifier: MIT
 * Bad input to the program: each is told with file, field, what was found and what was expected, ends with exit status
 * 1, and leaves nothing behind. */
#include <fcntl.h>

#include "cli.h"

static struct cli cli;

enum { FRAMES = 11 }; /* of the clip: 10 to train on, 1 for validation */
#define TRAIN_WORDS "-o x.safetensors --iters 1 --rays 16 --levels 2 --quiet"

static int make_clip(void **state) {
  (void)state;
  support_clear("base");
  support_clear("m.safetensors");
  support_clear("m.run");
  cli_run(&cli, "synth base --size 64 --frames %d --seed 5 --quiet", FRAMES);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "train base -o m.safetensors --iters 1 --rays 16 --levels 2 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* Trains on the folder `broken` and expects the words, exit status 1 and no file. */
static void refuse(const char *first, const char *second, const char *third, const char *fourth) {
  support_clear("x.safetensors");
  support_clear("x.run");
  cli_run(&cli, "train broken " TRAIN_WORDS);
  cli_expect(&cli, 1, "ernerf train: ", first, second, third, fourth, NULL);
  assert_string_equal(cli.out, "");
  assert_false(cli_there("x.safetensors") || cli_there("x.run"));
}

/* A copy of the clip with a file's bytes changed: `count` of them, from the file's start. */
static void break_file(const char *name, const uint8_t *bytes, size_t count) {
  char path[256];
  cli_copy("base", "broken");
  snprintf(path, sizeof path, "broken/%s", name);
  cli_replace(path, bytes, count);
}

static void test_npy(void **state) {
  (void)state;
  size_t count = 0;
  uint8_t *bytes = cli_bytes("base/aud_ds.npy", &count);
  break_file("aud_ds.npy", bytes, count - 100);
  refuse("aud_ds.npy", "claims", "found", "bytes");
  uint8_t *longer = calloc(count + 100, 1);
  assert_non_null(longer);
  memcpy(longer, bytes, count);
  break_file("aud_ds.npy", longer, count + 100);
  refuse("aud_ds.npy", "claims", "found", "bytes");
  free(longer);

  /* a header that claims more than there is, up to what no size can hold */
  char *shape = strstr((char *)bytes + 10, "(11, 16, 29");
  assert_non_null(shape);
  memcpy(shape, "(99, 16, 29", 11);
  break_file("aud_ds.npy", bytes, count);
  refuse("aud_ds.npy", "claims", "found", "bytes");
  memcpy(shape, "(11, 16, 00", 11);
  break_file("aud_ds.npy", bytes, count);
  refuse("aud_ds.npy", "claims", "found", "bytes");

  /* a value that is no number */
  memcpy(shape, "(11, 16, 29", 11);
  const float infinite = strtof("inf", NULL);
  memcpy(bytes + count - 4 * 29, &infinite, sizeof infinite);
  break_file("aud_ds.npy", bytes, count);
  refuse("aud_ds.npy", "inf", "expected", "finite");
  free(bytes);
}

/* ---- transforms_train.json ----------------------------------------------------------------------------------------
 */

static json_t *load_transforms(void) {
  json_error_t error;
  json_t *root = json_load_file("base/transforms_train.json", 0, &error);
  assert_true(json_is_object(root));
  return root;
}

static json_t *third_frame(json_t *root) { return json_array_get(json_object_get(root, "frames"), 2); }

/* Takes the root. */
static void break_transforms(json_t *root) {
  char *text = json_dumps(root, JSON_COMPACT);
  assert_non_null(text);
  break_file("transforms_train.json", (const uint8_t *)text, strlen(text));
  free(text);
  json_decref(root);
}

/* A field of the file, or of its third frame, gone (value NULL) or with another value. */
static void refuse_field(bool of_frame, const char *field, const char *value, const char *found) {
  json_t *root = load_transforms(), *at = of_frame ? third_frame(root) : root;
  if (value == NULL)
    json_object_del(at, field);
  else
    json_object_set_new(at, field, json_loads(value, JSON_DECODE_ANY, NULL));
  break_transforms(root);
  refuse("transforms_train.json", of_frame ? "frame 2" : "", field, found);
  if (strstr(cli.err, "expected") == NULL) fail_msg("%s: nothing is said of what was expected: %s", field, cli.err);
}

static void test_json(void **state) {
  (void)state;
  refuse_field(false, "focal_len", NULL, "missing");
  refuse_field(false, "focal_len", "\"wide\"", "wide");
  refuse_field(false, "focal_len", "-5", "-5");
  refuse_field(false, "frames", NULL, "missing");
  refuse_field(false, "frames", "{}", "");
  refuse_field(false, "frames", "[]", "");
  refuse_field(true, "img_id", NULL, "missing");
  refuse_field(true, "aud_id", "\"2\"", "2");
  refuse_field(true, "aud_id", "-1", "-1");
  refuse_field(true, "img_id", "1.5", "1.5");
  refuse_field(true, "transform_matrix", NULL, "missing");
  refuse_field(true, "transform_matrix", "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1]]", "");
  break_file("transforms_train.json", (const uint8_t *)"{\"frames\": [", 12);
  refuse("transforms_train.json", "line", "", "");
}

/* Numbers that float32 cannot hold, that no number is, that JSON does not know. */
static void test_poses(void **state) {
  (void)state;
  static const char *const values[] = {"1e300", "\"0\"", "null"};
  for (size_t i = 0; i < sizeof values / sizeof values[0]; i++) {
    json_t *root = load_transforms(), *matrix = json_object_get(third_frame(root), "transform_matrix");
    json_array_set_new(json_array_get(matrix, 1), 3, json_loads(values[i], JSON_DECODE_ANY, NULL));
    break_transforms(root);
    refuse("transforms_train.json", "frame 2", "transform_matrix", "expected");
  }
  static const char *const words[] = {"NaN", "1e999", "Infinity"};
  for (size_t i = 0; i < sizeof words / sizeof words[0]; i++) {
    char text[512];
    const int bytes =
        snprintf(text, sizeof text,
                 "{\"focal_len\": 100, \"cx\": 32, \"cy\": 32, \"frames\": [{\"img_id\": 0, \"aud_id\": 0, "
                 "\"transform_matrix\": [[%s, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]]}]}",
                 words[i]);
    break_file("transforms_train.json", (const uint8_t *)text, (size_t)bytes);
    refuse("transforms_train.json", "line 1", "", "");
  }
}

/* ---- a frame's files ----------------------------------------------------------------------------------------------
 */

static void test_pictures(void **state) {
  (void)state;
  size_t count = 0;
  cli_copy("base", "broken");
  remove("broken/gt_imgs/4.jpg");
  refuse("gt_imgs/4.jpg", "missing", "img_id 4", "");

  support_clear("other");
  cli_run(&cli, "synth other --size 96 --frames 8 --quiet");
  cli_expect(&cli, 0, NULL);
  uint8_t *bytes = cli_bytes("other/gt_imgs/1.jpg", &count);
  break_file("gt_imgs/4.jpg", bytes, count);
  refuse("gt_imgs/4.jpg", "96 x 96", "expected 64 x 64", "");
  free(bytes);
  bytes = cli_bytes("other/torso_imgs/1.png", &count);
  break_file("torso_imgs/10.png", bytes, count);
  refuse("torso_imgs/10.png", "96 x 96", "expected 64 x 64", "");
  free(bytes);

  bytes = cli_bytes("base/gt_imgs/4.jpg", &count);
  break_file("gt_imgs/4.jpg", bytes, 100); /* cut off in its header */
  refuse("gt_imgs/4.jpg", "", "", "");
  free(bytes);
}

static void test_blink(void **state) {
  (void)state;
  static const char rows[] = "frame, AU45_r\n1, 0.0\n2, 0.5\n3, 0.1\n", other[] = "frame, AU12_r\n1, 0.0\n";
  break_file("au.csv", (const uint8_t *)rows, sizeof rows - 1);
  refuse("au.csv", "AU45_r", "3 rows", "expected at least 11");
  break_file("au.csv", (const uint8_t *)other, sizeof other - 1);
  refuse("au.csv", "AU45_r", "missing", "found: frame, AU12_r");
  static const char word[] = "frame, AU45_r\n1, 0.0\n2, much\n";
  break_file("au.csv", (const uint8_t *)word, sizeof word - 1);
  refuse("au.csv", "much", "expected", "AU45_r");
}

static void test_landmarks(void **state) {
  (void)state;
  char text[4096];
  size_t used = 0;
  for (int i = 0; i < 67; i++) used += (size_t)snprintf(text + used, sizeof text - used, "%d %d\n", i, i);
  break_file("ori_imgs/2.lms", (const uint8_t *)text, used);
  refuse("ori_imgs/2.lms", "67", "expected 68", "");
  used += (size_t)snprintf(text + used, sizeof text - used, "12\n");
  break_file("ori_imgs/2.lms", (const uint8_t *)text, used);
  refuse("ori_imgs/2.lms", "", "", "");
}

/* ---- models ------------------------------------------------------------------------------------------------------ */

static void test_model(void **state) {
  (void)state;
  size_t count = 0;
  uint8_t *bytes = cli_bytes("m.safetensors", &count);
  support_clear("x.mp4");
  const size_t cuts[] = {count - 1, count / 2, 100, 4, 0};
  for (size_t i = 0; i < sizeof cuts / sizeof cuts[0]; i++) {
    support_write("cut.safetensors", bytes, cuts[i]);
    cli_run(&cli, "render cut.safetensors --clip base -o x.mp4");
    cli_expect(&cli, 1, "ernerf render: ", "cut.safetensors", "expected", NULL);
    assert_false(cli_there("x.mp4"));
  }
  cli_run(&cli, "eval cut.safetensors base --json x.json");
  cli_expect(&cli, 1, "ernerf eval: ", "cut.safetensors", NULL);
  cli_run(&cli, "info cut.safetensors --json x.json");
  cli_expect(&cli, 1, "ernerf info: ", "cut.safetensors", NULL);
  cli_run(&cli, "train base --torso --head cut.safetensors -o x.safetensors --iters 1 --rays 16");
  cli_expect(&cli, 1, "ernerf train: ", "cut.safetensors", NULL);
  assert_false(cli_there("x.json") || cli_there("x.safetensors"));

  /* a name that no model has, in the place of one that it has */
  char *name = NULL;
  for (size_t i = 0; i + 9 < count && name == NULL; i++)
    if (memcmp(bytes + i, "unc_net.n", 9) == 0) name = (char *)bytes + i;
  assert_non_null(name);
  memcpy(name, "ucn", 3);
  support_write("cut.safetensors", bytes, count);
  cli_run(&cli, "info cut.safetensors");
  cli_expect(&cli, 1, "cut.safetensors", "unc_net.net.0.weight", "missing", "expected", NULL);
  free(bytes);

  cli_run(&cli, "eval base/aud_ds.npy base");
  cli_expect(&cli, 1, "base/aud_ds.npy", NULL);
}

/* Features of another kind, and a model of another clip. */
static void test_mismatch(void **state) {
  (void)state;
  static uint8_t wide[128 + 9 * 16 * 44 * 4];
  static const char header[] = "{'descr': '<f4', 'fortran_order': False, 'shape': (9, 16, 44), }";
  memset(wide, ' ', 128);
  memcpy(wide, "\x93NUMPY\x01\x00\x76\x00", 10); /* a header of 118 bytes */
  memcpy(wide + 10, header, sizeof header - 1);
  wide[127] = '\n';
  support_write("wide.npy", wide, sizeof wide);
  cli_run(&cli, "info wide.npy --json");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "render m.safetensors --clip base --audio wide.npy -o x.mp4");
  cli_expect(&cli, 1, "wide.npy", "44", "expected 29", NULL);
  assert_false(cli_there("x.mp4"));
  cli_run(&cli, "eval m.safetensors other");
  cli_expect(&cli, 1, "m.safetensors", "another clip", "expected", "--force", NULL);
  cli_run(&cli, "eval m.safetensors other --force --split val");
  cli_expect(&cli, 0, "warning", "another clip", NULL);
  cli_run(&cli, "render m.safetensors --clip base --fix-eye 0.5 --backend opencl --device 255 -o x.mp4");
  cli_expect(&cli, 1, "OpenCL", NULL);
  assert_false(cli_there("x.mp4"));
}

/* ---- places that take nothing ------------------------------------------------------------------------------------ */

static void test_no_folder(void **state) {
  (void)state;
  support_clear("nofolder");
  static const char *const lines[] = {"train base -o nofolder/x.safetensors --iters 1",
                                      "render m.safetensors --clip base -o nofolder/x.mp4",
                                      "render m.safetensors --clip base -o nofolder/x%d.png",
                                      "render m.safetensors --clip base -o nofolder/x%d.exr",
                                      "info devices --json nofolder/x.json",
                                      "check base --json nofolder/x.json"};
  for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
    cli_run(&cli, "%s", lines[i]);
    cli_expect(&cli, 1, "nofolder", NULL);
    assert_false(cli_there("nofolder"));
  }
  cli_run(&cli, "synth base --size 64 --frames 8");
  cli_expect(&cli, 1, "base", "expected", NULL);
  cli_run(&cli, "check nowhere");
  cli_expect(&cli, 1, "nowhere", NULL);
}

/* What is read is not written over, under whatever name. */
static void test_output_is_input(void **state) {
  (void)state;
  static const char *const lines[][2] = {
      {"check base -y --json base/transforms_train.json", "base/transforms_train.json: is an input"},
      {"eval m.safetensors base -y --json base/transforms_val.json", "base/transforms_val.json: is an input"},
      {"train base --from m.safetensors -o ./m.safetensors --iters 1 --rays 16", "m.safetensors: is an input"},
      {"train base --torso --head m.safetensors -o m.safetensors --iters 1 --rays 16", "m.safetensors: is an input"},
      {"render m.safetensors --clip base --frames 0:1 -o base/torso_imgs/%d.png", "is among the clip's pictures"},
      {"info base/transforms_val.json -y --json base/transforms_val.json", "base/transforms_val.json: is an input"},
      {"soak base --steps 1 -y --json base/transforms_train.json", "base/transforms_train.json: is an input"},
      {"render m.safetensors --clip base --bg-img behind1.png -y -o behind%d.png", "behind1.png: is an input"}};
  size_t count = 0, after = 0;
  cli_run(&cli, "render m.safetensors --clip base --frames 1:2 -y -o behind%%d.png");
  cli_expect(&cli, 0, NULL);
  uint8_t *model = cli_bytes("m.safetensors", &count);
  cli_copy("base", "broken");
  for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
    cli_run(&cli, "%s", lines[i][0]);
    cli_expect(&cli, 1, lines[i][1], "expected another", NULL);
  }
  uint8_t *same = cli_bytes("m.safetensors", &after);
  assert_true(count == after && memcmp(model, same, count) == 0);
  free(model), free(same);
  assert_false(cli_there("behind0.png"));
  cli_run(&cli, "check base");
  cli_expect(&cli, 0, NULL);
}

/* Of all that a clip is made of, nothing is replaced, by whatever verb. */
static void test_output_is_of_the_clip(void **state) {
  (void)state;
  static const char *const files[] = {
      "transforms_train.json", "transforms_val.json", "bc.jpg",        "aud.wav",        "au.csv",
      "prepare.json",          "aud_ds.npy",          "aud_eo.npy",    "aud_hu.npy",     "aud.npy",
      "aud_cep.npy",           "aud_art.npy",         "gt_imgs/4.jpg", "ori_imgs/4.lms", "torso_imgs/4.png",
      "parsing/4.png"};
  static const char *const lines[] = {"live m.safetensors --clip whole --duration 1 --format raw -y -o whole/%s",
                                      "eval m.safetensors whole -y --sheet whole/%s"};
  char path[64];
  cli_copy("base", "whole");
  (void)mkdir("whole/parsing", 0777);
  for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
    snprintf(path, sizeof path, "whole/%s", files[i]);
    if (!cli_there(path)) support_write_text(path, "mine");
    cli_run(&cli, lines[0], files[i]);
    cli_expect(&cli, 1, path, "expected another", NULL);
  }
  for (size_t k = 1; k < sizeof lines / sizeof *lines; k++) {
    cli_run(&cli, lines[k], "parsing/4.png");
    cli_expect(&cli, 1, "whole/parsing/4.png: is", "expected another", NULL);
  }
  cli_run(&cli, "render m.safetensors --clip whole -y -o whole/parsing/%%d.png");
  cli_expect(&cli, 1, "whole/parsing", "expected another", NULL);
  size_t count = 0;
  uint8_t *kept = cli_bytes("whole/parsing/4.png", &count);
  assert_int_equal(count, 4);
  free(kept);
}

/* Where a training would find at its end that it has no place. */
static void test_no_place(void **state) {
  (void)state;
  static const char *const taken[] = {"x.safetensors", "x.run/state.safetensors", "x.run/log.jsonl", "x.run"};
  for (size_t i = 0; i < sizeof taken / sizeof *taken; i++) {
    const char *name = taken[i];
    support_clear("x.safetensors"), support_clear("x.run");
    if (strchr(name, '/') != NULL) assert_int_equal(mkdir("x.run", 0777), 0);
    if (strcmp(name, "x.run") != 0) assert_int_equal(mkdir(name, 0777), 0);
    if (i == 3) assert_int_equal(symlink("nowhere", name), 0);
    cli_run(&cli, "train base " TRAIN_WORDS);
    cli_expect(&cli, 1, name, "expected a ", NULL);
    assert_false(cli_there("nowhere") || cli_there("x.run/val_000001.png"));
    remove("x.run");
  }
  support_clear("x.safetensors"), support_clear("x.run");
}

/* Pictures that another process writes are not mixed with others, also with --overwrite and where its range begins
 * elsewhere; a lock that nobody holds does not matter, and none is left. */
static void test_pictures_of_two(void **state) {
  (void)state;
  support_clear("two");
  assert_int_equal(mkdir("two", 0777), 0);
  const int lock = open("two/all.png.claim.ernerf-tmp", O_RDWR | O_CREAT, 0666);
  struct flock second = {.l_type = F_WRLCK, .l_whence = SEEK_SET, .l_start = 1, .l_len = 1};
  assert_true(lock >= 0 && fcntl(lock, F_SETLK, &second) == 0);
  cli_run(&cli, "render m.safetensors --clip base --frames 0:2 -y -o two/%%d.png --quiet");
  cli_expect(&cli, 1, "two/%d.png: another process writes these pictures", NULL);
  cli_run(&cli, "render m.safetensors --clip base --frames 1:2 -y -o two/%%03d.png --quiet");
  cli_expect(&cli, 1, "two/%03d.png: another process writes these pictures", NULL);
  assert_int_equal(cli_count("two"), 1);
  cli_run(&cli, "render m.safetensors --clip base --frames 0:1 -y -o two/%%d.png --quiet"); /* others */
  cli_expect(&cli, 0, NULL);
  assert_true(cli_there("two/all.png.claim.ernerf-tmp")); /* the other process still holds it */
  close(lock);
  cli_run(&cli, "render m.safetensors --clip base --frames 0:2 -y -o two/%%d.png --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(cli_count("two"), 3); /* with all.png.provenance.json */
}

/* A disk that takes `bytes` bytes a file: the words, exit status 1, and none of the files. */
static void refuse_full(size_t bytes, const char *line, const char *name) {
  support_clear("full");
  assert_int_equal(mkdir("full", 0777), 0);
  cli_run_full(&cli, bytes, "%s", line);
  cli_expect(&cli, 1, name, NULL);
  if (cli_count("full") > 1 || cli_there("full/x.safetensors") || cli_there("full/x.mp4") || cli_there("full/x0.png") ||
      cli_there("full/x0.exr") || cli_there("full/x.json"))
    fail_msg("ernerf %s left something behind", line);
}

static void test_full_disk(void **state) {
  (void)state;
  refuse_full(20000, "train base -o full/x.safetensors --iters 1 --rays 16 --levels 2 --quiet", "full/x");
  /* neither the run's folder nor what its validation wrote: the same training can be begun again */
  assert_int_equal(cli_count("full"), 0);
  cli_run(&cli, "train base -o full/x.safetensors --iters 1 --rays 16 --levels 2 --quiet");
  cli_expect(&cli, 0, NULL);
  refuse_full(3000, "render m.safetensors --clip base --frames 0:3 --bg-img white -o full/x.mp4 --quiet", "full/x.mp4");
  assert_int_equal(cli_count("full"), 0);
  refuse_full(1000, "render m.safetensors --clip base --frames 0:1 -o full/x%d.png --quiet", "full/x0.png");
  assert_int_equal(cli_count("full"), 0);
  refuse_full(1000, "render m.safetensors --clip base --frames 0:1 -o full/x%d.exr --quiet", "full/x0.exr");
  assert_int_equal(cli_count("full"), 0);
  refuse_full(100, "info m.safetensors --json full/x.json", "full/x.json");
  assert_int_equal(cli_count("full"), 0);
  refuse_full(2000, "synth full/clip --size 64 --frames 8 --quiet", "full/clip");
  assert_int_equal(cli_count("full"), 0);
}

/* Files that belong together are all of one run: the page is the largest, and the last. */
static void test_full_disk_keeps_the_set_long(void **state) {
  (void)state;
  static const char line[] = "tradeoff m.safetensors base --frames 0:2 --split train --seconds 1 --quiet";
  struct stat page;
  cli_run(&cli, "%s -o set", line);
  cli_expect(&cli, 0, NULL);
  assert_int_equal(system("cp -r set before"), 0);
  assert_int_equal(stat("set/index.html", &page), 0);
  const size_t bytes = (size_t)page.st_size * 3 / 4;
  cli_run_full(&cli, bytes, "%s -o set -y", line);
  cli_expect(&cli, 1, "set/index.html", NULL);
  assert_int_equal(system("diff -r set before"), 0);
  cli_run_full(&cli, bytes, "%s -o fresh", line);
  cli_expect(&cli, 1, "fresh/index.html", NULL);
  assert_false(cli_there("fresh"));
}

static void test_full_output(void **state) {
  (void)state;
  static const char *const lines[] = {"info devices", "info devices --json", "--help", "train --help",
                                      "render m.safetensors --clip base --frames 0:1 -o -"};
  for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
    snprintf(cli.line, sizeof cli.line, "%s", lines[i]);
    cli_start(&cli, "/dev/full", 0);
    cli_wait(&cli);
    cli_expect(&cli, 1, "standard output", "written", NULL);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_npy),
                                     cmocka_unit_test(test_json),
                                     cmocka_unit_test(test_poses),
                                     cmocka_unit_test(test_pictures),
                                     cmocka_unit_test(test_blink),
                                     cmocka_unit_test(test_landmarks),
                                     cmocka_unit_test(test_model),
                                     cmocka_unit_test(test_mismatch),
                                     cmocka_unit_test(test_no_folder),
                                     cmocka_unit_test(test_output_is_input),
                                     cmocka_unit_test(test_output_is_of_the_clip),
                                     cmocka_unit_test(test_no_place),
                                     cmocka_unit_test(test_pictures_of_two),
                                     cmocka_unit_test(test_full_disk),
                                     cmocka_unit_test(test_full_disk_keeps_the_set_long),
                                     cmocka_unit_test(test_full_output)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
