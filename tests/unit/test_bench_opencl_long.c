/* SPDX-License-Identifier: MIT
 * The benchmarks on an OpenCL device beside the CPU: the same kernels with the same work, frames and steps with the
 * same samples, and memory that does not grow with the time they are given. */
#include "../support.h"

#include <math.h>
#include <stdbool.h>
#include <sys/resource.h>

#include "lab/bench/bench_shared.h"

enum { SIDE = 64, RAYS = 1024, MOST = 256 };

static ern_context *context;
static ern_backend *backends[2]; /* the best of the CPU, the device */
static ern_bench_scene *scene;
static ern_bench_machine machine;

static ern_bench_options options_of(double seconds) {
  ern_bench_options options = ern_bench_options_default();
  options.seconds = seconds;
  options.threads = 2;
  options.rays = RAYS;
  return options;
}

static int set_up(void **state) {
  (void)state;
  const ern_bench_options options = options_of(0);
  ern_backend_config config = ern_backend_config_default();
  context = support_context();
  support_ok(context, ern_backend_create(&backends[0], context, &config));
  config.name = "opencl";
  support_ok(context, ern_backend_create(&backends[1], context, &config));
  support_ok(context, ern_bench_scene_make(&scene, context, SIDE, SIDE, 1));
  support_ok(context, ern_bench_peaks(backends, 2, &options, &machine));
  return 0;
}

static int tear_down(void **state) {
  (void)state;
  ern_bench_scene_free(&scene);
  for (int k = 0; k < 2; k++) ern_backend_free(&backends[k]);
  ern_context_free(&context);
  return 0;
}

static bool is_positive(double value) { return isfinite(value) && value > 0; }

struct rows {
  ern_bench_kernel row[MOST];
  size_t count;
};
static int take_row(void *user, const ern_bench_kernel *kernel) {
  struct rows *rows = user;
  assert_true(rows->count < MOST);
  rows->row[rows->count++] = *kernel;
  return 0;
}

static void test_kernels(void **state) {
  (void)state;
  static const char *const bounds[] = {"flops", "cache", "memory", "reads", ""};
  static struct rows rows;
  const ern_bench_options options = options_of(1);
  support_ok(context, ern_bench_kernels(backends, 2, scene, &machine, &options, take_row, &rows));
  assert_true(rows.count > 2 * 40);
  for (size_t i = 0; i < rows.count; i += 2) {
    const ern_bench_kernel *cpu = &rows.row[i], *device = &rows.row[i + 1];
    size_t known = 0;
    assert_string_equal(cpu->name, device->name);
    assert_string_equal(cpu->backend, "cpu");
    assert_string_equal(device->backend, "opencl");
    assert_true(cpu->items == device->items && cpu->flops == device->flops && cpu->bytes == device->bytes &&
                cpu->reads == device->reads);
    assert_int_equal(cpu->threads, 2);
    assert_int_equal(device->threads, (int)machine.peak[1].units);
    assert_true(is_positive(device->seconds.least) && device->seconds.median >= device->seconds.least);
    assert_true(isnan(device->share) ? device->bound[0] == 0 : device->share > 0);
    for (size_t b = 0; b < sizeof bounds / sizeof *bounds; b++) known += strcmp(device->bound, bounds[b]) == 0;
    assert_int_equal(known, 1);
  }
}

static void check_device(const ern_bench_pass pass[2]) {
  assert_string_equal(pass[1].backend, "opencl");
  assert_true(is_positive(pass[1].share) && is_positive(pass[1].seconds.least));
  assert_true(pass[1].marched == pass[0].marched && pass[1].rays == pass[0].rays);
  assert_true(pass[1].stages >= 4 && pass[1].stages <= ERN_BENCH_STAGES);
  for (int k = 0; k < pass[1].stages; k++) assert_true(is_positive(pass[1].stage[k].seconds));
}

static void test_passes(void **state) {
  (void)state;
  const ern_bench_options options = options_of(1);
  ern_bench_pass pass[2];
  support_ok(context, ern_bench_frame(backends, 2, scene, &machine, &options, pass));
  check_device(pass);
  assert_true(pass[1].fused && pass[1].evaluated < pass[1].marched);
  for (int torso = 0; torso < 2; torso++) {
    support_ok(context, ern_bench_step(backends, 2, scene, &machine, &options, torso, pass));
    check_device(pass);
    assert_false(pass[1].fused); /* a device trains through the stages */
  }
}

static double most_memory(void) {
  struct rusage usage;
  assert_int_equal(getrusage(RUSAGE_SELF, &usage), 0);
  return (double)usage.ru_maxrss;
}

/* Everything has been called by the tests before, for a second: thousands of launches more need no more memory, but for
 * what the driver keeps of a queue's last commands. A launch that was kept takes a kilobyte or so. */
static void test_memory(void **state) {
  (void)state;
  static struct rows rows;
  const ern_bench_options options = options_of(20);
  ern_bench_pass pass[2];
  const double before = most_memory();
  rows.count = 0;
  support_ok(context, ern_bench_kernels(backends, 2, scene, &machine, &options, take_row, &rows));
  support_ok(context, ern_bench_frame(backends, 2, scene, &machine, &options, pass));
  support_ok(context, ern_bench_step(backends, 2, scene, &machine, &options, false, pass));
  if (most_memory() > 1.1 * before)
    fail_msg("%.0f MB grew to %.0f in a longer run", before / 1024, most_memory() / 1024);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_kernels), cmocka_unit_test(test_passes),
                                     cmocka_unit_test(test_memory)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
