/* SPDX-License-Identifier: MIT
 * Encoders and networks against PyTorch, stage by stage, each from PyTorch's own input of that stage. Tolerances are
 * those of the material: features 3e-5 absolute, sigma 1e-4 relative, everything else 1e-4 absolute. */
#include "../support.h"

#include <math.h>

#include "core/memory.h"
#include "hashgrid/hashgrid.h"
#include "io/npy.h"
#include "io/safetensors.h"
#include "mlp/activation_ops.h"
#include "mlp/audio_ops.h"
#include "mlp/encoding_ops.h"
#include "mlp/mlp_tile.h"

enum { POINTS = 512, LEVELS = 12, ROWS = 3 * LEVELS, CODE = 32, WIDTH = 29, LENGTH = 16 };

struct fixture {
  ern_context *context;
  struct ern_tensor_file file;
};

static void fixture_open(struct fixture *fixture) {
  char path[1024];
  support_shared("parity/head_torso.safetensors", path);
  fixture->context = support_context();
  if (ern_safetensors_read(fixture->context, path, &fixture->file) != ERN_OK) {
    fail_msg("%s", ern_last_error(fixture->context));
  }
}

static void fixture_close(struct fixture *fixture) {
  ern_tensor_file_free(fixture->context, &fixture->file);
  ern_context_free(&fixture->context);
}

/* stage_NAME.npy, which must have `count` values. The caller frees. */
static float *stage(ern_context *context, const char *name, size_t count) {
  char file[128], path[1024];
  snprintf(file, sizeof file, "parity/stage_%s.npy", name);
  support_shared(file, path);
  struct ern_npy array = {0};
  if (ern_npy_read(context, path, &array) != ERN_OK) fail_msg("%s", ern_last_error(context));
  assert_int_equal(array.count, count);
  float *values = malloc(count * sizeof *values);
  assert_non_null(values);
  memcpy(values, array.data, count * sizeof *values);
  ern_npy_free(context, &array);
  return values;
}

/* [rows][columns] -> [columns][rows] */
static float *turned(float *values, size_t rows, size_t columns) {
  float *out = malloc(rows * columns * sizeof *out);
  assert_non_null(out);
  for (size_t r = 0; r < rows; r++) {
    for (size_t c = 0; c < columns; c++) out[c * rows + r] = values[r * columns + c];
  }
  free(values);
  return out;
}

static float *stage_rows(ern_context *context, const char *name, size_t rows) {
  return turned(stage(context, name, rows * POINTS), POINTS, rows);
}

/* Copies a tensor of `count` values to block + at; returns the place behind it. */
static size_t place(const struct fixture *fixture, float *block, size_t at, const char *name, size_t count) {
  const struct ern_tensor *tensor = ern_tensor_file_find(&fixture->file, name);
  if (tensor == NULL) fail_msg("there is no %s", name);
  assert_int_equal(tensor->count, count);
  assert_int_equal(ern_tensor_to_float(fixture->context, tensor, block + at), ERN_OK);
  return at + count;
}

static void expect_near(const char *what, const float *found, const float *expected, size_t count, double absolute,
                        double relative) {
  double worst = 0;
  for (size_t i = 0; i < count; i++) {
    const double excess = fabs((double)found[i] - expected[i]) / (absolute + relative * fabs((double)expected[i]));
    if (!(excess <= 1)) fail_msg("%s [%zu]: %.9g, PyTorch %.9g", what, i, found[i], expected[i]);
    if (excess > worst) worst = excess;
  }
  print_message("%s: worst error %.3f of the tolerance\n", what, worst);
}

static void test_features(void **state) {
  (void)state;
  struct fixture fixture;
  fixture_open(&fixture);
  float *x = stage_rows(fixture.context, "points_x", 3), *expected = stage_rows(fixture.context, "features", ROWS);
  const struct ern_grid_shape shape = {.dims = 2,
                                       .levels = LEVELS,
                                       .features = 1,
                                       .base = 64,
                                       .finest = 512,
                                       .table_limit = 1 << 14,
                                       .hashed = true,
                                       .bound = 1};
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, &shape), ERN_OK);
  float *table = malloc(grid.entries * sizeof *table), *f = malloc(ROWS * POINTS * sizeof *f);
  assert_true(table != NULL && f != NULL);
  static const char *const name[3] = {"encoder_xy.embeddings", "encoder_yz.embeddings", "encoder_xz.embeddings"};
  static const size_t axis[3][2] = {{0, 1}, {1, 2}, {0, 2}};
  for (size_t plane = 0; plane < 3; plane++) {
    place(&fixture, table, 0, name[plane], grid.entries);
    const float *const coordinates[ERN_GRID_MAX_DIMS] = {x + axis[plane][0] * POINTS, x + axis[plane][1] * POINTS};
    ern_grid_fwd_ref(f + plane * LEVELS * POINTS, POINTS, coordinates, table, &grid, 0, LEVELS, POINTS);
  }
  expect_near("features", f, expected, (size_t)ROWS * POINTS, 3e-5, 0);
  free(x), free(expected), free(table), free(f);
  fixture_close(&fixture);
}

static void test_audio_code(void **state) {
  (void)state;
  struct fixture fixture;
  fixture_open(&fixture);
  float *turned_windows = stage(fixture.context, "audio_window", ERN_AUDIO_WINDOWS * WIDTH * LENGTH);
  float windows[ERN_AUDIO_WINDOWS * LENGTH * WIDTH];
  for (size_t w = 0; w < ERN_AUDIO_WINDOWS; w++) {
    for (size_t c = 0; c < WIDTH; c++) {
      for (size_t t = 0; t < LENGTH; t++) {
        windows[(w * LENGTH + t) * WIDTH + c] = turned_windows[(w * WIDTH + c) * LENGTH + t];
      }
    }
  }
  float *block = malloc(100000 * sizeof *block);
  assert_non_null(block);
  struct ern_audio_net net = {.width = WIDTH, .window_length = LENGTH, .code = CODE};
  static const size_t conv[ERN_AUDIO_CONVS + 1] = {WIDTH, 32, 32, 64, 64};
  static const size_t att[ERN_AUDIO_ATT_CONVS + 1] = {CODE, 16, 8, 4, 2, 1};
  size_t at = 0;
  char name[128];
  for (size_t l = 0; l < ERN_AUDIO_CONVS; l++) {
    net.conv_weight[l] = at;
    snprintf(name, sizeof name, "audio_net.encoder_conv.%zu.weight", 2 * l);
    net.conv_bias[l] = at = place(&fixture, block, at, name, conv[l + 1] * conv[l] * 3);
    snprintf(name, sizeof name, "audio_net.encoder_conv.%zu.bias", 2 * l);
    at = place(&fixture, block, at, name, conv[l + 1]);
  }
  for (size_t l = 0; l < 2; l++) {
    const size_t outs = l == 0 ? 64 : CODE;
    net.fc_weight[l] = at;
    snprintf(name, sizeof name, "audio_net.encoder_fc1.%zu.weight", 2 * l);
    net.fc_bias[l] = at = place(&fixture, block, at, name, outs * 64);
    snprintf(name, sizeof name, "audio_net.encoder_fc1.%zu.bias", 2 * l);
    at = place(&fixture, block, at, name, outs);
  }
  for (size_t l = 0; l < ERN_AUDIO_ATT_CONVS; l++) {
    net.att_conv_weight[l] = at;
    snprintf(name, sizeof name, "audio_att_net.attentionConvNet.%zu.weight", 2 * l);
    net.att_conv_bias[l] = at = place(&fixture, block, at, name, att[l + 1] * att[l] * 3);
    snprintf(name, sizeof name, "audio_att_net.attentionConvNet.%zu.bias", 2 * l);
    at = place(&fixture, block, at, name, att[l + 1]);
  }
  net.att_fc_weight = at;
  net.att_fc_bias = at = place(&fixture, block, at, "audio_att_net.attentionNet.0.weight", 64);
  place(&fixture, block, at, "audio_att_net.attentionNet.0.bias", 8);

  float code[CODE], *expected = stage(fixture.context, "audio_code", CODE);
  ern_audio_fwd_ref(code, windows, block, &net);
  expect_near("audio code", code, expected, CODE, 1e-4, 0);
  free(turned_windows), free(block), free(expected);
  fixture_close(&fixture);
}

static void test_sh(void **state) {
  (void)state;
  struct fixture fixture;
  fixture_open(&fixture);
  float *d = stage_rows(fixture.context, "points_dir", 3), *expected = stage_rows(fixture.context, "sh", 16);
  float *y = malloc(16 * POINTS * sizeof *y);
  assert_non_null(y);
  ern_sh_fwd_ref(y, POINTS, d, POINTS, POINTS);
  expect_near("sh", y, expected, 16 * POINTS, 1e-4, 0);
  free(d), free(expected), free(y);
  fixture_close(&fixture);
}

/* y = NET(pieces); widths end with 0. */
static void network(const struct fixture *fixture, float *y, const struct ern_rows_view *x, int pieces,
                    const char *name, const int *width) {
  struct ern_mlp mlp = {.layers = 0};
  float *block = malloc(100000 * sizeof *block);
  assert_non_null(block);
  size_t at = 0;
  mlp.width[0] = width[0];
  for (int l = 0; width[l + 1] != 0; l++) {
    char tensor[128];
    snprintf(tensor, sizeof tensor, "%s.net.%d.weight", name, l);
    mlp.weight[l] = at;
    mlp.width[l + 1] = width[l + 1];
    at = place(fixture, block, at, tensor, (size_t)width[l] * (size_t)width[l + 1]);
    mlp.layers = l + 1;
  }
  float *scratch = NULL;
  assert_int_equal(ERN_NEW(fixture->context, ern_mlp_scratch(&mlp), &scratch), ERN_OK);
  ern_mlp_fwd_ref(y, POINTS, x, pieces, NULL, block, &mlp, POINTS, scratch);
  ern_release(fixture->context, scratch);
  free(block);
}

/* The head field behind the encoders, from PyTorch's features, code and harmonics. */
static void test_head(void **state) {
  (void)state;
  struct fixture fixture;
  fixture_open(&fixture);
  ern_context *context = fixture.context;
  float *f = stage_rows(context, "features", ROWS), *code = stage(context, "audio_code", CODE);
  float *eye = stage(context, "eye", 1), *sh = stage_rows(context, "sh", 16);
  static float attention[CODE * POINTS], norm[POINTS], look[POINTS], mixed[(CODE + 1) * POINTS], h[65 * POINTS];
  static float sigma[POINTS], rgb[3 * POINTS], uncertainty[POINTS];
  const struct ern_rows_view features = {f, POINTS, ROWS, ERN_PER_SAMPLE};

  network(&fixture, attention, &features, 1, "aud_ch_att_net", (const int[]){ROWS, 64, CODE, 0});
  network(&fixture, look, &features, 1, "eye_att_net", (const int[]){ROWS, 16, 1, 0});
  ern_activate_fwd_ref(look, look, ERN_ACT_SIGMOID, POINTS);
  for (size_t i = 0; i < POINTS; i++) {
    float sum = 0;
    for (size_t a = 0; a < CODE; a++) {
      sum += attention[a * POINTS + i] * attention[a * POINTS + i];
      mixed[a * POINTS + i] = attention[a * POINTS + i] * code[a];
    }
    norm[i] = sqrtf(sum);
    mixed[CODE * POINTS + i] = look[i] * eye[0];
  }
  const struct ern_rows_view density[2] = {features, {mixed, POINTS, CODE + 1, ERN_PER_SAMPLE}};
  network(&fixture, h, density, 2, "sigma_net", (const int[]){ROWS + CODE + 1, 64, 64, 65, 0});
  ern_activate_fwd_ref(sigma, h, ERN_ACT_DENSITY, POINTS);

  float individual[40000];
  place(&fixture, individual, 0, "individual_codes", 40000);
  const struct ern_rows_view colour[3] = {
      {sh, POINTS, 16, ERN_PER_SAMPLE}, {h + POINTS, POINTS, 64, ERN_PER_SAMPLE}, {individual, 1, 4, ERN_PER_BATCH}};
  network(&fixture, rgb, colour, 3, "color_net", (const int[]){84, 64, 3, 0});
  ern_activate_fwd_ref(rgb, rgb, ERN_ACT_COLOUR, 3 * POINTS);
  network(&fixture, uncertainty, &features, 1, "unc_net", (const int[]){ROWS, 32, 1, 0});
  ern_activate_fwd_ref(uncertainty, uncertainty, ERN_ACT_SOFTPLUS, POINTS);

  struct {
    const char *name;
    const float *found;
    size_t rows;
    double absolute, relative;
  } const expected[] = {{"audio_attention_norm", norm, 1, 1e-4, 0},
                        {"eye_attention", look, 1, 1e-4, 0},
                        {"sigma", sigma, 1, 0, 1e-4},
                        {"geo", h + POINTS, 64, 1e-4, 0},
                        {"rgb", rgb, 3, 1e-4, 0},
                        {"uncertainty", uncertainty, 1, 1e-4, 0}};
  for (size_t k = 0; k < sizeof expected / sizeof *expected; k++) {
    float *values = stage_rows(context, expected[k].name, expected[k].rows);
    expect_near(expected[k].name, expected[k].found, values, expected[k].rows * POINTS, expected[k].absolute,
                expected[k].relative);
    free(values);
  }
  free(f), free(code), free(eye), free(sh);
  fixture_close(&fixture);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_features),
      cmocka_unit_test(test_audio_code),
      cmocka_unit_test(test_sh),
      cmocka_unit_test(test_head),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
