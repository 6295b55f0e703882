/* SPDX-License-Identifier: MIT
 * Where the rays of a step go: by their shares, and where a frame has no face or odd regions (docs/numerics.md). */
#include <limits.h>

#include "core/rng.h"
#include "made_clip.h"
#include "train/trainer.h"

enum { RAYS = 1 << 16, PIXELS = SIDE * SIDE };

static struct made made;

static int open_clip(void **state) {
  (void)state;
  made_open(&made);
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
  struct ern_batch batch;
  config.rays = RAYS;
  config.ray_sampling = sampling;
  config.torso = head != NULL;
  config.head = head;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
  const struct ern_arena_mark mark = ern_arena_mark(trainer->shared.stream);
  support_ok(made.context, ern_trainer_batch(&trainer->batches, 0, &batch));
  ern_arena_release(trainer->shared.stream, mark);
  memset(count, 0, PIXELS * sizeof *count);
  for (int i = 0; i < RAYS; i++) {
    assert_in_range(trainer->batches.host_pixels[i], 0, PIXELS - 1);
    count[trainer->batches.host_pixels[i]]++;
  }
  ern_trainer_free(&trainer);
}

static bool is_in(ern_box box, int pixel) {
  const int row = pixel / SIDE, column = pixel % SIDE;
  return row >= box.top && row < box.bottom && column >= box.left && column < box.right;
}

/* Each pixel's count is within 6 standard deviations of its expectation: 1e-9 of chance for one. */
static void expect_counts(const int count[PIXELS], ern_box box, double share) {
  double area = 0;
  for (int pixel = 0; pixel < PIXELS; pixel++) area += is_in(box, pixel);
  if (area == 0) share = 0;
  for (int pixel = 0; pixel < PIXELS; pixel++) {
    const double chance = (1 - share) / PIXELS + (is_in(box, pixel) ? share / area : 0), expected = RAYS * chance;
    if (fabs(count[pixel] - expected) > 6 * sqrt(expected) + 1)
      fail_msg("pixel %d: %d rays, expected %.1f", pixel, count[pixel], expected);
  }
}

/* case: a lower face past all borders, of one pixel, of INT_MIN to INT_MAX | plain code: remainder by 0, overflow |
 * here: what the picture has of it, at its share | bound: 6 standard deviations of each pixel's count */
static void test_share_of_the_lower_face(void **state) {
  (void)state;
  static const ern_box cases[] = {
      {8, 18, 4, 16}, {-5, 30, -4, 26}, {0, 1, 0, 1}, {18, 40, 15, 90}, {INT_MIN, INT_MAX, INT_MIN, INT_MAX}};
  int count[PIXELS];
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    made.lower_face = cases[i];
    count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, count);
    expect_counts(count, made.lower_face, (double)ERN_LOWER_FACE_SHARE);
  }
}

/* case: a head for dubbing: the shown box inside, past the borders, empty | plain code: rays of one box lost | here:
 * each box at its share, others anywhere | bound: 6 standard deviations of each pixel's count */
/* Of a head for dubbing: two boxes, each with its share, whether or not the other one is known. */
static void test_shares_of_a_dubbed_face(void **state) {
  (void)state;
  const ern_box face = {10, 18, 4, 16}, dubbed[] = {{6, 20, 2, 18}, {-5, 40, -4, 40}, {0, 0, 0, 0}};
  int count[PIXELS];
  for (size_t i = 0; i < sizeof dubbed / sizeof *dubbed; i++) {
    made.lower_face = face;
    made.dubbed = dubbed[i];
    double area = 0, lower = (double)ERN_DUB_LOWER_FACE_SHARE, wide = (double)ERN_DUBBED_SHARE;
    for (int pixel = 0; pixel < PIXELS; pixel++) area += is_in(dubbed[i], pixel);
    if (area == 0) wide = 0;
    count_rays(ERN_RAY_SAMPLING_DUB, NULL, count);
    for (int pixel = 0; pixel < PIXELS; pixel++) {
      const double expected = RAYS * ((1 - lower - wide) / PIXELS + (is_in(face, pixel) ? lower / (8 * 12) : 0) +
                                      (is_in(dubbed[i], pixel) ? wide / area : 0));
      if (fabs(count[pixel] - expected) > 6 * sqrt(expected) + 1)
        fail_msg("pixel %d: %d rays, expected %.1f", pixel, count[pixel], expected);
    }
  }
}

/* case: eyes likewise; a clip without eye values | plain code: as above | here: their share beside the lower face's;
 * the rays without eyes | bound: 6 standard deviations of each pixel's count; exact */
/* Eyes have a share of their own beside the lower face's, where the clip has eye values. */
static void test_share_of_the_eyes(void **state) {
  (void)state;
  static const ern_box cases[] = {{4, 6, 3, 17}, {-5, 30, -4, 26}, {0, 1, 0, 1}, {INT_MIN, INT_MAX, INT_MIN, INT_MAX}};
  static int count[PIXELS], without[PIXELS];
  made.lower_face = (ern_box){0, 0, 0, 0};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    made.eyes = cases[i];
    count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, count);
    expect_counts(count, made.eyes, (double)ERN_EYES_SHARE);
  }
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, without);
  made.data.has_eye = false;
  count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, count);
  made.data.has_eye = true;
  assert_memory_equal(count, without, sizeof count);

  /* below the eyes the lower face has what it has without them */
  made.eyes = (ern_box){0, 0, 0, 0};
  made.lower_face = (ern_box){10, 18, 4, 16};
  count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, without);
  made.eyes = (ern_box){4, 6, 3, 17};
  count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, count);
  made.eyes = (ern_box){0, 0, 0, 0};
  const double eyes = (double)ERN_EYES_SHARE / (2 * 14), face = (double)ERN_LOWER_FACE_SHARE / (8 * 12);
  const double any = (1 - (double)ERN_EYES_SHARE - (double)ERN_LOWER_FACE_SHARE) / PIXELS;
  for (int pixel = 0; pixel < PIXELS; pixel++) {
    const bool seen = is_in((ern_box){4, 6, 3, 17}, pixel), heard = is_in(made.lower_face, pixel);
    const double expected = RAYS * (any + (seen ? eyes : 0) + (heard ? face : 0));
    if (fabs(count[pixel] - expected) > 6 * sqrt(expected) + 1)
      fail_msg("pixel %d: %d rays, expected %.1f", pixel, count[pixel], expected);
    assert_true(seen || count[pixel] <= without[pixel]);
  }
}

static uint8_t head_pixels[PIXELS];
static ern_status give_head(void *user, int split, size_t index, const uint8_t **head) {
  (void)user, (void)split, (void)index;
  *head = head_pixels;
  return ERN_OK;
}

/* case: a head and its edge of no pixel, all, first, last, a row, a column, every seventh | plain code: an endless
 * search | here: their shares; without such a pixel the rays without it | bound: 6 standard deviations of each pixel's
 * count; exact */
/* Pixels of a head, and of its edge, of which neither 0 nor 255 is told, have shares of their own beside those of lower
 * face and eyes. Without such pixels the rays are those without a head. */
static void test_shares_of_the_head(void **state) {
  (void)state;
  static int count[PIXELS], without[PIXELS];
  const ern_box face = {8, 18, 4, 16}, eyes = {4, 6, 3, 17};
  made.lower_face = face;
  made.eyes = eyes;
  count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, without);
  made.data.head = give_head;
  for (int kind = 0; kind < 7; kind++) { /* nothing, all edge, all head, the first, the last, an L, every seventh */
    double edges = 0, heads = 0;
    for (int i = 0; i < PIXELS; i++) {
      const bool there[] = {false, true, true, i == 0, i == PIXELS - 1, i / SIDE == 3 || i % SIDE == 19, i % 7 == 0};
      head_pixels[i] = !there[kind] ? 0 : kind == 2 || (kind == 5 && i % 2 == 0) ? 255 : (uint8_t)(1 + i % 254);
      edges += head_pixels[i] > 0 && head_pixels[i] < 255;
      heads += head_pixels[i] > 0;
    }
    count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, count);
    if (kind == 0) assert_memory_equal(count, without, sizeof count);
    const double silhouette = edges > 0 ? (double)ERN_SILHOUETTE_SHARE : 0;
    const double head = heads > 0 ? (double)ERN_HEAD_SHARE : 0;
    const double any = 1 - (double)ERN_LOWER_FACE_SHARE - (double)ERN_EYES_SHARE - silhouette - head;
    for (int i = 0; i < PIXELS; i++) {
      const uint8_t of_head = head_pixels[i];
      const double expected =
          RAYS * (any / PIXELS + (is_in(face, i) ? (double)ERN_LOWER_FACE_SHARE / (10 * 12) : 0) +
                  (is_in(eyes, i) ? (double)ERN_EYES_SHARE / (2 * 14) : 0) +
                  (of_head > 0 && of_head < 255 ? silhouette / edges : 0) + (of_head > 0 ? head / heads : 0));
      if (fabs(count[i] - expected) > 6 * sqrt(expected) + 1)
        fail_msg("kind %d, pixel %d: %d rays, expected %.1f", kind, i, count[i], expected);
    }
  }
  made.lower_face = made.eyes = (ern_box){0, 0, 0, 0};
  made.data.head = NULL;
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, without);
  made.data.head = give_head;
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, count);
  assert_memory_equal(count, without, sizeof count);
  made.data.head = NULL;
}

/* case: no face in the frame; a lower face upside down or without a pixel | plain code: rays lost | here: uniform rays
 * | bound: exact */
/* A lower face that is not known, or without a pixel: the very rays of uniform sampling, which are those of the counter
 * of random numbers. */
static void test_no_face_in_the_frame(void **state) {
  (void)state;
  static const ern_box empty[] = {
      {0, 0, 0, 0},   {5, 5, 0, 20},       {9, 3, 2, 8},   {3, 9, 8, 2},
      {20, 30, 0, 9}, {0, 9, INT_MIN, -1}, {-9, 0, 0, 20}, {INT_MAX, INT_MIN, INT_MAX, INT_MIN}};
  int uniform[PIXELS], count[PIXELS], expected[PIXELS] = {0};
  made.lower_face = empty[0];
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, uniform);
  const uint64_t seed = small_config(1, NULL).seed;
  for (int i = 0; i < RAYS; i++)
    expected[ern_below(ern_random_at(seed, 0, (uint32_t)i, ERN_RNG_PIXEL).word[0], PIXELS)]++;
  assert_memory_equal(uniform, expected, sizeof expected);
  expect_counts(uniform, made.lower_face, 0);
  for (size_t i = 0; i < sizeof empty / sizeof *empty; i++) {
    made.lower_face = empty[i];
    count_rays(ERN_RAY_SAMPLING_REGIONS, NULL, count);
    assert_memory_equal(count, uniform, sizeof count);
  }
}

/* case: a torso, and `uniform`, in a frame with a face | plain code: bytes that are not the published ones | here: the
 * face is not looked at | bound: exact */
/* The paper's own sampling does not look at it, and neither does a torso, which the head hides there. */
static void test_uniform_and_torso(void **state) {
  (void)state;
  int uniform[PIXELS], count[PIXELS];
  ern_train_config config = small_config(1, NULL);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  ern_model *head = NULL;
  made.lower_face = (ern_box){0, 0, 0, 0};
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
  support_ok(made.context, ern_trainer_step(trainer, &report));
  support_ok(made.context, ern_trainer_model(trainer, &head));
  ern_trainer_free(&trainer);
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, uniform);
  made.lower_face = (ern_box){10, 13, 6, 12};
  count_rays(ERN_RAY_SAMPLING_UNIFORM, NULL, count);
  assert_memory_equal(count, uniform, sizeof count);
  count_rays(ERN_RAY_SAMPLING_REGIONS, head, count);
  assert_memory_equal(count, uniform, sizeof count);
  ern_model_free(&head);
}

/* ---- frames with shut eyes ----------------------------------------------------------------------------------------
 */

enum { DRAWS = 1 << 16 };

/* count[frame]: how often a step draws it. */
static void count_frames(ern_ray_sampling sampling, const ern_dataset *data, int count[FRAMES]) {
  ern_train_config config = small_config(1, NULL);
  ern_trainer *trainer = NULL;
  config.ray_sampling = sampling;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, data, &config));
  memset(count, 0, FRAMES * sizeof *count);
  for (trainer->shared.step = 0; trainer->shared.step < DRAWS; trainer->shared.step++)
    count[ern_trainer_step_frame(&trainer->batches, 0)]++;
  ern_trainer_free(&trainer);
}

static float eyes_of_all; /* NaN: eyes of the made clip, 0, 0.2, 0.4, 0.6 */
static ern_status frame_with_eyes(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = made_frame(user, split, index, frame);
  if (!isnan(eyes_of_all)) frame->eye = eyes_of_all;
  return status;
}

/* case: one frame of four with shut eyes, none, all; no eye values; `uniform` | plain code: a choice among none | here:
 * drawn at its share more; each alike; the published frames | bound: 6 standard deviations of each frame's count; exact
 */
/* The last frame's eyes are shut: it is drawn so much more often. Where no eye is shut, or all are, each frame is as
 * likely as another; and so it is with uniform rays. */
static void test_frames_with_shut_eyes(void **state) {
  (void)state;
  const float cases[] = {NAN, 0.49f, 1};
  ern_dataset data = made.data;
  data.frame = frame_with_eyes;
  for (size_t i = 0; i < 3; i++) {
    int count[FRAMES];
    eyes_of_all = cases[i];
    const double share = i == 0 ? (double)ERN_BLINK_SHARE : 0;
    count_frames(ERN_RAY_SAMPLING_REGIONS, &data, count);
    for (int f = 0; f < FRAMES; f++) {
      const double chance = (1 - share) / FRAMES + (f == FRAMES - 1 ? share : 0), expected = DRAWS * chance;
      if (fabs(count[f] - expected) > 6 * sqrt(expected))
        fail_msg("frame %d: %d, expected %.1f", f, count[f], expected);
    }
  }
  int published[FRAMES] = {0}, count[FRAMES];
  const uint64_t seed = small_config(1, NULL).seed;
  eyes_of_all = NAN;
  for (uint64_t step = 0; step < DRAWS; step++)
    published[ern_below(ern_random_at(seed, step, 0, ERN_RNG_FRAME).word[0], FRAMES)]++;
  count_frames(ERN_RAY_SAMPLING_UNIFORM, &data, count);
  assert_memory_equal(count, published, sizeof count);
  data.has_eye = false;
  count_frames(ERN_RAY_SAMPLING_REGIONS, &data, count);
  assert_memory_equal(count, published, sizeof count);
}

/* ---- several frames a step --------------------------------------------------------------------------------------- */

static bool asked[FRAMES];
static ern_status frame_asked_for(void *user, int split, size_t index, ern_dataset_frame *frame) {
  if (split == 0) asked[index] = true;
  return made_frame(user, split, index, frame);
}

/* One step of 10 rays in so many parts, from frames [begin, end). */
static ern_train_report step_of(int frames_per_step, size_t begin, size_t end) {
  ern_train_config config = small_config(1, NULL);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  ern_dataset data = made.data;
  data.frame = frame_asked_for;
  data.has_eye = false; /* else each part has its own noise of the eye */
  config.rays = 10;
  config.data_begin = begin;
  config.data_end = end;
  config.frames_per_step = frames_per_step;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &data, &config));
  memset(asked, 0, sizeof asked);
  support_ok(made.context, ern_trainer_step(trainer, &report));
  ern_trainer_free(&trainer);
  return report;
}

/* case: 10 rays of one frame in 1, 3 and 10 parts | plain code: a ray lost or met twice | here: the same rays | bound:
 * 1e-9; 1e-5 dB */
/* Of one frame the parts have the rays of the whole: 3, 3 and 4. */
static void test_parts_of_one_frame(void **state) {
  (void)state;
  made.lower_face = (ern_box){8, 18, 4, 16};
  const ern_train_report whole = step_of(1, 2, 3), parts = step_of(3, 2, 3), each = step_of(10, 2, 3);
  assert_true(whole.samples_per_ray > 0);
  assert_true(fabs(parts.samples_per_ray - whole.samples_per_ray) < 1e-9);
  assert_true(fabs(each.samples_per_ray - whole.samples_per_ray) < 1e-9);
  assert_true(fabs(parts.psnr - whole.psnr) < 1e-5 && fabs(each.psnr - whole.psnr) < 1e-5);
}

/* case: a step of 1 and of 8 frames | plain code: the same frame each time | here: each part draws its own | bound: one
 * frame and that of the refresh; 3 of 4 at least */
/* Each part draws its own frame. */
static void test_frames_of_a_step(void **state) {
  (void)state;
  size_t one = 0, eight = 0;
  (void)step_of(1, 0, 0);
  for (size_t i = 0; i < FRAMES; i++) one += asked[i];
  (void)step_of(8, 0, 0);
  for (size_t i = 0; i < FRAMES; i++) eight += asked[i];
  assert_in_range(one, 1, 2); /* the refresh draws one too */
  assert_in_range(eight, 3, FRAMES);
}

static void train_on(const char *output, bool resume, uint64_t steps, ern_train_config config) {
  ern_trainer *trainer = NULL;
  ern_train_report report;
  config.output = output;
  config.resume = resume;
  support_ok(made.context, ern_trainer_create(&trainer, made.backend, &made.data, &config));
  for (uint64_t k = 0; k < steps; k++) support_ok(made.context, ern_trainer_step(trainer, &report));
  support_ok(made.context, ern_trainer_save(trainer));
  ern_trainer_free(&trainer);
}

/* case: 3 frames a step, refined, stopped at step 5 of 12, 1 and 2 threads | plain code: another order of sums | here:
 * as in one go | bound: same bytes */
/* With poses refined, and a resume in the middle: the same bytes for any number of threads. */
static void test_resumed_parts(void **state) {
  (void)state;
  ern_train_config config = small_config(12, NULL);
  config.frames_per_step = 3;
  config.refine_poses = true;
  config.overwrite = true;
  config.threads = 1;
  train_on("parts_whole.safetensors", false, 12, config);
  config.threads = 2;
  train_on("parts_resumed.safetensors", false, 5, config);
  train_on("parts_resumed.safetensors", true, 7, config);
  expect_same("parts_whole.safetensors", "parts_resumed.safetensors");
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_share_of_the_lower_face), cmocka_unit_test(test_shares_of_a_dubbed_face),
      cmocka_unit_test(test_share_of_the_eyes),       cmocka_unit_test(test_shares_of_the_head),
      cmocka_unit_test(test_no_face_in_the_frame),    cmocka_unit_test(test_uniform_and_torso),
      cmocka_unit_test(test_parts_of_one_frame),      cmocka_unit_test(test_frames_with_shut_eyes),
      cmocka_unit_test(test_frames_of_a_step),        cmocka_unit_test(test_resumed_parts)};
  return cmocka_run_group_tests(tests, open_clip, close_clip);
}
