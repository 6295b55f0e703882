/* SPDX-License-Identifier: MIT
 * Same seed, same bytes, of heads of every backbone, for 1, 2 and 4 threads and on every run. Occupancy is refreshed in
 * one of 512 cells: all of them take the mlp backbone a minute. Then when it is refreshed and how much of it, and the
 * same bytes there, after a resume too. */
#include "../made_clip.h"

#include "render/occupancy_ops.h"
#include "train/trainer.h"

enum { SPARSER = 512, STEPS = 2 };

static struct made data;

/* Leaves one of so many cells, evenly, in the list of those that a refresh looks at. */
static void thin_out(ern_trainer *trainer) {
  const struct ern_backend *backend = trainer->shared.backend;
  const size_t count = trainer->occupancy.cell_count, left = count / SPARSER;
  int32_t *cells = malloc(count * sizeof *cells);
  assert_non_null(cells);
  support_ok(data.context, backend->download_int32(trainer->shared.stream, cells, trainer->occupancy.cells, count));
  for (size_t i = 0; i < left; i++) cells[i] = cells[SPARSER * i];
  support_ok(data.context, backend->upload_int32(trainer->shared.stream, trainer->occupancy.cells, cells, left));
  trainer->occupancy.cell_count = left;
  free(cells);
}

/* The model after some steps, as the bytes of its file; the caller frees them. */
static char *train_kind(ern_backbone backbone, int threads, uint64_t seed, size_t *count) {
  ern_train_config config = small_config(STEPS, NULL);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  ern_model *model = NULL;
  config.backbone = backbone;
  config.threads = threads;
  config.seed = seed;
  config.rays = 256;
  if (backbone == ERN_BACKBONE_TRIPLANE || backbone == ERN_BACKBONE_MLP) config.levels = 0;
  support_ok(data.context, ern_trainer_create(&trainer, data.backend, &data.data, &config));
  thin_out(trainer);
  for (int step = 0; step < STEPS; step++) support_ok(data.context, ern_trainer_step(trainer, &report));
  assert_true(isfinite(report.loss) && report.loss > 0 && trainer->occupancy.cell_count > 100);
  support_ok(data.context, ern_trainer_model(trainer, &model));
  support_ok(data.context, ern_model_save(model, "kind.safetensors"));
  ern_model_free(&model);
  ern_trainer_free(&trainer);
  return read_file("kind.safetensors", count);
}

static void same_for_all(ern_backbone backbone) {
  static const int threads[] = {1, 2, 4, 1};
  size_t first = 0, count = 0;
  char *expected = train_kind(backbone, 1, 7, &first), *other = train_kind(backbone, 1, 8, &count);
  assert_true(first != count || memcmp(expected, other, first) != 0);
  free(other);
  for (size_t i = 0; i < sizeof threads / sizeof *threads; i++) {
    char *found = train_kind(backbone, threads[i], 7, &count);
    if (first != count || memcmp(expected, found, first) != 0)
      fail_msg("%s: %d threads give other bytes than one", ern_backbone_name(backbone), threads[i]);
    free(found);
  }
  free(expected);
}

static void test_trihash(void **state) { (void)state, same_for_all(ERN_BACKBONE_TRIHASH); }
static void test_hash3d(void **state) { (void)state, same_for_all(ERN_BACKBONE_HASH3D); }
static void test_triplane(void **state) { (void)state, same_for_all(ERN_BACKBONE_TRIPLANE); }
static void test_mlp_long(void **state) { (void)state, same_for_all(ERN_BACKBONE_MLP); }

/* ---- refreshes past the first steps; the steps between are left out by setting the trainer's number of them ---- */

enum { BLOCKS = ERN_OCCUPANCY_CELLS / ERN_OCCUPANCY_BLOCK, LATE = ERN_REFRESH_WARM_UP + 128, VALUES = 1 << 20 };

static ern_trainer *make(const ern_train_config *config) {
  ern_trainer *trainer = NULL;
  support_ok(data.context, ern_trainer_create(&trainer, data.backend, &data.data, config));
  return trainer;
}

static void take_steps(ern_trainer *trainer, uint64_t steps) {
  ern_train_report report;
  for (uint64_t k = 0; k < steps; k++) support_ok(data.context, ern_trainer_step(trainer, &report));
  assert_true(isfinite(report.loss));
}

/* Steps between refreshes, at first and later; asked for, or by rays: more rays, sooner. */
static void test_interval(void **state) {
  (void)state;
  static const struct {
    uint64_t asked;
    int rays;
    uint64_t first, later;
  } cases[] = {{0, 1, 64, 128},    {0, 1024, 64, 128},
               {0, 2048, 64, 64},  {0, 4096, 32, 32},
               {0, 8192, 16, 16},  {0, 16384, 16, 16},
               {0, 65536, 16, 16}, {0, 1048576, 16, 16},
               {3, 1024, 3, 3},    {1000000, 1024, 1000000, 1000000}};
  ern_train_config config = small_config(1000, NULL);
  config.rays = 1;
  ern_trainer *trainer = make(&config);
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    trainer->shared.config.refresh_every = cases[i].asked;
    trainer->shared.config.rays = cases[i].rays;
    trainer->shared.step = ERN_REFRESH_WARM_UP - 1;
    assert_int_equal(ern_trainer_refresh_every(&trainer->shared), cases[i].first);
    trainer->shared.step = ERN_REFRESH_WARM_UP;
    assert_int_equal(ern_trainer_refresh_every(&trainer->shared), cases[i].later);
  }
  trainer->shared.config.rays = 1;
  ern_trainer_free(&trainer);
}

/* All cells at first; then those of blocks with an occupied cell, and in 16 turns the others, each once. */
static void test_turns(void **state) {
  (void)state;
  uint8_t *bits = calloc(1, ERN_OCCUPANCY_BYTES), *seen = calloc(1, BLOCKS);
  int32_t *cells = malloc(ERN_OCCUPANCY_CELLS * sizeof *cells);
  assert_true(bits != NULL && seen != NULL && cells != NULL);
  ern_train_config config = small_config(100000, NULL);
  config.rays = 64;
  ern_trainer *trainer = make(&config);
  const struct ern_backend *backend = trainer->shared.backend;
  const size_t all = trainer->occupancy.cell_count;
  support_ok(data.context, backend->download_int32(trainer->shared.stream, cells, trainer->occupancy.cells, all));
  for (size_t i = 0; i < all; i++) seen[cells[i] / ERN_OCCUPANCY_BLOCK] = 20; /* may be looked at */
  const int32_t near = cells[all / 2] / ERN_OCCUPANCY_BLOCK;
  take_steps(trainer, 1);
  assert_int_equal(trainer->occupancy.cell_count, all);
  bits[ERN_OCCUPANCY_BLOCK / 8 * near + 3] = 4;
  for (uint64_t turn = 0; turn < 16; turn++) {
    trainer->shared.step = LATE + 128 * turn;
    support_ok(data.context,
               backend->upload_bytes(trainer->shared.stream, trainer->occupancy.bits, bits, ERN_OCCUPANCY_BYTES));
    take_steps(trainer, 1);
    assert_in_range(trainer->occupancy.cell_count, 1, all / 8);
    support_ok(data.context, backend->download_int32(trainer->shared.stream, cells, trainer->occupancy.cells,
                                                     trainer->occupancy.cell_count));
    int32_t before = -1;
    for (size_t i = 0; i < trainer->occupancy.cell_count; i++) {
      const int32_t block = cells[i] / ERN_OCCUPANCY_BLOCK;
      if (block != before) seen[block]++;
      before = block;
    }
  }
  for (int32_t block = 0; block < BLOCKS; block++)
    assert_int_equal(seen[block], block == near ? 20 + 16 : seen[block] == 0 ? 0 : 20 + 1);
  ern_trainer_free(&trainer);
  free(bits), free(seen), free(cells);
}

/* The values of a training of a refresh of all cells and two of a part, the second after `resumed`. */
static void train_late(int threads, bool resumed, float *grid, float *values) {
  ern_train_config config = small_config(LATE + 200, "late.safetensors");
  config.rays = 64;
  config.threads = threads;
  config.overwrite = true;
  ern_trainer *trainer = make(&config);
  take_steps(trainer, 1);
  trainer->shared.step = LATE;
  take_steps(trainer, 2);
  const size_t first = trainer->occupancy.cell_count;
  if (resumed) {
    support_ok(data.context, ern_trainer_save(trainer));
    ern_trainer_free(&trainer);
    config.overwrite = false;
    config.resume = true;
    trainer = make(&config);
    assert_int_equal(trainer->shared.step, LATE + 2);
  }
  take_steps(trainer, 127);
  assert_true(trainer->shared.step == LATE + 129 && trainer->occupancy.cell_count > 0 &&
              trainer->occupancy.cell_count != first);
  support_ok(data.context, trainer->shared.backend->download_reals(trainer->shared.stream, grid,
                                                                   trainer->occupancy.grid, ERN_OCCUPANCY_CELLS));
  support_ok(data.context,
             trainer->shared.backend->download_reals(trainer->shared.stream, values, trainer->shared.parameters,
                                                     trainer->shared.parameters.count));
  ern_trainer_free(&trainer);
}

static void test_late_long(void **state) {
  (void)state;
  static const int threads[] = {2, 4, 1};
  float *grid[2], *values[2];
  for (int k = 0; k < 2; k++) {
    grid[k] = calloc(ERN_OCCUPANCY_CELLS, sizeof(float)), values[k] = calloc(VALUES, sizeof(float));
    assert_true(grid[k] != NULL && values[k] != NULL);
  }
  train_late(1, false, grid[0], values[0]);
  for (size_t i = 0; i < 3; i++) {
    train_late(threads[i], i > 0, grid[1], values[1]);
    assert_memory_equal(grid[0], grid[1], ERN_OCCUPANCY_CELLS * sizeof(float));
    assert_memory_equal(values[0], values[1], VALUES * sizeof(float));
  }
  for (int k = 0; k < 2; k++) free(grid[k]), free(values[k]);
}

/* ---- refined poses ---- */

/* A head that moves to and fro before the camera, without a turn: poses that differ by a move alone, so that an affine
 * function of the move is one of the pose. */
static ern_status swinging_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_status status = made_frame(user, split, 1, frame);
  frame->aud_id = (int64_t)index % WINDOWS;
  frame->matrix[7] = 0.02f * sinf(0.3f * (float)index);
  return status;
}

/* The model after so many steps of 20, the state of the 13th resumed where `stop`; and that the mean of the angles
 * is 0. */
static char *train_poses(int threads, bool stop, size_t *count) {
  ern_train_config config = small_config(20, stop ? "poses2.safetensors" : "poses.safetensors");
  ern_train_report report;
  config.refine_poses = true;
  config.threads = threads;
  ern_trainer *trainer = make(&config);
  take_steps(trainer, 13);
  if (stop) {
    support_ok(data.context, ern_trainer_save(trainer));
    support_ok(data.context, ern_trainer_step(trainer, &report)); /* lost */
    ern_trainer_free(&trainer);
    config.resume = true;
    trainer = make(&config);
    assert_int_equal(trainer->shared.step, 13);
  }
  support_ok(data.context, ern_trainer_run(trainer, NULL));
  ern_trainer_free(&trainer);
  return read_file(config.output, count);
}

static void test_poses_long(void **state) {
  (void)state;
  static const int threads[] = {1, 2, 4, 3};
  size_t first = 0, count = 0;
  ern_model *model = NULL;
  char *expected = train_poses(1, false, &first);
  for (size_t i = 0; i < sizeof threads / sizeof *threads; i++) {
    char *found = train_poses(threads[i], i > 1, &count);
    if (first != count || memcmp(expected, found, first) != 0)
      fail_msg("refined poses: %d threads%s give other bytes", threads[i], i > 1 ? ", resumed," : "");
    free(found);
  }
  free(expected);
  support_ok(data.context, ern_model_load(&model, data.context, "poses.safetensors"));
  assert_int_equal(model->cameras, FRAMES);
  for (size_t k = 0; k < 3; k++) {
    double sum = 0, size = 0;
    for (size_t i = 0; i < FRAMES; i++)
      sum += (double)model->camera[3 * i + k], size += fabs((double)model->camera[3 * i + k]);
    assert_true(size > 1e-6 && fabs(sum) <= 1e-6 * size);
  }
  ern_model_free(&model);
}

/* What all rows have is removed; what depends on the pose stays, and the model predicts it from a pose. */
static void test_pose_mean(void **state) {
  (void)state;
  enum { MANY = 64 };
  const double none[ERN_POSE_PARAMETERS] = {0};
  ern_dataset many = data.data;
  ern_train_config config = small_config(20, NULL);
  ern_trainer *trainer = NULL;
  config.refine_poses = true;
  many.frames[0] = MANY;
  many.frame = swinging_frame;
  support_ok(data.context, ern_trainer_create(&trainer, data.backend, &many, &config));
  float *row = trainer->poses->row, *camera = trainer->shared.model->camera;
  const float degree = 3.14159265f / 180;
  float mean = 0;
  for (size_t i = 0; i < MANY; i++) mean += trainer->shared.views[i].pose[3] / MANY;
  for (size_t i = 0; i < MANY; i++) row[6 * i] = 0.01f + 0.2f * trainer->shared.views[i].pose[3];
  ern_trainer_poses_step(trainer->poses, 0, none); /* bends the path of frame 0 and of its neighbours */
  support_ok(data.context, ern_trainer_poses_download(trainer->poses));
  for (size_t i = 3; i < MANY - 3; i++) {
    const float expected = 0.2f * (trainer->shared.views[i].pose[3] - mean) / degree;
    double predicted[ERN_POSE_CORRECTION];
    assert_true(fabsf(camera[3 * i] - expected) < 0.02f);
    ern_pose_regression_predict(trainer->shared.model->unseen[0], ERN_POSE_CORRECTION, trainer->shared.views[i].pose,
                                predicted);
    /* a ridge of 0.3 leaves m/(m + 0.3) of the slope, where m of the six numbers say the same */
    if (fabsf(expected) > 0.1f)
      assert_true(predicted[0] / (double)expected > 0.6 && predicted[0] / (double)expected < 1.1);
  }
  ern_trainer_free(&trainer);
}

/* Frames out of [begin, end) get what the regression predicts; a training without the setting leaves all poses. */
static void test_poses_left_alone(void **state) {
  (void)state;
  ern_train_config config = small_config(20, NULL);
  config.refine_poses = true;
  config.data_begin = 1;
  config.data_end = 3;
  ern_trainer *trainer = make(&config);
  ern_model *model = NULL;
  take_steps(trainer, 20);
  support_ok(data.context, ern_trainer_model(trainer, &model));
  for (size_t i = 0; i < 4; i++) {
    double predicted[ERN_POSE_CORRECTION];
    ern_pose_regression_predict(model->unseen[0], ERN_POSE_CORRECTION, trainer->shared.views[i].pose, predicted);
    for (size_t k = 0; k < 3; k++)
      if (i == 0 || i == 3)
        assert_true(model->camera[3 * i + k] == (float)predicted[k] &&
                    model->camera[3 * (4 + i) + k] == (float)predicted[3 + k]);
      else
        assert_true(model->camera[3 * i + k] != 0);
  }
  ern_model_free(&model);
  ern_trainer_free(&trainer);
  config.refine_poses = false;
  trainer = make(&config);
  take_steps(trainer, 3);
  support_ok(data.context, ern_trainer_model(trainer, &model));
  assert_true(trainer->poses == NULL && model->cameras == 0);
  ern_model_free(&model);
  ern_trainer_free(&trainer);
}

/* A resume goes on as its state began; a torso keeps the refinement of its head. */
static void test_poses_are_kept(void **state) {
  (void)state;
  ern_train_config config = small_config(20, "poses.safetensors");
  ern_trainer *trainer = NULL;
  ern_model *head = NULL, *portrait = NULL;
  ern_train_state about = {.refine_poses = false};
  ern_model_info info;
  size_t count = 0;
  free(train_poses(1, false, &count));
  support_ok(data.context, ern_train_state_describe(data.context, config.output, &about, &info));
  assert_true(about.refine_poses && info.cameras == FRAMES);
  config.resume = true;
  config.overwrite = false;
  support_expect(data.context, ern_trainer_create(&trainer, data.backend, &data.data, &config), ERN_E_MISMATCH,
                 "refine_poses is yes, this training has no", NULL);
  support_ok(data.context, ern_model_load(&head, data.context, config.output));
  config = small_config(3, NULL);
  config.torso = true;
  config.head = head;
  trainer = make(&config);
  take_steps(trainer, 3);
  support_ok(data.context, ern_trainer_model(trainer, &portrait));
  assert_int_equal(portrait->cameras, FRAMES);
  assert_memory_equal(portrait->camera, head->camera, 6 * FRAMES * sizeof(float));
  assert_memory_equal(&portrait->unseen, &head->unseen, sizeof head->unseen);
  ern_model_free(&portrait);
  ern_model_free(&head);
  ern_trainer_free(&trainer);
}

static int prepare(void **state) {
  (void)state;
  made_open(&data);
  return 0;
}

static int close_all(void **state) {
  (void)state;
  made_close(&data);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_trihash),          cmocka_unit_test(test_hash3d),        cmocka_unit_test(test_triplane),
      cmocka_unit_test(test_mlp_long),         cmocka_unit_test(test_interval),      cmocka_unit_test(test_turns),
      cmocka_unit_test(test_late_long),        cmocka_unit_test(test_poses_long),    cmocka_unit_test(test_pose_mean),
      cmocka_unit_test(test_poses_left_alone), cmocka_unit_test(test_poses_are_kept)};
  return cmocka_run_group_tests(tests, prepare, close_all);
}
