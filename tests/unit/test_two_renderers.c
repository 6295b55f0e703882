/* SPDX-License-Identifier: MIT
 * Renderers on one model and one backend, each in a thread of its own, at the same time: the bytes are those of each
 * alone. A trainer beside them changes nothing either. */
#include <pthread.h>

#include "made_clip.h"

enum { RENDERERS = 4, PICTURES = 6, ROUNDS = 3 };

struct shared {
  struct made made;
  ern_model *model;
  pthread_barrier_t begin;
};

/* What one thread does, and what came of it. */
struct work {
  struct shared *shared;
  int kind; /* 0: one thread; 1: two; 2: a head of half the size; 3: what stands still is kept */
  bool wait;
  ern_status status;
  uint8_t rgba[PICTURES][SIDE * SIDE * 4];
  float opacity[PICTURES][SIDE * SIDE];
};

static ern_status render(struct work *w, ern_renderer *renderer, const float *windows, int picture) {
  struct made *m = &w->shared->made;
  ern_dataset_frame pose;
  ern_status status = made_frame(m, 0, (size_t)(picture / 2 % FRAMES), &pose); /* each camera stands for two pictures */
  ern_frame_input input = {
      .camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
      .windows = windows,
      .window_length = 16,
      .eye = 0.1f * (float)picture,
      .background = m->background,
  };
  const ern_frame_output output = {.rgba = w->rgba[picture], .opacity = w->opacity[picture]};
  ern_camera_pose(input.camera.pose, pose.matrix, 4);
  if (status == ERN_OK) status = ern_renderer_frame(renderer, &input, &output, NULL);
  return status;
}

static void *work_through(void *user) {
  struct work *w = (struct work *)user;
  struct made *m = &w->shared->made;
  static const float eyes[2] = {0.1f, 0.5f};
  float windows[2 * 8 * 16 * WIDTH];
  ern_renderer *renderer = NULL;
  ern_render_options options = ern_render_options_default();
  options.threads = w->kind == 1 ? 2 : 1;
  if (w->kind == 2) options.image_scale = 0.5f;
  if (w->wait) pthread_barrier_wait(&w->shared->begin);
  w->status = ern_renderer_create(&renderer, m->backend, w->shared->model, &options);
  for (int i = 0; i < 2; i++) ern_audio_windows(windows + i * 8 * 16 * WIDTH, &m->features, 3 * i, ERN_AUDIO_PAD_EDGE);
  if (w->status == ERN_OK && w->kind == 3) w->status = ern_renderer_reuse_rays(renderer, windows, 16, eyes, 2, 0.002f);
  for (int picture = 0; picture < PICTURES && w->status == ERN_OK; picture++) {
    ern_audio_windows(windows, &m->features, picture, ERN_AUDIO_PAD_EDGE);
    w->status = render(w, renderer, windows, picture);
  }
  ern_renderer_free(&renderer);
  return NULL;
}

static void *train_beside(void *user) {
  struct shared *shared = (struct shared *)user;
  ern_train_config config = small_config(4, NULL);
  ern_trainer *trainer = NULL;
  config.levels = 2;
  pthread_barrier_wait(&shared->begin);
  ern_status status = ern_trainer_create(&trainer, shared->made.backend, &shared->made.data, &config);
  if (status == ERN_OK) status = ern_trainer_run(trainer, NULL);
  ern_trainer_free(&trainer);
  return status == ERN_OK ? NULL : user;
}

static int open_shared(void **state) {
  static struct shared shared;
  ern_train_config config = small_config(24, "two.safetensors");
  made_open(&shared.made);
  clear_run("two");
  support_ok(shared.made.context, train(&shared.made, &config, NULL));
  support_ok(shared.made.context, ern_model_load(&shared.model, shared.made.context, "two.safetensors"));
  *state = &shared;
  return 0;
}

static int close_shared(void **state) {
  struct shared *shared = (struct shared *)*state;
  ern_model_free(&shared->model);
  made_close(&shared->made);
  return 0;
}

static void expect_same_pictures(const struct work *found, const struct work *expected) {
  support_ok(expected->shared->made.context, found->status);
  assert_memory_equal(found->rgba, expected->rgba, sizeof expected->rgba);
  assert_memory_equal(found->opacity, expected->opacity, sizeof expected->opacity);
}

/* That there is something to see, and that it moves. */
static void expect_portraits(const struct work *w) {
  double sum = 0;
  for (int i = 0; i < SIDE * SIDE; i++) sum += (double)w->opacity[0][i];
  assert_true(sum > 1);
  assert_memory_not_equal(w->rgba[0], w->rgba[2], sizeof w->rgba[0]);
}

static void test_each_as_alone(void **state) {
  static struct work alone[RENDERERS], together[RENDERERS];
  struct shared *shared = (struct shared *)*state;
  pthread_t thread[RENDERERS];
  for (int k = 0; k < RENDERERS; k++) {
    alone[k] = (struct work){.shared = shared, .kind = k};
    work_through(&alone[k]);
    support_ok(shared->made.context, alone[k].status);
    expect_portraits(&alone[k]);
  }
  assert_int_equal(pthread_barrier_init(&shared->begin, NULL, RENDERERS), 0);
  for (int round = 0; round < ROUNDS; round++) {
    for (int k = 0; k < RENDERERS; k++) {
      together[k] = (struct work){.shared = shared, .kind = k, .wait = true};
      assert_int_equal(pthread_create(&thread[k], NULL, work_through, &together[k]), 0);
    }
    for (int k = 0; k < RENDERERS; k++) assert_int_equal(pthread_join(thread[k], NULL), 0);
    for (int k = 0; k < RENDERERS; k++) expect_same_pictures(&together[k], &alone[k]);
  }
  pthread_barrier_destroy(&shared->begin);
}

static void test_beside_a_training(void **state) {
  static struct work alone, beside;
  struct shared *shared = (struct shared *)*state;
  pthread_t thread[2];
  void *failed = NULL;
  alone = (struct work){.shared = shared, .kind = 1};
  work_through(&alone);
  beside = (struct work){.shared = shared, .kind = 1, .wait = true};
  assert_int_equal(pthread_barrier_init(&shared->begin, NULL, 2), 0);
  assert_int_equal(pthread_create(&thread[0], NULL, work_through, &beside), 0);
  assert_int_equal(pthread_create(&thread[1], NULL, train_beside, shared), 0);
  assert_int_equal(pthread_join(thread[0], NULL), 0);
  assert_int_equal(pthread_join(thread[1], &failed), 0);
  assert_null(failed);
  expect_same_pictures(&beside, &alone);
  pthread_barrier_destroy(&shared->begin);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_each_as_alone), cmocka_unit_test(test_beside_a_training)};
  return cmocka_run_group_tests(tests, open_shared, close_shared);
}
