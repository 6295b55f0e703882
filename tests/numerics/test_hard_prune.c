/* SPDX-License-Identifier: MIT
 * Pruning of the occupancy grid: which cells stay, a resume before, at and after it, and values that are no numbers
 * (docs/numerics.md). */
#include "made_clip.h"
#include "render/morton.h"
#include "train/trainer.h"

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

static ern_trainer *trainer_of(const ern_train_config *config) {
  ern_trainer *t = NULL;
  support_ok(made.context, ern_trainer_create(&t, made.backend, &made.data, config));
  return t;
}

static void read_bits(ern_trainer *t, uint8_t *bits) {
  support_ok(made.context,
             t->shared.backend->download_bytes(t->shared.stream, bits, t->occupancy.bits, ERN_OCCUPANCY_BYTES));
}

static void write_parameters(ern_trainer *t, float value) {
  const size_t n = t->shared.parameters.count;
  float *values = malloc(n * sizeof *values);
  assert_non_null(values);
  for (size_t i = 0; i < n; i++) values[i] = value;
  support_ok(made.context, t->shared.backend->upload_reals(t->shared.stream, t->shared.parameters, values, n));
  free(values);
}

static size_t count_of(const uint8_t *bits) {
  size_t count = 0;
  for (size_t i = 0; i < ERN_OCCUPANCY_CELLS; i++) count += bits[i >> 3] >> (i & 7) & 1;
  return count;
}

/* Depth of a cell's centre below the face of the scene's box that the cameras look at, y = 0.5. */
static double depth_of(uint32_t cell) {
  return 0.5 - (((double)ern_morton_gather(cell >> 1) + 0.5) / (ERN_OCCUPANCY_SIDE / 2) - 1);
}

/* case: pruning where the density is 1 everywhere | plain code: cells of another axis | here: the cells down to the
 * equation's depth | bound: a step and a cell */
/* Where all parameters are 0 the density is exp(0) = 1 everywhere, so sample i of a ray has the weight
 * w_i = (1 - e^-dt) e^(-i dt), of which the first is the largest. */
static void test_cells_of_a_constant_density(void **state) {
  (void)state;
  enum { LAST = 20 };
  static uint8_t before[ERN_OCCUPANCY_BYTES], after[ERN_OCCUPANCY_BYTES];
  const double dt = 2 * sqrt(3.0) / ERN_OCCUPANCY_SIDE, cell = 2.0 / ERN_OCCUPANCY_SIDE;
  ern_train_config config = small_config(10, NULL);
  config.max_steps = ERN_OCCUPANCY_SIDE; /* so that dt is as below */
  config.levels = 14;
  made.data.focal = 480; /* rays within 1.7 degrees of the axis leave the box through its back, y = -0.5 */
  ern_trainer *t = trainer_of(&config);
  write_parameters(t, 0);
  support_ok(made.context, ern_trainer_refresh(&t->occupancy));
  read_bits(t, before);
  t->shared.config.prune_share = (float)exp(-(LAST + 0.5) * dt); /* samples 0 to LAST have more */
  support_ok(made.context, ern_trainer_prune(&t->occupancy, t->poses));
  read_bits(t, after);
  double deepest = 0, nearest = 1;
  for (uint32_t c = 0; c < ERN_OCCUPANCY_CELLS; c++) {
    const bool was = before[c >> 3] >> (c & 7) & 1, is = after[c >> 3] >> (c & 7) & 1;
    assert_true(was || !is);
    if (is) deepest = fmax(deepest, depth_of(c)), nearest = fmin(nearest, depth_of(c));
  }
  /* cameras turn by up to 0.2, so a ray's depth is 0.98 of its length; its first sample is up to dt below the face */
  assert_true(nearest < 1.5 * cell);
  assert_true(deepest > 0.97 * LAST * dt - cell && deepest < (LAST + 1) * dt + cell);
  ern_trainer_free(&t);
  made.data.focal = 48;
}

/* case: pruning by shares of 1e-6 to 1; NaN densities; an empty grid | plain code: NaN drops every cell | here: no more
 * cells for a larger share; cells of NaN stay; an empty grid stays empty | bound: exact */
/* A larger share leaves fewer cells, and none that a smaller one does not; a NaN keeps what it is in; nothing occupied
 * stays so. */
static void test_prune_shares(void **state) {
  (void)state;
  static const float shares[] = {1e-6f, 0.3f, 0.7f, 1};
  static uint8_t all[ERN_OCCUPANCY_BYTES], bits[2][ERN_OCCUPANCY_BYTES];
  ern_train_config config = small_config(40, NULL);
  ern_train_report report;
  size_t most = 0;
  config.rays = 512;
  ern_trainer *t = trainer_of(&config);
  for (int k = 0; k < 30; k++) support_ok(made.context, ern_trainer_step(t, &report));
  read_bits(t, all);
  memcpy(bits[1], all, sizeof all);
  for (size_t k = 0; k < sizeof shares / sizeof *shares; k++) {
    t->shared.config.prune_share = shares[k];
    support_ok(made.context, t->shared.backend->upload_bytes(t->shared.stream, t->occupancy.bits, all, sizeof all));
    support_ok(made.context, ern_trainer_prune(&t->occupancy, t->poses));
    memcpy(bits[0], bits[1], sizeof all);
    read_bits(t, bits[1]);
    for (size_t i = 0; i < sizeof all; i++) assert_int_equal(bits[1][i] & ~bits[0][i], 0);
    assert_true(t->occupancy.pruned);
    if (k == 0) most = count_of(bits[1]);
  }
  assert_true(most < count_of(all) && count_of(bits[1]) < most && count_of(bits[1]) > 0);
  const size_t seen = count_of(bits[0]);
  support_ok(made.context, t->shared.backend->upload_bytes(t->shared.stream, t->occupancy.bits, bits[0], sizeof all));
  write_parameters(t, NAN);
  support_ok(made.context, ern_trainer_prune(&t->occupancy, t->poses));
  read_bits(t, bits[1]);
  assert_true(count_of(bits[1]) > 0 && count_of(bits[1]) <= seen);
  memset(bits[0], 0, sizeof all);
  support_ok(made.context, t->shared.backend->upload_bytes(t->shared.stream, t->occupancy.bits, bits[0], sizeof all));
  support_ok(made.context, ern_trainer_prune(&t->occupancy, t->poses));
  read_bits(t, bits[1]);
  assert_int_equal(count_of(bits[1]), 0);
  support_ok(made.context, ern_trainer_step(t, &report) == ERN_E_NONFINITE ? ERN_OK : ERN_E_STATE);
  ern_trainer_free(&t);
}

/* Columns from the middle on are beside the head; 0: all pixels are. */
static int head_columns;
static ern_status half_a_head(void *user, int split, size_t index, const uint8_t **head) {
  static uint8_t mask[SIDE * SIDE];
  (void)user, (void)split, (void)index;
  for (int i = 0; i < SIDE * SIDE; i++) mask[i] = i % SIDE < head_columns ? 255 : 0;
  *head = mask;
  return ERN_OK;
}

/* By how many columns the cell's centre is right of the middle of the picture in frame f. */
static double right_of_middle(const ern_trainer *t, size_t f, uint32_t cell) {
  const float *pose = t->shared.views[f].pose;
  double along = 0, across = 0;
  for (int r = 0; r < 3; r++) {
    const double at =
        ((double)ern_morton_gather(cell >> r) + 0.5) / (ERN_OCCUPANCY_SIDE / 2) - 1 - (double)pose[4 * r + 3];
    across += at * (double)pose[4 * r], along += at * (double)pose[4 * r + 2];
  }
  return (double)t->shared.views[f].focal * across / along;
}

static void prune_from(ern_trainer *t, uint8_t *before, uint8_t *after) {
  support_ok(made.context,
             t->shared.backend->upload_bytes(t->shared.stream, t->occupancy.bits, before, ERN_OCCUPANCY_BYTES));
  support_ok(made.context, ern_trainer_prune(&t->occupancy, t->poses));
  read_bits(t, after);
}

/* case: pruning where half of each picture is beside the head, and where all is | plain code: cells beside the head
 * stay | here: cells that every frame sees beside it go, those that every frame sees in it stay; without a head all
 * stay | bound: 2 of 20 columns, exact */
static void test_pruned_beside_head(void **state) {
  (void)state;
  static uint8_t before[ERN_OCCUPANCY_BYTES], all[ERN_OCCUPANCY_BYTES], bits[ERN_OCCUPANCY_BYTES];
  ern_train_config config = small_config(10, NULL);
  size_t gone = 0, kept = 0;
  made.data.head = half_a_head;
  head_columns = SIDE / 2;
  ern_trainer *t = trainer_of(&config);
  write_parameters(t, 0);
  support_ok(made.context, ern_trainer_refresh(&t->occupancy));
  read_bits(t, before);
  t->shared.config.prune_share = 0.3f;
  t->shared.config.head_random_background = false; /* as published: the head is not asked for */
  prune_from(t, before, all);
  t->shared.config.head_random_background = true;
  prune_from(t, before, bits);
  for (uint32_t c = 0; c < ERN_OCCUPANCY_CELLS; c++) {
    const bool was = all[c >> 3] >> (c & 7) & 1, is = bits[c >> 3] >> (c & 7) & 1;
    double least = INFINITY, most = -INFINITY;
    assert_true(was || !is);
    for (size_t f = 0; was && f < FRAMES; f++) {
      const double right = right_of_middle(t, f, c);
      least = fmin(least, right), most = fmax(most, right);
    }
    if (was && least > 2 && is) fail_msg("cell %u, %.1f columns or more beside the head, stays", c, least);
    if (was && most < -2 && !is) fail_msg("cell %u, %.1f columns or more within the head, went", c, -most);
    gone += was && !is, kept += is;
  }
  assert_true(gone > 1000 && kept > 1000);
  head_columns = 0;
  prune_from(t, before, bits);
  assert_memory_equal(bits, all, sizeof bits);
  ern_trainer_free(&t);
  made.data.head = NULL;
}

static ern_train_config pruned_config(void) {
  ern_train_config config = small_config(40, NULL);
  config.rays = 512;
  config.prune_share = 0.5f;
  config.frames_per_step = 2;
  config.refine_poses = true;
  return config;
}

static void train_on(const char *output, bool resume, uint64_t steps, ern_train_config config) {
  ern_train_report report;
  config.output = output;
  config.resume = resume;
  config.overwrite = !resume;
  ern_trainer *t = trainer_of(&config);
  for (uint64_t k = 0; k < steps; k++) support_ok(made.context, ern_trainer_step(t, &report));
  assert_true(t->occupancy.pruned == (t->shared.step > 34)); /* the first step at or after 0.85 of 40 prunes */
  support_ok(made.context, ern_trainer_save(t));
  ern_trainer_free(&t);
}

/* case: stopped at 33 to 36 of 40 steps, pruned at 34, 2 frames a step, refined, 1 and 2 threads | plain code: pruned
 * twice or never | here: as in one go | bound: same bytes */
static void test_resumed_pruning(void **state) {
  (void)state;
  ern_train_config config = pruned_config();
  config.threads = 1;
  train_on("prune_whole.safetensors", false, 40, config);
  config.threads = 2;
  for (uint64_t stop = 33; stop <= 36; stop++) {
    train_on("prune_resumed.safetensors", false, stop, config);
    train_on("prune_resumed.safetensors", true, 40 - stop, config);
    expect_same("prune_whole.safetensors", "prune_resumed.safetensors");
  }
  ern_train_state said;
  ern_model_info model;
  support_ok(made.context, ern_train_state_describe(made.context, "prune_resumed.safetensors", &said, &model));
  assert_true(said.prune_share == config.prune_share);
}

/* case: a pruned training resumed for 160 more steps | plain code: a grid that stays pruned | here: refreshed again,
 * and pruned again later | bound: exact */
/* A training that is resumed for longer refreshes the grid again, and prunes it again late. */
static void test_pruning_resumed_for_longer(void **state) {
  (void)state;
  static uint8_t bits[2][ERN_OCCUPANCY_BYTES];
  ern_train_config config = pruned_config();
  ern_train_report report;
  train_on("prune_longer.safetensors", false, 40, config);
  config.output = "prune_longer.safetensors";
  config.resume = true;
  config.overwrite = false;
  config.iters = 200;
  config.refresh_every = 8;
  ern_trainer *t = trainer_of(&config);
  assert_false(t->occupancy.pruned);
  read_bits(t, bits[0]);
  for (int k = 0; k < 10; k++) support_ok(made.context, ern_trainer_step(t, &report));
  read_bits(t, bits[1]);
  assert_true(!t->occupancy.pruned && count_of(bits[1]) > count_of(bits[0]));
  for (int k = 0; k < 130; k++) support_ok(made.context, ern_trainer_step(t, &report));
  assert_true(t->shared.step == 180 && t->occupancy.pruned);
  ern_trainer_free(&t);
}

/* case: a share of -0.1, 1.1, NaN, infinity | plain code: no cell left | here: refused by name | bound: exact */
static void test_refused_prune_share(void **state) {
  (void)state;
  static const float wrong[] = {-0.1f, 1.1f, NAN, INFINITY};
  ern_train_config config = small_config(10, NULL);
  ern_trainer *t = NULL;
  for (size_t k = 0; k < sizeof wrong / sizeof *wrong; k++) {
    config.prune_share = wrong[k];
    support_expect(made.context, ern_trainer_create(&t, made.backend, &made.data, &config), ERN_E_ARGUMENT,
                   "prune_share", NULL);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_cells_of_a_constant_density),
                                     cmocka_unit_test(test_prune_shares),
                                     cmocka_unit_test(test_resumed_pruning),
                                     cmocka_unit_test(test_pruning_resumed_for_longer),
                                     cmocka_unit_test(test_refused_prune_share),
                                     cmocka_unit_test(test_pruned_beside_head)};
  return cmocka_run_group_tests(tests, open_clip, close_clip);
}
