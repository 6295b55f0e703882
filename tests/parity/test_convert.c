/* SPDX-License-Identifier: MIT
 * Converted models: what the public program expects is written, what it cannot hold is refused, and .pth to
 * .safetensors and back changes no bit. */
#include <math.h>

#include "core/memory.h"
#include "model/checkpoint.h"
#include "model/model.h"
#include "model/torso_ops.h"
#include "render/render_ops.h"
#include "support.h"

static char said[4096];

static void keep_line(void *user, ern_log_level level, const char *line) {
  (void)user;
  (void)level;
  snprintf(said + strlen(said), sizeof said - strlen(said), "%s\n", line);
}

static ern_context *listening_context(void) {
  ern_context *context = NULL;
  ern_context_config config = ern_context_config_default();
  config.log = keep_line;
  said[0] = 0;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  return context;
}

static void same_tensors(const struct ern_tensor_file *a, const struct ern_tensor_file *b) {
  assert_int_equal(a->tensor_count, b->tensor_count);
  for (size_t i = 0; i < a->tensor_count; i++) {
    const struct ern_tensor *left = &a->tensors[i], *right = ern_tensor_file_find(b, left->name);
    if (right == NULL) fail_msg("%s is lost", left->name);
    assert_int_equal(left->dtype, right->dtype);
    assert_int_equal(left->dims, right->dims);
    assert_memory_equal(left->shape, right->shape, sizeof left->shape);
    if (left->count > 0) assert_memory_equal(left->data, right->data, left->count * ern_dtype_bytes(left->dtype));
  }
}

static void test_round_trip(void **state) {
  (void)state;
  static const char *const names[] = {"parity/head.pth", "parity/head_torso.pth", "parity/full/head_full.pth",
                                      "real/audnet.pt", "real/track_params.pt"};
  support_needs_shared();
  ern_context *context = support_context();
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    char path[1024];
    struct ern_tensor_file first = {0}, middle = {0}, last = {0};
    support_shared(names[i], path);
    support_ok(context, ern_file_convert(context, path, "a.safetensors"));
    support_ok(context, ern_file_convert(context, "a.safetensors", "b.pth"));
    support_ok(context, ern_checkpoint_read(context, path, &first));
    support_ok(context, ern_checkpoint_read(context, "a.safetensors", &middle));
    same_tensors(&first, &middle);
    support_ok(context, ern_file_convert(context, "b.pth", "c.safetensors"));
    support_ok(context, ern_checkpoint_read(context, "c.safetensors", &last));
    for (size_t t = 0; t < first.tensor_count; t++) /* floats came back as tensors beside them */
      assert_non_null(ern_tensor_file_find(&last, first.tensors[t].name));
    ern_tensor_file_free(context, &first);
    ern_tensor_file_free(context, &middle);
    ern_tensor_file_free(context, &last);
  }
  ern_context_free(&context);
}

static void test_full(void **state) {
  (void)state;
  char path[1024];
  support_needs_shared();
  ern_context *context = support_context();
  struct ern_tensor_file file = {0};
  support_shared("parity/full/head_full.pth", path);
  support_ok(context, ern_checkpoint_read(context, path, &file));
  size_t moments = 0, averages = 0;
  for (size_t t = 0; t < file.tensor_count; t++) {
    const char *name = file.tensors[t].name;
    const bool moment = strncmp(name, "state.moment.", 13) == 0, average = strncmp(name, "state.average.", 14) == 0;
    moments += moment;
    averages += average;
    if (!moment && !average) continue;
    const struct ern_tensor *of = ern_tensor_file_find(&file, name + (moment ? 13 : 14));
    assert_non_null(of);
    assert_int_equal(of->count, file.tensors[t].count);
    const float *values = of->data, *state_values = file.tensors[t].data;
    for (size_t i = 0; i < of->count; i += 97) {
      if (moment) assert_true(state_values[i] >= 0);
      /* how the file was made: parity/torch/full.py */
      if (average) assert_true(fabsf(state_values[i] - 0.999f * values[i]) <= 1e-6f * fabsf(values[i]));
    }
  }
  assert_int_equal(moments, 39);
  assert_int_equal(averages, 39);
  assert_non_null(strstr(ern_tensor_file_metadata(&file, "ernerf.state"), "\"step\":2,\"ema_updates\":1"));
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

/* ---- made-up models ---------------------------------------------------------------------------------------------- */

static ern_model *make_model(ern_context *context, struct ern_model_config config) {
  ern_model *model = NULL;
  config.head = true;
  config.feature_width = 29;
  config.window_length = 16;
  config.bound = 1;
  support_ok(context, ern_model_make(&model, context, &config));
  ern_parameters_init(model->block, &model->table, false, 1);
  if (config.torso) ern_parameters_init(model->block, &model->table, true, 1);
  for (size_t i = 0; i < ERN_OCCUPANCY_BYTES; i += 3) model->bits[i] = (uint8_t)i;
  return model;
}

static void convert_model(ern_context *context, const ern_model *model, struct ern_tensor_file *file) {
  support_ok(context, ern_model_save(model, "m.safetensors"));
  support_ok(context, ern_file_convert(context, "m.safetensors", "m.pth"));
  support_ok(context, ern_checkpoint_read(context, "m.pth", file));
}

static void expect_shape(const struct ern_tensor_file *file, const char *name, size_t first, size_t second) {
  const struct ern_tensor *tensor = ern_tensor_file_find(file, name);
  if (tensor == NULL) fail_msg("%s is missing", name);
  assert_int_equal(tensor->shape[0], first);
  assert_int_equal(tensor->shape[1], second);
}

/* A clip without blinks, few frames: padded codes, an eye branch of zeros, a column of zeros; bits as a grid. */
static void test_padded(void **state) {
  (void)state;
  ern_context *context = listening_context();
  ern_model *model = make_model(context, (struct ern_model_config){.levels = 12, .codes = 5, .torso = true}),
            *back = NULL;
  struct ern_tensor_file file;
  convert_model(context, model, &file);
  expect_shape(&file, "individual_codes", 10000, 4);
  expect_shape(&file, "individual_codes_torso", 10000, 8);
  expect_shape(&file, "sigma_net.net.0.weight", 64, 69);
  expect_shape(&file, "eye_att_net.net.0.weight", 16, 36);
  expect_shape(&file, "eye_att_net.net.1.weight", 1, 16);
  expect_shape(&file, "density_grid", 1, ERN_OCCUPANCY_CELLS);
  expect_shape(&file, "step_counter", 16, 2);
  assert_int_equal(ern_tensor_file_find(&file, "step_counter")->dtype, ERN_I32);
  const float *column = ern_tensor_file_find(&file, "sigma_net.net.0.weight")->data,
              *grid = ern_tensor_file_find(&file, "density_grid")->data,
              *weights = model->block + ern_parameters_find(&model->table, "sigma_net.net.0.weight")->at;
  for (size_t r = 0; r < 64; r++) {
    assert_memory_equal(column + 69 * r, weights + 68 * r, 68 * sizeof(float));
    assert_true(column[69 * r + 68] == 0);
  }
  for (size_t i = 0; i < ERN_OCCUPANCY_CELLS; i++)
    assert_true(grid[i] == ((model->bits[i / 8] >> (i % 8) & 1) != 0 ? 20.0f : 0.0f));
  assert_non_null(strstr(said, "eye branch"));
  ern_tensor_file_free(context, &file);
  support_ok(context, ern_model_load(&back, context, "m.pth"));
  assert_memory_equal(back->bits, model->bits, ERN_OCCUPANCY_BYTES);
  assert_int_equal(back->field.config.codes, 10000);
  assert_true(back->field.config.eye);
  ern_model_free(&back);
  ern_model_free(&model);
  ern_context_free(&context);
}

static void test_messages(void **state) {
  (void)state;
  ern_context *context = listening_context();
  struct ern_tensor_file file;
  ern_model *model = make_model(context, (struct ern_model_config){.levels = 14, .codes = 10001, .eye = true});
  convert_model(context, model, &file);
  expect_shape(&file, "individual_codes", 10001, 4);
  expect_shape(&file, "encoder_xy.embeddings", 191896, 1);
  assert_non_null(strstr(said, "num_levels"));
  assert_non_null(strstr(said, "--ind_num 10001"));
  ern_tensor_file_free(context, &file);
  ern_model_free(&model);
  model = make_model(context, (struct ern_model_config){.levels = 12, .codes = 4, .torso = true, .torso_gamma = true});
  support_ok(context, ern_model_save(model, "m.safetensors"));
  support_clear("g.pth");
  support_expect(context, ern_file_convert(context, "m.safetensors", "g.pth"), ERN_E_UNSUPPORTED, "torso_gamma", NULL);
  assert_null(fopen("g.pth", "rb"));
  ern_model_free(&model);
  support_expect(context, ern_file_convert(context, "m.safetensors", "m.zip"), ERN_E_ARGUMENT, "m.zip", ".pth", NULL);
  support_expect(context, ern_file_convert(context, "nowhere.pth", "m.pth"), ERN_E_MISSING, "nowhere.pth", NULL);
  ern_context_free(&context);
}

/* ---- camera refinement ------------------------------------------------------------------------------------------- */

static void test_camera(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_model *model = make_model(context, (struct ern_model_config){.levels = 12, .codes = 2, .eye = true}),
            *back = NULL;
  support_ok(context, ERN_NEW(context, 12, &model->camera));
  model->cameras = 2;
  const float values[12] = {0, 0, 0, 90, 0, 0, 0, 0, 0, 1, 2, 3};
  memcpy(model->camera, values, sizeof values);
  struct ern_tensor_file file;
  convert_model(context, model, &file);
  expect_shape(&file, "camera_dR", 2, 3);
  ern_tensor_file_free(context, &file);
  support_ok(context, ern_model_load(&back, context, "m.pth"));
  assert_int_equal(back->cameras, 2);
  const float unit[16] = {1, 0, 0, 0.5f, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  float pose[16];
  memcpy(pose, unit, sizeof pose);
  ern_model_refine(back, 0, pose);
  for (int i = 0; i < 16; i++) assert_true(fabsf(pose[i] - unit[i]) < 1e-6f);
  memcpy(pose, unit, sizeof pose);
  ern_model_refine(back, 1, pose); /* transpose of a quarter turn about x, and the move */
  const float turned[16] = {1, 0, 0, 1.5f, 0, 0, 1, 2, 0, -1, 0, 3, 0, 0, 0, 1};
  for (int i = 0; i < 16; i++) assert_true(fabsf(pose[i] - turned[i]) < 1e-6f);
  ern_model_free(&back);
  ern_model_free(&model);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_round_trip), cmocka_unit_test(test_full),
                                     cmocka_unit_test(test_padded), cmocka_unit_test(test_messages),
                                     cmocka_unit_test(test_camera)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
