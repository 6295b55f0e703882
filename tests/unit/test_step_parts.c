/* SPDX-License-Identifier: MIT
 * A step in parts: the same model whether one trainer computes all parts or several share them, here as threads that
 * are each other's communicator; what cannot be cut or shared is refused. */
#include <pthread.h>

#include "../made_clip.h"

#include "train/trainer.h"

enum { MOST = 4 };

/* ---- a communicator of threads ----------------------------------------------------------------------------------- */

struct meeting {
  pthread_barrier_t barrier;
  int size;
  void *brought[MOST];
  double *figures[MOST];
};
struct member {
  struct meeting *meeting;
  int rank;
};

/* All have brought theirs, and none takes it away before all are done with it. */
static void meet(struct member *m) { (void)pthread_barrier_wait(&m->meeting->barrier); }

static ern_status sum(void *user, float *values, size_t count, double *figures, size_t figure_count, char *words) {
  struct member *m = user;
  struct meeting *meeting = m->meeting;
  float *own = malloc(count * sizeof *own);
  double *own_figures = malloc(figure_count * sizeof *own_figures);
  (void)words;
  meeting->brought[m->rank] = values;
  meeting->figures[m->rank] = figures;
  meet(m);
  for (size_t i = 0; i < count; i++) {
    float sums[MOST];
    for (int r = 0; r < meeting->size; r++) sums[r] = ((float *)meeting->brought[r])[i];
    for (int n = meeting->size; n > 1; n /= 2)
      for (int r = 0; r < n / 2; r++) sums[r] = sums[2 * r] + sums[2 * r + 1];
    own[i] = sums[0];
  }
  for (size_t i = 0; i < figure_count; i++) {
    double sums[MOST];
    for (int r = 0; r < meeting->size; r++) sums[r] = meeting->figures[r][i];
    for (int n = meeting->size; n > 1; n /= 2)
      for (int r = 0; r < n / 2; r++) sums[r] = sums[2 * r] + sums[2 * r + 1];
    own_figures[i] = sums[0];
  }
  meet(m);
  memcpy(values, own, count * sizeof *own);
  memcpy(figures, own_figures, figure_count * sizeof *own_figures);
  free(own), free(own_figures);
  return ERN_OK;
}

static ern_status gather(void *user, float *values, size_t count, char *words) {
  struct member *m = user;
  const size_t size = (size_t)m->meeting->size;
  (void)words;
  m->meeting->brought[m->rank] = values;
  meet(m);
  for (size_t r = 0; r < size; r++) {
    const size_t begin = count * r / size, end = count * (r + 1) / size;
    if ((int)r != m->rank)
      memcpy(values + begin, (float *)m->meeting->brought[r] + begin, (end - begin) * sizeof *values);
  }
  meet(m);
  return ERN_OK;
}

static ern_status broadcast(void *user, void *bytes, size_t count, char *words) {
  struct member *m = user;
  (void)words;
  m->meeting->brought[m->rank] = bytes;
  meet(m);
  if (m->rank > 0) memcpy(bytes, m->meeting->brought[0], count);
  meet(m);
  return ERN_OK;
}

/* ---- trainings --------------------------------------------------------------------------------------------------- */

struct job {
  struct member member;
  ern_train_config config;
  pthread_t thread;
  ern_status status;
  char words[ERN_ERROR_BYTES];
};

static void *train_one(void *user) {
  struct job *job = user;
  struct made *data = malloc(sizeof *data);
  made_open(data);
  const ern_communicator together = {.user = &job->member,
                                     .rank = job->member.rank,
                                     .size = job->member.meeting->size,
                                     .sum = sum,
                                     .gather = gather,
                                     .broadcast = broadcast};
  if (together.size > 1) job->config.communicator = &together;
  job->status = train(data, &job->config, NULL);
  snprintf(job->words, sizeof job->words, "%s", ern_last_error(data->context));
  made_close(data);
  free(data);
  return NULL;
}

/* By `size` processes. */
static void train_together(const ern_train_config *config, int size, struct job jobs[MOST]) {
  struct meeting meeting = {.size = size};
  assert_int_equal(pthread_barrier_init(&meeting.barrier, NULL, (unsigned)size), 0);
  for (int r = 0; r < size; r++) {
    jobs[r] = (struct job){.member = {&meeting, r}, .config = *config};
    assert_int_equal(pthread_create(&jobs[r].thread, NULL, train_one, &jobs[r]), 0);
  }
  for (int r = 0; r < size; r++) assert_int_equal(pthread_join(jobs[r].thread, NULL), 0);
  pthread_barrier_destroy(&meeting.barrier);
}

static void trains_as_one(const ern_train_config *config) {
  static const char *const names[] = {[1] = "one.safetensors", [2] = "two.safetensors", [4] = "four.safetensors"};
  for (int size = 1; size <= MOST; size *= 2) {
    struct job jobs[MOST];
    ern_train_config own = *config;
    own.output = names[size];
    own.threads = size == 1 ? 3 : 1;
    train_together(&own, size, jobs);
    for (int r = 0; r < size; r++)
      if (jobs[r].status != ERN_OK) fail_msg("rank %d of %d: %s", r, size, jobs[r].words);
    expect_same(names[1], names[size]);
  }
}

static void test_head_long(void **state) {
  (void)state;
  ern_train_config config = small_config(4, NULL);
  config.step_parts = 4;
  config.refresh_every = 2;
  trains_as_one(&config);
}

static void test_head_of_frames_long(void **state) {
  (void)state;
  ern_train_config config = small_config(4, NULL);
  config.step_parts = 4;
  config.refresh_every = 2;
  config.frames_per_step = 8;
  config.refine_poses = true;
  trains_as_one(&config);
}

static void test_torso(void **state) {
  (void)state;
  struct made data;
  ern_model *head = NULL;
  ern_train_config config = small_config(2, "head.safetensors");
  made_open(&data);
  support_ok(data.context, train(&data, &config, NULL));
  support_ok(data.context, ern_model_load(&head, data.context, "head.safetensors"));
  config.step_parts = 4;
  config.torso = true;
  config.head = head;
  trains_as_one(&config);
  ern_model_free(&head);
  made_close(&data);
}

/* What is learnt is what one part learns, but for rounding and the weights of pixels by their uncertainty, which are of
 * a part: with one frame, after one step, the grids move where they did. */
static void test_is_the_gradient(void **state) {
  (void)state;
  struct made data;
  float *gradient[2] = {NULL, NULL};
  double dot = 0, square[2] = {0};
  size_t n = 0;
  made_open(&data);
  for (int k = 0; k < 2; k++) {
    ern_train_config config = small_config(1, NULL);
    ern_trainer *trainer = NULL;
    ern_train_report report;
    config.step_parts = k == 0 ? 1 : 4;
    support_ok(data.context, ern_trainer_create(&trainer, data.backend, &data.data, &config));
    support_ok(data.context, ern_trainer_step(trainer, &report));
    n = trainer->values.gradient.count;
    gradient[k] = malloc(n * sizeof *gradient[k]);
    support_ok(data.context,
               data.backend->download_reals(trainer->shared.stream, gradient[k], trainer->values.gradient, n));
    ern_trainer_free(&trainer);
  }
  for (size_t i = 0; i < n; i++) {
    dot += (double)gradient[0][i] * (double)gradient[1][i];
    for (int k = 0; k < 2; k++) square[k] += (double)gradient[k][i] * (double)gradient[k][i];
  }
  /* at s = 0 the weights are 1: all that differs is the order of float sums, 1e-7 a value, and the smoothness term,
   * whose weight is s too */
  assert_true(square[0] > 0 && fabs(dot / square[0] - 1) < 1e-5 && fabs(square[1] / square[0] - 1) < 1e-5);
  free(gradient[0]), free(gradient[1]);
  made_close(&data);
}

static void test_refused(void **state) {
  (void)state;
  struct made data;
  made_open(&data);
  const struct {
    int parts, frames, rays;
    const char *words;
  } rows[] = {{0, 1, 96, "step_parts is 0"},
              {3, 1, 96, "power of 2"},
              {128, 1, 128, "step_parts is 128, expected 1 to 64"},
              {4, 1, 98, "divides the 98 rays"},
              {4, 3, 96, "one divides the other"}};
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    ern_train_config config = small_config(1, NULL);
    config.step_parts = rows[i].parts;
    config.frames_per_step = rows[i].frames;
    config.rays = rows[i].rays;
    support_expect(data.context, train(&data, &config, NULL), ERN_E_ARGUMENT, rows[i].words, NULL);
  }
  ern_train_config config = small_config(1, NULL);
  ern_communicator together = {.rank = 0, .size = 2, .sum = sum, .gather = gather, .broadcast = broadcast};
  config.communicator = &together;
  support_expect(data.context, train(&data, &config, NULL), ERN_E_ARGUMENT, "2 processes share the 1 parts", NULL);
  config.step_parts = 2;
  together.rank = 2;
  support_expect(data.context, train(&data, &config, NULL), ERN_E_ARGUMENT, "rank 2 of 2", NULL);
  together.rank = 1;
  together.sum = NULL;
  support_expect(data.context, train(&data, &config, NULL), ERN_E_ARGUMENT, "lacks a function", NULL);
  made_close(&data);
}

static ern_status dead(void *user, float *values, size_t count, double *figures, size_t figure_count, char *words) {
  (void)user, (void)values, (void)count, (void)figures, (void)figure_count;
  snprintf(words, ERN_COMMUNICATOR_WORDS, "rank 1 has died");
  return ERN_E_IO;
}
static ern_status nothing(void *user, void *bytes, size_t count, char *words) {
  (void)user, (void)bytes, (void)count, (void)words;
  return ERN_OK;
}
static ern_status none(void *user, float *values, size_t count, char *words) {
  return nothing(user, values, count, words);
}

/* Rank 0's value of the loss is that of other weights: of all that is broadcast the loss alone is a double. */
static ern_status other_weights(void *user, void *bytes, size_t count, char *words) {
  (void)user, (void)words;
  if (count == sizeof(double)) *(double *)bytes *= 1.01;
  return ERN_OK;
}
static ern_status square(void *user, const float *pixel, const float *truth, int side, double *loss, float *dpixel) {
  (void)user;
  *loss = 0;
  for (int i = 0; i < 3 * side * side; i++) {
    dpixel[i] = 2 * (pixel[i] - truth[i]);
    *loss += (double)(dpixel[i] * dpixel[i] / 4);
  }
  return ERN_OK;
}

static void test_other_loss(void **state) {
  (void)state;
  struct made data;
  made_open(&data);
  ern_train_config config = small_config(2, NULL);
  config.rays = 512; /* two patches */
  config.step_parts = 2;
  config.patch_size = 16;
  config.fine_steps = 1;
  config.fine_loss = &(ern_fine_loss){.name = "square", .compute = square};
  ern_communicator together = {.rank = 1, .size = 2, .sum = dead, .gather = none, .broadcast = other_weights};
  config.communicator = &together;
  support_expect(data.context, train(&data, &config, NULL), ERN_E_MISMATCH, "rank 1", "fine_loss \"square\"", NULL);
  made_close(&data);
}

/* What was learnt before is saved, and the words are those of the communicator. */
static void test_dies(void **state) {
  (void)state;
  struct made data;
  ern_train_state about;
  ern_model_info model;
  made_open(&data);
  clear_run("dies");
  ern_train_config config = small_config(2, "dies.safetensors");
  config.step_parts = 2;
  support_ok(data.context, train(&data, &config, NULL));
  ern_communicator together = {.rank = 0, .size = 2, .sum = dead, .gather = none, .broadcast = nothing};
  config.communicator = &together;
  config.resume = true;
  config.iters = 4;
  support_expect(data.context, train(&data, &config, NULL), ERN_E_IO, "step 2: rank 1 has died", NULL);
  support_ok(data.context, ern_train_state_describe(data.context, "dies.safetensors", &about, &model));
  assert_int_equal(about.step, 2);
  assert_int_equal(about.step_parts, 2);
  made_close(&data);
}

/* Alone in a group of two; the other dies after so many sums. */
static ern_status dead_later(void *user, float *values, size_t count, double *figures, size_t figure_count,
                             char *words) {
  int *left = user;
  return (*left)-- > 0 ? ERN_OK : dead(NULL, values, count, figures, figure_count, words);
}

/* In step 5, whose occupancy grid is refreshed before the sum or not: with a refresh the state of step 4 has that of
 * step 5, which a resume would repeat. */
static void test_dies_after_refresh(void **state) {
  (void)state;
  for (size_t refresh = 2; refresh <= 3; refresh++) {
    struct made data;
    ern_train_state about;
    ern_model_info model;
    int sums = 1;
    made_open(&data);
    clear_run("refreshed");
    ern_train_config config = small_config(3, "refreshed.safetensors");
    config.step_parts = 2;
    config.refresh_every = refresh;
    support_ok(data.context, train(&data, &config, NULL));
    ern_communicator together = {
        .user = &sums, .rank = 0, .size = 2, .sum = dead_later, .gather = none, .broadcast = nothing};
    config.communicator = &together;
    config.resume = true;
    config.iters = 6;
    support_expect(data.context, train(&data, &config, NULL), ERN_E_IO, "step 4: rank 1 has died",
                   refresh == 2 ? "the state of step 3 is whole" : "step 4 is saved", NULL);
    support_ok(data.context, ern_train_state_describe(data.context, "refreshed.safetensors", &about, &model));
    assert_int_equal(about.step, refresh == 2 ? 3 : 4);
    made_close(&data);
  }
}

static ern_status of_another(void *user, void *bytes, size_t count, char *words) {
  (void)user, (void)words;
  snprintf(bytes, count, "backend cpu (another)");
  return ERN_OK;
}

/* Rank 0 has the same words, and twice the weight of 0.1. */
static ern_status of_other_settings(void *user, void *bytes, size_t count, char *words) {
  (void)user, (void)words;
  if (strcmp(bytes, "0.1") == 0) snprintf(bytes, count, "0.2");
  return ERN_OK;
}

/* Another instruction set would round otherwise, and other weights would lead to another model. */
static void test_mismatch(void **state) {
  (void)state;
  struct made data;
  made_open(&data);
  ern_train_config config = small_config(1, NULL);
  ern_communicator together = {.rank = 1, .size = 2, .sum = dead, .gather = none, .broadcast = of_another};
  config.step_parts = 2;
  config.communicator = &together;
  support_expect(data.context, train(&data, &config, NULL), ERN_E_MISMATCH, "rank 1 has libernerf",
                 "rank 0 has backend cpu (another)", NULL);
  together.broadcast = of_other_settings;
  support_expect(data.context, train(&data, &config, NULL), ERN_E_MISMATCH,
                 "rank 1 has fine_weight 0.1; rank 0 has 0.2, expected the same", NULL);
  made_close(&data);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_head_long), cmocka_unit_test(test_head_of_frames_long), cmocka_unit_test(test_torso),
      cmocka_unit_test(test_refused),   cmocka_unit_test(test_is_the_gradient),     cmocka_unit_test(test_other_loss),
      cmocka_unit_test(test_dies),      cmocka_unit_test(test_dies_after_refresh),  cmocka_unit_test(test_mismatch)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
