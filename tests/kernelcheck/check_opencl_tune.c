/* SPDX-License-Identifier: MIT
 * The tuner of an OpenCL device: what it keeps in the cache folder, which of it is trusted, that it is bounded in time,
 * and that results do not depend on it. */
#include "machines.h"

#include <unistd.h>

#include "backend_opencl/backend_opencl.h"
#include "backend_opencl/device/buffer.h"
#include "backend_opencl/device/cache.h"
#include "backend_opencl/device/tune.h"
#include "backend_opencl/device/tune_workloads.h"
#include "core/memory.h"
#include "io/file.h"

static ern_context *context;
static struct ern_cl_device device;
static int number;

/* Sizes that no measurement would choose. */
static const int odd_size[2][ERN_CL_TUNABLE_COUNT] = {
    {[ERN_CL_SIZE_mlp_fwd] = 24,
     [ERN_CL_SIZE_mlp_bwd] = 24,
     [ERN_CL_SIZE_grid_fwd] = 8,
     [ERN_CL_SIZE_grid_bwd] = 16,
     [ERN_CL_SIZE_rays_tile] = 7,
     [ERN_CL_SIZE_rays_groups] = 3,
     [ERN_CL_SIZE_torso_tile] = 11,
     [ERN_CL_SIZE_torso_groups] = 5},
    {[ERN_CL_SIZE_mlp_fwd] = 1,
     [ERN_CL_SIZE_mlp_bwd] = 1,
     [ERN_CL_SIZE_grid_fwd] = 1,
     [ERN_CL_SIZE_grid_bwd] = 4,
     [ERN_CL_SIZE_rays_tile] = 1,
     [ERN_CL_SIZE_rays_groups] = 3,
     [ERN_CL_SIZE_torso_tile] = 2,
     [ERN_CL_SIZE_torso_groups] = 5},
};

/* An entry by which `size` is much faster than the standard. */
static void make_entry(struct ern_cl_measured *measured, const int *size) {
  for (ern_cl_tunable tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++)
    measured[tunable] = (struct ern_cl_measured){ern_cl_standard_size(&device, tunable), size[tunable], 2000, 1000};
}

static void entry_path(char path[256]) {
  char key[ERN_CL_KEY_BYTES];
  support_ok(context, ern_cl_tune_key(context, &device, key));
  snprintf(path, 256, "cache/libernerf/%s.clbin", key);
}

static void forget_entry(void) {
  char path[256];
  entry_path(path);
  remove(path);
}

static bool is_known(void) {
  struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT];
  ern_cl_tune_read(context, &device, measured);
  return ern_cl_is_tuned(measured);
}

/* ---- entries ----------------------------------------------------------------------------------------------------- */

static void test_entry(void **state) {
  struct ern_cl_measured written[ERN_CL_TUNABLE_COUNT], read[ERN_CL_TUNABLE_COUNT];
  (void)state;
  forget_entry();
  assert_false(is_known());
  make_entry(written, odd_size[device.cpu]);
  assert_true(ern_cl_tune_write(context, &device, written));
  ern_cl_tune_read(context, &device, read);
  assert_memory_equal(read, written, sizeof read);
  assert_true(ern_cl_is_tuned(read));
  /* another driver, another form: another entry */
  struct ern_cl_device other = device;
  other.driver[0] ^= 1;
  ern_cl_tune_read(context, &other, read);
  assert_false(ern_cl_is_tuned(read));
  other = device;
  other.cpu = !other.cpu;
  ern_cl_tune_read(context, &other, read);
  assert_false(ern_cl_is_tuned(read));
  assert_string_equal(ern_last_error(context), "");
}

/* Cut, flipped or another device's file: no entry, and rewritten. */
static void test_damage(void **state) {
  struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT];
  uint8_t *bytes = NULL;
  size_t count = 0;
  char path[256];
  (void)state;
  entry_path(path);
  make_entry(measured, odd_size[device.cpu]);
  assert_true(ern_cl_tune_write(context, &device, measured));
  support_ok(context, ern_file_read(context, path, 1 << 20, &bytes, &count));
  const size_t lengths[] = {0, 1, 64, 128, count / 2, count - 1};
  for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) {
    support_write(path, (const char *)bytes, lengths[i]);
    assert_false(is_known());
  }
  for (size_t at = 0; at < count; at += 13) {
    bytes[at] ^= 4;
    support_write(path, (const char *)bytes, count);
    assert_false(is_known());
    bytes[at] ^= 4;
  }
  support_write(path, (const char *)bytes, count);
  assert_true(is_known());
  struct ern_cl_device other = device;
  other.driver[0] ^= 1;
  assert_true(ern_cl_tune_write(context, &other, measured));
  char key[ERN_CL_KEY_BYTES], foreign[256];
  support_ok(context, ern_cl_tune_key(context, &other, key));
  snprintf(foreign, sizeof foreign, "cache/libernerf/%s.clbin", key);
  assert_int_equal(rename(foreign, path), 0);
  assert_false(is_known());
  assert_true(ern_cl_tune_write(context, &device, measured));
  assert_true(is_known());
  ern_release(context, bytes);
}

/* Whole files that say what cannot be. */
static void test_nonsense(void **state) {
  struct ern_cl_measured good[ERN_CL_TUNABLE_COUNT];
  const struct ern_cl_measured bad[] = {{0, 8, 2000, 1000},   {64, 0, 2000, 1000},   {64, -8, 2000, 1000},
                                        {64, 8, -5, 1000},    {64, 8, 2000, 0},      {64, 1 << 20, 2000, 1000},
                                        {64, 12, 2000, 1000}, {64, INT32_MIN, 5, 5}, {64, 8, 2000, -1}};
  (void)state;
  make_entry(good, odd_size[device.cpu]);
  assert_int_equal(ern_cl_standard_size(&device, ERN_CL_SIZE_grid_fwd), 64);
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT];
    memcpy(measured, good, sizeof good);
    measured[ERN_CL_SIZE_grid_fwd] = bad[i];
    assert_true(ern_cl_tune_write(context, &device, measured));
    if (is_known()) fail_msg("entry %zu is believed", i);
  }
}

static struct ern_cl_backend *open_backend(bool deterministic) {
  ern_backend_config config = ern_backend_config_default();
  ern_backend *backend = NULL;
  config.name = "opencl";
  config.device = number;
  config.deterministic = deterministic;
  support_ok(context, ern_backend_create(&backend, context, &config));
  return (struct ern_cl_backend *)backend;
}
static void close_backend(struct ern_cl_backend *own) {
  ern_backend *backend = &own->table;
  ern_backend_free(&backend);
}

/* Where nothing can be kept, all goes on. */
static void test_no_folder(void **state) {
  struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT];
  (void)state;
  support_write("file", "x", 1);
  char *const before = strdup(getenv("XDG_CACHE_HOME"));
  assert_non_null(before);
  char path[4096];
  assert_non_null(getcwd(path, sizeof path - 16));
  strcat(path, "/file");
  assert_int_equal(setenv("XDG_CACHE_HOME", path, 1), 0);
  make_entry(measured, odd_size[device.cpu]);
  assert_false(ern_cl_tune_write(context, &device, measured));
  close_backend(open_backend(false));
  assert_string_equal(ern_last_error(context), "");
  assert_int_equal(setenv("XDG_CACHE_HOME", before, 1), 0);
  free(before);
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static void test_budget(void **state) {
  struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT] = {{0}};
  struct ern_cl_backend *bench = NULL;
  (void)state;
  support_ok(context, ern_cl_backend_open(context, number, false, &bench));
  support_ok(context, ern_cl_measure(bench, ~0u, 0, measured));
  support_ok(context, ern_cl_measure(bench, ~0u, 1e-6, measured));
  for (ern_cl_tunable tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++) {
    assert_true(measured[tunable].standard_ns == 0);
    assert_int_equal(bench->size[tunable], ern_cl_standard_size(&bench->device, tunable));
  }
  bench->table.free(&bench->table);
}

/* A device that takes the standard and 256 alone. */
static ern_status (*grid_fwd)(struct ern_stream *stream, struct ern_grid_fwd_args *args);
static int refusals;
static ern_status picky_grid_fwd(struct ern_stream *stream, struct ern_grid_fwd_args *args) {
  const int size = ern_cl_backend_of(stream)->size[ERN_CL_SIZE_grid_fwd];
  if (size == 64 || size == 256) return grid_fwd(stream, args);
  refusals++;
  return ern_cl_check(ern_cl_backend_of(stream), refusals % 2 ? CL_INVALID_WORK_GROUP_SIZE : CL_OUT_OF_RESOURCES,
                      "grid_fwd");
}

/* One tunable is measured, the others are not; sizes that the device does not take are passed over. */
static void test_measure(void **state) {
  const unsigned wanted = 1u << ERN_CL_SIZE_grid_fwd;
  struct ern_cl_backend *bench = NULL;
  (void)state;
  for (int refused = 0; refused < 2; refused++) {
    struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT] = {{0}};
    support_ok(context, ern_cl_backend_open(context, number, false, &bench));
    grid_fwd = bench->table.grid_fwd;
    if (refused) bench->table.grid_fwd = picky_grid_fwd;
    support_ok(context, ern_cl_measure(bench, wanted, 60, measured));
    const struct ern_cl_measured *m = &measured[ERN_CL_SIZE_grid_fwd];
    assert_true(m->standard == 64 && m->standard_ns > 0 && m->best_ns > 0 && m->best != 64 &&
                (!refused || m->best == 256));
    assert_int_equal(refusals, refused ? device.cpu ? 1 : 2 : 0);
    assert_int_equal(bench->size[ERN_CL_SIZE_grid_fwd], ern_cl_size_selected(m));
    for (ern_cl_tunable tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++)
      assert_true(tunable == ERN_CL_SIZE_grid_fwd || measured[tunable].standard_ns == 0);
    bench->table.free(&bench->table);
  }
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static float *result_of(struct ern_cl_backend *backend, struct ern_cl_workloads *loads, ern_cl_tunable tunable,
                        ern_span span) {
  float *values = malloc(span.count * sizeof *values);
  assert_non_null(values);
  support_ok(context, ern_cl_workload_prepare(loads, tunable, loads->stream));
  support_ok(context, ern_cl_workload_run(loads, tunable, loads->stream));
  support_ok(context, backend->table.download_reals(loads->stream, values, span, span.count));
  return values;
}

static ern_span output_of(const struct ern_cl_workloads *loads, ern_cl_tunable tunable) {
  switch (tunable) {
    case ERN_CL_SIZE_mlp_fwd: return loads->mlp.forward.y.span;
    case ERN_CL_SIZE_mlp_bwd: return loads->mlp.dparameters;
    case ERN_CL_SIZE_grid_fwd: return loads->grid.forward.f.span;
    case ERN_CL_SIZE_grid_bwd: return loads->grid.dtable;
    case ERN_CL_SIZE_torso_tile: return loads->torso.pixel.span;
    default: return loads->rays.pixel.span;
  }
}

/* Narrow layers, whose kernels are built in a fraction of the time. */
static void make_small(struct ern_cl_workloads *loads) {
  struct ern_field *field = &loads->field;
  loads->mlp.forward.mlp.width[0] = loads->mlp.forward.x[0].rows = loads->mlp.dx[0].rows = 8;
  for (int l = 1; l < 3; l++) loads->mlp.forward.mlp.width[l] = field->density.width[l] = 8;
  field->attention.width[1] = field->eye.width[1] = field->colour.width[1] = 8;
}

/* Sums of 8,192 products of about 1 in parts of other lengths: some roundings of 2^-24 of sums of about 100. */
static const double reordered = 1e-3;

static void test_results(void **state) {
  static const ern_cl_tunable looked_at[] = {ERN_CL_SIZE_mlp_fwd,  ERN_CL_SIZE_mlp_bwd,   ERN_CL_SIZE_grid_fwd,
                                             ERN_CL_SIZE_grid_bwd, ERN_CL_SIZE_rays_tile, ERN_CL_SIZE_torso_tile};
  struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT];
  struct ern_cl_backend *backend[2];
  struct ern_cl_workloads *loads[2];
  (void)state;
  make_entry(measured, odd_size[device.cpu]);
  for (int odd = 0; odd < 2; odd++) {
    forget_entry();
    if (odd) assert_true(ern_cl_tune_write(context, &device, measured));
    backend[odd] = open_backend(true);
    support_ok(context, ern_cl_loads_make(backend[odd], &loads[odd]));
    make_small(loads[odd]);
  }
  for (ern_cl_tunable tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++) {
    const bool used = tunable != ERN_CL_SIZE_mlp_bwd; /* whose sums would be others */
    assert_int_equal(backend[1]->size[tunable], used ? odd_size[device.cpu][tunable] : backend[0]->size[tunable]);
  }
  for (size_t i = 0; i < sizeof looked_at / sizeof *looked_at; i++) {
    const ern_cl_tunable tunable = looked_at[i];
    const ern_span span = output_of(loads[0], tunable);
    if (tunable == ERN_CL_SIZE_mlp_bwd) backend[1]->size[tunable] = odd_size[device.cpu][tunable];
    float *standard = result_of(backend[0], loads[0], tunable, span);
    float *odd = result_of(backend[1], loads[1], tunable, output_of(loads[1], tunable));
    if (tunable == ERN_CL_SIZE_mlp_bwd) {
      for (size_t k = 0; k < span.count; k++)
        if (!is_near(odd[k], standard[k], reordered, reordered))
          fail_msg("weight %zu: %g, expected %g", k, (double)odd[k], (double)standard[k]);
    } else if (memcmp(odd, standard, span.count * sizeof *odd) != 0) {
      fail_msg("tunable %d changes a result", (int)tunable);
    }
    free(standard), free(odd);
  }
  for (int k = 0; k < 2; k++) {
    ern_cl_loads_free(loads[k]);
    close_backend(backend[k]);
  }
  forget_entry();
}

/* The cache folder is the test's own; the driver's stays the build's. */
static int set_up(void **state) {
  char path[4096], driver[4096];
  const char *cache = getenv("XDG_CACHE_HOME"), *chosen = getenv("ERNERF_TEST_DEVICE");
  (void)state;
  snprintf(driver, sizeof driver, "%s/pocl", cache != NULL ? cache : "/tmp");
  if (cache != NULL && getenv("POCL_CACHE_DIR") == NULL && setenv("POCL_CACHE_DIR", driver, 1) != 0) return -1;
  if (getcwd(path, sizeof path - 16) == NULL) return -1;
  strcat(path, "/cache");
  if (setenv("XDG_CACHE_HOME", path, 1) != 0) return -1;
  number = chosen != NULL ? atoi(chosen) : 0;
  context = support_context();
  return ern_cl_device_open(context, number, &device) == ERN_OK ? 0 : -1;
}
static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_entry),    cmocka_unit_test(test_damage),
                                     cmocka_unit_test(test_nonsense), cmocka_unit_test(test_no_folder),
                                     cmocka_unit_test(test_budget),   cmocka_unit_test(test_measure),
                                     cmocka_unit_test(test_results)};
  return cmocka_run_group_tests_name("opencl tuner", tests, set_up, tear_down);
}
