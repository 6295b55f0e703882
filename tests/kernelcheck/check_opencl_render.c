/* SPDX-License-Identifier: MIT
 * The fused passes of rendering on an OpenCL device against the stages of the CPU's reference. `--bench` measures a
 * 450 x 450 view of a made-up head against the CPU's best instruction set. */
#include <time.h>

#include "twin.h"

#include "model/parameters.h"
#include "render/morton.h"

enum { OUTPUTS = 10 /* pixel 3, colour 3, opacity, depth, attention, eye */ };
static const char *const output_name[OUTPUTS] = {"red",         "green",   "blue",  "sum of red", "sum of green",
                                                 "sum of blue", "opacity", "depth", "attention",  "eye"};

static ern_context *context;
static struct twin twin;

struct scene {
  struct ern_model_config config;
  struct ern_field field;
  float *block, *background;
  uint8_t *bits;
  struct ern_view view;
  struct ern_march_settings settings;
  float stop, log_sigma, eye_value, code[ERN_AUDIO_CODE];
  int32_t *pixel;
  size_t rays;
};

static void *room(size_t count, size_t bytes) {
  void *memory = calloc(count > 0 ? count : 1, bytes);
  assert_non_null(memory);
  return memory;
}

/* Cells between two radii around the middle of the head's box. */
static void fill_shell(uint8_t *bits, float inner, float outer) {
  for (uint32_t number = 0; number < ERN_OCCUPANCY_CELLS; number++) {
    const float x = (float)ern_morton_gather(number) / 64 - 1, y = (float)ern_morton_gather(number >> 1) / 64 - 1,
                z = (float)ern_morton_gather(number >> 2) / 64 - 1, r = sqrtf(x * x + y * y + z * z);
    if (r >= inner && r <= outer) bits[number >> 3] |= (uint8_t)(1u << (number & 7));
  }
}

/* Random parameters; `log_sigma` is about what the density's exponent spreads over. */
static struct scene scene_make_of(bool view, int levels, bool eye, int codes, int width, int height, float log_sigma) {
  struct scene scene = {.stop = 1e-4f, .log_sigma = log_sigma, .eye_value = 0.4f};
  struct ern_parameter_table rows;
  scene.config = (struct ern_model_config){.levels = levels,
                                           .feature_width = 29,
                                           .window_length = 16,
                                           .head = true,
                                           .eye = eye,
                                           .no_view = !view,
                                           .codes = codes,
                                           .bound = 1};
  support_ok(context, ern_parameters_build(context, &scene.config, &scene.field, &rows));
  scene.block = room(scene.field.parameters, sizeof(float));
  ern_parameters_init(scene.block, &rows, false, 11);
  for (int plane = 0; plane < ERN_PLANES; plane++)
    twin_fill(scene.block + scene.field.encoder.table[plane], scene.field.encoder.grid[plane].entries,
              3 + (uint64_t)plane, 1);
  const struct ern_mlp *density = &scene.field.density;
  for (size_t i = 0; i < 64; i++) scene.block[density->weight[2] + i] *= log_sigma;
  scene.bits = room(ERN_OCCUPANCY_BYTES, 1);
  fill_shell(scene.bits, 0.2f, 0.45f);
  /* the pose of a head that is looked at from 3.4 units ahead */
  scene.view = (struct ern_view){
      .pose = {0.02f, -0.99f, 0.05f, 0.03f, 0.03f, -0.05f, -0.99f, 3.4f, 0.99f, 0.02f, 0.03f, -0.05f, 0, 0, 0, 1},
      .focal = 2.7f * (float)width,
      .cx = (float)width / 2,
      .cy = (float)height / 2,
      .width = width,
      .height = height};
  scene.settings = (struct ern_march_settings){1, 16, 1.0f / 256, 0.05f};
  twin_fill(scene.code, ERN_AUDIO_CODE, 5, 1);
  scene.rays = (size_t)width * (size_t)height;
  scene.pixel = room(scene.rays, sizeof(int32_t));
  scene.background = room(3 * scene.rays, sizeof(float));
  for (size_t i = 0; i < scene.rays; i++) scene.pixel[i] = (int32_t)i;
  for (size_t i = 0; i < 3 * scene.rays; i++) scene.background[i] = 0.5f + twin_random(6, i, 0.5f);
  return scene;
}
static struct scene scene_make(int levels, bool eye, int codes, int width, int height, float log_sigma) {
  return scene_make_of(true, levels, eye, codes, width, height, log_sigma);
}

static void scene_free(struct scene *scene) {
  free(scene->block), free(scene->background), free(scene->bits), free(scene->pixel);
}

/* A scene on both backends, ready to be rendered. */
struct stage {
  struct twin_rows out;
  struct ern_render_rays_args args[2];
};

static struct stage stage_make(const struct scene *scene, bool all) {
  struct stage stage;
  const struct twin_span block = twin_reals(&twin, scene->block, scene->field.parameters);
  const struct twin_span code = twin_reals(&twin, scene->code, ERN_AUDIO_CODE);
  const struct twin_span bits = twin_bytes(&twin, scene->bits, ERN_OCCUPANCY_BYTES);
  const struct twin_span pixel = twin_int32s(&twin, scene->pixel, scene->rays);
  const struct twin_rows background = twin_rows_of(&twin, scene->background, 3, scene->rays, ERN_PER_RAY);
  stage.out = twin_rows_of(&twin, NULL, OUTPUTS, scene->rays, ERN_PER_RAY);
  for (int k = 0; k < 2; k++) {
    const ern_rows out = stage.out.on[k];
    struct ern_render_rays_args *args = &stage.args[k];
    *args = (struct ern_render_rays_args){.pixel = ern_rows_part(out, 0, 3),
                                          .opacity = ern_span_of_row(out, 6, scene->rays),
                                          .pixel_number = pixel.on[k],
                                          .view = scene->view,
                                          .background = background.on[k],
                                          .bits = bits.on[k],
                                          .parameters = block.on[k],
                                          .field = &scene->field,
                                          .code = code.on[k],
                                          .eye_value = scene->eye_value,
                                          .individual = 1,
                                          .settings = scene->settings,
                                          .transmittance_stop = scene->stop,
                                          .n = scene->rays};
    if (all) {
      args->colour = ern_rows_part(out, 3, 3);
      args->depth = ern_span_of_row(out, 7, scene->rays);
      args->attention = ern_span_of_row(out, 8, scene->rays);
      args->eye = ern_span_of_row(out, 9, scene->rays);
    }
    struct ern_render_prepare_args prepare = {block.on[k], &scene->field};
    support_ok(context, twin.backend[k]->render_prepare(twin.stream[k], &prepare));
  }
  return stage;
}

/* Folding two layers and the audio code changes the order of sums: of numbers of about 1, some hundred roundings of
 * 2^-24. A transmittance within rounding of the stop may let one sample more or less count: `stop` of a colour, and of
 * the unweighted sums a whole sample, which is why those are held only where nothing stops. */
static double allowed_of(const struct scene *scene) { return 4e-5 + 2 * (double)scene->stop; }

/* Of rows `first` to `last` everything is near the reference; poison is where it was. */
static void check_rows(const struct scene *scene, const char *what, const struct stage *stage, int first, int last) {
  const double allowed = allowed_of(scene);
  for (int row = first; row < last; row++) {
    float *values[2];
    for (int k = 0; k < 2; k++) {
      values[k] = room(scene->rays, sizeof(float));
      support_ok(context,
                 twin.backend[k]->download_reals(twin.stream[k], values[k],
                                                 ern_span_of_row(stage->out.on[k], row, scene->rays), scene->rays));
    }
    for (size_t i = 0; i < scene->rays; i++)
      if (!twin_near(values[1][i], values[0][i], allowed, allowed))
        fail_msg("%s: %s of ray %zu of %zu is %.9g, expected %.9g", what, output_name[row], i, scene->rays,
                 (double)values[1][i], (double)values[0][i]);
    free(values[0]), free(values[1]);
  }
}

/* No value between the rows or outside of them was written. */
static void check_gaps(const struct scene *scene, const char *what, const struct stage *stage) {
  const ern_rows out = stage->out.on[1];
  float *values = twin_down(&twin, 1, out.span);
  for (size_t i = 0; i < out.span.count + 2 * TWIN_GUARD; i++) {
    const bool inside =
        i >= TWIN_GUARD && i < TWIN_GUARD + out.span.count && (i - TWIN_GUARD) % out.stride < scene->rays;
    if (!inside && values[i] != TWIN_POISON) fail_msg("%s: %g was written outside", what, (double)values[i]);
  }
  free(values);
}

static void check_scene(const struct scene *scene, const char *what) {
  struct stage stage = stage_make(scene, true);
  TWIN_RUN(&twin, render_rays, stage.args);
  const bool stops = scene->stop > 0;
  check_rows(scene, what, &stage, 0, stops ? 8 : scene->config.eye ? 10 : 9);
  check_gaps(scene, what, &stage);
  twin_clear(&twin);
}

static void test_models(void **state) {
  (void)state;
  for (int variant = 0; variant < 8; variant++) {
    const int levels = variant & 1 ? 14 : variant & 2 ? 12 : 2;
    struct scene scene = scene_make(levels, (variant & 2) != 0, variant & 4 ? 3 : 0, 45, 37, 8);
    char what[64];
    snprintf(what, sizeof what, "levels %d, eye %d, codes %d", levels, scene.config.eye, scene.config.codes);
    check_scene(&scene, what);
    scene.stop = 3e-3f;
    check_scene(&scene, what);
    scene.stop = 0;
    check_scene(&scene, what);
    scene_free(&scene);
  }
}

static void test_without_view(void **state) {
  (void)state;
  for (int codes = 0; codes <= 2; codes += 2) {
    struct scene scene = scene_make_of(false, 12, codes > 0, codes, 33, 26, 8);
    check_scene(&scene, codes > 0 ? "no view" : "no view, no codes, no eye");
    scene_free(&scene);
  }
}

/* ---- rays: occupancies, lists, settings -------------------------------------------------------------------------- */

static void test_occupancies(void **state) {
  (void)state;
  for (int variant = 0; variant < 3; variant++) {
    struct scene scene = scene_make(12, true, 2, 33, 26, variant == 2 ? 40 : 4);
    if (variant == 0) memset(scene.bits, 0, ERN_OCCUPANCY_BYTES);
    if (variant == 1) memset(scene.bits, 0xff, ERN_OCCUPANCY_BYTES);
    static const char *const what[] = {"nothing occupied", "all occupied", "dense"};
    check_scene(&scene, what[variant]);
    scene.stop = 0.3f;
    check_scene(&scene, what[variant]);
    scene_free(&scene);
  }
}

static void test_settings(void **state) {
  (void)state;
  static const int steps[] = {1, 2, 300, ERN_MAX_STEPS};
  for (size_t k = 0; k < sizeof steps / sizeof *steps; k++) {
    struct scene scene = scene_make(12, true, 2, 17, 17, 4);
    char what[64];
    scene.settings.max_steps = steps[k];
    snprintf(what, sizeof what, "%d steps", steps[k]);
    check_scene(&scene, what);
    scene_free(&scene);
  }
}

/* Rays that are no whole picture, and one that is, but in another order. */
static void test_lists_of_pixels(void **state) {
  (void)state;
  static const size_t counts[] = {1, 2, 15, 16, 17, 47, 48, 49, 65, 500, 900};
  struct scene scene = scene_make(12, true, 2, 30, 30, 8);
  for (size_t k = 0; k < sizeof counts / sizeof *counts; k++) {
    char what[64];
    scene.rays = counts[k];
    for (size_t i = 0; i < scene.rays; i++)
      scene.pixel[i] = (int32_t)ern_below(ern_random_at(9, 0, (uint32_t)i, ERN_RNG_INIT).word[0], 900);
    snprintf(what, sizeof what, "%zu of 900 pixels", scene.rays);
    check_scene(&scene, what);
  }
  scene_free(&scene);
}

/* No ray; a stream that nothing was prepared on, or for other parameters, goes through the stages. */
static void test_unprepared(void **state) {
  (void)state;
  struct scene scene = scene_make(2, false, 0, 9, 8, 8);
  struct stage stage = stage_make(&scene, true), other = stage_make(&scene, true);
  TWIN_RUN(&twin, render_rays, stage.args);
  check_rows(&scene, "other parameters", &stage, 0, 8);
  for (int k = 0; k < 2; k++) other.args[k].n = 0;
  TWIN_RUN(&twin, render_rays, other.args);
  float *values = twin_down(&twin, 1, other.out.on[1].span);
  for (size_t i = 0; i < other.out.on[1].span.count + 2 * TWIN_GUARD; i++) assert_true(values[i] == TWIN_POISON);
  free(values);
  twin_clear(&twin);
  scene_free(&scene);
}

/* ---- torso ------------------------------------------------------------------------------------------------------- */

/* How far sums in another order, and a table that is looked up between other neighbours first, may take a colour: a
 * hundred roundings of values of size 1, times the slopes that the encoding's last octave and the table give to the
 * deformation's error. The goal of a rendered pixel is 1e-3. */
static const double torso_tolerance = 2e-5;

static void check_torso(int width, int height, struct ern_torso_place frame, float threshold, bool extras,
                        const char *what) {
  struct ern_parameter_table rows;
  struct ern_field field;
  struct ern_model_config config = {.levels = 2,
                                    .feature_width = 29,
                                    .window_length = 16,
                                    .torso = true,
                                    .torso_gamma = extras,
                                    .codes = extras ? 5 : 0,
                                    .bound = 1};
  static const float pose[16] = {0.1f, -0.99f, -0.03f, 0.19f, 0.06f,  0.04f, -1.02f, 3.04f,
                                 1.0f, 0.09f,  0.07f,  -0.2f, 0.003f, 0.01f, -0.02f, 1.0f};
  support_ok(context, ern_parameters_build(context, &config, &field, &rows));
  float *block = room(field.parameters, sizeof(float)), *cells = room(ERN_TORSO_CELLS, sizeof(float));
  const size_t pixels = (size_t)width * (size_t)height;
  float *planes = room(3 * pixels, sizeof(float));
  ern_parameters_init(block, &rows, true, 7);
  twin_fill(block + field.torso_table, 2 * (size_t)field.torso_grid.entries, 8, 0.1f);
  twin_fill(cells, ERN_TORSO_CELLS, 10, 1);
  twin_fill(planes, 3 * pixels, 9, 1);
  if (extras) block[field.gamma] = 1.25f;
  const struct twin_span parameters = twin_reals(&twin, block, field.parameters);
  const struct twin_span grid = twin_reals(&twin, cells, ERN_TORSO_CELLS);
  const struct twin_span opacity = twin_take(&twin, ERN_ELEMENT_REAL, pixels);
  const struct twin_rows pixel = twin_rows_of(&twin, planes, 3, pixels, ERN_PER_SAMPLE);
  struct ern_render_torso_args args[2];
  for (int k = 0; k < 2; k++) {
    args[k] = (struct ern_render_torso_args){.pixel = pixel.on[k],
                                             .opacity = opacity.on[k],
                                             .grid = grid.on[k],
                                             .threshold = threshold,
                                             .width = width,
                                             .height = height,
                                             .frame = frame,
                                             .shrink = 0.8f,
                                             .individual = extras ? 3 : 0,
                                             .parameters = parameters.on[k],
                                             .field = &field};
    memcpy(args[k].pose, pose, sizeof pose);
    struct ern_render_prepare_args prepare = {parameters.on[k], &field};
    support_ok(context, twin.backend[k]->render_prepare(twin.stream[k], &prepare));
  }
  TWIN_RUN(&twin, render_torso, args);
  print_message("%s, %d x %d\n", what, width, height);
  twin_same_rows(&twin, "torso", pixel, torso_tolerance, torso_tolerance);
  twin_same(&twin, "torso's opacity", opacity, torso_tolerance, torso_tolerance);
  twin_clear(&twin);
  free(block), free(cells), free(planes);
}

static void test_torso(void **state) {
  (void)state;
  const struct ern_torso_place whole = {0}, within = {9, 0, 17, 15}, beyond = {-20, -3, 40, 70};
  check_torso(17, 33, within, -2, false, "a frame within the picture");
  check_torso(17, 33, beyond, -2, false, "a frame beyond the picture");
  static const int sizes[][2] = {{1, 1}, {3, 7}, {1, 40}, {40, 1}, {16, 32}, {17, 33}, {61, 70}};
  for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
    check_torso(sizes[s][0], sizes[s][1], whole, 0.01f, s % 2 == 0, "some pixels");
    check_torso(sizes[s][0], sizes[s][1], whole, -2, s % 2 == 1, "all pixels");
    check_torso(sizes[s][0], sizes[s][1], whole, 2, s % 2 == 1, "no pixel");
  }
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

/* Seconds that passed, and of the processor, which tell where others run too. */
struct seconds {
  double passed, processor;
};
static double clock_of(clockid_t clock) {
  struct timespec t;
  clock_gettime(clock, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void frame_seconds(struct seconds *least, int k, struct stage *stage) {
  float value;
  const double began = clock_of(CLOCK_MONOTONIC), cpu_began = clock_of(CLOCK_PROCESS_CPUTIME_ID);
  support_ok(context, twin.backend[k]->render_rays(twin.stream[k], &stage->args[k]));
  support_ok(context, twin.backend[k]->download_reals(twin.stream[k], &value, stage->args[k].opacity, 1));
  least->passed = fmin(least->passed, clock_of(CLOCK_MONOTONIC) - began);
  least->processor = fmin(least->processor, clock_of(CLOCK_PROCESS_CPUTIME_ID) - cpu_began);
}

static int measure(void) {
  context = support_context();
  twin_open(&twin, context);
  twin.backend[0]->stream_free(twin.stream[0]);
  ern_backend_free(&twin.backend[0]);
  support_ok(context, ern_backend_create(&twin.backend[0], context, NULL));
  support_ok(context, twin.backend[0]->stream_make(twin.backend[0], 0, &twin.stream[0]));
  struct scene scene = scene_make(14, true, 2, 450, 450, 8);
  struct stage stage = stage_make(&scene, false);
  struct seconds least[2] = {{1e9, 1e9}, {1e9, 1e9}};
  for (int turn = 0; turn < 10; turn++)
    for (int k = 0; k < 2; k++) frame_seconds(&least[k], k, &stage);
  printf("450 x 450: cpu %.2f ms, device %.2f ms, %.0f %% of its speed; processor time %.2f and %.2f ms, %.0f %%\n",
         least[0].passed * 1e3, least[1].passed * 1e3, 100 * least[0].passed / least[1].passed,
         least[0].processor * 1e3, least[1].processor * 1e3, 100 * least[0].processor / least[1].processor);
  scene_free(&scene);
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) return measure();
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_models),   cmocka_unit_test(test_without_view),    cmocka_unit_test(test_occupancies),
      cmocka_unit_test(test_settings), cmocka_unit_test(test_lists_of_pixels), cmocka_unit_test(test_unprepared),
      cmocka_unit_test(test_torso)};
  return cmocka_run_group_tests_name("opencl render", tests, set_up, tear_down);
}
