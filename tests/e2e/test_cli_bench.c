/* SPDX-License-Identifier: MIT
 * `ernerf bench`: its object, its table, its refusals. The figures themselves are not checked. */
#include "cli.h"

#include <math.h>

static struct cli cli;

static double number(const json_t *object, const char *key) {
  const json_t *value = json_object_get(object, key);
  if (!json_is_number(value)) fail_msg("%s is no number", key);
  return json_number_value(value);
}
static void positive(const json_t *object, const char *key) {
  const double value = number(object, key);
  if (!(isfinite(value) && value > 0)) fail_msg("%s is %g, expected above 0", key, value);
}

static void check_timing(const json_t *object) {
  const json_t *seconds = json_object_get(object, "seconds");
  positive(seconds, "least");
  positive(seconds, "repeats");
  assert_true(number(seconds, "median") >= number(seconds, "least"));
}

/* The last of several is the device. */
static void check_passes(const json_t *passes, size_t count) {
  size_t index;
  json_t *pass;
  assert_int_equal(json_array_size(passes), count);
  json_array_foreach(passes, index, pass) {
    static const char *const keys[] = {"rays",  "marched",       "evaluated",        "colours", "samples_per_second",
                                       "flops", "flops_written", "flops_per_second", "share",   "per_second"};
    check_timing(pass);
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++) positive(pass, keys[i]);
    assert_true(json_object_size(json_object_get(pass, "stages")) >= 4);
    if (index == 0) assert_int_equal(json_integer_value(json_object_get(pass, "threads")), 2);
    if (count > 1) positive(pass, "times_cpu");
    assert_true(json_is_boolean(json_object_get(pass, "fused")));
  }
}

static void test_object(void **state) {
  (void)state;
  size_t index;
  json_t *kernel;
  cli_run(&cli, "bench --isa auto --size 32x32 --rays 64 --frames 2 --seconds 0.2 --threads 2 --seed 3 --quiet --json");
  cli_expect(&cli, 0, NULL);
  json_t *object = cli_json(&cli, NULL);
  assert_true(json_is_string(json_object_get(object, "cpu")));
  const json_t *scene = json_object_get(object, "scene"), *peaks = json_object_get(object, "peaks");
  assert_true(json_is_null(json_object_get(scene, "model")));
  assert_true(number(scene, "width") == 32 && number(scene, "pixels") == 32 * 32);
  positive(scene, "marched");
  positive(scene, "lit");
  assert_true(number(scene, "sample_flops") > number(scene, "folded_flops"));
  positive(json_object_get(peaks, "stream_memory"), "one");
  assert_int_equal(json_array_size(json_object_get(peaks, "isas")), 1);
  positive(json_object_get(json_array_get(json_object_get(peaks, "isas"), 0), "flops"), "all");
  const json_t *kernels = json_object_get(object, "kernels");
  assert_true(json_array_size(kernels) > 40);
  json_array_foreach(kernels, index, kernel) {
    check_timing(kernel);
    positive(kernel, "items_per_second");
    assert_true(json_is_string(json_object_get(kernel, "name")));
    assert_true(json_is_null(json_object_get(kernel, "share")) || number(kernel, "share") > 0);
  }
  check_passes(json_object_get(object, "frame"), 1);
  check_passes(json_object_get(json_object_get(object, "step"), "head"), 1);
  check_passes(json_object_get(json_object_get(object, "step"), "torso"), 1);
  json_decref(object);
}

static void test_parts_long(void **state) {
  (void)state;
  support_clear("part.json");
  cli_run(&cli, "bench --isa ref --only frame --size 24x24 --seconds 0 --threads 2 --json part.json");
  cli_expect_out(&cli, 0, "peaks", "a frame, ref, 2 threads", "stage by stage", "march", "made-up", NULL);
  assert_null(strstr(cli.out, "a step"));
  json_t *object = cli_json(&cli, "part.json");
  assert_int_equal(json_array_size(json_object_get(object, "kernels")), 0);
  assert_true(json_is_null(json_object_get(json_object_get(object, "step"), "head")));
  const json_t *frames = json_object_get(object, "frame");
  assert_int_equal(json_array_size(frames), 1);
  json_decref(object);
  cli_run(&cli, "bench --isa auto --only peaks --seconds 0 --size 8x8");
  cli_expect_out(&cli, 0, "multiply-adds", "random reads", "stream inside L2", NULL);
  assert_null(strstr(cli.out, "kernels"));
  assert_null(strstr(cli.err, "%")); /* progress is for terminals */
}

/* A head without the branches that a clip may not call for is measured as it is. */
static void test_model_long(void **state) {
  (void)state;
  char clip[1024];
  snprintf(clip, sizeof clip, "%s/data/tiny", getenv("ERNERF_SOURCE"));
  support_clear("m.safetensors");
  support_clear("m.run");
  cli_run(&cli, "train %s -o m.safetensors --iters 1 --rays 64 --effects codes,torso --quiet", clip);
  cli_expect(&cli, 0, NULL);
  support_clear("model.json");
  cli_run(&cli, "bench m.safetensors %s --isa auto --only step --rays 64 --seconds 0 --threads 2 --json model.json",
          clip);
  cli_expect_out(&cli, 0, "m.safetensors on a frame of", "a step of the head", NULL);
  assert_null(strstr(cli.out, "a step of the torso")); /* it has none */
  json_t *object = cli_json(&cli, "model.json");
  check_passes(json_object_get(json_object_get(object, "step"), "head"), 1);
  assert_true(json_is_string(json_object_get(json_object_get(object, "scene"), "clip")));
  json_decref(object);
  cli_run(&cli, "bench m.safetensors %s --isa auto --only kernels --seconds 0", clip);
  cli_expect_out(&cli, 0, "density_mlp_bwd", "composite_fwd", NULL);
  assert_null(strstr(cli.out, "torso_mlp"));
  cli_run(&cli, "bench none.safetensors %s", clip);
  cli_expect(&cli, 1, "none.safetensors", NULL);
}

#if defined(ERN_OPENCL)
/* Values of the key in the objects of a list, of which `count` are `value`. */
static void check_count(const json_t *list, const char *key, const char *value, size_t count) {
  size_t index, found = 0;
  json_t *object;
  json_array_foreach(list, index, object) {
    const char *text = json_string_value(json_object_get(object, key));
    found += text != NULL && strcmp(text, value) == 0;
  }
  assert_int_equal(found, count);
}

static void check_device_kernels(const json_t *kernels) {
  size_t index;
  json_t *kernel;
  const size_t count = json_array_size(kernels);
  assert_true(count > 2 * 30);
  check_count(kernels, "backend", "opencl", count / 2); /* each on both, side by side */
  json_array_foreach(kernels, index, kernel) {
    const json_t *other = json_array_get(kernels, index ^ 1);
    assert_string_equal(json_string_value(json_object_get(kernel, "name")),
                        json_string_value(json_object_get(other, "name")));
    assert_true(number(kernel, "items") == number(other, "items")); /* the same work */
    check_timing(kernel);
    positive(kernel, "times_cpu");
  }
}

/* The CPU and a device in one run. The model and the size of its step are those of test_cli_opencl_faults, so that the
 * device's kernels are built once for both. */
static void test_device_long(void **state) {
  (void)state;
  char clip[1024];
  snprintf(clip, sizeof clip, "%s/data/tiny", getenv("ERNERF_SOURCE"));
  support_clear("d.safetensors");
  support_clear("d.run");
  support_clear("device.json");
  cli_run(&cli, "train %s -o d.safetensors --iters 1 --rays 64 --levels 4 --seed 3 --quiet", clip);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "bench d.safetensors %s --backend all --device 0 --rays 64 --frames 1 --seconds 0 --threads 2 --json "
          "device.json",
          clip);
  cli_expect_out(&cli, 0, "OpenCL device 0: ", "multiply-adds, opencl", "opencl, stream in memory", "density_mlp_bwd",
                 "a frame, opencl, ", "of the peak of the device", "a step of the head, opencl, ", NULL);
  json_t *object = cli_json(&cli, "device.json");
  assert_true(json_is_string(json_object_get(object, "cpu")));
  assert_int_equal(json_integer_value(json_object_get(json_object_get(object, "device"), "number")), 0);
  const json_t *peaks = json_object_get(object, "peaks"), *devices = json_object_get(peaks, "devices");
  assert_int_equal(json_array_size(json_object_get(peaks, "isas")), 1);
  assert_int_equal(json_array_size(devices), 1);
  positive(json_array_get(devices, 0), "units");
  positive(json_object_get(json_array_get(devices, 0), "flops"), "all");
  positive(json_object_get(json_array_get(devices, 0), "stream_memory"), "all");
  check_device_kernels(json_object_get(object, "kernels"));
  check_passes(json_object_get(object, "frame"), 2);
  check_passes(json_object_get(json_object_get(object, "step"), "head"), 2);
  check_count(json_object_get(object, "frame"), "backend", "opencl", 1);
  json_decref(object);
}

static void test_device_alone(void **state) {
  (void)state;
  support_clear("alone.json");
  cli_run(&cli, "bench --backend opencl --only peaks --seconds 0 --size 8x8 --json alone.json");
  cli_expect_out(&cli, 0, "OpenCL device 0: ", "random reads, opencl", NULL);
  assert_null(strstr(cli.out, "stream inside L2")); /* the CPU's */
  json_t *object = cli_json(&cli, "alone.json");
  assert_true(json_is_null(json_object_get(object, "cpu")));
  assert_int_equal(json_array_size(json_object_get(json_object_get(object, "peaks"), "isas")), 0);
  json_decref(object);
}

static void test_no_device(void **state) {
  (void)state;
  cli_run(&cli, "bench --backend opencl --device 200 --only peaks");
  cli_expect(&cli, 1, "ernerf bench: ", "no device 200", "info devices", NULL);
  assert_int_equal(setenv("OCL_ICD_VENDORS", "nothing-here", 1), 0);
  cli_run(&cli, "bench --backend all --only peaks");
  cli_expect(&cli, 1, "ernerf bench: ", "no driver is installed", NULL);
  assert_string_equal(cli.out, "");
  unsetenv("OCL_ICD_VENDORS");
}
#else
static void test_without(void **state) {
  (void)state;
  cli_run(&cli, "bench --backend opencl --only peaks");
  cli_expect(&cli, 1, "this build is without OpenCL", NULL);
  assert_string_equal(cli.out, "");
}
#endif

static void test_refused(void **state) {
  (void)state;
  cli_run(&cli, "bench --isa sse9");
  cli_expect(&cli, 1, "sse9", "expected one that this machine has", NULL);
  cli_run(&cli, "bench --isa ref,ref");
  cli_expect(&cli, 1, "ref twice", NULL);
  cli_run(&cli, "bench --json nowhere/x.json");
  cli_expect(&cli, 1, "nowhere/x.json", "folder", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_object),
    cmocka_unit_test(test_parts_long),
    cmocka_unit_test(test_model_long),
#if defined(ERN_OPENCL)
    cmocka_unit_test(test_device_alone),
    cmocka_unit_test(test_no_device),
    cmocka_unit_test(test_device_long),
#else
    cmocka_unit_test(test_without),
#endif
    cmocka_unit_test(test_refused)
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
