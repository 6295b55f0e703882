/* SPDX-License-Identifier: MIT
 * What the laboratory's functions do with NULL, with numbers out of range and with structures that nobody initialised.
 */
#include "arguments.h"
#include "ernerf-lab/bench.h"
#include "ernerf-lab/measured_files.h"
#include "ernerf-lab/synth.h"
#include "made_clip.h"

static struct world {
  ern_context *context;
  ern_backend *backend;
  struct made clip;
  ern_model *model;
  ern_bench_scene *scene;
} w;

/* ---- bench.h ----------------------------------------------------------------------------------------------------- */

static int say_kernel(void *user, const ern_bench_kernel *kernel) {
  (void)user, (void)kernel;
  return 0;
}

/* What all measurements take: backends and options. `call` uses backends, count and options. */
#define REFUSED_MEASUREMENT(call)                                \
  do {                                                           \
    ern_backend *some[9] = {w.backend}, *const *backends = NULL; \
    ern_bench_options options = ern_bench_options_default();     \
    size_t count = 1;                                            \
    REFUSED_ALONE(call);                                         \
    backends = some;                                             \
    count = 0;                                                   \
    REFUSED_ALONE(call);                                         \
    count = 9;                                                   \
    REFUSED(w.context, "9 backends, expected 1 to 8", call);     \
    count = 2;                                                   \
    REFUSED(w.context, "backends[k] is NULL", call);             \
    some[0] = NULL;                                              \
    REFUSED_ALONE(call);                                         \
    some[0] = w.backend;                                         \
    count = 1;                                                   \
    options.threads = -1;                                        \
    REFUSED(w.context, "threads is -1", call);                   \
    options.threads = ERN_THREADS_MOST + 1;                      \
    REFUSED(w.context, "threads is 257", call);                  \
    options = (ern_bench_options){.frames = 1, .rays = 1};       \
    REFUSED(w.context, "ern_bench_options_default", call);       \
  } while (0)

CHECK(ern_bench_options_default) { assert_int_not_equal(ern_bench_options_default().cookie, 0); }
CHECK(ern_bench_peaks) {
  ern_bench_machine machine;
  REFUSED_MEASUREMENT(ern_bench_peaks(backends, count, &options, &machine));
  REFUSED(w.context, "ern_bench_peaks: machine is NULL", ern_bench_peaks(&w.backend, 1, NULL, NULL));
}
CHECK(ern_bench_scene_make) {
  ern_bench_scene *made = w.scene;
  REFUSED_ALONE(ern_bench_scene_make(&made, NULL, 4, 4, 0));
  assert_null(made);
  REFUSED(w.context, "ern_bench_scene_make: scene is NULL", ern_bench_scene_make(NULL, w.context, 4, 4, 0));
  REFUSED(w.context, "size is -1 x 4", ern_bench_scene_make(&made, w.context, -1, 4, 0));
}
CHECK(ern_bench_scene_of) {
  static float windows[8 * 16 * WIDTH];
  ern_bench_scene *made = w.scene;
  const uint8_t *truth = w.clip.truth[0];
  ern_frame_input frame = {.camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = windows,
                           .window_length = 16,
                           .background = w.clip.background};
  const float matrix[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.8f, 0, 0, 0, 1};
  ern_camera_pose(frame.camera.pose, matrix, 4);
  REFUSED_ALONE(ern_bench_scene_of(&made, NULL, w.model, &frame, truth, NULL));
  assert_null(made);
  REFUSED(w.context, "scene is NULL", ern_bench_scene_of(NULL, w.context, w.model, &frame, truth, NULL));
  REFUSED(w.context, "model is NULL", ern_bench_scene_of(&made, w.context, NULL, &frame, truth, NULL));
  REFUSED(w.context, "frame is NULL", ern_bench_scene_of(&made, w.context, w.model, NULL, truth, NULL));
  REFUSED(w.context, "truth is NULL", ern_bench_scene_of(&made, w.context, w.model, &frame, NULL, NULL));
  frame.background = NULL;
  REFUSED(w.context, "background is NULL", ern_bench_scene_of(&made, w.context, w.model, &frame, truth, NULL));
  frame.background = w.clip.background;
  frame.window_length = -1;
  REFUSED(w.context, "window_length is -1", ern_bench_scene_of(&made, w.context, w.model, &frame, truth, NULL));
  frame.window_length = 16;
  support_ok(w.context, ern_bench_scene_of(&made, w.context, w.model, &frame, truth, NULL));
  ern_bench_scene_free(&made);
}
CHECK(ern_bench_scene_free) {
  ern_bench_scene *none = NULL;
  ern_bench_scene_free(NULL);
  ern_bench_scene_free(&none);
}
CHECK(ern_bench_sample_flops) { assert_true(ern_bench_sample_flops(NULL) == 0); }
CHECK(ern_bench_scene_describe) {
  ern_bench_scene_info info;
  REFUSED(w.context, "backend is NULL", ern_bench_scene_describe(w.scene, NULL, 1, &info));
  REFUSED(w.context, "scene is NULL", ern_bench_scene_describe(NULL, w.backend, 1, &info));
  REFUSED(w.context, "info is NULL", ern_bench_scene_describe(w.scene, w.backend, 1, NULL));
  REFUSED(w.context, "found -1", ern_bench_scene_describe(w.scene, w.backend, -1, &info));
}
CHECK(ern_bench_kernels) {
  REFUSED_MEASUREMENT(ern_bench_kernels(backends, count, w.scene, NULL, &options, say_kernel, NULL));
  REFUSED(w.context, "scene is NULL", ern_bench_kernels(&w.backend, 1, NULL, NULL, NULL, say_kernel, NULL));
  REFUSED(w.context, "say is NULL", ern_bench_kernels(&w.backend, 1, w.scene, NULL, NULL, NULL, NULL));
}
CHECK(ern_bench_frame) {
  ern_bench_pass passes[9];
  REFUSED_MEASUREMENT(ern_bench_frame(backends, count, w.scene, NULL, &options, passes));
  REFUSED(w.context, "scene is NULL", ern_bench_frame(&w.backend, 1, NULL, NULL, NULL, passes));
  REFUSED(w.context, "results is NULL", ern_bench_frame(&w.backend, 1, w.scene, NULL, NULL, NULL));
}
CHECK(ern_bench_step) {
  ern_bench_pass passes[9];
  REFUSED_MEASUREMENT(ern_bench_step(backends, count, w.scene, NULL, &options, false, passes));
  REFUSED(w.context, "scene is NULL", ern_bench_step(&w.backend, 1, NULL, NULL, NULL, false, passes));
  REFUSED(w.context, "results is NULL", ern_bench_step(&w.backend, 1, w.scene, NULL, NULL, false, NULL));
}
CHECK(ern_bench_collisions) {
  ern_bench_collision_table out;
  REFUSED_ALONE(ern_bench_collisions(NULL, w.scene, &out));
  REFUSED(w.context, "scene is NULL", ern_bench_collisions(w.backend, NULL, &out));
  REFUSED(w.context, "table is NULL", ern_bench_collisions(w.backend, w.scene, NULL));
}

/* ---- synth.h ----------------------------------------------------------------------------------------------------- */

CHECK(ern_synth_options_default) { assert_int_not_equal(ern_synth_options_default().cookie, 0); }
CHECK(ern_synth_write) {
  ern_synth_options options = ern_synth_options_default();
  REFUSED_ALONE(ern_synth_write(NULL, "made", &options));
  REFUSED(w.context, "folder is NULL", ern_synth_write(w.context, NULL, &options));
  REFUSED(w.context, "options is NULL", ern_synth_write(w.context, "made", NULL));
  REFUSED(w.context, "ern_synth_options_default",
          ern_synth_write(w.context, "made", &(ern_synth_options){.size = 64, .frames = 8}));
  options.frames = -1;
  REFUSED(w.context, "frames is -1", ern_synth_write(w.context, "made", &options));
}

/* ---- measured_files.h -------------------------------------------------------------------------------------------- */

CHECK(ern_table_read) {
  const char *const names[] = {"a", "b", NULL};
  ern_table table = {.rows = 7};
  REFUSED_ALONE(ern_table_read(NULL, "t.csv", names, 2, &table));
  assert_int_equal(table.rows, 0);
  REFUSED(w.context, "path is NULL", ern_table_read(w.context, NULL, names, 2, &table));
  REFUSED(w.context, "names is NULL", ern_table_read(w.context, "t.csv", NULL, 2, &table));
  REFUSED(w.context, "names[k] is NULL", ern_table_read(w.context, "t.csv", names, 3, &table));
  REFUSED(w.context, "table is NULL", ern_table_read(w.context, "t.csv", names, 2, NULL));
  REFUSED(w.context, "33 columns", ern_table_read(w.context, "t.csv", names, 33, &table));
  support_write_text("t.csv", " b, c\n 1, 2\n 3, 4\n");
  support_ok(w.context, ern_table_read(w.context, "t.csv", names, 2, &table));
  assert_true(table.rows == 2 && table.columns[0] == NULL && table.columns[1][1] == 3);
  ern_table_free(w.context, &table);
  support_write_text("t.csv", "b\n1\nx\n");
  support_expect(w.context, ern_table_read(w.context, "t.csv", names, 2, &table), ERN_E_FORMAT, "line 3", "\"x\"",
                 NULL);
  assert_true(table.rows == 0 && table.columns[1] == NULL);
}
CHECK(ern_table_free) {
  ern_table table = {.rows = 0};
  ern_table_free(NULL, &table);
  ern_table_free(w.context, NULL);
  ern_table_free(w.context, &table);
}
CHECK(ern_points_read) {
  float points[68][2];
  REFUSED_ALONE(ern_points_read(NULL, "a.lms", points));
  REFUSED(w.context, "path is NULL", ern_points_read(w.context, NULL, points));
  REFUSED(w.context, "points is NULL", ern_points_read(w.context, "a.lms", NULL));
}
/* ------------------------------------------------------------------------------------------------------------------ */

static const struct arguments_check table[] = {ROW(ern_bench_options_default),
                                               ROW(ern_bench_peaks),
                                               ROW(ern_bench_scene_make),
                                               ROW(ern_bench_scene_of),
                                               ROW(ern_bench_scene_free),
                                               ROW(ern_bench_sample_flops),
                                               ROW(ern_bench_scene_describe),
                                               ROW(ern_bench_kernels),
                                               ROW(ern_bench_frame),
                                               ROW(ern_bench_step),
                                               ROW(ern_bench_collisions),
                                               ROW(ern_synth_options_default),
                                               ROW(ern_synth_write),
                                               ROW(ern_table_read),
                                               ROW(ern_table_free),
                                               ROW(ern_points_read)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("src/lab/include/ernerf-lab/bench.h", table, CHECKS) +
                       arguments_cover("src/lab/include/ernerf-lab/synth.h", table, CHECKS) +
                       arguments_cover("src/lab/include/ernerf-lab/measured_files.h", table, CHECKS),
                   CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  ern_trainer *trainer = NULL;
  made_open(&w.clip);
  w.context = w.clip.context;
  w.backend = w.clip.backend;
  const ern_train_config config = small_config(1, NULL);
  support_ok(w.context, ern_trainer_create(&trainer, w.backend, &w.clip.data, &config));
  support_ok(w.context, ern_trainer_model(trainer, &w.model));
  ern_trainer_free(&trainer);
  support_ok(w.context, ern_bench_scene_make(&w.scene, w.context, 8, 8, 1));
  arguments_run(table, CHECKS);
  ern_bench_scene_free(&w.scene);
  ern_model_free(&w.model);
  made_close(&w.clip);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
