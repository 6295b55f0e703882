/* SPDX-License-Identifier: MIT
 * Where a head's voice ends: the heights that a training finds from lips and eyes, what the model's file says of them,
 * what a head that goes on keeps, and that other speech changes no pixel above. */
#include "../made_clip.h"

/* x_0 of eyes and lips as they are projected into each frame, and the heights that follow (trainer_fade.c). */
static const double eyes_height = 0.35, lips_height = -0.4, depth = 0.2;
static double height_of(double share) { return lips_height + share * (eyes_height - lips_height); }

/* A box of 3 x 3 pixels around the projection of (height, depth, 0) of the scene. */
static ern_box box_of(const ern_dataset_frame *frame, double height) {
  float pose[16];
  ern_camera_pose(pose, frame->matrix, 4);
  const double from[3] = {height - (double)pose[3], depth - (double)pose[7], -(double)pose[11]};
  double seen[3] = {0};
  for (int c = 0; c < 3; c++)
    for (int r = 0; r < 3; r++) seen[c] += (double)pose[4 * r + c] * from[r];
  const int x = (int)floor(48 * seen[0] / seen[2] + SIDE / 2), y = (int)floor(48 * seen[1] / seen[2] + SIDE / 2);
  return (ern_box){.top = y - 1, .bottom = y + 1, .left = x - 1, .right = x + 1};
}

static ern_status faced_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = made_frame(user, split, index, frame);
  frame->lips = box_of(frame, lips_height);
  frame->eyes = box_of(frame, eyes_height);
  return status;
}

static ern_status faceless_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = faced_frame(user, split, index, frame);
  frame->has_face = false;
  return status;
}

static ern_model_info trained(struct made *m, const ern_train_config *config) {
  ern_model *model = NULL;
  ern_model_info info;
  support_ok(m->context, train(m, config, NULL));
  support_ok(m->context, ern_model_load(&model, m->context, config->output));
  ern_model_describe(model, &info);
  ern_model_free(&model);
  return info;
}

/* A pixel of these pictures is 0.07 wide at the face, and a box's middle is off by half of one at most. */
static void expect_found(const ern_model_info *info) {
  const double begin = (double)info->voice_fade[0], end = (double)info->voice_fade[1];
  if (!(fabs(begin - height_of(0.31)) < 0.05 && fabs(end - height_of(1.07)) < 0.05))
    fail_msg("the voice ends from %.3f to %.3f, expected %.3f to %.3f", begin, end, height_of(0.31), height_of(1.07));
}

static void expect_none(const ern_model_info *info) {
  assert_true(info->voice_fade[0] == 0 && info->voice_fade[1] == 0);
}

static void test_heights(void **state) {
  (void)state;
  struct made m;
  ern_model_info info;
  made_open(&m);
  clear_run("head"), clear_run("portrait");
  ern_train_config config = small_config(2, "head.safetensors");
  info = trained(&m, &config); /* boxes without a pixel */
  expect_none(&info);
  m.data.frame = faceless_frame;
  info = trained(&m, &config);
  expect_none(&info);
  m.data.frame = faced_frame;
  config.attention = ERN_ATTENTION_CONCAT;
  info = trained(&m, &config);
  expect_none(&info);
  config.attention = ERN_ATTENTION_CHANNEL;
  config.voice_fade = false;
  info = trained(&m, &config);
  expect_none(&info);
  config.voice_fade = true;
  config.ray_sampling = ERN_RAY_SAMPLING_DUB;
  info = trained(&m, &config);
  expect_none(&info);
  config.ray_sampling = ERN_RAY_SAMPLING_REGIONS;
  info = trained(&m, &config);
  expect_found(&info);
  ern_model *head = NULL;
  support_ok(m.context, ern_model_load(&head, m.context, "head.safetensors"));
  config = small_config(2, "portrait.safetensors");
  config.torso = true;
  config.head = head;
  m.data.frame = faceless_frame; /* a torso keeps its head's */
  info = trained(&m, &config);
  expect_found(&info);
  ern_model_free(&head);
  made_close(&m);
}

/* A head that goes on keeps what it began with: a resumed one, and one that begins from a file. A warning says so where
 * it is not to. */
static void test_goes_on(void **state) {
  (void)state;
  static char said[SUPPORT_LINES];
  struct made m;
  ern_model_info info;
  made_open(&m);
  made_close(&m);
  made_listen(&m, said);
  clear_run("with"), clear_run("without"), clear_run("next");
  m.data.frame = faced_frame;
  ern_train_config config = small_config(2, "with.safetensors");
  (void)trained(&m, &config);
  config.iters = 4;
  config.resume = true;
  info = trained(&m, &config);
  expect_found(&info);
  assert_null(strstr(said, "voice_fade"));
  config.iters = 6;
  config.voice_fade = false;
  info = trained(&m, &config);
  expect_found(&info);
  assert_non_null(strstr(said, "with.run/state.safetensors: voice_fade is no, but"));

  config = small_config(2, "without.safetensors");
  config.voice_fade = false;
  (void)trained(&m, &config);
  config.iters = 4;
  config.resume = config.voice_fade = true;
  info = trained(&m, &config);
  expect_none(&info);

  config = small_config(4, "next.safetensors");
  config.from = "without.safetensors";
  info = trained(&m, &config);
  expect_none(&info);
  config.from = "with.safetensors";
  config.voice_fade = false;
  said[0] = 0;
  info = trained(&m, &config);
  expect_found(&info);
  assert_non_null(strstr(said, "with.safetensors: voice_fade is no, but"));
  made_close(&m);
}

/* Speech A and B from a camera straight ahead: rows whose rays stay above the heights at which the voice ends are the
 * same to the bit, others are not. */
static void test_above(void **state) {
  (void)state;
  static float rgb[2][SIDE * SIDE * 3], windows[2][8 * 16 * WIDTH];
  struct made m;
  ern_model *model = NULL;
  ern_renderer *renderer = NULL;
  ern_dataset_frame about = {0};
  const ern_render_options options = ern_render_options_default();
  made_open(&m);
  clear_run("above");
  m.data.frame = faced_frame;
  const ern_train_config config = small_config(40, "above.safetensors");
  support_ok(m.context, train(&m, &config, NULL));
  support_ok(m.context, ern_model_load(&model, m.context, "above.safetensors"));
  support_ok(m.context, faced_frame(&m, 0, 1, &about));
  support_ok(m.context, ern_renderer_create(&renderer, m.backend, model, &options));
  for (int i = 0; i < 8 * 16 * WIDTH; i++)
    windows[0][i] = sinf(0.37f * (float)i), windows[1][i] = cosf(1.1f * (float)i);
  for (int k = 0; k < 2; k++) {
    ern_frame_input input = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                             .windows = windows[k],
                             .window_length = 16,
                             .individual = ERN_INDIVIDUAL_MEAN,
                             .background = m.background};
    ern_camera_pose(input.camera.pose, about.matrix, 4);
    support_ok(m.context, ern_renderer_frame(renderer, &input, &(ern_frame_output){.rgb = rgb[k]}, NULL));
  }
  /* a row's ray at the near end of the box (|y| <= 1/2): its height is (row's slope) (3.2 - 0.5), growing from there */
  const double end = height_of(1.07) + 0.05;
  double below = 0;
  size_t above = 0;
  for (int row = 0; row < SIDE; row++)
    for (int i = 3 * row * SIDE; i < 3 * (row + 1) * SIDE; i++) {
      const double apart = fabs((double)rgb[0][i] - (double)rgb[1][i]);
      if ((SIDE / 2 - row - 0.5) / 48 * 2.7 < end) {
        below = fmax(below, apart);
        continue;
      }
      above++;
      if (apart != 0) fail_msg("row %d: a value differs by %g", row, apart);
    }
  assert_true(above > 0);
  assert_true(below > 1e-3);
  ern_renderer_free(&renderer);
  ern_model_free(&model);
  made_close(&m);
}

/* Heights of a file that are not two ascending numbers of the scene, also where they are equal as floats; and a member
 * that this version does not know. */
static void test_refused(void **state) {
  (void)state;
  static const char *const wrong[] = {"[0.9,0.1]", "[-7,0.13]", "[null,1 ]", "[0.1,0.100000000001]"};
  struct made m;
  ern_model *model = NULL;
  made_open(&m);
  clear_run("good");
  m.data.frame = faced_frame;
  const ern_train_config config = small_config(2, "good.safetensors");
  support_ok(m.context, train(&m, &config, NULL));
  size_t count = 0;
  char *bytes = read_file("good.safetensors", &count), *at = NULL;
  for (size_t i = 0; at == NULL && i + 16 < count; i++)
    if (memcmp(bytes + i, "voice_fade\\\":[", 14) == 0) at = bytes + i + 13;
  assert_non_null(at);
  char *const last = memchr(at, ']', 60);
  assert_non_null(last);
  for (size_t k = 0; k < sizeof wrong / sizeof *wrong; k++) {
    assert_true((size_t)(last - at) + 1 >= strlen(wrong[k]));
    memset(at, ' ', (size_t)(last - at) + 1);
    memcpy(at, wrong[k], strlen(wrong[k]));
    support_write("bad.safetensors", bytes, count);
    support_expect(m.context, ern_model_load(&model, m.context, "bad.safetensors"), ERN_E_FORMAT, "bad.safetensors",
                   "voice_fade", NULL);
  }
  memcpy(at - 13, "voice_fond", 10);
  support_write("bad.safetensors", bytes, count);
  support_expect(m.context, ern_model_load(&model, m.context, "bad.safetensors"), ERN_E_FORMAT, "bad.safetensors",
                 "metadata \"ernerf\"", "voice_fond", NULL);
  free(bytes);
  made_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_heights), cmocka_unit_test(test_goes_on),
                                     cmocka_unit_test(test_above), cmocka_unit_test(test_refused)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
