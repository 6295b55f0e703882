/* SPDX-License-Identifier: MIT
 * Where the rays of a step go: by their shares, and where a frame has no face or odd regions (docs/numerics.md). */
#include <limits.h>

#include "core/rng.h"
#include "made_clip.h"
#include "train/trainer.h"

enum { RAYS = 1 << 16, PIXELS = SIDE * SIDE };

static struct made made;
static ern_dataset_frame regions; /* of every frame: mouth, lower face, eyes */

static ern_status frame_with_regions(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = made_frame(user, split, index, frame);
  frame->mouth = regions.mouth;
  frame->lower_face = regions.lower_face;
  frame->eyes = regions.eyes;
  return status;
}

static int open_clip(void **state) {
  (void)state;
  made_open(&made);
  made.data.frame = frame_with_regions;
  return 0;
}
static int close_clip(void **state) {
  (void)state;
  made_close(&made);
  return 0;
}

/* count[pixel]: rays of one step through it. */
static void count_rays(ern_ray_sampling sampling, const ern_model *head, int count[PIXELS]) {
  ern_train_config config = small_config(1, NULL);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  config.rays = RAYS;
  config.ray_sampling = sampling;
  config.torso = head != NULL;
  config.head = head;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
  support_ok(made.context, ern_trainer_step(trainer, &report));
  memset(count, 0, PIXELS * sizeof *count);
  for (int i = 0; i < RAYS; i++) {
    assert_in_range(trainer->host_pixels[i], 0, PIXELS - 1);
    count[trainer->host_pixels[i]]++;
  }
  ern_trainer_free(&trainer);
}

static bool is_in(ern_box box, int pixel) {
  const int row = pixel / SIDE, column = pixel % SIDE;
  return row >= box.top && row < box.bottom && column >= box.left && column < box.right;
}

/* Each pixel's count is within 6 standard deviations of its expectation: 1e-9 of chance for one. */
static void expect_counts(const int count[PIXELS], const ern_box box[3], const double share[3]) {
  double rest = 1, area[3] = {0};
  for (int k = 0; k < 3; k++) {
    for (int pixel = 0; pixel < PIXELS; pixel++) area[k] += is_in(box[k], pixel);
    rest -= area[k] > 0 ? share[k] : 0;
  }
  for (int pixel = 0; pixel < PIXELS; pixel++) {
    double chance = rest / PIXELS;
    for (int k = 0; k < 3; k++) chance += is_in(box[k], pixel) ? share[k] / area[k] : 0;
    const double expected = RAYS * chance;
    if (fabs(count[pixel] - expected) > 6 * sqrt(expected) + 1)
      fail_msg("pixel %d: %d rays, expected %.1f", pixel, count[pixel], expected);
  }
}

static const double shares[3] = {ERN_MOUTH_SHARE, ERN_LOWER_FACE_SHARE, ERN_EYES_SHARE}, none[3] = {0};

static void test_shares_of_regions(void **state) {
  (void)state;
  static const struct {
    ern_box mouth, lower_face, eyes;
  } cases[] = {{{10, 13, 6, 12}, {8, 18, 4, 16}, {5, 8, 5, 15}},  /* a face */
               {{10, 13, 6, 12}, {-5, 30, -4, 26}, {0, 1, 0, 1}}, /* past all borders; one pixel */
               {{18, 40, 15, 90}, {INT_MIN, INT_MAX, INT_MIN, INT_MAX}, {-9, 1, -9, 2}},
               {{0, 0, 0, 0}, {8, 18, 4, 16}, {0, 0, 0, 0}}}; /* one is known */
  int count[PIXELS];
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    const ern_box box[3] = {cases[i].mouth, cases[i].lower_face, cases[i].eyes};
    regions = (ern_dataset_frame){.mouth = box[0], .lower_face = box[1], .eyes = box[2]};
    count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, count);
    expect_counts(count, box, shares);
  }
}

/* Nothing that is known, and regions without a pixel: the very rays of uniform sampling, which are those of the counter
 * of random numbers. */
static void test_no_face_in_the_frame(void **state) {
  (void)state;
  static const ern_box empty[] = {
      {0, 0, 0, 0},   {5, 5, 0, 20},       {9, 3, 2, 8},   {3, 9, 8, 2},
      {20, 30, 0, 9}, {0, 9, INT_MIN, -1}, {-9, 0, 0, 20}, {INT_MAX, INT_MIN, INT_MAX, INT_MIN}};
  int uniform[PIXELS], count[PIXELS], expected[PIXELS] = {0};
  regions = (ern_dataset_frame){0};
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, uniform);
  const uint64_t seed = small_config(1, NULL).seed;
  for (int i = 0; i < RAYS; i++)
    expected[ern_below(ern_random_at(seed, 0, (uint32_t)i, ERN_RNG_PIXEL).word[0], PIXELS)]++;
  assert_memory_equal(uniform, expected, sizeof expected);
  expect_counts(uniform, empty, none);
  for (size_t i = 0; i < sizeof empty / sizeof *empty; i++) {
    regions = (ern_dataset_frame){.mouth = empty[i], .lower_face = empty[i], .eyes = empty[i]};
    count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, count);
    assert_memory_equal(count, uniform, sizeof count);
  }
}

/* What is paper's own does not look at regions, and neither does a torso, which the head hides there. */
static void test_uniform_and_torso(void **state) {
  (void)state;
  int uniform[PIXELS], count[PIXELS];
  ern_train_config config = small_config(1, NULL);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  ern_model *head = NULL;
  regions = (ern_dataset_frame){0};
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
  support_ok(made.context, ern_trainer_step(trainer, &report));
  support_ok(made.context, ern_trainer_model(trainer, &head));
  ern_trainer_free(&trainer);
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, uniform);
  regions = (ern_dataset_frame){.mouth = {10, 13, 6, 12}};
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, count);
  assert_memory_equal(count, uniform, sizeof count);
  count_rays(ERN_RAY_SAMPLING_REGIONS, head, count);
  assert_memory_equal(count, uniform, sizeof count);
  ern_model_free(&head);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_shares_of_regions),
                                     cmocka_unit_test(test_no_face_in_the_frame),
                                     cmocka_unit_test(test_uniform_and_torso)};
  return cmocka_run_group_tests(tests, open_clip, close_clip);
}
