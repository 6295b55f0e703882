/* SPDX-License-Identifier: MIT
 * What the engine's functions do with NULL, with numbers out of range and with structures that nobody initialised
 * (base.h). Rendering, training, media and the laboratory have files of their own. */
#include "arguments.h"
#include "made_clip.h"

static struct world {
  ern_context *context;
  ern_backend *backend;
  ern_model *model;
  struct made clip;
} w;

static const char *const junk = "no such file";

/* ---- base.h ------------------------------------------------------------------------------------------------------ */

CHECK(ern_status_name) { assert_string_equal(ern_status_name((ern_status)999), "ERN_E_UNKNOWN"); }
CHECK(ern_version) { assert_non_null(ern_version()); }
CHECK(ern_context_config_default) { assert_int_not_equal(ern_context_config_default().cookie, 0); }
CHECK(ern_context_config_fill) { FILLS(ern_context_config, ern_context_config_fill); }
static void must_not_log(void *user, ern_log_level level, const char *line) {
  (void)user, (void)level;
  fail_msg("a hook past the size was called: %s", line);
}
CHECK(ern_context_create) {
  ern_backend *backend = NULL;
  ern_context *made = (ern_context *)(void *)&w;
  ern_context_config config = ern_context_config_default();
  REFUSED_ALONE(ern_context_create(NULL, NULL));
  config.release = NULL;
  REFUSED_ALONE(ern_context_create(&made, &config));
  assert_null(made);
  config = (ern_context_config){0};
  REFUSED_ALONE(ern_context_create(&made, &config));
  config = ern_context_config_default();
  config.size += 8;
  assert_int_equal(ern_context_create(&made, &config), ERN_E_UNSUPPORTED);
  config.size = 4;
  REFUSED_ALONE(ern_context_create(&made, &config));
  config.size = offsetof(ern_context_config, release); /* the rest is as by default */
  config.allocate = NULL;
  config.release = NULL;
  assert_int_equal(ern_context_create(&made, &config), ERN_E_ARGUMENT);
  config = ern_context_config_default();
  config.size = offsetof(ern_context_config, log);
  config.log = must_not_log; /* past the size */
  assert_int_equal(ern_context_create(&made, &config), ERN_OK);
  support_ok(made, ern_backend_create(&backend, made, NULL)); /* which logs its choice */
  ern_backend_free(&backend);
  ern_context_free(&made);
}
CHECK(ern_context_free) {
  ern_context *none = NULL;
  ern_context_free(NULL);
  ern_context_free(&none);
}
CHECK(ern_last_error) { assert_string_equal(ern_last_error(NULL), ""); }
CHECK(ern_last_error_copy) {
  char text[4] = "abc";
  assert_int_equal(ern_last_error_copy(NULL, text, sizeof text), 0);
  assert_string_equal(text, "");
  REFUSED(w.context, "ern_model_load: path is NULL", ern_model_load(&(ern_model *){NULL}, w.context, NULL));
  const size_t length = strlen("ern_model_load: path is NULL");
  assert_int_equal(ern_last_error_copy(w.context, NULL, 0), length);
  assert_int_equal(ern_last_error_copy(w.context, text, 0), length);
  assert_string_equal(text, "");
  assert_int_equal(ern_last_error_copy(w.context, text, sizeof text), length);
  assert_string_equal(text, "ern");
}

/* ---- backend.h --------------------------------------------------------------------------------------------------- */

static void say_device(void *user, const ern_device_info *device) { (void)user, (void)device; }
static void say_tuning(void *user, const ern_tuning *tuning) { (void)user, (void)tuning; }

CHECK(ern_backend_config_default) { assert_int_not_equal(ern_backend_config_default().cookie, 0); }
CHECK(ern_backend_config_fill) { FILLS(ern_backend_config, ern_backend_config_fill); }
CHECK(ern_backend_create) {
  ern_backend *made = w.backend;
  REFUSED_ALONE(ern_backend_create(&made, NULL, NULL));
  assert_null(made);
  REFUSED(w.context, "ern_backend_create: backend is NULL", ern_backend_create(NULL, w.context, NULL));
  REFUSED(w.context, "ern_backend_config_default", ern_backend_create(&made, w.context, &(ern_backend_config){0}));
  ern_backend_config config = ern_backend_config_default();
  config.name = "opencl";
  config.device = -1;
  assert_int_equal(ern_backend_create(&made, w.context, &config), ERN_E_UNSUPPORTED);
  config.size = offsetof(ern_backend_config, name); /* of a time without the rest */
  support_ok(w.context, ern_backend_create(&made, w.context, &config));
  ern_backend_free(&made);
  config.size = sizeof config + 8;
  REFUSED_LATER(w.context, ern_backend_config, ern_backend_create(&made, w.context, &config));
}
CHECK(ern_backend_free) {
  ern_backend *none = NULL;
  ern_backend_free(NULL);
  ern_backend_free(&none);
}
CHECK(ern_backend_describe) {
  ern_backend_info info = {.real_bytes = 7};
  ern_backend_describe(NULL, &info);
  assert_int_equal(info.real_bytes, 0);
  ern_backend_describe(w.backend, NULL);
}
CHECK(ern_backend_describe_sized) {
  ern_backend_describe_sized(w.backend, NULL, sizeof(ern_backend_info));
  KEEPS_TO(ern_backend_info, ern_backend_describe_sized(w.backend, it, bytes));
  KEEPS_TO(ern_backend_info, ern_backend_describe_sized(NULL, it, bytes));
}
CHECK(ern_backend_tuning) {
  ern_backend_tuning(NULL, say_tuning, NULL);
  ern_backend_tuning(w.backend, NULL, NULL);
}
CHECK(ern_devices_list) {
  REFUSED_ALONE(ern_devices_list(NULL, say_device, NULL));
  REFUSED(w.context, "ern_devices_list: say is NULL", ern_devices_list(w.context, NULL, NULL));
}

/* ---- data.h ------------------------------------------------------------------------------------------------------ */

/* A loader of a structure that owns memory, and its free function. */
#define CHECK_LOADER(load, release, type)                                       \
  do {                                                                          \
    type loaded;                                                                \
    memset(&loaded, 1, sizeof loaded);                                          \
    REFUSED_ALONE(load(NULL, junk, &loaded));                                   \
    assert_memory_equal(&loaded, &(type){0}, sizeof loaded);                    \
    memset(&loaded, 1, sizeof loaded);                                          \
    REFUSED(w.context, #load ": path is NULL", load(w.context, NULL, &loaded)); \
    assert_memory_equal(&loaded, &(type){0}, sizeof loaded);                    \
    memset(&loaded, 1, sizeof loaded);                                          \
    assert_int_equal(load(w.context, junk, &loaded), ERN_E_MISSING);            \
    assert_memory_equal(&loaded, &(type){0}, sizeof loaded);                    \
    REFUSED(w.context, "is NULL", load(w.context, junk, NULL));                 \
    release(NULL, &loaded);                                                     \
    release(w.context, NULL);                                                   \
    release(w.context, &loaded);                                                \
  } while (0)

CHECK(ern_features_load) { CHECK_LOADER(ern_features_load, ern_features_free, ern_features); }
CHECK(ern_features_save) {
  float value = 1;
  ern_features features = {&value, 1, 1, 1};
  REFUSED_ALONE(ern_features_save(NULL, "a.npy", &features));
  REFUSED(w.context, "path is NULL", ern_features_save(w.context, NULL, &features));
  REFUSED(w.context, "features is NULL", ern_features_save(w.context, "a.npy", NULL));
  value = NAN; /* what could not be read again */
  support_expect(w.context, ern_features_save(w.context, "a.npy", &features), ERN_E_NONFINITE, "a.npy: value [0, 0, 0]",
                 NULL);
  value = -2e30f;
  support_expect(w.context, ern_features_save(w.context, "a.npy", &features), ERN_E_FORMAT, "a.npy: value [0, 0, 0]",
                 NULL);
  assert_int_equal(access("a.npy", F_OK), -1);
  features.data = NULL;
  REFUSED(w.context, "data NULL", ern_features_save(w.context, "a.npy", &features));
}
CHECK(ern_features_free) {
  float value = 1;
  ern_features features = {&value, 1, 1, 1};
  ern_features_free(NULL, &features);
  assert_ptr_equal(features.data, &value);
}
CHECK(ern_eyes_load) { CHECK_LOADER(ern_eyes_load, ern_eyes_free, ern_eyes); }
CHECK(ern_eyes_free) {
  float value = 1;
  ern_eyes eyes = {&value, 1};
  ern_eyes_free(NULL, &eyes);
  assert_ptr_equal(eyes.data, &value);
}
CHECK(ern_pose_list_load) { CHECK_LOADER(ern_pose_list_load, ern_pose_list_free, ern_pose_list); }
CHECK(ern_pose_list_free) {
  ern_pose pose;
  ern_pose_list list = {.count = 1, .poses = &pose};
  ern_pose_list_free(NULL, &list);
  assert_ptr_equal(list.poses, &pose);
}
CHECK(ern_file_check_output) {
  REFUSED_ALONE(ern_file_check_output(NULL, junk));
  REFUSED(w.context, "ern_file_check_output: path is NULL", ern_file_check_output(w.context, NULL));
}
CHECK(ern_file_save) {
  REFUSED_ALONE(ern_file_save(NULL, "saved", "x", 1));
  REFUSED(w.context, "ern_file_save: path is NULL", ern_file_save(w.context, NULL, "x", 1));
  REFUSED(w.context, "ern_file_save: bytes is NULL", ern_file_save(w.context, "saved", NULL, 1));
  support_ok(w.context, ern_file_save(w.context, "saved", NULL, 0));
}

CHECK(ern_files_save) {
  const char *const paths[] = {"saved", NULL};
  const void *const bytes[] = {"x", NULL};
  const size_t sizes[] = {1, 1};
  REFUSED_ALONE(ern_files_save(NULL, 1, paths, bytes, sizes));
  REFUSED(w.context, "ern_files_save: paths is NULL", ern_files_save(w.context, 1, NULL, bytes, sizes));
  REFUSED(w.context, "ern_files_save: bytes is NULL", ern_files_save(w.context, 1, paths, NULL, sizes));
  REFUSED(w.context, "ern_files_save: sizes is NULL", ern_files_save(w.context, 1, paths, bytes, NULL));
  REFUSED(w.context, "ern_files_save: paths[i] is NULL", ern_files_save(w.context, 2, paths, bytes, sizes));
  support_ok(w.context, ern_files_save(w.context, 0, NULL, NULL, NULL));
}

/* ---- model.h ----------------------------------------------------------------------------------------------------- */

static void say_tensor(void *user, const ern_tensor_info *tensor) { (void)user, (void)tensor; }

CHECK(ern_backbone_name) {
  assert_null(ern_backbone_name((ern_backbone)-1));
  assert_null(ern_backbone_name((ern_backbone)99));
}
CHECK(ern_attention_name) { assert_null(ern_attention_name((ern_attention)99)); }
CHECK(ern_audio_pad_name) { assert_null(ern_audio_pad_name((ern_audio_pad)99)); }
CHECK(ern_eye_attention_name) { assert_null(ern_eye_attention_name((ern_eye_attention)99)); }
CHECK(ern_model_load) {
  ern_model *made = w.model;
  REFUSED_ALONE(ern_model_load(&made, NULL, junk));
  assert_null(made);
  made = w.model;
  REFUSED(w.context, "ern_model_load: path is NULL", ern_model_load(&made, w.context, NULL));
  assert_null(made);
  REFUSED(w.context, "ern_model_load: model is NULL", ern_model_load(NULL, w.context, junk));
}
CHECK(ern_model_free) {
  ern_model *none = NULL;
  ern_model_free(NULL);
  ern_model_free(&none);
}
CHECK(ern_model_save) {
  REFUSED_ALONE(ern_model_save(NULL, junk));
  REFUSED(w.context, "ern_model_save: path is NULL", ern_model_save(w.model, NULL));
  REFUSED(w.context, "x.pth: expected a name that ends in .safetensors", ern_model_save(w.model, "x.pth"));
}
CHECK(ern_model_describe) {
  ern_model_info info = {.levels = 7};
  ern_model_describe(NULL, &info);
  assert_int_equal(info.levels, 0);
  ern_model_describe(w.model, NULL);
}
CHECK(ern_model_describe_sized) {
  ern_model_describe_sized(w.model, NULL, sizeof(ern_model_info));
  KEEPS_TO(ern_model_info, ern_model_describe_sized(w.model, it, bytes));
}
CHECK(ern_file_tensors) {
  REFUSED_ALONE(ern_file_tensors(NULL, junk, say_tensor, NULL));
  REFUSED(w.context, "ern_file_tensors: path is NULL", ern_file_tensors(w.context, NULL, say_tensor, NULL));
  REFUSED(w.context, "ern_file_tensors: say is NULL", ern_file_tensors(w.context, junk, NULL, NULL));
}
CHECK(ern_file_sha256) {
  char hex[65];
  REFUSED_ALONE(ern_file_sha256(NULL, junk, hex));
  REFUSED(w.context, "ern_file_sha256: path is NULL", ern_file_sha256(w.context, NULL, hex));
  REFUSED(w.context, "ern_file_sha256: hex is NULL", ern_file_sha256(w.context, junk, NULL));
}
CHECK(ern_model_refine) {
  float pose[16] = {3};
  ern_model_refine(NULL, 0, pose);
  ern_model_refine(w.model, 0, NULL);
  ern_model_refine(w.model, SIZE_MAX, pose);
  assert_true(pose[0] == 3);
}
CHECK(ern_model_refine_unseen) {
  const int64_t frame = 3;
  float pose[16] = {3};
  ern_model_refine_unseen(NULL, &frame, 1, 4, pose);
  ern_model_refine_unseen(w.model, NULL, 1, 4, pose);
  ern_model_refine_unseen(w.model, &frame, 1, 4, NULL);
  ern_model_refine_unseen(w.model, &frame, 0, INT64_MIN, pose);
  assert_true(pose[0] == 3);
}
CHECK(ern_file_convert) {
  REFUSED_ALONE(ern_file_convert(NULL, junk, "a.pth"));
  REFUSED(w.context, "ern_file_convert: in is NULL", ern_file_convert(w.context, NULL, "a.pth"));
  REFUSED(w.context, "ern_file_convert: out is NULL", ern_file_convert(w.context, junk, NULL));
}

/* ---- setting.h --------------------------------------------------------------------------------------------------- */

CHECK(ern_setting_read) {
  ern_train_config config = ern_train_config_default();
  assert_false(ern_setting_read(NULL, "1", &config));
  assert_false(ern_setting_read(ern_train_setting(6), NULL, &config));
  assert_false(ern_setting_read(ern_train_setting(6), "1", NULL));
}
CHECK(ern_setting_write) {
  const ern_train_config config = ern_train_config_default();
  char text[ERN_SETTING_TEXT_BYTES] = "x";
  ern_setting_write(NULL, &config, text);
  ern_setting_write(ern_train_setting(6), NULL, text);
  ern_setting_write(ern_train_setting(6), &config, NULL);
  assert_string_equal(text, "x");
}
CHECK(ern_setting_expected) {
  char text[8] = "x";
  ern_setting_expected(NULL, text, sizeof text);
  ern_setting_expected(ern_train_setting(6), NULL, 8);
  ern_setting_expected(ern_train_setting(6), text, 0);
  assert_string_equal(text, "x");
}

/* ------------------------------------------------------------------------------------------------------------------ */

static const struct arguments_check table[] = {ROW(ern_status_name),
                                               ROW(ern_version),
                                               ROW(ern_context_config_default),
                                               ROW(ern_context_config_fill),
                                               ROW(ern_context_create),
                                               ROW(ern_context_free),
                                               ROW(ern_last_error),
                                               ROW(ern_last_error_copy),
                                               ROW(ern_backend_config_default),
                                               ROW(ern_backend_config_fill),
                                               ROW(ern_backend_create),
                                               ROW(ern_backend_free),
                                               ROW(ern_backend_describe),
                                               ROW(ern_backend_describe_sized),
                                               ROW(ern_backend_tuning),
                                               ROW(ern_devices_list),
                                               ROW(ern_features_load),
                                               ROW(ern_features_save),
                                               ROW(ern_features_free),
                                               ROW(ern_eyes_load),
                                               ROW(ern_eyes_free),
                                               ROW(ern_pose_list_load),
                                               ROW(ern_pose_list_free),
                                               ROW(ern_file_check_output),
                                               ROW(ern_file_save),
                                               ROW(ern_files_save),
                                               ROW(ern_audio_pad_name),
                                               ROW(ern_backbone_name),
                                               ROW(ern_attention_name),
                                               ROW(ern_eye_attention_name),
                                               ROW(ern_model_load),
                                               ROW(ern_model_free),
                                               ROW(ern_model_save),
                                               ROW(ern_model_describe),
                                               ROW(ern_model_describe_sized),
                                               ROW(ern_file_tensors),
                                               ROW(ern_file_sha256),
                                               ROW(ern_model_refine),
                                               ROW(ern_model_refine_unseen),
                                               ROW(ern_file_convert),
                                               ROW(ern_setting_read),
                                               ROW(ern_setting_write),
                                               ROW(ern_setting_expected)};
enum { CHECKS = sizeof table / sizeof *table };

/* All headers but those of the other files, so that a new one is missed here first. */
static void test_every_function_has_a_check(void **state) {
  (void)state;
  char path[1024];
  size_t found = 0;
  snprintf(path, sizeof path, "%s/include/ernerf", getenv("ERNERF_SOURCE"));
  DIR *folder = opendir(path);
  assert_non_null(folder);
  for (struct dirent *entry = readdir(folder); entry != NULL; entry = readdir(folder)) {
    const char *const name = entry->d_name;
    if (strstr(name, ".h") == NULL || strcmp(name, "train.h") == 0 || strcmp(name, "render.h") == 0 ||
        strcmp(name, "media.h") == 0 || strcmp(name, "speech.h") == 0 || strcmp(name, "live.h") == 0 ||
        strcmp(name, "stream.h") == 0 || strcmp(name, "prepare.h") == 0)
      continue;
    char header[300];
    snprintf(header, sizeof header, "include/ernerf/%s", name);
    found += arguments_cover(header, table, CHECKS);
  }
  closedir(folder);
  assert_int_equal(found, CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  ern_trainer *trainer = NULL;
  made_open(&w.clip);
  w.context = w.clip.context;
  w.backend = w.clip.backend;
  const ern_train_config config = small_config(1, NULL);
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &w.clip.data, &config));
  support_ok(w.context, ern_trainer_model(trainer, &w.model));
  ern_trainer_free(&trainer);
  arguments_run(table, CHECKS);
  ern_model_free(&w.model);
  made_close(&w.clip);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
