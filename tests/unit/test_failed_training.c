/* SPDX-License-Identifier: MIT
 * What the host answers with an error in a training costs no step that was made. */
#include <math.h>
#include <sys/stat.h>
#include <unistd.h>

#include "made_clip.h"

#include "backend_cpu/backend_cpu.h"
#include "train/trainer.h"

static void train_to(struct made *m, const char *output, uint64_t iters, int threads, uint64_t save_every) {
  ern_train_config config = small_config(iters, output);
  config.threads = threads;
  config.save_every = save_every;
  support_ok(m->context, train(m, &config, NULL));
}

static ern_status validation_hook(void *user, uint64_t step, double psnr, size_t frames, const uint8_t *picture,
                                  int width, int height, const char *name) {
  (void)step, (void)psnr, (void)frames, (void)picture, (void)width, (void)height, (void)name;
  return *(ern_status *)user;
}

/* The steps that a curve names. */
static void expect_curve(const char *path, const char *steps) {
  char line[256], found[256] = "";
  FILE *file = fopen(path, "r");
  while (file != NULL && fgets(line, sizeof line, file) != NULL) {
    unsigned step = 0;
    if (sscanf(line, "%u,", &step) == 1) snprintf(found + strlen(found), sizeof found - strlen(found), "%u ", step);
  }
  if (file != NULL) fclose(file);
  assert_string_equal(found, steps);
}

/* A validation that fails does not lose the model that is done, and has a word of its own. */
static void test_failed_validation_saves(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_status answer = ERN_E_MEDIA;
  made_open(&m);
  clear_run("unseen"), clear_run("seen");
  assert_int_equal(ern_model_load(&(ern_model *){NULL}, m.context, "nowhere"), ERN_E_MISSING); /* an older error */
  const ern_train_hooks hooks = {.user = &answer, .validation = validation_hook};
  ern_train_config config = small_config(4, "unseen.safetensors");
  config.save_every = config.validate_every = 2;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_expect(m.context, ern_trainer_run(trainer, &hooks), ERN_E_MEDIA,
                 "`validation` answered ERN_E_MEDIA at step 2", "step 2 is saved", NULL);
  assert_int_equal(access("unseen.run/state.safetensors", F_OK), 0);
  support_expect(m.context, ern_trainer_run(trainer, &hooks), ERN_E_MEDIA, "step 4 is saved", NULL);
  ern_trainer_free(&trainer);
  train_to(&m, "seen.safetensors", 4, 2, 2);
  expect_same("unseen.safetensors", "seen.safetensors");
  /* also where no save is due */
  clear_run("early");
  config.output = "early.safetensors", config.save_every = 4;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_expect(m.context, ern_trainer_run(trainer, &hooks), ERN_E_MEDIA, "step 2 is saved", NULL);
  assert_int_equal(access("early.run/state.safetensors", F_OK), 0);
  ern_trainer_free(&trainer);
  expect_curve("early.run/curve.csv", "");
  /* a resume makes up for it, and does so once */
  config.resume = true;
  for (int i = 0; i < 2; i++) {
    support_ok(m.context, train(&m, &config, NULL));
    expect_curve("early.run/curve.csv", "2 4 ");
  }
  config.resume = false;
  config.save_every = 2;
  /* values that are not sound are not saved */
  clear_run("unsound");
  answer = ERN_E_NONFINITE;
  config.output = "unsound.safetensors";
  support_expect(m.context, train(&m, &config, &hooks), ERN_E_NONFINITE, "answered ERN_E_NONFINITE", NULL);
  assert_int_not_equal(access("unsound.run/state.safetensors", F_OK), 0);
  made_close(&m);
}

static ern_status stop_at_frame(void *user, int split, size_t frame, const float *rgb, const uint8_t *truth) {
  (void)user, (void)split, (void)frame, (void)rgb, (void)truth;
  return ERN_E_CANCELLED;
}

/* Who stops within a validation has its step saved, though no save is due at it, and goes on from there. */
static void test_stop_within_a_validation_long(void **state) {
  (void)state;
  struct made m;
  ern_train_state saved;
  ern_model_info info;
  made_open(&m);
  clear_run("halted"), clear_run("whole");
  const ern_train_hooks hooks = {.validation_frame = stop_at_frame};
  ern_train_config config = small_config(4, "halted.safetensors");
  config.validate_every = 3;
  config.save_every = 0;
  support_expect(m.context, train(&m, &config, &hooks), ERN_E_CANCELLED, "step 3 is saved", NULL);
  support_ok(m.context, ern_train_state_describe(m.context, "halted.safetensors", &saved, &info));
  assert_int_equal(saved.step, 3);
  config.resume = true;
  support_ok(m.context, train(&m, &config, NULL));
  train_to(&m, "whole.safetensors", 4, 2, 0);
  expect_same("halted.safetensors", "whole.safetensors");
  config.output = NULL; /* nowhere to save it */
  config.resume = false;
  support_expect(m.context, train(&m, &config, &hooks), ERN_E_CANCELLED, "`validation_frame`", "at step 3", NULL);
  made_close(&m);
}

struct failing {
  struct made *made;
  int good; /* calls that are answered before one fails */
};

static ern_status failing_pixels(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso) {
  struct failing *failing = user;
  return failing->good-- == 0 ? ERN_E_IO : made_pixels(failing->made, split, index, truth, torso);
}

static ern_status failing_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  return made_frame(((struct failing *)user)->made, split, index, frame);
}

/* A picture that cannot be read costs no step that was made; a resume ends where a training without the fault does. */
static void test_failed_picture_saves(void **state) {
  (void)state;
  struct made m;
  made_open(&m);
  clear_run("whole"), clear_run("gap");
  train_to(&m, "whole.safetensors", 40, 2, 0);
  ern_train_config config = small_config(40, "gap.safetensors");
  struct failing failing = {&m, 32}; /* the occupancy grid is refreshed before step 33 */
  m.data.user = &failing;
  m.data.pixels = failing_pixels;
  m.data.frame = failing_frame;
  support_expect(m.context, train(&m, &config, NULL), ERN_E_IO, "`pixels` answered ERN_E_IO", "step 32 is saved", NULL);
  config.resume = true;
  support_ok(m.context, train(&m, &config, NULL));
  expect_same("whole.safetensors", "gap.safetensors");
  made_close(&m);
}

/* The model after a few steps through the stages, in which a device's next batch is drawn while it computes. ahead
 * false: each batch is drawn in its own step. */
static char *drawn_model(struct made *m, bool ahead, size_t *count) {
  const ern_train_config config = small_config(5, NULL);
  ern_trainer *trainer = NULL;
  ern_model *model = NULL;
  ern_train_report report;
  support_ok(m->context, ern_trainer_create(&trainer, m->backend, &m->data, &config));
  trainer->occupancy.cell_count = 64; /* all cells would take the reference seconds */
  for (uint64_t step = 1; step <= config.iters; step++) {
    support_ok(m->context, ern_trainer_step(trainer, &report));
    if (!ahead) trainer->batches.drawn.step = 0;
    const bool drawn = ahead && step < config.iters && ((struct failing *)m->data.user)->good != -1;
    assert_int_equal(trainer->batches.drawn.step, drawn ? step : 0);
  }
  support_ok(m->context, ern_trainer_model(trainer, &model));
  support_ok(m->context, ern_model_save(model, "drawn.safetensors"));
  ern_model_free(&model);
  ern_trainer_free(&trainer);
  return read_file("drawn.safetensors", count);
}

/* A batch that is drawn ahead is the step's own, also after a picture could not be read ahead. */
static void test_drawn_ahead(void **state) {
  (void)state;
  struct made m;
  size_t count = 0, ahead_count = 0;
  made_open(&m);
  ern_backend_free(&m.backend);
  support_ok(m.context, ern_cpu_backend_make(m.context, ERN_ISA_REF, &m.backend));
  struct failing failing = {&m, 1000};
  m.data.user = &failing;
  m.data.pixels = failing_pixels;
  m.data.frame = failing_frame;
  char *expected = drawn_model(&m, false, &count);
  for (int good = 3; good <= 1000; good += 997) {
    failing.good = good; /* the fourth call: for step 4, within step 3 */
    char *found = drawn_model(&m, true, &ahead_count);
    assert_int_equal(count, ahead_count);
    assert_memory_equal(expected, found, count);
    free(found);
  }
  free(expected);
  made_close(&m);
}

static void expect_untouched(const struct made *m, ern_trainer *trainer, const char *path, const char *kept) {
  support_expect(m->context, ern_trainer_save(trainer), ERN_E_IO, "lock", "nothing is saved", NULL);
  expect_same(path, kept);
}

/* What lies at X.run when the folder was moved, or when the program is in another working folder, is not this
 * training's. */
static void test_another_folder_long(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_train_report report;
  made_open(&m);
  clear_run("moved"), support_clear("aside.run"), support_clear("elsewhere");
  ern_train_config config = small_config(4, "moved.safetensors");
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_ok(m.context, ern_trainer_step(trainer, &report));
  assert_int_equal(rename("moved.run", "aside.run"), 0);
  support_expect(m.context, ern_trainer_save(trainer), ERN_E_IO, "moved.run/lock", "moved, removed or replaced", NULL);
  config.seed = 9;
  support_ok(m.context, train(&m, &config, NULL)); /* another training comes there */
  assert_int_equal(system("cp moved.run/state.safetensors kept.state && cp moved.safetensors kept.model"), 0);
  expect_untouched(&m, trainer, "moved.run/state.safetensors", "kept.state");
  expect_same("moved.safetensors", "kept.model");
  assert_int_equal(mkdir("elsewhere", 0777), 0);
  assert_int_equal(system("mv moved.run elsewhere && mv aside.run moved.run"), 0);
  assert_int_equal(chdir("elsewhere"), 0);
  expect_untouched(&m, trainer, "moved.run/state.safetensors", "../kept.state");
  assert_int_equal(chdir(".."), 0);
  support_ok(m.context, remove("moved.safetensors") == 0 ? ERN_OK : ERN_E_IO);
  support_ok(m.context, ern_trainer_save(trainer)); /* back in its own */
  ern_trainer_free(&trainer);
  made_close(&m);
}

static int step_to_the_end(void *user, const ern_train_report *report) {
  ern_train_report own;
  (void)report;
  while (ern_trainer_step(*(ern_trainer **)user, &own) == ERN_OK) continue;
  return 0;
}

/* What a callback has trained is saved too. */
static void test_steps_in_a_callback(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  made_open(&m);
  clear_run("inside"), clear_run("outside");
  ern_train_config config = small_config(100000, "inside.safetensors");
  config.iters = 40;
  config.validate_every = 2; /* progress is told with it */
  config.validate_frames = 1;
  const ern_train_hooks hooks = {.user = &trainer, .progress = step_to_the_end};
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &m.data, &config));
  support_ok(m.context, ern_trainer_run(trainer, &hooks));
  ern_trainer_free(&trainer);
  train_to(&m, "outside.safetensors", 40, 2, 0);
  expect_same("inside.safetensors", "outside.safetensors");
  made_close(&m);
}

/* A name that the model's file cannot hold is refused before the first step. */
static void test_names(void **state) {
  (void)state;
  struct made m;
  char longer[70];
  ern_trainer *trainer = NULL;
  made_open(&m);
  memset(longer, 'a', sizeof longer);
  longer[sizeof longer - 1] = 0;
  const ern_train_config config = small_config(2, NULL);
  const char *const speech[] = {"\xff\xfe", longer, NULL, NULL}, *const identity[] = {NULL, NULL, "\xc3(", longer},
                    *const said[] = {"kind of the speech is no UTF-8", "kind of the speech is longer",
                                     "identity is no UTF-8", "identity is longer"};
  for (size_t i = 0; i < 4; i++) {
    ern_dataset data = m.data;
    data.speech = speech[i];
    data.identity = identity[i];
    support_expect(m.context, ern_trainer_create(&trainer, m.backend, &data, &config), ERN_E_ARGUMENT, said[i], NULL);
    assert_null(trainer);
  }
  made_close(&m);
}

/* The network that made the features is kept in the model; what describes none is refused. */
static void test_network(void **state) {
  (void)state;
  struct made m;
  ern_trainer *trainer = NULL;
  ern_model *model = NULL;
  ern_model_info info;
  static const char network[] =
      "{\"kind\":\"mine\",\"rate\":16000,\"normalisation\":\"none\",\"piece_samples\":8080,\"context_samples\":0,"
      "\"row_samples\":400,\"width\":29,\"window_rows\":16}";
  made_open(&m);
  const ern_train_config config = small_config(2, NULL);
  ern_dataset data = m.data;
  data.speech = "other";
  data.speech_network = network;
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &data, &config), ERN_E_ARGUMENT, "kind other",
                 "mine", NULL);
  data.speech = "mine";
  data.speech_network = "{\"kind\":\"mine\"}";
  support_expect(m.context, ern_trainer_create(&trainer, m.backend, &data, &config), ERN_E_ARGUMENT,
                 "speech_network: rate is missing", NULL);
  assert_null(trainer);
  data.speech_network = network;
  support_ok(m.context, ern_trainer_create(&trainer, m.backend, &data, &config));
  support_ok(m.context, ern_trainer_model(trainer, &model));
  support_ok(m.context, ern_model_save(model, "network.safetensors"));
  ern_model_free(&model);
  support_ok(m.context, ern_model_load(&model, m.context, "network.safetensors"));
  ern_model_describe(model, &info);
  assert_string_equal(info.speech, "mine");
  assert_string_equal(info.speech_network, network);
  ern_model_free(&model);
  ern_trainer_free(&trainer);
  made_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_failed_validation_saves),
                                     cmocka_unit_test(test_stop_within_a_validation_long),
                                     cmocka_unit_test(test_failed_picture_saves),
                                     cmocka_unit_test(test_drawn_ahead),
                                     cmocka_unit_test(test_another_folder_long),
                                     cmocka_unit_test(test_steps_in_a_callback),
                                     cmocka_unit_test(test_names),
                                     cmocka_unit_test(test_network)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
