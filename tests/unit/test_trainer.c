/* SPDX-License-Identifier: MIT
 * The trainer as a promise: the same bytes for any number of threads and after any resume; nothing lost when a training
 * fails, is stopped, or meets the wrong files. */
#include <math.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "made_clip.h"
#include "train/trainer.h"

static int stop_hook(void *user, const ern_train_report *report) {
  (void)user;
  return report->step > 0;
}

/* ---- determinism ------------------------------------------------------------------------------------------------- */

static void train_to(struct made *m, const char *output, uint64_t iters, int threads, uint64_t save_every) {
  ern_train_config config = small_config(iters, output);
  config.threads = threads;
  config.save_every = save_every;
  support_ok(m->context, train(m, &config, NULL));
}

static void test_threads_long(void **state) {
  (void)state;
  struct made m;
  made_open(&m);
  clear_run("one"), clear_run("two"), clear_run("four"), clear_run("again");
  train_to(&m, "one.safetensors", 20, 1, 0);
  train_to(&m, "two.safetensors", 20, 2, 0);
  train_to(&m, "four.safetensors", 20, 4, 7);
  train_to(&m, "again.safetensors", 20, 2, 0);
  expect_same("one.safetensors", "two.safetensors");
  expect_same("one.safetensors", "four.safetensors");
  expect_same("one.safetensors", "again.safetensors");
  made_close(&m);
}

/* Another seed must not give the same. */
static void test_seed(void **state) {
  (void)state;
  struct made m;
  made_open(&m);
  clear_run("seed0"), clear_run("seed1");
  ern_train_config config = small_config(3, "seed0.safetensors");
  support_ok(m.context, train(&m, &config, NULL));
  config.output = "seed1.safetensors";
  config.seed = 1;
  support_ok(m.context, train(&m, &config, NULL));
  size_t a_count = 0, b_count = 0;
  char *a = read_file("seed0.safetensors", &a_count), *b = read_file("seed1.safetensors", &b_count);
  assert_int_equal(a_count, b_count);
  assert_true(memcmp(a, b, a_count) != 0);
  free(a), free(b);
  made_close(&m);
}

/* Kills a training at step `at` by leaving after its save, then resumes it to the end. */
static void train_in_two(struct made *m, const char *output, uint64_t at, uint64_t iters, const ern_model *head) {
  ern_trainer *trainer = NULL;
  ern_train_report report;
  ern_train_config config = small_config(iters, output);
  config.torso = head != NULL;
  config.head = head;
  support_ok(m->context, ern_trainer_create(&trainer, m->backend, &m->data, &config));
  for (uint64_t k = 0; k < at; k++) support_ok(m->context, ern_trainer_step(trainer, &report));
  support_ok(m->context, ern_trainer_save(trainer));
  support_ok(m->context, ern_trainer_step(trainer, &report)); /* lost with the process */
  ern_trainer_free(&trainer);
  config.resume = true;
  support_ok(m->context, train(m, &config, NULL));
}

static void test_resume(void **state) {
  (void)state;
  struct made m;
  made_open(&m);
  clear_run("straight"), clear_run("resumed");
  train_to(&m, "straight.safetensors", 24, 2, 0);
  train_in_two(&m, "resumed.safetensors", 17, 24, NULL);
  expect_same("straight.safetensors", "resumed.safetensors");
  made_close(&m);
}

static void test_torso_resume_long(void **state) {
  (void)state;
  struct made m;
  ern_model *head = NULL, *portrait = NULL;
  ern_model_info info;
  made_open(&m);
  clear_run("head"), clear_run("torso"), clear_run("torso2");
  train_to(&m, "head.safetensors", 4, 2, 0);
  support_ok(m.context, ern_model_load(&head, m.context, "head.safetensors"));
  ern_train_config config = small_config(40, "torso.safetensors");
  config.torso = true;
  config.head = head;
  support_ok(m.context, train(&m, &config, NULL));
  train_in_two(&m, "torso2.safetensors", 21, 40, head);
  expect_same("torso.safetensors", "torso2.safetensors");
  support_ok(m.context, ern_model_load(&portrait, m.context, "torso.safetensors"));
  ern_model_describe(portrait, &info);
  assert_true(info.has_torso && info.has_eye && !info.has_gamma);
  assert_int_equal(info.head_steps, 4);
  assert_int_equal(info.torso_steps, 40);
  ern_model_free(&head), ern_model_free(&portrait);
  made_close(&m);
}

/* A damaged newest state: the one before it is taken. */
static void test_damaged_state(void **state) {
  (void)state;
  struct made m;
  made_open(&m);
  clear_run("hurt");
  train_to(&m, "hurt.safetensors", 8, 2, 4);
  size_t count = 0;
  char *bytes = read_file("hurt.run/state.safetensors", &count);
  support_write("hurt.run/state.safetensors", bytes, count / 2);
  free(bytes);
  ern_train_config config = small_config(12, "hurt.safetensors");
  config.resume = true;
  ern_trainer *trainer = NULL;
  ern_train_report report;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_ok(m.context, ern_trainer_step(trainer, &report));
  assert_int_equal(report.step, 5);
  support_ok(m.context, ern_trainer_save(trainer));
  ern_trainer_free(&trainer);
  /* the state that was not whole has not replaced the one before it */
  support_write("hurt.run/state.safetensors", "again", 5);
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_ok(m.context, ern_trainer_step(trainer, &report));
  assert_int_equal(report.step, 5);
  ern_trainer_free(&trainer);
  config.output = NULL;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_ARGUMENT, "resume is set",
                 "output is NULL", NULL);
  made_close(&m);
}

/* ---- what must not happen ---------------------------------------------------------------------------------------- */

static void test_nonfinite(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_train_report report;
  made_open(&m);
  clear_run("nan");
  const ern_train_config config = small_config(50, "nan.safetensors");
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  for (int k = 0; k < 3; k++) support_ok(m.context, ern_trainer_step(trainer, &report));
  support_ok(m.context, ern_trainer_save(trainer));
  m.poison = NAN;
  support_expect(m.context, ern_trainer_step(trainer, &report), ERN_E_NONFINITE, "training frame", "eye is nan", NULL);
  m.poison = 0;
  float speech[sizeof m.speech / sizeof *m.speech];
  memcpy(speech, m.speech, sizeof speech);
  for (size_t i = 0; i < sizeof speech / sizeof *speech; i++) m.speech[i] = NAN; /* behind the trainer's back */
  support_expect(m.context, ern_trainer_step(trainer, &report), ERN_E_NONFINITE, "step 3", "as before", NULL);
  memcpy(m.speech, speech, sizeof speech);
  support_ok(m.context, ern_trainer_step(trainer, &report)); /* the values were not touched */
  assert_int_equal(report.step, 4);
  assert_true(isfinite(report.loss));
  ern_trainer_free(&trainer);
  ern_model *model = NULL;
  support_ok(m.context, ern_model_load(&model, m.context, "nan.safetensors"));
  ern_model_free(&model);
  made_close(&m);
}

static void test_lock(void **state) {
  (void)state;
  struct made m;
  ern_trainer *first = NULL, *second = NULL;
  made_open(&m);
  clear_run("locked");
  const ern_train_config config = small_config(5, "locked.safetensors");
  support_ok(m.context, ern_trainer_create(&first, m.backend, &m.data, &config));
  support_expect(m.context, ern_trainer_create(&second, m.backend, &m.data, &config), ERN_E_BUSY, "locked.run/lock",
                 "another training", NULL);
  ern_trainer_free(&first);
  support_ok(m.context, ern_trainer_create(&second, m.backend, &m.data, &config));
  ern_trainer_free(&second);
  made_close(&m);
}

static void test_another_clip_or_configuration(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_model *head = NULL;
  made_open(&m);
  clear_run("other");
  train_to(&m, "other.safetensors", 3, 2, 0);
  ern_train_config config = small_config(5, "other.safetensors");
  config.resume = true;
  config.levels = 5;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_MISMATCH, "other.run",
                 "levels is 4", "expects 5", NULL);
  config.levels = 4;
  m.data.identity = "9999222233334444555566667777888899999999ccccddddeeeeffff00001111";
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_MISMATCH, "another clip",
                 NULL);
  support_ok(m.context, ern_model_load(&head, m.context, "other.safetensors"));
  config = small_config(5, NULL);
  config.torso = true;
  config.head = head;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_MISMATCH, "another clip",
                 NULL);
  config.force = true;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  ern_trainer_free(&trainer);
  ern_model_free(&head);
  made_close(&m);
}

/* Without --resume an earlier training stands until the first save of the new one. */
static void test_earlier_training_untouched_long(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  made_open(&m);
  clear_run("earlier"), clear_run("copy");
  train_to(&m, "earlier.safetensors", 3, 2, 0);
  train_to(&m, "copy.safetensors", 3, 2, 0);
  const ern_train_config config = small_config(6, "earlier.safetensors");
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  ern_train_report report;
  support_ok(m.context, ern_trainer_step(trainer, &report));
  ern_trainer_free(&trainer);
  expect_same("earlier.safetensors", "copy.safetensors");
  ern_train_config resume = small_config(3, "earlier.safetensors");
  resume.resume = true;
  support_ok(m.context, train(&m, &resume, NULL)); /* the state of step 3 is still there */
  expect_same("earlier.safetensors", "copy.safetensors");
  made_close(&m);
}

static void expect_refused(struct made *m, const ern_train_config *config, const char *file, const char *advice) {
  ern_trainer *trainer = NULL;
  support_expect(m->context, ern_trainer_create(&trainer, m->backend, &m->data, config), ERN_E_EXISTS, file, advice,
                 "--overwrite", NULL);
  assert_null(trainer);
}

/* Without resume and overwrite an earlier training is not even begun upon. */
static void test_earlier_is_kept_long(void **state) {
  (void)state;
  struct made m;
  made_open(&m);
  clear_run("kept"), clear_run("copy"), clear_run("alone");
  train_to(&m, "kept.safetensors", 3, 2, 1);
  train_to(&m, "copy.safetensors", 3, 2, 1);
  size_t count = 0;
  char *bytes = read_file("kept.run/state.safetensors", &count);
  support_write("state.before", bytes, count);
  free(bytes);
  ern_train_config config = small_config(6, "kept.safetensors");
  config.overwrite = false;
  expect_refused(&m, &config, "kept.safetensors", "--resume");
  assert_int_equal(rename("kept.safetensors", "moved.safetensors"), 0);
  expect_refused(&m, &config, "kept.run/", "--resume");
  expect_same("kept.run/state.safetensors", "state.before");
  expect_same("moved.safetensors", "copy.safetensors");
  /* a model whose X.run is gone: a resume has nothing to go on from, and would replace the model */
  assert_int_equal(rename("moved.safetensors", "alone.safetensors"), 0);
  config.output = "alone.safetensors";
  expect_refused(&m, &config, "alone.safetensors", "no state");
  config.resume = true;
  expect_refused(&m, &config, "alone.safetensors", "no state");
  assert_int_not_equal(access("alone.run", F_OK), 0);
  expect_same("alone.safetensors", "copy.safetensors");
  /* a start that was killed during its first save left a lock and half of a state */
  for (int resume = 0; resume < 2; resume++) {
    config = small_config(3, "kept.safetensors");
    config.overwrite = false;
    config.resume = resume == 1;
    clear_run("kept");
    assert_int_equal(mkdir("kept.run", 0777), 0);
    support_write_text("kept.run/lock", "");
    support_write_text("kept.run/state.next.safetensors.ernerf-tmp", "half");
    assert_int_equal(chmod("kept.run/state.next.safetensors.ernerf-tmp", 01644), 0); /* its mark */
    support_ok(m.context, train(&m, &config, NULL));
    expect_same("kept.safetensors", "copy.safetensors");
    assert_int_not_equal(access("kept.run/state.next.safetensors.ernerf-tmp", F_OK), 0);
  }
  made_close(&m);
}

/* A file that comes to X after the start is somebody's: it stays, and the state is saved. */
static void test_model_that_came_meanwhile(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  size_t count = 0;
  made_open(&m);
  clear_run("soon"), clear_run("copy");
  train_to(&m, "copy.safetensors", 3, 2, 0);
  ern_train_config config = small_config(3, "soon.safetensors");
  config.overwrite = false;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_write_text("soon.safetensors", "somebody's");
  support_expect(m.context, ern_trainer_run(trainer, NULL), ERN_E_EXISTS, "soon.safetensors", NULL);
  ern_trainer_free(&trainer);
  char *text = read_file("soon.safetensors", &count);
  assert_int_equal(count, strlen("somebody's"));
  free(text);
  config.resume = true;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_EXISTS, "soon.safetensors",
                 "no model of this clip", NULL);
  assert_int_equal(unlink("soon.safetensors"), 0);
  support_ok(m.context, train(&m, &config, NULL));
  expect_same("soon.safetensors", "copy.safetensors");
  made_close(&m);
}

/* iters is the total: a state past it is not quietly written again. */
static void test_resume_past_the_end(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  made_open(&m);
  clear_run("past");
  train_to(&m, "past.safetensors", 4, 2, 0);
  ern_train_config config = small_config(3, "past.safetensors");
  config.resume = true;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_STATE, "past.run",
                 "at step 4", "at most the 3", NULL);
  made_close(&m);
}

static void test_stop_saves(void **state) {
  (void)state;
  struct made m;
  made_open(&m);
  clear_run("stopped");
  ern_train_config config = small_config(100000, "stopped.safetensors");
  const ern_train_hooks hooks = {.progress = stop_hook};
  support_expect(m.context, train(&m, &config, &hooks), ERN_E_CANCELLED, "stopped at step", "the state is saved", NULL);
  assert_int_equal(access("stopped.run/state.safetensors", F_OK), 0);
  made_close(&m);
}

/* A child that the program forked does not keep the lock of a training that has been freed. */
static void test_lock_after_fork(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  made_open(&m);
  clear_run("forked");
  ern_train_config config = small_config(2, "forked.safetensors");
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  const pid_t child = fork();
  assert_true(child >= 0);
  if (child == 0) {
    pause();
    _exit(0);
  }
  support_expect(m.context, ern_trainer_create(&(ern_trainer *){NULL}, m.backend, &m.data, &config), ERN_E_BUSY, NULL);
  ern_trainer_free(&trainer);
  const ern_status status = ern_trainer_create(&trainer, m.backend, &m.data, &config);
  kill(child, SIGKILL);
  assert_int_equal(waitpid(child, NULL, 0), child);
  support_ok(m.context, status);
  ern_trainer_free(&trainer);
  made_close(&m);
}

/* ---- where a training starts ------------------------------------------------------------------------------------- */

static void test_from_long(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_train_report report;
  made_open(&m);
  clear_run("source"), clear_run("target");
  train_to(&m, "source.safetensors", 6, 2, 0);
  ern_train_config config = small_config(9, NULL);
  config.from = "source.safetensors"; /* weights alone: from step 0 */
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_ok(m.context, ern_trainer_step(trainer, &report));
  assert_int_equal(report.step, 1);
  ern_trainer_free(&trainer);
  config.from = "source.run/state.safetensors"; /* with its state: from step 6 */
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_ok(m.context, ern_trainer_step(trainer, &report));
  assert_int_equal(report.step, 7);
  ern_trainer_free(&trainer);
  config.iters = 6;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_STATE, "already at step 6",
                 NULL);
  config.seconds = 3600; /* steps do not count then, but the time does */
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  ern_trainer_free(&trainer);
  config.seconds = 1e-5;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_STATE, "trained for",
                 NULL);
  made_close(&m);
}

static void test_ema(void **state) {
  (void)state;
  struct made m;
  made_open(&m);
  clear_run("average");
  ern_train_config config = small_config(10, "average.safetensors"); /* 5 updates */
  config.ema = true;
  support_expect(m.context, train(&m, &config, NULL), ERN_E_ARGUMENT, "10 steps in all with 2 between its updates",
                 "5 updates", "at least 10", "at most 1 steps between updates or 20 steps in all", NULL);
  assert_int_equal(access("average.run", F_OK), -1);
  config = small_config(22, "average.safetensors"); /* 11 updates */
  support_ok(m.context, train(&m, &config, NULL));
  size_t raw_count = 0, average_count = 0;
  char *raw = read_file("average.safetensors", &raw_count);
  config.ema = config.resume = true; /* at the last step it only writes */
  support_ok(m.context, train(&m, &config, NULL));
  char *average = read_file("average.safetensors", &average_count);
  assert_int_equal(raw_count, average_count);
  assert_true(memcmp(raw, average, raw_count) != 0);
  free(raw), free(average);
  made_close(&m);
}

/* Saves before the tenth update write what a training without the average writes; later ones do not, nor does a resume
 * change any of it. */
static void test_ema_before_its_time_long(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_train_report report;
  made_open(&m);
  clear_run("early"), clear_run("plain"), clear_run("late");
  for (int ema = 0; ema < 2; ema++) {
    ern_train_config config = small_config(22, ema ? "early.safetensors" : "plain.safetensors");
    config.ema = ema;
    support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
    for (int k = 0; k < 19; k++) support_ok(m.context, ern_trainer_step(trainer, &report)); /* 9 updates */
    support_ok(m.context, ern_trainer_save(trainer));
    ern_trainer_free(&trainer);
  }
  expect_same("early.safetensors", "plain.safetensors");
  ern_train_config config = small_config(19, "early.safetensors");
  config.ema = config.resume = true;
  support_expect(m.context, train(&m, &config, NULL), ERN_E_ARGUMENT, "9 updates", "20 steps in all or more", NULL);
  config.iters = 22;
  support_ok(m.context, train(&m, &config, NULL));
  config = small_config(22, "late.safetensors");
  config.ema = true;
  support_ok(m.context, train(&m, &config, NULL));
  expect_same("early.safetensors", "late.safetensors");
  made_close(&m);
}

/* The head under a torso's average is the head, also after a resume. */
static void test_ema_of_a_torso_long(void **state) {
  (void)state;
  struct made m;
  ern_model *head = NULL;
  made_open(&m);
  clear_run("under"), clear_run("mean"), clear_run("mean2");
  train_to(&m, "under.safetensors", 4, 2, 0);
  support_ok(m.context, ern_model_load(&head, m.context, "under.safetensors"));
  ern_train_config config = small_config(24, "mean.safetensors");
  config.torso = config.ema = true;
  config.head = head;
  support_ok(m.context, train(&m, &config, NULL));
  train_in_two(&m, "mean2.safetensors", 21, 24, head);
  config.output = "mean2.safetensors";
  config.resume = true;
  support_ok(m.context, train(&m, &config, NULL)); /* at its last step: it only writes */
  expect_same("mean.safetensors", "mean2.safetensors");
  ern_model_free(&head);
  made_close(&m);
}

/* Densities of cells change with the first step of each three, and with no other. */
static void test_refresh_every_long(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_train_report report;
  const size_t bytes = ERN_OCCUPANCY_CELLS * sizeof(float);
  float *before = calloc(1, bytes), *after = calloc(1, bytes);
  assert_true(before != NULL && after != NULL);
  made_open(&m);
  ern_train_config config = small_config(7, NULL);
  config.refresh_every = 3;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  for (int step = 0; step < 7; step++) {
    support_ok(m.context, ern_trainer_step(trainer, &report));
    support_ok(m.context, trainer->shared.backend->download_reals(trainer->shared.stream, after,
                                                                  trainer->occupancy.grid, ERN_OCCUPANCY_CELLS));
    assert_int_equal(memcmp(before, after, bytes) != 0, step % 3 == 0);
    memcpy(before, after, bytes);
  }
  free(before), free(after);
  ern_trainer_free(&trainer);
  made_close(&m);
}

static void test_bad_configuration(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  made_open(&m);
  ern_train_config config = small_config(5, "missing/folder/x.safetensors");
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_IO, "missing/folder/x.run",
                 NULL);
  config = small_config(5, NULL);
  config.rays = 0;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_ARGUMENT, "rays is 0",
                 NULL);
  config = small_config(5, NULL);
  config.refresh_every = 2000000000000;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_ARGUMENT,
                 "refresh_every is 2000000000000", NULL);
  config = small_config(5, NULL);
  config.torso = true;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_ARGUMENT, "needs the head",
                 NULL);
  config = small_config(5, NULL);
  config.codes = 2;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_ARGUMENT,
                 "individual codes", NULL);
  config = small_config(5, NULL);
  config.data_begin = 4;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config), ERN_E_ARGUMENT, "frames 4",
                 NULL);
  made_close(&m);
}

static ern_status keep_psnr(void *user, uint64_t step, double psnr, size_t frames, const uint8_t *picture, int width,
                            int height, const char *name) {
  (void)step, (void)frames, (void)picture, (void)width, (void)height, (void)name;
  *(double *)user = psnr;
  return ERN_OK;
}

static double psnr_of_dubbed(struct made *m, ern_box dubbed) {
  double psnr = NAN;
  const ern_train_hooks hooks = {.user = &psnr, .validation = keep_psnr};
  ern_train_config config = small_config(1, NULL);
  config.ray_sampling = ERN_RAY_SAMPLING_DUB;
  m->dubbed = dubbed;
  support_ok(m->context, train(m, &config, &hooks));
  return psnr;
}

/* A box of what is dubbed that has no pixel in the picture counts as unknown: the PSNR is that of all of it. */
static void test_validation_without_a_box(void **state) {
  (void)state;
  static const ern_box outside[] = {{2, 8, SIDE, SIDE + 9}, {SIDE, SIDE + 4, 2, 8}, {-9, 0, 2, 8}, {8, 2, 2, 8}};
  struct made m;
  made_open(&m);
  const double whole = psnr_of_dubbed(&m, (ern_box){0});
  assert_true(psnr_of_dubbed(&m, (ern_box){2, 8, 2, 8}) != whole);
  for (size_t i = 0; i < sizeof outside / sizeof *outside; i++) assert_true(psnr_of_dubbed(&m, outside[i]) == whole);
  made_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_threads_long),
                                     cmocka_unit_test(test_seed),
                                     cmocka_unit_test(test_resume),
                                     cmocka_unit_test(test_torso_resume_long),
                                     cmocka_unit_test(test_damaged_state),
                                     cmocka_unit_test(test_nonfinite),
                                     cmocka_unit_test(test_lock),
                                     cmocka_unit_test(test_another_clip_or_configuration),
                                     cmocka_unit_test(test_earlier_training_untouched_long),
                                     cmocka_unit_test(test_earlier_is_kept_long),
                                     cmocka_unit_test(test_model_that_came_meanwhile),
                                     cmocka_unit_test(test_resume_past_the_end),
                                     cmocka_unit_test(test_stop_saves),
                                     cmocka_unit_test(test_lock_after_fork),
                                     cmocka_unit_test(test_from_long),
                                     cmocka_unit_test(test_ema),
                                     cmocka_unit_test(test_ema_before_its_time_long),
                                     cmocka_unit_test(test_ema_of_a_torso_long),
                                     cmocka_unit_test(test_refresh_every_long),
                                     cmocka_unit_test(test_bad_configuration),
                                     cmocka_unit_test(test_validation_without_a_box)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
