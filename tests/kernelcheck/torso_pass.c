/* SPDX-License-Identifier: MIT
 * The fused pass of the torso over a picture against its stages, in float and in double. */
#include "harness.h"

#include "model/parameters.h"
#include "model/torso_ops.h"
#include "render/render_ops.h"
#include "render/stages.h"

enum { PLANES = 4 /* red, green, blue, opacity */, SLACK = 21 /* of a plane, behind its pixels */ };

/* A field of random parameters and a picture to lay it over. */
struct scene {
  struct ern_model_config config;
  struct ern_field field;
  float *block, *cells, *planes;
  int width, height;
  struct ern_torso_place frame; /* zeros: the picture */
  size_t pixels, stride;
  float threshold;
};

enum choice { CHOOSE_SOME, CHOOSE_ALL, CHOOSE_NONE };

/* Tables of +-table: a trained one has values of about 0.1. `deform` scales the last layer of the deformation. */
static struct scene scene_make(int width, int height, enum choice choice, bool extras, float table, float deform) {
  static const float threshold[] = {0.01f, -2, 2};
  struct ern_parameter_table rows;
  struct scene scene = {.width = width, .height = height, .threshold = threshold[choice]};
  scene.config = (struct ern_model_config){.levels = 2,
                                           .feature_width = 29,
                                           .window_length = 16,
                                           .torso = true,
                                           .torso_gamma = extras,
                                           .codes = extras ? 5 : 0,
                                           .bound = 1};
  support_ok(machines.context, ern_parameters_build(machines.context, &scene.config, &scene.field, &rows));
  scene.block = floats(scene.field.parameters);
  ern_parameters_init(scene.block, &rows, true, machines_seed(7));
  fill_random(scene.block + scene.field.torso_table, 2 * (size_t)scene.field.torso_grid.entries, 8, table);
  if (extras) scene.block[scene.field.gamma] = 1.25f;
  for (size_t i = 0; i < 64; i++) scene.block[scene.field.torso_deform.weight[2] + i] *= deform;
  scene.pixels = (size_t)width * (size_t)height;
  scene.stride = scene.pixels + SLACK;
  scene.planes = floats(PLANES * scene.stride);
  fill_random(scene.planes, PLANES * scene.stride, 9, 1);
  scene.cells = floats(ERN_TORSO_CELLS);
  fill_random(scene.cells, ERN_TORSO_CELLS, 10, 1);
  return scene;
}

/* A scene on all machines, prepared. */
struct stage {
  struct many planes;
  struct ern_render_torso_args args[MACHINES];
};

static struct stage stage_make(const struct scene *scene) {
  static const float pose[16] = {0.1f, -0.99f, -0.03f, 0.19f, 0.06f,  0.04f, -1.02f, 3.04f,
                                 1.0f, 0.09f,  0.07f,  -0.2f, 0.003f, 0.01f, -0.02f, 1.0f};
  static float motion[2][ERN_MOTION_VALUES]; /* none, some */
  const struct many parameters = many_reals(scene->block, scene->field.parameters);
  const struct many grid = many_reals(scene->cells, ERN_TORSO_CELLS);
  for (size_t i = 0; i < ERN_MOTION_VALUES; i++) motion[1][i] = random_at(9, i, 0.05f);
  struct stage stage = {.planes = many_reals(scene->planes, PLANES * scene->stride)};
  EACH_MACHINE (k) {
    const ern_span planes = stage.planes.on[k];
    stage.args[k] = (struct ern_render_torso_args){
        .pixel = {ern_span_part(planes, 0, 3 * scene->stride), scene->stride, 3, ERN_PER_SAMPLE},
        .opacity = ern_span_part(planes, 3 * scene->stride, scene->pixels),
        .grid = grid.on[k],
        .threshold = scene->threshold,
        .width = scene->width,
        .height = scene->height,
        .frame = scene->frame,
        .shrink = 0.8f,
        .individual = scene->config.codes > 0 ? 3 : 0,
        .motion = motion[scene->width % 2 == 0],
        .parameters = parameters.on[k],
        .field = &scene->field};
    memcpy(stage.args[k].pose, pose, sizeof pose);
    struct ern_render_prepare_args prepare = {parameters.on[k], &scene->field};
    RUN_ON(k, render_prepare, &prepare);
  }
  return stage;
}

/* The planes of all machines; until machines_clear. */
struct painted {
  const float *on[MACHINES];
};

static struct painted paint(const struct scene *scene) {
  struct stage stage = stage_make(scene);
  struct painted painted;
  RUN(render_torso, stage.args);
  EACH_MACHINE (k) painted.on[k] = floats_of(k, stage.planes);
  return painted;
}

static double farthest(const struct scene *scene, const float *a, const float *b) {
  double most = 0;
  for (size_t i = 0; i < PLANES * scene->stride; i++) most = fmax(most, fabs((double)a[i] - (double)b[i]));
  return most;
}

/* Nothing is written outside the planes, a pixel that was not chosen keeps its bits, its opacity is 0. */
static size_t check_untouched(const struct scene *scene, const float *found, const float *reference) {
  const float *opacity = found + 3 * scene->stride;
  size_t chosen = 0;
  for (size_t i = 0; i < scene->pixels; i++) {
    const bool here = reference[3 * scene->stride + i] != 0;
    chosen += here;
    for (size_t c = 0; c < 3; c++) {
      const size_t at = c * scene->stride + i;
      if (!here && memcmp(&found[at], &scene->planes[at], sizeof *found) != 0) fail_msg("pixel %zu was not chosen", i);
      if (here && found[at] == scene->planes[at] && fabsf(opacity[i]) > 1e-3f) fail_msg("pixel %zu was left out", i);
    }
    if (!here) assert_true(opacity[i] == 0);
  }
  for (size_t p = 0; p < PLANES; p++) {
    const size_t end = p * scene->stride + scene->pixels;
    assert_memory_equal(found + end, scene->planes + end, SLACK * sizeof *found);
  }
  return chosen;
}

/* What float costs is how far the reference in float is from that in double. The fast pass adds in another order and
 * looks between other neighbours first; its cost is of the same size: at most twice the largest of the reference's in
 * the picture. In a picture of a few pixels the reference may be lucky: four roundings of a value of size 1 are always
 * granted. */
static const double most_times = 2, least = 0x1p-22;

static void check_scene(const struct scene *scene, const char *what, double bound) {
  const struct machines_mark mark = machines_mark();
  const struct painted painted = paint(scene);
  const float *exact = painted.on[0], *reference = painted.on[1];
  const double price = farthest(scene, reference, exact);
  for (int k = 2; k < machines.count; k++) {
    const float *found = painted.on[k];
    const size_t chosen = check_untouched(scene, found, reference);
    const double apart = farthest(scene, found, reference), error = farthest(scene, found, exact);
    print_message("%-7s %3d x %3d, %6zu chosen: %-10s to ref %.1e, to double %.1e (ref %.1e)\n", what, scene->width,
                  scene->height, chosen, machines.name[k], apart, error, price);
    if (scene->threshold > 1) assert_int_equal(chosen, 0);
    if (scene->threshold < -1) assert_int_equal(chosen, scene->pixels);
    for (size_t i = 0; i < PLANES * scene->stride; i++) assert_true(isfinite(found[i]));
    if (!(error <= most_times * price + least)) fail_msg("%s: off by %.2e", machines.name[k], error);
    if (!(apart <= bound)) fail_msg("%s: %.2e from the reference", machines.name[k], apart);
  }
  machines_clear_to(mark);
}

/* Values as training leaves them: the goal of 1e-5 at every pixel. */
static void test_trained(void **state) {
  (void)state;
  static const int sizes[][2] = {{1, 1},   {3, 7},   {7, 3},   {1, 40},  {40, 1},   {4, 4},
                                 {16, 32}, {17, 19}, {17, 33}, {61, 70}, {61, 130}, {450, 450}};
  for (size_t s = 0; s < COUNT_OF(sizes); s++) {
    const bool large = sizes[s][0] > 100;
    if ((is_emulated() && large) || (is_small() && sizes[s][1] > 70)) continue;
    const enum choice last = large && !is_long() ? CHOOSE_SOME : CHOOSE_NONE;
    for (enum choice choice = CHOOSE_SOME; choice <= last; choice++) {
      for (int extras = large; extras < 2; extras++) {
        if (is_emulated() || (!is_long() && !is_device(machines.count - 1)) ? extras != (int)(s % 2)
                                                                            : is_sampled() && extras == 0)
          continue;
        const struct scene scene = scene_make(sizes[s][0], sizes[s][1], choice, extras == 1, 0.1f, 1);
        check_scene(&scene, "trained", 1e-5);
        machines_clear();
      }
    }
  }
}

/* Inputs beside those that must be there: PoCL builds a kernel of its own for those without. */
static bool with_extras(bool wanted) { return wanted || is_sampled(); }

/* A frame that lies within the picture, covers it, or is partly beside it. */
static void test_placed(void **state) {
  (void)state;
  static const struct ern_torso_place frames[] = {{20, 0, 61, 61},     {0, 13, 40, 100}, {-30, 0, 61, 160},
                                                  {-7, -50, 161, 114}, {40, 90, 3, 5},   {-9, -9, 1, 1},
                                                  {9, 0, 17, 15},      {-20, -3, 40, 70}};
  for (size_t f = 0; f < COUNT_OF(frames); f++) {
    const bool narrow = f >= 6; /* all pixels of a picture of one column more than a register has */
    struct scene scene = narrow ? scene_make(17, 33, CHOOSE_ALL, with_extras(false), 0.1f, 1)
                                : scene_make(61, 100, CHOOSE_SOME, with_extras(f % 2 == 0), 0.1f, 1);
    scene.frame = frames[f];
    if (narrow || !is_small()) check_scene(&scene, "placed", 1e-5);
    machines_clear();
  }
}

/* A table that jumps by 2 between entries, and a deformation that the clamp holds at the edges for most pixels. */
static void test_rough(void **state) {
  (void)state;
  if (is_small()) skip();
  struct scene scene = scene_make(emulated_side(250), emulated_side(131), CHOOSE_ALL, true, 1, 1);
  check_scene(&scene, "rough", INFINITY);
  scene = scene_make(emulated_side(121), emulated_side(250), CHOOSE_ALL, with_extras(false), 0.1f, 40);
  check_scene(&scene, "held", INFINITY);
  machines_clear();
}

/* A NaN in the deformation: the table is not looked at, as in the reference, and the layer is what the rest makes it.
 */
static void test_not_a_number(void **state) {
  (void)state;
  struct scene scene = scene_make(33, 21, CHOOSE_SOME, true, 0.1f, 1);
  scene.block[scene.field.torso_deform.weight[2] + 3] = NAN;
  check_scene(&scene, "NaN", 1e-5);
  scene.block[scene.field.torso_net.weight[2] + 3] = NAN; /* of alpha: wherever the torso is */
  const struct painted painted = paint(&scene);
  EACH_OTHER (k)
    for (size_t i = 0; i < PLANES * scene.stride; i++)
      assert_int_equal(isnan(painted.on[k][i]), isnan(painted.on[1][i]));
  machines_clear();
}

static void test_threads(void **state) {
  (void)state;
  const struct scene scene = scene_make(emulated_side(210), emulated_side(130), CHOOSE_SOME, true, 0.1f, 1);
  EACH_OTHER (k) {
    const struct machines_mark mark = machines_mark();
    const float *one = NULL;
    if (is_device(k)) continue; /* its streams have none */
    for (int threads = 1; threads <= 4; threads *= 2) {
      struct ern_stream *own = stream_replace(k, threads);
      struct stage stage = stage_make(&scene);
      RUN_ON(k, render_torso, &stage.args[k]);
      const float *found = floats_of(k, stage.planes);
      if (one == NULL) one = found;
      assert_memory_equal(one, found, PLANES * scene.stride * sizeof *one);
      stream_restore(k, own);
    }
    machines_clear_to(mark);
  }
  machines_clear();
}

/* A field that the kernels are not made for goes through the stages; an opacity that is not wanted is not written. */
static void test_other_shapes(void **state) {
  (void)state;
  struct scene scene = scene_make(30, 20, CHOOSE_ALL, false, 0.1f, 1);
  scene.field.torso_grid.hashed = true;
  check_scene(&scene, "hashed", 1e-5);
  scene.field.torso_grid.hashed = false;
  const size_t colours = 3 * scene.stride;
  const struct painted with = paint(&scene);
  struct stage stage = stage_make(&scene);
  EACH_MACHINE (k) stage.args[k].opacity = (ern_span){0};
  RUN(render_torso, stage.args);
  EACH_OTHER (k) {
    const float *without = floats_of(k, stage.planes);
    assert_memory_equal(with.on[k], without, colours * sizeof *without);
    assert_memory_equal(without + colours, scene.planes + colours, scene.stride * sizeof *without);
  }
  machines_clear();
}

/* Memory that is refused is an error in words, and nothing is lost. Of the CPU: its backends read each other's arrays;
 * a device's failures are those of tests/faults. */
static struct ern_render_torso_args *refused_args;
static const char *refused_isa;
static ern_status one_picture(ern_context *context) {
  struct ern_stream *stream = NULL;
  struct ern_backend *backend = NULL;
  ern_backend_config config = ern_backend_config_default();
  config.isa = refused_isa;
  ern_status status = ern_backend_create(&backend, context, &config);
  if (status == ERN_OK) status = backend->stream_make(backend, 1, &stream);
  if (status == ERN_OK) status = backend->render_torso(stream, refused_args);
  if (backend != NULL) backend->stream_free(stream);
  ern_backend_free(&backend);
  return status;
}

static void test_no_memory(void **state) {
  (void)state;
  const struct scene scene = scene_make(9, 5, CHOOSE_ALL, false, 0.1f, 1);
  struct stage stage = stage_make(&scene);
  EACH_OTHER (k) {
    if (is_device(k)) continue;
    refused_args = &stage.args[k], refused_isa = machines.name[k];
    support_refuse_each(one_picture);
  }
  machines_clear();
}

/* Head and shoulders: a disc over a half ellipse, 46% of the cells. */
static void bench(void) {
  struct scene scene = scene_make(450, 450, CHOOSE_SOME, true, 0.1f, 1);
  for (int c = 0; c < ERN_TORSO_SIDE; c++) {
    for (int r = 0; r < ERN_TORSO_SIDE; r++) {
      const double x = (c - 63.5) / 64, y = (r - 63.5) / 64;
      const bool shoulders = y > 0.1 && x * x + (y - 1.1) * (y - 1.1) < 1, neck = fabs(x) < 0.3 && y > -0.2;
      scene.cells[c * ERN_TORSO_SIDE + r] = shoulders || neck ? 1 : 0;
    }
  }
  struct stage stage = stage_make(&scene);
  RUN_ON(1, render_torso, &stage.args[1]);
  const float *opacity = floats_of(1, stage.planes) + 3 * scene.stride;
  size_t chosen = 0;
  for (size_t i = 0; i < scene.pixels; i++) chosen += opacity[i] != 0;
  /* of the layers that are left to a pixel, without what rows and columns of the picture share */
  const double products = 3 * 32 * 32 + 32 * 2 + 32 * 4;
  printf("450 x 450 pixels, %.0f %% chosen\n", 100 * (double)chosen / (double)scene.pixels);
  BENCH_PRODUCTS("by pixel", scene.pixels, products * (double)chosen, render_torso, stage.args);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_trained),      cmocka_unit_test(test_placed),  cmocka_unit_test(test_rough),
    cmocka_unit_test(test_not_a_number), cmocka_unit_test(test_threads), cmocka_unit_test(test_other_shapes),
    cmocka_unit_test(test_no_memory),
};
NOUN(torso_pass, bench, .in_double = true)
