/* SPDX-License-Identifier: MIT
 * Rays, marching, occupancy, attention and torso against PyTorch. Sample counts have to be the same to the last one;
 * values of a stage within 1e-4 absolute, the tolerance of the material. */
#include "../support.h"

#include <jansson.h>
#include <math.h>

#include "core/memory.h"
#include "ernerf/data.h"
#include "hashgrid/hashgrid.h"
#include "io/npy.h"
#include "io/safetensors.h"
#include "mlp/activation_ops.h"
#include "mlp/encoding_ops.h"
#include "mlp/mlp_tile.h"
#include "model/attention_ops.h"
#include "model/torso_ops.h"
#include "render/march_ops.h"
#include "render/occupancy_ops.h"

enum {
  SIDE = 128,
  PIXELS = SIDE * SIDE,
  STEPS = 16,
  POINTS = 512,
  RECORDED = 20,
  RECORDED_RAYS = 1024,
  ROWS = 36,
  CODE = 32
};

static const struct ern_march_settings settings = {1, STEPS, 1 / 256.0f, 0.05f};

/* ---- material ---- */

static void *need(size_t count, size_t bytes) {
  void *memory = calloc(count, bytes);
  assert_non_null(memory);
  return memory;
}

static void open_model(ern_context *context, const char *name, struct ern_tensor_file *file) {
  char path[1024];
  support_shared(name, path);
  if (ern_safetensors_read(context, path, file) != ERN_OK) fail_msg("%s", ern_last_error(context));
}

static const struct ern_tensor *tensor(const struct ern_tensor_file *file, const char *name, size_t count) {
  const struct ern_tensor *found = ern_tensor_file_find(file, name);
  if (found == NULL) fail_msg("there is no %s", name);
  assert_int_equal(found->count, count);
  return found;
}

static struct ern_npy array(ern_context *context, const char *name, ern_npy_type type, size_t count) {
  char path[1024];
  struct ern_npy read = {0};
  support_shared(name, path);
  if (ern_npy_read(context, path, &read) != ERN_OK) fail_msg("%s", ern_last_error(context));
  assert_int_equal(read.type, type);
  assert_int_equal(read.count, count);
  return read;
}

/* stage_NAME.npy [POINTS][rows], turned to [rows][POINTS]. The caller frees. */
static float *stage_rows(ern_context *context, const char *name, size_t rows) {
  char path[128];
  snprintf(path, sizeof path, "parity/stage_%s.npy", name);
  struct ern_npy read = array(context, path, ERN_NPY_F32, rows * POINTS);
  float *values = need(read.count, sizeof *values);
  for (size_t i = 0; i < POINTS; i++) {
    for (size_t row = 0; row < rows; row++) values[row * POINTS + i] = ((const float *)read.data)[i * rows + row];
  }
  ern_npy_free(context, &read);
  return values;
}

static struct ern_pose_list open_poses(ern_context *context, const char *split) {
  char name[128], path[1024];
  struct ern_pose_list list = {0};
  snprintf(name, sizeof name, "parity/clip/transforms_%s.json", split);
  support_shared(name, path);
  if (ern_pose_list_load(context, path, &list) != ERN_OK) fail_msg("%s", ern_last_error(context));
  assert_int_equal(list.width, SIDE);
  assert_int_equal(list.height, SIDE);
  return list;
}

/* docs/formats.md, transform_matrix: rows 1, 2, 0 of the file's matrix; columns 1 and 2 negated; the translation
 * times 4. */
static struct ern_view view_of(const struct ern_pose_list *list, size_t frame) {
  struct ern_view view = {{0}, (float)list->focal, (float)list->cx, (float)list->cy, list->width, list->height};
  const float *m = list->poses[frame].matrix;
  for (int row = 0; row < 3; row++) {
    const float *from = m + 4 * ((row + 1) % 3);
    view.pose[4 * row] = from[0];
    view.pose[4 * row + 1] = -from[1];
    view.pose[4 * row + 2] = -from[2];
    view.pose[4 * row + 3] = from[3] * 4;
  }
  view.pose[15] = 1;
  return view;
}

static void expect_near(const char *what, const float *found, const float *expected, size_t count) {
  double worst = 0;
  for (size_t i = 0; i < count; i++) {
    const double error = fabs((double)found[i] - expected[i]);
    if (!(error <= 1e-4)) fail_msg("%s [%zu]: %.9g, PyTorch %.9g", what, i, found[i], expected[i]);
    if (error > worst) worst = error;
  }
  print_message("%s: worst error %.2e\n", what, worst);
}

/* ---- marching ---- */

struct marched {
  float t[PIXELS * STEPS], dir[3 * PIXELS];
  int32_t pixel[PIXELS], count[PIXELS];
};

/* Rays of the pixels already in `marched`; returns the number of samples. */
static size_t march(struct marched *marched, const struct ern_view *view, const uint8_t *bits, const float *jitter,
                    size_t n) {
  const float origin[3] = {view->pose[3], view->pose[7], view->pose[11]};
  ern_rays_ref(marched->dir, PIXELS, marched->pixel, view, n);
  ern_march_ref(marched->t, marched->count, marched->dir, PIXELS, jitter, bits, origin, &settings, n);
  size_t total = 0;
  for (size_t r = 0; r < n; r++) total += (size_t)marched->count[r];
  return total;
}

/* Whole validation frames. The totals and sums of the samples' depths are those of the march of ernerf_torch.py under
 * NumPy; PyTorch's picture of the opacity may show light only where a ray has samples. */
static void test_validation_frames(void **state) {
  (void)state;
  static const struct {
    size_t samples;
    double depth;
  } expected[3] = {{51003, 144579.9151890278}, {50994, 145013.4892308712}, {50928, 145473.29183888435}};
  support_needs_shared();
  ern_context *context = support_context();
  struct ern_tensor_file file;
  open_model(context, "parity/head.safetensors", &file);
  struct ern_pose_list poses = open_poses(context, "val");
  const uint8_t *bits = tensor(&file, "density_bitfield", ERN_OCCUPANCY_BYTES)->data;
  struct marched *marched = need(1, sizeof *marched);
  for (size_t frame = 0; frame < 3; frame++) {
    const struct ern_view view = view_of(&poses, frame);
    const float origin[3] = {view.pose[3], view.pose[7], view.pose[11]};
    for (size_t i = 0; i < PIXELS; i++) marched->pixel[i] = (int32_t)i;
    const size_t total = march(marched, &view, bits, NULL, PIXELS);
    assert_int_equal(total, expected[frame].samples);

    int32_t *first = need(PIXELS + 1, sizeof *first), *ray = need(total, sizeof *ray);
    float *x = need(3 * total, sizeof *x), *dt = need(total, sizeof *dt), *depth = need(total, sizeof *depth);
    for (size_t r = 0; r < PIXELS; r++) first[r + 1] = first[r] + marched->count[r];
    ern_samples_ref(x, total, dt, depth, ray, marched->t, first, marched->dir, PIXELS, origin, &settings, 0, PIXELS);
    double sum = 0;
    for (size_t i = 0; i < total; i++) sum += (double)depth[i];
    assert_true(fabs(sum - expected[frame].depth) < 1e-6 * expected[frame].depth);

    char name[64];
    snprintf(name, sizeof name, "parity/val%zu_weights_sum.npy", frame);
    struct ern_npy opacity = array(context, name, ERN_NPY_F32, PIXELS);
    size_t lit = 0;
    for (size_t r = 0; r < PIXELS; r++) {
      const float value = ((const float *)opacity.data)[r];
      if (value > 0) lit++;
      assert_true((marched->count[r] > 0) == (value > 0));
    }
    assert_true(lit > PIXELS / 10 && lit < PIXELS);
    ern_npy_free(context, &opacity);
    free(first), free(ray), free(x), free(dt), free(depth);
  }
  free(marched);
  ern_pose_list_free(context, &poses);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

/* report.json: 3,399 samples for the rays of grad_pixels.npy in training frame 1. */
static void test_gradient_frame(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  struct ern_tensor_file file;
  open_model(context, "parity/head_torso.safetensors", &file);
  struct ern_pose_list poses = open_poses(context, "train");
  struct ern_npy pixels = array(context, "parity/grad_pixels.npy", ERN_NPY_I64, RECORDED_RAYS);
  struct marched *marched = need(1, sizeof *marched);
  for (size_t r = 0; r < RECORDED_RAYS; r++) marched->pixel[r] = (int32_t)((const int64_t *)pixels.data)[r];
  const struct ern_view view = view_of(&poses, 1);
  const uint8_t *bits = tensor(&file, "density_bitfield", ERN_OCCUPANCY_BYTES)->data;
  assert_int_equal(march(marched, &view, bits, NULL, RECORDED_RAYS), 3399);
  free(marched);
  ern_npy_free(context, &pixels);
  ern_pose_list_free(context, &poses);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

static json_t *open_terms(void) {
  char path[1024];
  json_error_t error;
  support_shared("parity/full/terms.json", path);
  json_t *terms = json_load_file(path, 0, &error);
  if (terms == NULL) fail_msg("%s: %s", path, error.text);
  return terms;
}

static json_int_t recorded(const json_t *terms, const char *kind, size_t step, const char *field) {
  const json_t *value = json_object_get(json_array_get(json_object_get(terms, kind), step), field);
  assert_true(json_is_integer(value));
  return json_integer_value(value);
}

/* The 20 recorded steps, with their start jitters. */
static void test_recorded_steps(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  struct ern_tensor_file file;
  open_model(context, "parity/head_torso.safetensors", &file);
  struct ern_pose_list poses = open_poses(context, "train");
  json_t *terms = open_terms();
  struct ern_npy frames = array(context, "parity/full/head_frames.npy", ERN_NPY_I64, RECORDED);
  struct ern_npy pixels = array(context, "parity/full/head_pixels.npy", ERN_NPY_I64, RECORDED * RECORDED_RAYS);
  struct ern_npy noise = array(context, "parity/full/head_noise.npy", ERN_NPY_F32, RECORDED * RECORDED_RAYS);
  const uint8_t *bits = tensor(&file, "density_bitfield", ERN_OCCUPANCY_BYTES)->data;
  struct marched *marched = need(1, sizeof *marched);
  for (size_t step = 0; step < RECORDED; step++) {
    const struct ern_view view = view_of(&poses, (size_t)((const int64_t *)frames.data)[step]);
    const int64_t *pixel = (const int64_t *)pixels.data + step * RECORDED_RAYS;
    for (size_t r = 0; r < RECORDED_RAYS; r++) marched->pixel[r] = (int32_t)pixel[r];
    const float *jitter = (const float *)noise.data + step * RECORDED_RAYS;
    assert_int_equal(march(marched, &view, bits, jitter, RECORDED_RAYS), recorded(terms, "head", step, "samples"));
  }
  free(marched);
  ern_npy_free(context, &frames), ern_npy_free(context, &pixels), ern_npy_free(context, &noise);
  json_decref(terms);
  ern_pose_list_free(context, &poses);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

/* The bits follow from the grid. PyTorch's mean is a sum in float, so a cell within 1e-5 of the threshold may differ.
 */
static void test_occupancy_bits(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  struct ern_tensor_file file;
  open_model(context, "parity/head_torso.safetensors", &file);
  const float *grid = tensor(&file, "density_grid", ERN_OCCUPANCY_CELLS)->data;
  const uint8_t *expected = tensor(&file, "density_bitfield", ERN_OCCUPANCY_BYTES)->data;
  double mean = 0;
  for (size_t cell = 0; cell < ERN_OCCUPANCY_CELLS; cell++) mean += grid[cell] > 0 ? grid[cell] : 0.0;
  mean /= ERN_OCCUPANCY_CELLS;
  const float threshold = mean < 10 ? (float)mean : 10.0f;
  uint8_t *bits = need(ERN_OCCUPANCY_BYTES, 1);
  ern_occupancy_pack_ref(bits, grid, threshold, 0, ERN_OCCUPANCY_BYTES);
  size_t occupied = 0;
  for (size_t cell = 0; cell < ERN_OCCUPANCY_CELLS; cell++) {
    const int bit = bits[cell / 8] >> (cell % 8) & 1;
    occupied += (size_t)bit;
    if (fabsf(grid[cell] - threshold) > 1e-5f * threshold) assert_int_equal(bit, expected[cell / 8] >> (cell % 8) & 1);
  }
  assert_true(occupied > 1000 && occupied < ERN_OCCUPANCY_CELLS / 2);
  free(bits);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

/* ---- networks around attention and torso ---- */

/* y = NET(pieces); widths end with 0. */
static void network(ern_context *context, const struct ern_tensor_file *file, float *y, const struct ern_rows_view *x,
                    int pieces, const char *name, const int *width) {
  struct ern_mlp mlp = {.layers = 0, .width = {width[0]}};
  float *block = need(20000, sizeof *block);
  size_t at = 0;
  for (int l = 0; width[l + 1] != 0; l++) {
    char weight[128];
    snprintf(weight, sizeof weight, "%s.net.%d.weight", name, l);
    const struct ern_tensor *found = tensor(file, weight, (size_t)width[l] * (size_t)width[l + 1]);
    assert_true(at + found->count <= 20000);
    memcpy(block + at, found->data, found->count * sizeof *block);
    mlp.weight[l] = at;
    mlp.width[l + 1] = width[l + 1];
    mlp.layers = l + 1;
    at += found->count;
  }
  float *scratch = NULL;
  assert_int_equal(ERN_NEW(context, ern_mlp_scratch(&mlp), &scratch), ERN_OK);
  ern_mlp_fwd_ref(y, POINTS, x, pieces, NULL, block, &mlp, POINTS, scratch);
  ern_release(context, scratch);
  free(block);
}

static void test_attention(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  struct ern_tensor_file file;
  open_model(context, "parity/head_torso.safetensors", &file);
  float *features = stage_rows(context, "features", ROWS), *expected = stage_rows(context, "audio_attention_norm", 1);
  struct ern_npy code = array(context, "parity/stage_audio_code.npy", ERN_NPY_F32, CODE);
  struct ern_npy eye = array(context, "parity/stage_eye.npy", ERN_NPY_F32, 1);
  float *look = stage_rows(context, "eye_attention", 1), *expected_geo = stage_rows(context, "geo", 64);
  static float v[CODE * POINTS], region[CODE * POINTS], norm[POINTS], region_eye[POINTS], h[65 * POINTS];
  const struct ern_rows_view f = {features, POINTS, ROWS, ERN_PER_SAMPLE};
  network(context, &file, v, &f, 1, "aud_ch_att_net", (const int[]){ROWS, 64, CODE, 0});
  ern_attention_fwd_ref(region, norm, region_eye, v, code.data, look, *(const float *)eye.data,
                        (struct ern_attention_shape){CODE, CODE}, POINTS, POINTS);
  expect_near("audio_attention_norm", norm, expected, POINTS);
  const struct ern_rows_view density[3] = {
      f, {region, POINTS, CODE, ERN_PER_SAMPLE}, {region_eye, POINTS, 1, ERN_PER_SAMPLE}};
  network(context, &file, h, density, 3, "sigma_net", (const int[]){ROWS + CODE + 1, 64, 64, 65, 0});
  expect_near("geo", h + POINTS, expected_geo, 64 * POINTS);
  free(features), free(expected), free(look), free(expected_geo);
  ern_npy_free(context, &code), ern_npy_free(context, &eye);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

/* Pose to key points, encodings, deformation, grid, network: alpha and colour of 512 coordinates. */
static void test_torso(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  struct ern_tensor_file file;
  open_model(context, "parity/head_torso.safetensors", &file);
  float *q = stage_rows(context, "torso_xy", 2);
  float *alpha = stage_rows(context, "torso_alpha", 1), *rgb = stage_rows(context, "torso_rgb", 3);
  struct ern_npy pose = array(context, "parity/stage_torso_pose.npy", ERN_NPY_F32, 16);
  for (size_t i = 0; i < 2 * POINTS; i++) q[i] *= 0.8f;
  float k[6], k_encoded[42];
  static float q_encoded[34 * POINTS], d[2 * POINTS], x[2 * POINTS], features[32 * POINTS], layer[4 * POINTS];
  ern_torso_pose_fwd_ref(k, tensor(&file, "anchor_points", 12)->data, NULL, pose.data);
  ern_freq_fwd_ref(k_encoded, 1, k, 1, 6, 3, 1);
  ern_freq_fwd_ref(q_encoded, POINTS, q, POINTS, 2, 8, POINTS);
  float code[8];
  memcpy(code, tensor(&file, "individual_codes_torso", 80000)->data, sizeof code);
  const struct ern_rows_view pieces[4] = {{features, POINTS, 32, ERN_PER_SAMPLE},
                                          {q_encoded, POINTS, 34, ERN_PER_SAMPLE},
                                          {k_encoded, 1, 42, ERN_PER_BATCH},
                                          {code, 1, 8, ERN_PER_BATCH}};
  network(context, &file, d, &pieces[1], 3, "torso_deform_net", (const int[]){84, 32, 32, 2, 0});
  ern_torso_deform_fwd_ref(x, q, d, POINTS, POINTS);

  const struct ern_grid_shape shape = {
      .dims = 2, .levels = 16, .features = 2, .base = 16, .finest = 2048, .table_limit = 1 << 16, .bound = 1};
  struct ern_grid grid;
  assert_int_equal(ern_grid_build(&grid, &shape), ERN_OK);
  const float *const coordinates[ERN_GRID_MAX_DIMS] = {x, x + POINTS};
  ern_grid_fwd_ref(features, POINTS, coordinates, tensor(&file, "torso_encoder.embeddings", 2 * grid.entries)->data,
                   &grid, 0, 16, POINTS);
  network(context, &file, layer, pieces, 4, "torso_net", (const int[]){116, 32, 32, 4, 0});
  ern_activate_fwd_ref(layer, layer, ERN_ACT_COLOUR, 4 * POINTS);
  expect_near("torso_alpha", layer, alpha, POINTS);
  expect_near("torso_rgb", layer + POINTS, rgb, 3 * POINTS);
  free(q), free(alpha), free(rgb);
  ern_npy_free(context, &pose);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

/* The 20 recorded torso steps: how many of their pixels the torso's occupancy reaches. */
static void test_torso_occupancy(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  struct ern_tensor_file file;
  open_model(context, "parity/head_torso.safetensors", &file);
  json_t *terms = open_terms();
  struct ern_npy pixels = array(context, "parity/full/torso_pixels.npy", ERN_NPY_I64, RECORDED * RECORDED_RAYS);
  const float *grid = tensor(&file, "density_grid_torso", ERN_TORSO_CELLS)->data;
  double mean = 0;
  for (size_t cell = 0; cell < ERN_TORSO_CELLS; cell++) mean += (double)grid[cell];
  mean /= ERN_TORSO_CELLS;
  const float threshold = mean < 0.01 ? (float)mean : 0.01f;
  for (size_t step = 0; step < RECORDED; step++) {
    int32_t pixel[RECORDED_RAYS], index[RECORDED_RAYS], selected[RECORDED_RAYS];
    const int64_t *from = (const int64_t *)pixels.data + step * RECORDED_RAYS;
    for (size_t r = 0; r < RECORDED_RAYS; r++) pixel[r] = (int32_t)from[r];
    const size_t count = ern_torso_select_ref(index, selected, pixel, grid, threshold, SIDE, SIDE, RECORDED_RAYS);
    assert_int_equal(count, recorded(terms, "torso", step, "pixels_in_occupancy"));
    for (size_t i = 0; i < count; i++) assert_int_equal(selected[i], pixel[index[i]]);
  }
  json_decref(terms);
  ern_npy_free(context, &pixels);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_validation_frames), cmocka_unit_test(test_gradient_frame),
      cmocka_unit_test(test_recorded_steps),    cmocka_unit_test(test_occupancy_bits),
      cmocka_unit_test(test_attention),         cmocka_unit_test(test_torso),
      cmocka_unit_test(test_torso_occupancy),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
