/* SPDX-License-Identifier: MIT
 * `ernerf info` and `ernerf check`: what they say to people and to programs. */
#include "cli.h"

#include "io/npy.h"

static struct cli cli;

static int make_clip(void **state) {
  (void)state;
  support_clear("clip");
  support_clear("m.safetensors");
  support_clear("m.run");
  cli_run(&cli, "synth clip --size 64 --frames 11 --seed 2 --json synth.json");
  cli_expect(&cli, 0, "11/11", "clip: 11 frames of 64 x 64", NULL);
  json_t *report = cli_json(&cli, "synth.json");
  assert_int_equal(json_integer_value(json_object_get(report, "frames")), 11);
  assert_int_equal(json_integer_value(json_object_get(report, "seed")), 2);
  json_decref(report);
  cli_run(&cli, "train clip -o m.safetensors --iters 2 --rays 16 --levels 3 --effects eye,codes,view,torso --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

static const char *text_of(const json_t *object, const char *field) {
  const json_t *value = json_object_get(object, field);
  if (!json_is_string(value)) fail_msg("the field %s is missing or no string", field);
  return json_string_value(value);
}

static json_int_t count_of(const json_t *object, const char *field) {
  const json_t *value = json_object_get(object, field);
  if (!json_is_integer(value)) fail_msg("the field %s is missing or no whole number", field);
  return json_integer_value(value);
}

/* The entry of a list whose field is `value`; NULL where there is none. */
static const json_t *find(const json_t *list, const char *field, const char *value) {
  for (size_t i = 0; i < json_array_size(list); i++)
    if (strcmp(text_of(json_array_get(list, i), field), value) == 0) return json_array_get(list, i);
  return NULL;
}

static bool has_word(const json_t *list, const char *word) {
  for (size_t i = 0; i < json_array_size(list); i++)
    if (strcmp(json_string_value(json_array_get(list, i)), word) == 0) return true;
  return false;
}

/* A GPU adds up in any order; PoCL is taken for one. */
static void check_deterministic(const char *form, bool deterministic) {
  assert_int_equal(setenv("ERNERF_OPENCL_FORM", form, 1), 0);
  cli_run(&cli, "info devices");
  cli_expect_out(&cli, 0, "the same bytes on every run: ",
                 deterministic ? "run: yes" : "run: with --set deterministic=yes alone", NULL);
  cli_run(&cli, "info devices --json");
  json_t *object = cli_json(&cli, NULL);
  const json_t *list = json_object_get(object, "devices");
  assert_true(json_is_true(json_object_get(find(list, "kind", "cpu"), "deterministic")));
  assert_int_equal(json_is_true(json_object_get(find(list, "kind", "opencl"), "deterministic")), deterministic);
  json_decref(object);
  assert_int_equal(unsetenv("ERNERF_OPENCL_FORM"), 0);
}

/* ---- info ---------------------------------------------------------------------------------------------------------
 */

static void test_devices(void **state) {
  (void)state;
  cli_run(&cli, "info devices");
  cli_expect_out(&cli, 0, "cpu", "instruction sets", "ref", "backends: auto (the CPU), cpu, opencl", NULL);
  cli_run(&cli, "info devices --json");
  json_t *object = cli_json(&cli, NULL);
  const json_t *cpu = find(json_object_get(object, "devices"), "kind", "cpu");
  assert_non_null(cpu);
  assert_non_null(strstr(text_of(cpu, "instruction_sets"), "ref64"));
  assert_true(count_of(cpu, "compute_units") >= 1 && count_of(cpu, "memory_bytes") > 0);
  const json_t *device = find(json_object_get(object, "devices"), "kind", "opencl");
  if (device != NULL) {
    assert_true(count_of(device, "buffer_bytes") > 0 && count_of(device, "local_bytes") > 0);
    assert_true(strlen(text_of(device, "driver")) > 0 && json_is_boolean(json_object_get(device, "half")) &&
                json_is_boolean(json_object_get(device, "subgroups")) &&
                json_is_boolean(json_object_get(device, "tuned")));
    assert_true(json_is_boolean(json_object_get(device, "adds_floats")) &&
                json_is_boolean(json_object_get(device, "kernels_kept")));
    assert_true(json_is_false(json_object_get(device, "tensor_cores")) || strstr(text_of(device, "name"), "NVIDIA"));
    check_deterministic("gpu", false);
    check_deterministic("cpu", true);
    cli_run(&cli, "info devices --tune --device 99");
    cli_expect(&cli, 1, "no device 99", NULL);
  }
  json_decref(object);
}

/* A file of tensors whose name has control characters, which a terminal would obey; JSON has the name as it is. */
static void test_name_of_tensor(void **state) {
  (void)state;
  static const char header[] = "{\"a\\u001b[31m\\nb\":{\"dtype\":\"U8\",\"shape\":[1],\"data_offsets\":[0,1]}}";
  char file[8 + sizeof header] = {(char)(sizeof header - 1)};
  memcpy(file + 8, header, sizeof header);
  support_write("name.safetensors", file, sizeof file);
  cli_run(&cli, "info name.safetensors");
  cli_expect_out(&cli, 0, "tensors of another program", "  a [31m b  ", NULL);
  cli_run(&cli, "info name.safetensors --json");
  json_t *object = cli_json(&cli, NULL);
  assert_non_null(find(json_object_get(object, "tensors"), "name", "a\033[31m\nb"));
  json_decref(object);
}

static void test_model(void **state) {
  (void)state;
  cli_run(&cli, "info m.safetensors");
  cli_expect_out(&cli, 0, "m.safetensors: head\n", "levels           3", "29 wide", "voice            ends between",
                 "sigma_net.net.0.weight", NULL);
  cli_run(&cli, "info m.safetensors --json");
  json_t *model = cli_json(&cli, NULL);
  assert_string_equal(text_of(model, "kind"), "head");
  assert_true(count_of(model, "step") == 2 && count_of(model, "levels") == 3 && count_of(model, "feature_width") == 29);
  const json_t *effects = json_object_get(model, "effects"), *tensors = json_object_get(model, "tensors");
  assert_true(has_word(effects, "audio") && has_word(effects, "eye") && has_word(effects, "view") &&
              has_word(effects, "codes"));
  assert_false(has_word(effects, "torso"));
  const json_t *tensor = find(tensors, "name", "sigma_net.net.0.weight");
  assert_non_null(tensor);
  assert_string_equal(text_of(tensor, "dtype"), "F32");
  const json_t *shape = json_object_get(tensor, "shape");
  assert_int_equal(json_array_size(shape), 2);
  assert_int_equal(json_integer_value(json_array_get(shape, 0)), 64);
  assert_int_equal(json_integer_value(json_array_get(shape, 1)), 3 * 3 + 32 + 1);
  const json_t *fade = json_object_get(model, "voice_fade");
  assert_int_equal(json_array_size(fade), 2);
  assert_true(json_number_value(json_array_get(fade, 0)) < json_number_value(json_array_get(fade, 1)));
  const size_t tensors_of_model = json_array_size(tensors);
  char clip[65];
  snprintf(clip, sizeof clip, "%s", text_of(model, "clip"));
  assert_int_equal(strlen(clip), 64);
  json_decref(model);

  cli_run(&cli, "info m.run/state.safetensors --json");
  json_t *whole = cli_json(&cli, NULL);
  assert_string_equal(text_of(whole, "kind"), "state");
  assert_string_equal(text_of(whole, "clip"), clip);
  assert_true(count_of(whole, "step") == 2 && json_array_size(json_object_get(whole, "tensors")) > tensors_of_model);
  json_decref(whole);
}

static void test_files(void **state) {
  (void)state;
  cli_run(&cli, "info clip/aud_ds.npy --json");
  json_t *object = cli_json(&cli, NULL);
  assert_string_equal(text_of(object, "kind"), "clip features");
  assert_true(count_of(object, "windows") == 11 && count_of(object, "window_length") == 16 &&
              count_of(object, "width") == 29);
  assert_string_equal(text_of(json_array_get(json_object_get(object, "tensors"), 0), "dtype"), "F32");
  json_decref(object);
  cli_run(&cli, "info clip/transforms_train.json --json");
  object = cli_json(&cli, NULL);
  assert_string_equal(text_of(object, "kind"), "poses");
  assert_true(count_of(object, "frames") == 10 && count_of(object, "width") == 64);
  json_decref(object);

  ern_context *context = support_context();
  static const float values[6];
  support_ok(context, ern_npy_write_f32(context, "plain.npy", values, 2, (const size_t[]){2, 3}));
  ern_context_free(&context);
  cli_run(&cli, "info plain.npy");
  cli_expect_out(&cli, 0, "plain.npy: array", "[2, 3]", NULL);

  cli_run(&cli, "info clip/au.csv");
  cli_expect(&cli, 1, "clip/au.csv", "expected", ".safetensors", NULL);
  cli_run(&cli, "info clip");
  cli_expect(&cli, 1, "clip", "ernerf check", NULL);
  cli_run(&cli, "info nowhere.npy");
  cli_expect(&cli, 1, "nowhere.npy", NULL);
}

/* Files that others wrote. */
static void test_shared(void **state) {
  (void)state;
  char path[1024];
  support_shared("parity/head.safetensors", path);
  cli_run(&cli, "info '%s' --json", path);
  json_t *object = cli_json(&cli, NULL);
  assert_string_equal(text_of(object, "kind"), "head");
  assert_true(count_of(object, "levels") == 12 && count_of(object, "feature_width") == 29);
  json_decref(object);
  support_shared("parity/head_torso.safetensors", path);
  cli_run(&cli, "info '%s' --json", path);
  object = cli_json(&cli, NULL);
  assert_string_equal(text_of(object, "kind"), "head+torso");
  assert_true(has_word(json_object_get(object, "effects"), "torso"));
  json_decref(object);
  support_shared("real/poses.json", path);
  cli_run(&cli, "info '%s' --json", path);
  object = cli_json(&cli, NULL);
  assert_true(count_of(object, "frames") == 728 && count_of(object, "width") == 450);
  json_decref(object);
}

/* ---- check --------------------------------------------------------------------------------------------------------
 */

/* The mark of the finding that begins with `name`. */
static const char *mark_of(const json_t *report, const char *name) {
  const json_t *findings = json_object_get(report, "findings");
  for (size_t i = 0; i < json_array_size(findings); i++) {
    const json_t *finding = json_array_get(findings, i);
    if (strncmp(text_of(finding, "sentence"), name, strlen(name)) == 0) return text_of(finding, "mark");
  }
  fail_msg("nothing is said of %s", name);
  return "";
}

static void test_check(void **state) {
  (void)state;
  char dots[2501] = "";
  for (size_t i = 0; i + 2 < sizeof dots; i += 2) memcpy(dots + i, "./", 3);
  cli_run(&cli, "check %sclip", dots); /* a name as long as the system takes */
  cli_expect_out(&cli, 0, "ok       bc.jpg", "ok       aud.wav", NULL);
  cli_run(&cli, "check clip");
  cli_expect_out(&cli, 0, "ok ", "10 frames of 64 x 64", "aud_ds.npy", "au.csv", "torso_imgs", "ernerf train", NULL);
  /* the made-up clip has no parsing/ and no torso.npy, and nothing else is missing */
  const char *missing = strstr(cli.out, "missing ");
  assert_non_null(missing);
  assert_ptr_equal(missing, strstr(cli.out, "missing  parsing"));
  missing = strstr(missing + 1, "missing ");
  assert_non_null(missing);
  assert_ptr_equal(missing, strstr(cli.out, "missing  torso.npy"));
  assert_null(strstr(missing + 1, "missing "));
  assert_string_equal(cli.err, "");
  cli_run(&cli, "check clip --json");
  json_t *report = cli_json(&cli, NULL);
  assert_true(json_is_true(json_object_get(report, "ok")));
  assert_string_equal(mark_of(report, "au.csv"), "ok");
  json_decref(report);

  cli_copy("clip", "partial");
  remove("partial/au.csv");
  remove("partial/aud.wav");
  support_clear("partial/torso_imgs");
  support_clear("partial/ori_imgs");
  cli_run(&cli, "check partial");
  cli_expect_out(&cli, 0, "missing  au.csv", "No blinking will be learnt", "OpenFace", "missing  torso_imgs", NULL);
  cli_run(&cli, "check partial --json partial.json --quiet");
  cli_expect_out(&cli, 0, "missing", NULL);
  assert_null(strstr(cli.out, "ok ")); /* --quiet leaves what is well unsaid */
  report = cli_json(&cli, "partial.json");
  assert_true(json_is_true(json_object_get(report, "ok")));
  static const char *const names[] = {"au.csv", "aud.wav", "torso_imgs", "ori_imgs"};
  for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) assert_string_equal(mark_of(report, names[i]), "missing");
  json_decref(report);

  remove("partial/transforms_val.json");
  assert_int_equal(symlink("transforms_train.json", "partial/transforms_val.json"), 0);
  cli_run(&cli, "check partial");
  cli_expect(&cli, 0, "warning: partial/transforms_val.json: 10 of its 10 frames are in transforms_train.json too",
             NULL);
  cli_expect_out(&cli, 0, "missing  transforms_val.json: 10 of its 10 frames are in", "will learn a head", NULL);

  cli_copy("clip", "wrong");
  remove("wrong/aud_ds.npy");
  remove("wrong/aud.wav");
  remove("wrong/gt_imgs/3.jpg");
  cli_run(&cli, "check wrong --json wrong.json");
  cli_expect(&cli, 1, "ernerf check: ", "wrong", NULL);
  cli_expect_out(&cli, 1, "wrong    ", "aud_ds.npy", "gt_imgs/3.jpg", "Not ready",
                 NULL); /* all of it, not the first alone */
  report = cli_json(&cli, "wrong.json");
  assert_true(json_is_false(json_object_get(report, "ok")));
  json_decref(report);
}

static void test_tiny(void **state) {
  (void)state;
  char path[1024];
  const char *source = getenv("ERNERF_SOURCE");
  if (source == NULL) fail_msg("ERNERF_SOURCE is not set: it is the folder of the sources");
  snprintf(path, sizeof path, "%s/data/tiny", source);
  cli_run(&cli, "check '%s'", path);
  cli_expect_out(&cli, 0, "128 x 128", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_devices), cmocka_unit_test(test_name_of_tensor),
                                     cmocka_unit_test(test_model),   cmocka_unit_test(test_files),
                                     cmocka_unit_test(test_shared),  cmocka_unit_test(test_check),
                                     cmocka_unit_test(test_tiny)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
