/* SPDX-License-Identifier: MIT
 * What head and torso are learnt over (docs/numerics.md): random colours, which leave one opacity alone, or the
 * clip's background. */
#include "made_clip.h"
#include "train/trainer.h"

enum { RAYS = 4096, PIXELS = SIDE * SIDE };

static struct made made;
static ern_model *head;

static int open_clip(void **state) {
  (void)state;
  made_open(&made);
  ern_trainer *trainer = NULL;
  ern_train_config config = small_config(1, NULL);
  ern_train_report report;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
  support_ok(made.context, ern_trainer_step(trainer, &report));
  support_ok(made.context, ern_trainer_model(trainer, &head));
  ern_trainer_free(&trainer);
  return 0;
}
static int close_clip(void **state) {
  (void)state;
  ern_model_free(&head);
  made_close(&made);
  return 0;
}

static ern_trainer *torso_trainer(bool over_random, uint64_t iters) {
  ern_train_config config = small_config(iters, NULL);
  ern_trainer *trainer = NULL;
  config.rays = RAYS;
  config.torso = true;
  config.head = head;
  config.torso_random_background = over_random;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
  return trainer;
}

/* Each ray's truth is the torso picture over the very colour that the layer is drawn over. */
static void expect_truths(const ern_trainer *trainer, size_t frame) {
  const float *rows = trainer->batches.host_rows;
  for (size_t i = 0; i < RAYS; i++) {
    const uint8_t *pixel = made.torso[frame] + 4 * (size_t)trainer->batches.host_pixels[i];
    const float alpha = (float)pixel[3] / 255;
    for (size_t c = 0; c < 3; c++) {
      const float back = rows[(3 + c) * RAYS + i];
      const float truth = (float)pixel[c] / 255 * alpha + back * (1 - alpha);
      if (!(back >= 0 && back <= 1) || fabsf(rows[c * RAYS + i] - truth) > 1e-6f)
        fail_msg("ray %zu: truth %g over %g, expected %g", i, (double)rows[c * RAYS + i], (double)back, (double)truth);
    }
  }
}

/* case: rays of a torso over random colours and the background | plain code: a truth over another colour | here: each
 * truth is the torso picture over the ray's own uniform colour | bound: 1e-6; 6 standard deviations of mean and
 * variance */
static void test_colours_of_the_rays(void **state) {
  (void)state;
  ern_train_report report;
  const size_t frames = made.data.frames[0];
  made.data.frames[0] = 1; /* so that it is known which one a step has */
  ern_trainer *clip = torso_trainer(false, 1);
  support_ok(made.context, ern_trainer_step(clip, &report));
  expect_truths(clip, 0);
  for (size_t i = 0; i < RAYS; i++)
    for (size_t c = 0; c < 3; c++)
      assert_true(clip->batches.host_rows[(3 + c) * RAYS + i] ==
                  (float)made.background[3 * (size_t)clip->batches.host_pixels[i] + c] / 255);
  ern_trainer_free(&clip);

  ern_trainer *random = torso_trainer(true, 1);
  support_ok(made.context, ern_trainer_step(random, &report));
  expect_truths(random, 0);
  for (size_t c = 0; c < 3; c++) { /* uniform: mean 1/2 and variance 1/12, within 6 of their standard deviations */
    double sum = 0, squares = 0;
    for (size_t i = 0; i < RAYS; i++) {
      const double value = (double)random->batches.host_rows[(3 + c) * RAYS + i] - 0.5;
      sum += value / RAYS;
      squares += value * value / RAYS;
    }
    assert_true(fabs(sum) < 6 * sqrt(1.0 / 12 / RAYS) && fabs(squares - 1.0 / 12) < 6 * sqrt(1.0 / 180 / RAYS));
  }
  ern_trainer_free(&random);
  made.data.frames[0] = frames;
}

/* Takes the steps, and draws the first frame with the model that they gave. */
static void train_and_draw(ern_trainer *trainer, int steps, const ern_frame_output *output) {
  ern_train_report report;
  ern_model *model = NULL;
  ern_renderer *renderer = NULL;
  ern_dataset_frame about;
  float windows[8 * 16 * WIDTH] = {0};
  for (int k = 0; k < steps; k++) support_ok(made.context, ern_trainer_step(trainer, &report));
  support_ok(made.context, ern_trainer_model(trainer, &model));
  support_ok(made.context, ern_renderer_create(&renderer, made.backend, model, NULL));
  support_ok(made.context, made_frame(&made, 0, 0, &about));
  ern_frame_input input = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = windows,
                           .window_length = 16,
                           .individual = 0};
  ern_camera_pose(input.camera.pose, about.matrix, made.data.scale);
  support_ok(made.context, ern_renderer_frame(renderer, &input, output, NULL));
  ern_renderer_free(&renderer);
  ern_model_free(&model);
}

/* Mean distance of the layer's opacity from 1 where the torso is opaque and the head is not, after a training. */
static double error_of_opacity(bool over_random) {
  enum { STEPS = 300 };
  ern_trainer *trainer = torso_trainer(over_random, STEPS);
  float alpha[PIXELS], opacity[PIXELS];
  const ern_frame_output output = {.alpha = alpha, .opacity = opacity};
  train_and_draw(trainer, STEPS, &output);
  double error = 0, weight = 0;
  for (int i = 0; i < PIXELS; i++) {
    if (made.torso[0][4 * i + 3] < 255) continue;
    error += 1 - (double)alpha[i];
    weight += 1 - (double)opacity[i];
  }
  assert_true(weight > 1);
  ern_trainer_free(&trainer);
  return error / weight;
}

/* case: a torso in the colour of its background | plain code: half transparent elsewhere | here: over random colours
 * opacity off by less than 0.05, over the background by four times that | bound: 300 steps */
/* A torso of the colour of its background: over that alone nothing tells its opacity, over random colours all does. */
static void test_torso_in_the_colour_of_its_background(void **state) {
  (void)state;
  for (int i = 0; i < PIXELS; i++) {
    for (int c = 0; c < 3; c++) {
      made.background[3 * i + c] = 128;
      for (int f = 0; f < FRAMES; f++) made.torso[f][4 * i + c] = 128;
    }
    for (int f = 0; f < FRAMES; f++) made.torso[f][4 * i + 3] = i >= PIXELS / 2 ? 255 : 0;
  }
  const double random = error_of_opacity(true), clip = error_of_opacity(false);
  print_message("opacity off by %.3f over random colours, by %.3f over the background\n", random, clip);
  assert_true(random < 0.05);
  assert_true(clip > 4 * random);
}

/* ---- a head ------------------------------------------------------------------------------------------------------ */

static uint8_t head_pixels[PIXELS];
static bool head_known;
static ern_status head_answer;
static ern_status give_head(void *user, int split, size_t index, const uint8_t **pixels) {
  (void)user, (void)index;
  assert_int_equal(split, 0);
  *pixels = head_known ? head_pixels : NULL;
  return head_answer;
}

static ern_trainer *head_trainer(const ern_dataset *data, bool over_random, int rays, uint64_t iters) {
  ern_train_config config = small_config(iters, NULL);
  ern_trainer *trainer = NULL;
  config.rays = rays;
  config.ray_sampling = ERN_RAY_SAMPLING_UNIFORM;
  config.head_random_background = over_random;
  config.threads = 1; /* so small a step takes two threads longer than one, to the same bytes */
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, data, &config));
  return trainer;
}

/* rows: those of one batch, of which batch 0 of step 0 has frame 0 alone. */
static void batch_rows(const ern_dataset *data, bool over_random, float rows[6 * RAYS], int32_t pixels[RAYS]) {
  ern_trainer *trainer = head_trainer(data, over_random, RAYS, 1);
  struct ern_batch batch;
  const struct ern_arena_mark mark = ern_arena_mark(trainer->shared.stream);
  support_ok(made.context, ern_trainer_batch(&trainer->batches, 0, &batch));
  ern_arena_release(trainer->shared.stream, mark);
  memcpy(rows, trainer->batches.host_rows, 6 * RAYS * sizeof *rows);
  memcpy(pixels, trainer->batches.host_pixels, RAYS * sizeof *pixels);
  ern_trainer_free(&trainer);
}

/* case: a head's pixels told by 0, 1, 128, 254, 255, or not | plain code: a random truth in the head | here: 255: the
 * truth over a random colour; 0: that colour; else as over the background | bound: exact */
/* Of the head a pixel keeps its truth, over a colour of its own; beside it the truth is that colour; where neither is
 * known, all is as over the clip's background. */
static void test_colours_behind_a_head(void **state) {
  (void)state;
  static float clip[6 * RAYS], random[6 * RAYS], unknown[6 * RAYS];
  static int32_t pixels[RAYS], same[RAYS];
  ern_dataset data = made.data;
  data.frames[0] = 1;
  data.head = give_head;
  head_known = true;
  for (int i = 0; i < PIXELS; i++) head_pixels[i] = (uint8_t[]){0, 255, 128, 1, 254}[i % 5];
  batch_rows(&data, false, clip, pixels);
  batch_rows(&data, true, random, same);
  assert_memory_equal(pixels, same, sizeof pixels);
  size_t equal = 0;
  for (size_t i = 0; i < RAYS; i++) {
    const uint8_t of_head = head_pixels[pixels[i]];
    for (size_t c = 0; c < 3; c++) {
      const float truth = random[c * RAYS + i], behind = random[(3 + c) * RAYS + i];
      assert_true(behind >= 0 && behind <= 1);
      assert_true(truth == (of_head == 0 ? behind : clip[c * RAYS + i]));
      if (of_head > 0 && of_head < 255)
        assert_true(behind == clip[(3 + c) * RAYS + i]);
      else
        equal += behind == clip[(3 + c) * RAYS + i];
    }
  }
  assert_in_range(equal, 0, 3 * RAYS / 100); /* a random colour hardly ever is the clip's */

  head_known = false;
  batch_rows(&data, true, unknown, same);
  assert_memory_equal(unknown, clip, sizeof clip);
  data.head = NULL;
  batch_rows(&data, true, unknown, same);
  assert_memory_equal(unknown, clip, sizeof clip);
}

/* case: `head` of the dataset gives an error | plain code: a step without its truth | here: ends the step by the
 * callback and the frame | bound: exact */
static void test_head_that_cannot_be_told(void **state) {
  (void)state;
  ern_train_report report;
  ern_dataset data = made.data;
  data.head = give_head;
  ern_trainer *trainer = head_trainer(&data, true, RAYS, 1);
  head_answer = ERN_E_IO;
  support_expect(made.context, ern_trainer_step(trainer, &report), ERN_E_IO, "`head` answered", "training frame", NULL);
  ern_trainer_free(&trainer);
  const ern_train_config config = small_config(1, NULL); /* a trainer asks for one when it is made */
  support_expect(made.context, ern_trainer_create(&trainer, made.backend, &data, &config), ERN_E_IO, "`head` answered",
                 "training frame 0", NULL);
  head_answer = ERN_OK;
}

/* Mean opacity in the middle of the picture and beside it, after a training. */
static void opacity_of_head(bool over_random, double *inside, double *outside) {
  enum { STEPS = 1600, FEW = 64 }; /* after 800 the opacity inside was only 0.43 with avx2, after 1600 0.75 */
  ern_dataset data = made.data;
  float opacity[PIXELS];
  double count[2] = {0}, sum[2] = {0};
  data.head = give_head;
  data.has_torso = false;
  data.frames[0] = 1; /* a square in one view is a body; in several it need not be */
  ern_trainer *trainer = head_trainer(&data, over_random, FEW, STEPS);
  const ern_frame_output output = {.opacity = opacity};
  train_and_draw(trainer, STEPS, &output);
  for (int i = 0; i < PIXELS; i++) {
    count[head_pixels[i] == 255]++;
    sum[head_pixels[i] == 255] += (double)opacity[i];
  }
  *outside = sum[0] / count[0];
  *inside = sum[1] / count[1];
  ern_trainer_free(&trainer);
}

/* case: a head in the colour of its background | plain code: keeps pieces of it | here: random colours: above 0.5 in
 * it, below 0.05 beside it; the background: half that difference | bound: 800 steps of 64 rays */
/* A head of the colour of its background, in a square of the picture. */
static void test_head_in_the_colour_of_its_background(void **state) {
  (void)state;
  double inside[2], outside[2];
  head_known = true;
  for (int i = 0; i < PIXELS; i++) {
    const int row = i / SIDE, column = i % SIDE;
    head_pixels[i] = row >= 6 && row < 14 && column >= 6 && column < 14 ? 255 : 0;
    for (int c = 0; c < 3; c++) {
      made.background[3 * i + c] = 128;
      for (int f = 0; f < FRAMES; f++) made.truth[f][3 * i + c] = 128;
    }
  }
  for (int k = 0; k < 2; k++) opacity_of_head(k == 1, &inside[k], &outside[k]);
  print_message("opacity of the head, beside it: %.3f, %.3f over random colours, %.3f, %.3f over the background\n",
                inside[1], outside[1], inside[0], outside[0]);
  assert_true(inside[1] > 0.5 && outside[1] < 0.05);
  assert_true(inside[0] - outside[0] < 0.5 * (inside[1] - outside[1]));
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_colours_of_the_rays), cmocka_unit_test(test_torso_in_the_colour_of_its_background),
      cmocka_unit_test(test_colours_behind_a_head), cmocka_unit_test(test_head_that_cannot_be_told),
      cmocka_unit_test(test_head_in_the_colour_of_its_background)};
  return cmocka_run_group_tests(tests, open_clip, close_clip);
}
