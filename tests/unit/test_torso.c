/* SPDX-License-Identifier: MIT
 * Torso coordinates, the choice of pixels by the 2D occupancy, and its refresh. A torso that moves by itself, under a
 * head that stands still: trained with the body's motion and without, drawn where it was recorded and where it was not,
 * resumed. */
#include "../made_clip.h"
#include "core/rng.h"
#include "io/safetensors.h"
#include "model/checkpoint.h"
#include "model/model.h"
#include "model/torso_ops.h"

enum { GRID = ERN_TORSO_SIDE, CELLS = ERN_TORSO_CELLS };

static float uniform(uint64_t seed, uint32_t at) {
  return ern_uniform(ern_random_at(seed, 0, at, ERN_RNG_INIT).word[0]);
}

static void test_coords(void **state) {
  (void)state;
  /* 5 wide, 3 high: corners, centre, and the middle of the last row */
  static const int32_t pixel[] = {0, 4, 10, 14, 7, 12};
  static const float expected[][2] = {{-1, -1}, {-1, 1}, {1, -1}, {1, 1}, {0, 0}, {1, 0}};
  enum { COUNT = sizeof pixel / sizeof *pixel, STRIDE = 9 };
  float q[2 * STRIDE];
  ern_torso_coords_ref(q, STRIDE, pixel, 5, 3, 0.8f, COUNT);
  for (int i = 0; i < COUNT; i++) {
    assert_true(q[i] == 0.8f * expected[i][0] && q[STRIDE + i] == 0.8f * expected[i][1]);
  }
  /* a side of one pixel is at 0 */
  const int32_t only[2] = {0, 1};
  ern_torso_coords_ref(q, STRIDE, only, 1, 2, 1, 2);
  assert_true(q[0] == -1 && q[1] == 1 && q[STRIDE] == 0 && q[STRIDE + 1] == 0);
  ern_torso_coords_ref(q, STRIDE, only, 2, 1, 1, 2);
  assert_true(q[0] == 0 && q[1] == 0 && q[STRIDE] == -1 && q[STRIDE + 1] == 1);
}

/* The control points of an affine motion: by (a_0 r + a_1 c + a_2, a_3 r + a_4 c + a_5), coordinates up to `shrink`. */
static void spread_affine(float motion[ERN_MOTION_VALUES], const float a[6], float shrink) {
  for (int i = 0; i < ERN_MOTION_VALUES; i++) {
    const int point = i % (ERN_MOTION_VALUES / 2), d = i / (ERN_MOTION_VALUES / 2);
    const float row = shrink * (2 * (float)(point / ERN_MOTION_SIDE) / (ERN_MOTION_SIDE - 1) - 1);
    const float column = shrink * (2 * (float)(point % ERN_MOTION_SIDE) / (ERN_MOTION_SIDE - 1) - 1);
    motion[i] = a[3 * d] * row + a[3 * d + 1] * column + a[3 * d + 2];
  }
}

/* Without motion a point keeps its bits; else it goes where the equation says. */
static void test_move(void **state) {
  (void)state;
  enum { COUNT = 3, STRIDE = 4 };
  static const float q[2 * STRIDE] = {-0.8f, 0.1f, 0.7f, 0, 0.3f, -0.6f, 0.8f, 0}, none[ERN_MOTION_VALUES] = {0};
  static const float affine[6] = {0.5f, -0.25f, 0.125f, 1, 2, -3}, beyond[2] = {-2, 7};
  float motion[ERN_MOTION_VALUES], moved[2 * STRIDE], edge[2], one[ERN_MOTION_VALUES] = {0};
  ern_torso_move_ref(moved, q, none, 0.8f, STRIDE, COUNT);
  for (int i = 0; i < COUNT; i++) assert_true(moved[i] == q[i] && moved[STRIDE + i] == q[STRIDE + i]);
  spread_affine(motion, affine, 0.8f);
  ern_torso_move_ref(moved, q, motion, 0.8f, STRIDE, COUNT);
  for (int i = 0; i < COUNT; i++) {
    const double r = (double)q[i], c = (double)q[STRIDE + i];
    assert_true(fabs((double)moved[i] - (1.5 * r - 0.25 * c + 0.125)) < 1e-6);
    assert_true(fabs((double)moved[STRIDE + i] - (3 * c + r - 3)) < 1e-6);
  }
  /* outside of the picture as at its edge: the last control point of the first row */
  one[ERN_MOTION_SIDE - 1] = 0.25f;
  ern_torso_move_ref(edge, beyond, one, 0.8f, 1, 1);
  assert_true(edge[0] == -1.75f && edge[1] == 7);
  /* half of a point's displacement half way to the next, and none at the next */
  const float between[2] = {-0.8f, 0.8f - 0.8f / (ERN_MOTION_SIDE - 1)};
  ern_torso_move_ref(edge, between, one, 0.8f, 1, 1);
  assert_true(fabsf(edge[0] - (-0.8f + 0.125f)) < 1e-6f && edge[1] == between[1]);
}

/* Bilinear in double over the cells (r, c) at c*128 + r, the corners of the picture on the centres of the corner cells.
 */
static double grid_at(const float *grid, double row, double column) {
  double sum = 0;
  for (int c = 0; c < GRID; c++) {
    for (int r = 0; r < GRID; r++) {
      const double wr = 1 - fabs((row + 1) / 2 * (GRID - 1) - r), wc = 1 - fabs((column + 1) / 2 * (GRID - 1) - c);
      if (wr > 0 && wc > 0) sum += wr * wc * (double)grid[c * GRID + r];
    }
  }
  return sum;
}

static void check_select(const float *grid, int width, int height, float threshold) {
  enum { COUNT = 400 };
  int32_t pixel[COUNT], index[COUNT], selected[COUNT];
  for (uint32_t i = 0; i < COUNT; i++) pixel[i] = (int32_t)((uint32_t)(width * height - 1) * (uint64_t)i / (COUNT - 1));
  const size_t count = ern_torso_select_ref(index, selected, pixel, grid, threshold, width, height, COUNT);
  size_t at = 0;
  for (int i = 0; i < COUNT; i++) {
    const double row = height > 1 ? 2.0 * (pixel[i] / width) / (height - 1) - 1 : 0;
    const double column = width > 1 ? 2.0 * (pixel[i] % width) / (width - 1) - 1 : 0;
    const double value = grid_at(grid, row, column);
    const bool chosen = at < count && index[at] == i;
    if (fabs(value - (double)threshold) > 1e-4) assert_true(chosen == (value > (double)threshold));
    if (chosen) assert_int_equal(selected[at], pixel[i]);
    at += chosen;
  }
  assert_int_equal(at, count);
  assert_true(count > COUNT / 20 && count < COUNT);
}

static void test_select(void **state) {
  (void)state;
  static float grid[CELLS];
  for (uint32_t k = 0; k < CELLS; k++) grid[k] = uniform(1, k);
  check_select(grid, 128, 128, 0.5f); /* a pixel a cell */
  check_select(grid, 450, 300, 0.5f);
  check_select(grid, 31, 77, 0.4f);
  check_select(grid, 1, 400, 0.5f);
  /* a row of the picture is a row of cells: c*128 + r */
  memset(grid, 0, sizeof grid);
  grid[3 * GRID + 90] = 1;
  int32_t pixel[GRID * GRID], index[GRID * GRID], selected[GRID * GRID];
  for (int32_t i = 0; i < GRID * GRID; i++) pixel[i] = i;
  assert_int_equal(ern_torso_select_ref(index, selected, pixel, grid, 0.5f, GRID, GRID, GRID * GRID), 1);
  assert_int_equal(selected[0], 90 * GRID + 3);
  assert_int_equal(ern_torso_select_ref(index, selected, pixel, grid, 0.5f, GRID, GRID, 0), 0);
}

static void test_points(void **state) {
  (void)state;
  static float q[2 * CELLS], again[2 * CELLS];
  ern_torso_points_ref(q, CELLS, 0.8f, 3, 48);
  ern_torso_points_ref(again, CELLS, 0.8f, 3, 64);
  for (int cell = 0; cell < CELLS; cell++) {
    const int of[2] = {cell % GRID, cell / GRID}; /* row, column */
    for (int k = 0; k < 2; k++) {
      const double found = (double)q[k * CELLS + cell] / 0.8, centre = (2.0 * of[k] / 127 - 1) * 127 / 128;
      assert_true(fabs(found - centre) <= 1.0 / 128 + 1e-6);
      assert_true(q[k * CELLS + cell] != again[k * CELLS + cell]);
    }
  }
}

static void test_update(void **state) {
  (void)state;
  static float grid[CELLS], before[CELLS], alpha[CELLS];
  for (uint32_t k = 0; k < CELLS; k++) {
    before[k] = grid[k] = uniform(5, k);
    alpha[k] = uniform(6, k) < 0.02f ? uniform(7, k) : -0.001f; /* alphas may be a little below 0 */
  }
  const double mean = ern_torso_update_ref(grid, alpha, 0.95f);
  double sum = 0;
  size_t raised = 0;
  for (int c = 0; c < GRID; c++) {
    for (int r = 0; r < GRID; r++) {
      float most = before[c * GRID + r] * 0.95f;
      for (int other = 0; other < 25; other++) {
        const int cc = c + other / 5 - 2, rr = r + other % 5 - 2;
        if (cc >= 0 && cc < GRID && rr >= 0 && rr < GRID) most = fmaxf(most, alpha[cc * GRID + rr]);
      }
      assert_true(grid[c * GRID + r] == most);
      raised += most > before[c * GRID + r] * 0.95f;
      sum += (double)most;
    }
  }
  assert_true(raised > CELLS / 20 && raised < CELLS / 2);
  assert_true(fabs(mean - sum / CELLS) < 1e-12);
}

/* From a camera that looks at the face along y, key points are the projections of the anchors. */
static void test_pose(void **state) {
  (void)state;
  const float pose[16] = {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1};
  const float anchors[12] = {0.1f, 0, 0.2f, 1, 0, 0.5f, 0, 1, 0.1f, 1, -0.3f, 2};
  float k[6];
  /* x_cam = z, y_cam = -x, z_cam = 3 - y */
  const double expected[6] = {0.2 / 3, -0.1 / 3, 0, 0, -0.3 / 2 / 5, -0.1 / 2 / 5};
  ern_torso_pose_fwd_ref(k, anchors, NULL, pose);
  for (int i = 0; i < 6; i++) assert_true(fabs((double)k[i] - expected[i]) < 1e-7);
  const float gamma = 2.5f;
  ern_torso_pose_fwd_ref(k, anchors, &gamma, pose);
  for (int i = 0; i < 6; i++) assert_true(fabs((double)k[i] - 2.5 * expected[i]) < 3e-7);
}

/* ---- the motion of the body, in trainings ---- */

/* Rows by which the body is lower in a frame than in its mean place; the last one is not trained on. */
static const float lower[FRAMES + 1] = {-3, -1, 1, 3, 2};

/* A smooth pattern of the body at that row and column, pixels. */
static uint8_t pattern(float row, float column, int channel) {
  return (uint8_t)lrintf(128 + 60 * sinf(0.9f * row + (float)channel) + 50 * sinf(0.7f * column));
}

static ern_status moving_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const size_t f = split == 0 ? index : FRAMES;
  const ern_status status = made_frame(user, split, 1, frame);
  frame->aud_id = (int64_t)f;
  spread_affine(frame->torso_motion, (float[6]){0, 0, -lower[f] * 2 / (SIDE - 1)}, 1);
  return status;
}

static ern_status moving_pixels(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso) {
  struct made *m = user;
  const size_t f = split == 0 ? index : FRAMES, slot = split == 0 ? index : 0;
  for (int i = 0; i < SIDE * SIDE; i++) {
    for (int c = 0; c < 3; c++) m->torso[slot][4 * i + c] = pattern((float)(i / SIDE) - lower[f], (float)(i % SIDE), c);
    m->torso[slot][4 * i + 3] = i / SIDE >= SIDE / 2 ? 255 : 0;
  }
  *truth = m->truth[slot];
  *torso = m->torso[slot];
  return ERN_OK;
}

static void moving_open(struct made *m, ern_model **head) {
  made_open(m);
  m->data.frame = moving_frame;
  m->data.pixels = moving_pixels;
  m->data.has_torso_motion = true;
  clear_run("head");
  const ern_train_config config = small_config(2, "head.safetensors");
  support_ok(m->context, train(m, &config, NULL));
  support_ok(m->context, ern_model_load(head, m->context, "head.safetensors"));
}

static ern_train_config torso_config(const ern_model *head, uint64_t iters, const char *output) {
  ern_train_config config = small_config(iters, output);
  config.torso = true;
  config.head = head;
  return config;
}

/* Root mean square error, grey values, of the torso alone where it is opaque in a frame of the validation; `motion` as
 * of ern_frame_input. */
static double error_of(struct made *m, const ern_model *model, const float *motion) {
  static const uint8_t no_head[SIDE * SIDE];
  static float rgb[SIDE * SIDE * 3];
  const uint8_t *truth = NULL, *torso = NULL;
  float windows[8 * 16 * WIDTH] = {0};
  ern_dataset_frame about = {0};
  ern_renderer *renderer = NULL;
  const ern_render_options options = ern_render_options_default();
  double sum = 0;
  support_ok(m->context, moving_frame(m, 1, 0, &about));
  support_ok(m->context, moving_pixels(m, 1, 0, &truth, &torso));
  ern_frame_input input = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = windows,
                           .window_length = 16,
                           .individual = ERN_INDIVIDUAL_MEAN,
                           .background = m->background,
                           .wanted = no_head,
                           .torso_motion = motion};
  ern_camera_pose(input.camera.pose, about.matrix, 4);
  support_ok(m->context, ern_renderer_create(&renderer, m->backend, model, &options));
  support_ok(m->context, ern_renderer_frame(renderer, &input, &(ern_frame_output){.rgb = rgb}, NULL));
  ern_renderer_free(&renderer);
  const int first = SIDE * (SIDE / 2 + 1);
  for (int i = first; i < SIDE * SIDE; i++)
    for (int c = 0; c < 3; c++) {
      const double off = 255 * (double)rgb[3 * i + c] - torso[4 * i + c];
      sum += off * off;
    }
  return sqrt(sum / (3 * (SIDE * SIDE - first)));
}

static void test_learnt_long(void **state) {
  (void)state;
  struct made m;
  ern_model *head = NULL, *with = NULL, *without = NULL;
  ern_model_info info;
  moving_open(&m, &head);
  clear_run("with"), clear_run("without");
  ern_train_config config = torso_config(head, 1500, "with.safetensors");
  support_ok(m.context, train(&m, &config, NULL));
  config.output = "without.safetensors";
  config.torso_motion = false;
  support_ok(m.context, train(&m, &config, NULL));
  support_ok(m.context, ern_model_load(&with, m.context, "with.safetensors"));
  support_ok(m.context, ern_model_load(&without, m.context, "without.safetensors"));
  ern_model_describe(with, &info);
  assert_true(info.has_torso_motion);
  ern_model_describe(without, &info);
  assert_false(info.has_torso_motion);
  float here[ERN_MOTION_VALUES], far[ERN_MOTION_VALUES];
  spread_affine(here, (float[6]){0, 0, -lower[FRAMES] * 2 / (SIDE - 1)}, 1);
  spread_affine(far, (float[6]){0, 0, 3.0f / SIDE}, 1);
  const double own = error_of(&m, with, here), elsewhere = error_of(&m, with, far), none = error_of(&m, without, here);
  if (!(own < 0.5 * none && own < 0.5 * elsewhere))
    fail_msg("errors: %.1f with motion, %.1f with that of another place, %.1f without", own, elsewhere, none);
  assert_true(error_of(&m, without, NULL) == none); /* which ignores it */
  ern_model_free(&head), ern_model_free(&with), ern_model_free(&without);
  made_close(&m);
}

/* Motion that follows from the pose is predicted from the pose. */
static ern_status turning_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = made_frame(user, split, index, frame);
  for (int k = 0; k < ERN_MOTION_VALUES; k++)
    frame->torso_motion[k] = 0.02f * (float)(k % 7 - 3) * ((float)index - 1.5f);
  return status;
}

static void draw(struct made *m, const ern_model *model, size_t frame, const float *motion, float *rgb) {
  float windows[8 * 16 * WIDTH] = {0};
  ern_dataset_frame about = {0};
  ern_renderer *renderer = NULL;
  const ern_render_options options = ern_render_options_default();
  support_ok(m->context, turning_frame(m, 0, frame, &about));
  ern_frame_input input = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = windows,
                           .window_length = 16,
                           .individual = ERN_INDIVIDUAL_MEAN,
                           .background = m->background,
                           .torso_motion = motion};
  ern_camera_pose(input.camera.pose, about.matrix, 4);
  support_ok(m->context, ern_renderer_create(&renderer, m->backend, model, &options));
  support_ok(m->context, ern_renderer_frame(renderer, &input, &(ern_frame_output){.rgb = rgb}, NULL));
  ern_renderer_free(&renderer);
}

static void test_predicted(void **state) {
  (void)state;
  static float recorded[SIDE * SIDE * 3], predicted[SIDE * SIDE * 3], still[SIDE * SIDE * 3];
  static const float none[ERN_MOTION_VALUES] = {0};
  struct made m;
  ern_model *head = NULL, *portrait = NULL;
  moving_open(&m, &head);
  m.data.frame = turning_frame;
  clear_run("turning");
  const ern_train_config config = torso_config(head, 60, "turning.safetensors");
  support_ok(m.context, train(&m, &config, NULL));
  support_ok(m.context, ern_model_load(&portrait, m.context, "turning.safetensors"));
  for (size_t f = 0; f < FRAMES; f++) {
    ern_dataset_frame about = {0};
    double off = 0, moved = 0;
    support_ok(m.context, turning_frame(&m, 0, f, &about));
    draw(&m, portrait, f, about.torso_motion, recorded);
    draw(&m, portrait, f, NULL, predicted);
    draw(&m, portrait, f, none, still);
    for (int i = 0; i < SIDE * SIDE * 3; i++) {
      off += fabs((double)recorded[i] - (double)predicted[i]);
      moved += fabs((double)recorded[i] - (double)still[i]);
    }
    if (!(off < 0.3 * moved)) fail_msg("frame %zu: off by %g, expected a part of %g", f, off, moved);
  }
  ern_model_free(&head), ern_model_free(&portrait);
  made_close(&m);
}

/* A file of before the control points has the regression of an affine motion. */
static void test_affine_file(void **state) {
  (void)state;
  static float affine[ERN_POSE_REGRESSION_ROWS][6] = {[0] = {0.05f, -0.03f, 0.02f, 0.04f, -0.02f, 0.03f},
                                                      [4] = {0.5f, 0.25f, -0.125f, 0, 1, 2},
                                                      [7] = {-1, -2, -3, -4, -5, -6},
                                                      [8] = {1, 2, 3, 4, 5, 6}};
  float expected[ERN_MOTION_VALUES];
  struct made m;
  struct ern_tensor_file file = {0};
  ern_model *head = NULL, *portrait = NULL;
  moving_open(&m, &head);
  clear_run("affine");
  const ern_train_config config = torso_config(head, 2, "affine.safetensors");
  support_ok(m.context, train(&m, &config, NULL));
  support_ok(m.context, ern_checkpoint_read(m.context, "affine.safetensors", &file));
  for (size_t i = 0; i < file.tensor_count; i++) {
    struct ern_tensor *tensor = &file.tensors[i];
    if (strcmp(tensor->name, "torso_motion_unseen") != 0) continue;
    assert_int_equal(tensor->shape[1], ERN_MOTION_VALUES);
    tensor->shape[1] = 6, tensor->count = ERN_POSE_REGRESSION_ROWS * 6, tensor->data = affine;
  }
  const struct ern_metadata metadata[] = {{"format", "ernerf"}, {"ernerf", ern_tensor_file_metadata(&file, "ernerf")}};
  support_ok(m.context, ern_safetensors_write(m.context, "affine.safetensors", file.tensors, file.tensor_count,
                                              metadata, 2, ERN_EXISTING_REPLACE));
  ern_tensor_file_free(m.context, &file);
  support_ok(m.context, ern_model_load(&portrait, m.context, "affine.safetensors"));
  for (int row = 0; row <= ERN_POSE_NUMBERS; row++) {
    spread_affine(expected, affine[row], 1);
    for (int i = 0; i < ERN_MOTION_VALUES; i++) assert_true(fabsf(portrait->motion[row][i] - expected[i]) < 1e-6f);
  }
  for (int row = ERN_POSE_NUMBERS + 1; row < ERN_POSE_REGRESSION_ROWS; row++)
    assert_memory_equal(portrait->motion[row], affine[row], sizeof affine[row]);
  ern_model_free(&head), ern_model_free(&portrait);
  made_close(&m);
}

/* A resumed torso goes on as it began, with motion or without, and with motion not on a clip that has lost it. */
static void test_resumed(void **state) {
  (void)state;
  static char said[SUPPORT_LINES];
  struct made m;
  ern_model *head = NULL, *portrait = NULL;
  ern_model_info info;
  moving_open(&m, &head);
  clear_run("straight"), clear_run("resumed"), clear_run("before");
  ern_train_config config = torso_config(head, 16, "straight.safetensors");
  support_ok(m.context, train(&m, &config, NULL));
  config.output = "resumed.safetensors";
  config.iters = 16;
  ern_trainer *trainer = NULL;
  ern_train_report report;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  for (int k = 0; k < 9; k++) support_ok(m.context, ern_trainer_step(trainer, &report));
  support_ok(m.context, ern_trainer_save(trainer));
  ern_trainer_free(&trainer);
  config.resume = true;
  m.data.has_torso_motion = false;
  support_expect(m.context, train(&m, &config, NULL), ERN_E_MISMATCH, "resumed.run/state.safetensors", "torso.npy",
                 NULL);
  m.data.has_torso_motion = true;
  config.torso_motion = false; /* not asked of a torso that goes on */
  struct made heard = m;
  made_listen(&heard, said);
  support_ok(heard.context, train(&heard, &config, NULL));
  made_close(&heard);
  assert_non_null(strstr(said, "resumed.run/state.safetensors: torso_motion is no, but"));
  expect_same("straight.safetensors", "resumed.safetensors");

  config = torso_config(head, 8, "before.safetensors");
  m.data.has_torso_motion = false;
  support_ok(m.context, train(&m, &config, NULL));
  config.iters = 12;
  config.resume = m.data.has_torso_motion = true;
  support_ok(m.context, train(&m, &config, NULL));
  support_ok(m.context, ern_model_load(&portrait, m.context, "before.safetensors"));
  ern_model_describe(portrait, &info);
  assert_true(info.torso_steps == 12 && !info.has_torso_motion);
  ern_model_free(&head), ern_model_free(&portrait);
  made_close(&m);
}

static ern_status bad_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = moving_frame(user, split, index, frame);
  frame->eye = 0;
  if (index == 2) frame->torso_motion[4] = ((struct made *)user)->poison;
  return status;
}

static void test_refused(void **state) {
  (void)state;
  static const float bad[] = {NAN, INFINITY, 1001, -1e30f};
  struct made m;
  ern_model *head = NULL;
  moving_open(&m, &head);
  m.data.frame = bad_frame;
  clear_run("bad");
  const ern_train_config config = torso_config(head, 4, "bad.safetensors");
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    m.poison = bad[i];
    support_expect(m.context, train(&m, &config, NULL), ERN_E_ARGUMENT, "frame 2: torso_motion: value 4 is", NULL);
  }
  ern_model_free(&head);
  made_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_coords),      cmocka_unit_test(test_move),      cmocka_unit_test(test_select),
      cmocka_unit_test(test_points),      cmocka_unit_test(test_update),    cmocka_unit_test(test_pose),
      cmocka_unit_test(test_learnt_long), cmocka_unit_test(test_predicted), cmocka_unit_test(test_affine_file),
      cmocka_unit_test(test_resumed),     cmocka_unit_test(test_refused),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
