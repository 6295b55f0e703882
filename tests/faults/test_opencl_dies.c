/* SPDX-License-Identifier: MIT
 * OpenCL drivers that end the process, or never answer: this one goes on, and says what happened. And what the log says
 * of a device that works. */
#include <sys/stat.h>
#include <unistd.h>

#include "made_clip.h"

static void keep_warning(void *user, ern_log_level level, const char *line) {
  if (level == ERN_LOG_WARNING) snprintf(user, 1024, "%s", line);
}

static ern_context *listening_context(char warning[1024]) {
  ern_context *context = NULL;
  ern_context_config config = ern_context_config_default();
  config.log = keep_warning;
  config.user = warning;
  warning[0] = 0;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  return context;
}

struct listed {
  int cpus, devices;
  char version[256]; /* of the first device */
};

static void count_device(void *user, const ern_device_info *device) {
  struct listed *listed = user;
  const bool cpu = strcmp(device->kind, "cpu") == 0;
  if (!cpu && listed->devices == 0) snprintf(listed->version, sizeof listed->version, "%s", device->version);
  *(cpu ? &listed->cpus : &listed->devices) += 1;
}

static void expect_words(const char *warning, const char *words) {
  if (strstr(warning, words) == NULL) fail_msg("the warning \"%s\" does not say \"%s\"", warning, words);
}

/* A list of devices and a backend, both without the device, and why: `words`, then the driver's own. */
static void expect_death(const char *words, const char *said) {
  char warning[1024];
  struct listed listed = {0};
  ern_backend *backend = NULL;
  ern_backend_config config = ern_backend_config_default();
  ern_context *context = listening_context(warning);
  config.name = "opencl";
  support_ok(context, ern_devices_list(context, count_device, &listed));
  assert_int_equal(listed.cpus, 1);
  assert_int_equal(listed.devices, 0);
  expect_words(warning, words);
  expect_words(warning, said);
  support_expect(context, ern_backend_create(&backend, context, &config), ERN_E_DEVICE, words, said, NULL);
  assert_null(backend);
  ern_context_free(&context);
}

static void begin_death(const char *how) {
  char place[1024];
  assert_non_null(getenv("ERNERF_DIES"));
  mkdir("vendors", 0777);
  assert_non_null(getcwd(place, sizeof place - 16));
  strcat(place, "/vendors/");
  support_write_text("vendors/dies.icd", getenv("ERNERF_DIES"));
  setenv("OCL_ICD_VENDORS", place, 1);
  setenv("ERNERF_TEST_DEATH", how, 1);
}

static void test_abort(void **state) {
  (void)state;
  begin_death("abort");
  expect_death("no device can be used: the drivers were loaded in a child process, which ended by SIGABRT",
               "it said: \"Not enough memory to run on this device\"");
}

static void test_exit(void **state) {
  (void)state;
  begin_death("exit");
  expect_death("in a child process, which ended with status 3", "Not enough memory to run on this device");
}

static void test_hang(void **state) {
  (void)state;
  begin_death("hang");
  setenv("ERNERF_PROBE_SECONDS", "1", 1);
  expect_death("in a child process, which did not answer for 1 seconds", "Not enough memory to run on this device");
  unsetenv("ERNERF_PROBE_SECONDS");
}

/* From here on with the machine's own drivers. */
static void test_without_linker(void **state) {
  (void)state;
  char warning[1024], *path = strdup(getenv("PATH"));
  struct listed listed = {0};
  unsetenv("OCL_ICD_VENDORS");
  ern_context *context = listening_context(warning);
  support_ok(context, ern_devices_list(context, count_device, &listed));
  assert_string_equal(warning, ""); /* nothing is wrong with it */
  ern_context_free(&context);
  if (listed.devices != 1 || strstr(listed.version, "PoCL") == NULL) {
    free(path);
    skip(); /* PoCL is the driver that needs one */
  }
  setenv("PATH", "/nonexistent", 1);
  expect_death("device 0 (", "linking");
  setenv("PATH", path, 1);
  free(path);
}

/* Without the program that tries devices they are used all the same, and a warning says so. */
static void test_without_program(void **state) {
  (void)state;
  char warning[1024], *program = strdup(getenv("ERNERF_PROBE_OPENCL"));
  struct listed listed = {0};
  ern_context *context = listening_context(warning);
  setenv("ERNERF_PROBE_OPENCL", "/nonexistent", 1);
  support_ok(context, ern_devices_list(context, count_device, &listed));
  assert_int_equal(listed.cpus, 1);
  expect_words(warning, "devices are used untried, as the program ernerf/ernerf-probe-opencl is missing");
  support_write_text("no-program", "#!/nonexistent\n");
  chmod("no-program", 0700);
  setenv("ERNERF_PROBE_OPENCL", "./no-program", 1);
  support_ok(context, ern_devices_list(context, count_device, &listed));
  expect_words(warning, "devices are used untried, as ./no-program cannot be started");
  setenv("ERNERF_PROBE_OPENCL", program, 1);
  free(program);
  ern_context_free(&context);
}

/* A device has no threads of its own: who asks for some is told. */
static void test_threads(void **state) {
  (void)state;
  char warning[1024];
  struct made clip;
  ern_trainer *trainer = NULL;
  ern_model *model = NULL;
  ern_renderer *renderer = NULL;
  ern_backend *device = NULL;
  ern_backend_config config = ern_backend_config_default();
  ern_render_options options = ern_render_options_default();
  made_open(&clip);
  const ern_train_config train_config = small_config(1, NULL);
  support_ok(clip.context, ern_trainer_create(&trainer, clip.backend, &clip.data, &train_config));
  support_ok(clip.context, ern_trainer_model(trainer, &model));
  ern_trainer_free(&trainer);
  ern_context *context = listening_context(warning);
  config.name = "opencl";
  const ern_status made = ern_backend_create(&device, context, &config);
  if (made == ERN_OK) {
    support_ok(context, ern_renderer_create(&renderer, device, model, &options));
    assert_string_equal(warning, "");
    ern_renderer_free(&renderer);
    options.threads = 2;
    support_ok(context, ern_renderer_create(&renderer, device, model, &options));
    expect_words(warning, "threads is 2, which the backend opencl has no use for");
    ern_renderer_free(&renderer);
  }
  ern_backend_free(&device);
  ern_context_free(&context);
  ern_model_free(&model);
  made_close(&clip);
  if (made == ERN_E_UNSUPPORTED) skip(); /* no device */
  assert_int_equal(made, ERN_OK);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_abort),
                                     cmocka_unit_test(test_exit),
                                     cmocka_unit_test(test_hang),
                                     cmocka_unit_test(test_without_linker),
                                     cmocka_unit_test(test_without_program),
                                     cmocka_unit_test(test_threads)};
  return getenv("ERNERF_DIES") != NULL ? cmocka_run_group_tests(tests, NULL, NULL) : 0;
}
