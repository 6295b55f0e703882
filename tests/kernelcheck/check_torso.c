/* SPDX-License-Identifier: MIT
 * The torso over a picture, as each instruction set's table does it, against its stages in float and in double. */
#include "kernelcheck.h"

#include "backend_cpu/backend_cpu.h"
#include "model/parameters.h"
#include "render/stages.h"

enum { PLANES = 4, SLACK = 21 /* of a plane, behind its pixels */ };

/* A field of random parameters and a picture to lay it over. */
struct scene {
  ern_context *context;
  struct ern_model_config config;
  struct ern_field field;
  float *block, *occupancy, *planes; /* planes: r, g, b, opacity */
  int width, height;
  struct ern_torso_place frame; /* zeros: the picture */
  size_t pixels, stride;
  float threshold;
};

static float *floats(size_t count) {
  float *values = calloc(count, sizeof *values);
  assert_non_null(values);
  return values;
}

enum choice { CHOOSE_SOME, CHOOSE_ALL, CHOOSE_NONE };

/* Tables of +-table: a trained one has values of about 0.1. `deform` scales the last layer of the deformation. */
static void scene_make(struct scene *scene, int width, int height, enum choice choice, bool extras, float table,
                       float deform) {
  struct ern_parameter_table rows;
  *scene = (struct scene){.context = support_context(), .width = width, .height = height};
  scene->config = (struct ern_model_config){
      .levels = 2, .feature_width = 29, .window_length = 16, .torso = true, .torso_gamma = extras, .bound = 1};
  if (extras) scene->config.codes = 5;
  support_ok(scene->context, ern_parameters_build(scene->context, &scene->config, &scene->field, &rows));
  scene->block = floats(scene->field.parameters);
  ern_parameters_init(scene->block, &rows, true, 7);
  for (size_t i = 0; i < 2 * (size_t)scene->field.torso_grid.entries; i++)
    scene->block[scene->field.torso_table + i] = random_at(8, i, table);
  if (extras) scene->block[scene->field.gamma] = 1.25f;
  for (size_t i = 0; i < 64; i++) scene->block[scene->field.torso_deform.weight[2] + i] *= deform;
  scene->pixels = (size_t)width * (size_t)height;
  scene->stride = scene->pixels + SLACK;
  scene->planes = floats(PLANES * scene->stride);
  for (size_t i = 0; i < PLANES * scene->stride; i++) scene->planes[i] = 0.5f + random_at(9, i, 0.5f);
  scene->occupancy = floats(ERN_TORSO_CELLS);
  for (size_t i = 0; i < ERN_TORSO_CELLS; i++) scene->occupancy[i] = random_at(10, i, 1);
  scene->threshold = choice == CHOOSE_ALL ? -2 : choice == CHOOSE_NONE ? 2 : 0.01f;
}

static void scene_free(struct scene *scene) {
  free(scene->block), free(scene->occupancy), free(scene->planes);
  ern_context_free(&scene->context);
}

/* A table with the scene on it. */
struct stage {
  struct ern_backend *backend;
  struct ern_stream *stream;
  struct ern_buffer *parameters, *occupancy, *planes;
  struct ern_render_torso_args args;
};

static ern_span whole(struct ern_buffer *buffer, size_t count) { return (ern_span){buffer, 0, count}; }

static struct ern_buffer *buffer_of(const struct stage *stage, const float *values, size_t count) {
  struct ern_buffer *buffer = NULL;
  assert_int_equal(stage->backend->buffer_make(stage->backend, ERN_ELEMENT_REAL, count, &buffer), ERN_OK);
  assert_int_equal(stage->backend->upload_reals(stage->stream, whole(buffer, count), values, count), ERN_OK);
  return buffer;
}

static void stage_make(struct stage *stage, const struct scene *scene, ern_isa isa, int threads) {
  static const float pose[16] = {0.1f, -0.99f, -0.03f, 0.19f, 0.06f,  0.04f, -1.02f, 3.04f,
                                 1.0f, 0.09f,  0.07f,  -0.2f, 0.003f, 0.01f, -0.02f, 1.0f};
  support_ok(scene->context, ern_cpu_backend_make(scene->context, isa, &stage->backend));
  support_ok(scene->context, stage->backend->stream_make(stage->backend, threads, &stage->stream));
  stage->parameters = buffer_of(stage, scene->block, scene->field.parameters);
  stage->occupancy = buffer_of(stage, scene->occupancy, ERN_TORSO_CELLS);
  stage->planes = buffer_of(stage, scene->planes, PLANES * scene->stride);
  const ern_span planes = whole(stage->planes, PLANES * scene->stride);
  stage->args = (struct ern_render_torso_args){
      .pixel = {ern_span_part(planes, 0, 3 * scene->stride), scene->stride, 3, ERN_PER_SAMPLE},
      .opacity = ern_span_part(planes, 3 * scene->stride, scene->pixels),
      .grid = whole(stage->occupancy, ERN_TORSO_CELLS),
      .threshold = scene->threshold,
      .width = scene->width,
      .height = scene->height,
      .frame = scene->frame,
      .shrink = 0.8f,
      .individual = scene->config.codes > 0 ? 3 : 0,
      .parameters = whole(stage->parameters, scene->field.parameters),
      .field = &scene->field};
  memcpy(stage->args.pose, pose, sizeof pose);
}

static void stage_free(struct stage *stage) {
  stage->backend->buffer_free(stage->backend, stage->parameters);
  stage->backend->buffer_free(stage->backend, stage->occupancy);
  stage->backend->buffer_free(stage->backend, stage->planes);
  stage->backend->stream_free(stage->stream);
  stage->backend->free(stage->backend);
}

/* The planes afterwards. */
static float *result(const struct scene *scene, ern_isa isa, int threads) {
  struct stage stage;
  float *found = floats(PLANES * scene->stride);
  stage_make(&stage, scene, isa, threads);
  support_ok(scene->context, stage.backend->render_torso(stage.stream, &stage.args));
  assert_int_equal(stage.backend->download_reals(stage.stream, found, whole(stage.planes, PLANES * scene->stride),
                                                 PLANES * scene->stride),
                   ERN_OK);
  stage_free(&stage);
  return found;
}

static bool is_fast(ern_isa isa) { return isa != ERN_ISA_REF && isa != ERN_ISA_REF64 && ern_isa_available(isa); }

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
  float *exact = result(scene, ERN_ISA_REF64, 1), *reference = result(scene, ERN_ISA_REF, 1);
  const double price = farthest(scene, reference, exact);
  for (ern_isa isa = ERN_ISA_REF; isa < ERN_ISAS; isa++) {
    if (!is_fast(isa)) continue;
    float *found = result(scene, isa, 1);
    const size_t chosen = check_untouched(scene, found, reference);
    const double apart = farthest(scene, found, reference), error = farthest(scene, found, exact);
    print_message("%-7s %3d x %3d, %6zu chosen: %-6s to ref %.1e, to double %.1e (ref %.1e)\n", what, scene->width,
                  scene->height, chosen, ern_isa_name(isa), apart, error, price);
    if (scene->threshold > 1) assert_int_equal(chosen, 0);
    if (scene->threshold < -1) assert_int_equal(chosen, scene->pixels);
    for (size_t i = 0; i < PLANES * scene->stride; i++) assert_true(isfinite(found[i]));
    if (!(error <= most_times * price + least)) fail_msg("%s: off by %.2e", ern_isa_name(isa), error);
    if (!(apart <= bound)) fail_msg("%s: %.2e from the reference", ern_isa_name(isa), apart);
    free(found);
  }
  free(exact), free(reference);
}

static const int sizes[][2] = {{1, 1}, {3, 7}, {7, 3}, {1, 40}, {40, 1}, {4, 4}, {17, 19}, {61, 130}, {450, 450}};
enum { SIZES = sizeof sizes / sizeof *sizes };

/* Values as training leaves them: the goal of 1e-5 at every pixel. */
static void test_trained(void **state) {
  (void)state;
  for (int s = 0; s < SIZES; s++) {
    if (is_emulated() && sizes[s][0] > 100) continue;
    for (enum choice choice = CHOOSE_SOME; choice <= CHOOSE_NONE; choice++) {
      struct scene scene;
      scene_make(&scene, sizes[s][0], sizes[s][1], choice, s % 2 == 0, 0.1f, 1);
      check_scene(&scene, "trained", 1e-5);
      scene_free(&scene);
    }
  }
}

/* A frame that lies within the picture, covers it, or is partly beside it. */
static void test_placed(void **state) {
  (void)state;
  static const struct ern_torso_place frames[] = {{20, 0, 61, 61},     {0, 13, 40, 100}, {-30, 0, 61, 160},
                                                  {-7, -50, 161, 114}, {40, 90, 3, 5},   {-9, -9, 1, 1}};
  for (size_t f = 0; f < sizeof frames / sizeof *frames; f++) {
    struct scene scene;
    scene_make(&scene, 61, 100, CHOOSE_SOME, f % 2 == 0, 0.1f, 1);
    scene.frame = frames[f];
    check_scene(&scene, "placed", 1e-5);
    scene_free(&scene);
  }
}

/* A table that jumps by 2 between entries, and a deformation that the clamp holds at the edges for most pixels. */
static void test_rough(void **state) {
  (void)state;
  struct scene scene;
  scene_make(&scene, emulated_side(250), emulated_side(131), CHOOSE_ALL, true, 1, 1);
  check_scene(&scene, "rough", INFINITY);
  scene_free(&scene);
  scene_make(&scene, emulated_side(121), emulated_side(250), CHOOSE_ALL, false, 0.1f, 40);
  check_scene(&scene, "held", INFINITY);
  scene_free(&scene);
}

/* A NaN in the deformation: the table is not looked at, as in the reference, and the layer is what the rest makes it.
 */
static void test_not_a_number(void **state) {
  (void)state;
  struct scene scene;
  scene_make(&scene, 33, 21, CHOOSE_SOME, true, 0.1f, 1);
  scene.block[scene.field.torso_deform.weight[2] + 3] = NAN;
  check_scene(&scene, "NaN", 1e-5);
  scene.block[scene.field.torso_net.weight[2] + 3] = NAN; /* of alpha: wherever the torso is */
  float *reference = result(&scene, ERN_ISA_REF, 1);
  for (ern_isa isa = ERN_ISA_REF; isa < ERN_ISAS; isa++) {
    if (!is_fast(isa)) continue;
    float *found = result(&scene, isa, 1);
    for (size_t i = 0; i < PLANES * scene.stride; i++) assert_int_equal(isnan(found[i]), isnan(reference[i]));
    free(found);
  }
  free(reference);
  scene_free(&scene);
}

static void test_threads(void **state) {
  (void)state;
  struct scene scene;
  scene_make(&scene, 210, 130, CHOOSE_SOME, true, 0.1f, 1);
  for (ern_isa isa = ERN_ISA_REF; isa < ERN_ISAS; isa++) {
    if (!is_fast(isa)) continue;
    float *one = result(&scene, isa, 1);
    for (int threads = 2; threads <= 4; threads += 2) {
      float *many = result(&scene, isa, threads);
      assert_memory_equal(one, many, PLANES * scene.stride * sizeof *one);
      free(many);
    }
    free(one);
  }
  scene_free(&scene);
}

/* A field that the kernels are not made for goes through the stages; an opacity that is not wanted is not written. */
static void test_other_shapes(void **state) {
  (void)state;
  struct scene scene;
  scene_make(&scene, 30, 20, CHOOSE_ALL, false, 0.1f, 1);
  scene.field.torso_grid.hashed = true;
  check_scene(&scene, "hashed", 1e-5);
  scene.field.torso_grid.hashed = false;
  for (ern_isa isa = ERN_ISA_REF; isa < ERN_ISAS; isa++) {
    if (!is_fast(isa)) continue;
    struct stage stage;
    float *with = result(&scene, isa, 1), *without = floats(PLANES * scene.stride);
    const size_t count = PLANES * scene.stride, colours = 3 * scene.stride;
    stage_make(&stage, &scene, isa, 2);
    stage.args.opacity = (ern_span){0};
    support_ok(scene.context, stage.backend->render_torso(stage.stream, &stage.args));
    assert_int_equal(stage.backend->download_reals(stage.stream, without, whole(stage.planes, count), count), ERN_OK);
    assert_memory_equal(with, without, colours * sizeof *with);
    assert_memory_equal(without + colours, scene.planes + colours, scene.stride * sizeof *with);
    stage_free(&stage);
    free(with), free(without);
  }
  scene_free(&scene);
}

/* Memory that is refused is an error in words, and nothing is lost. */
static ern_status one_picture(ern_context *context) {
  struct scene scene;
  struct stage stage = {.backend = NULL};
  scene_make(&scene, 9, 5, CHOOSE_ALL, false, 0.1f, 1);
  ern_context *own = scene.context;
  const ern_isa best = ern_isa_available(ERN_ISA_AVX512) ? ERN_ISA_AVX512
                       : ern_isa_available(ERN_ISA_AVX2) ? ERN_ISA_AVX2
                       : ern_isa_available(ERN_ISA_NEON) ? ERN_ISA_NEON
                                                         : ERN_ISA_REF;
  stage_make(&stage, &scene, best, 1);
  struct ern_stream *refused = NULL;
  struct ern_backend *backend = NULL;
  ern_status status = ern_cpu_backend_make(context, best, &backend);
  if (status == ERN_OK) status = backend->stream_make(backend, 1, &refused);
  if (status == ERN_OK) status = backend->render_torso(refused, &stage.args);
  if (backend != NULL) {
    backend->stream_free(refused);
    backend->free(backend);
  }
  stage_free(&stage);
  scene.context = own;
  scene_free(&scene);
  return status;
}

static void test_no_memory(void **state) {
  (void)state;
  support_refuse_each(one_picture);
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static void bench_run(void *user) {
  struct stage *stage = user;
  (void)stage->backend->render_torso(stage->stream, &stage->args);
}

static double bench_of(const struct scene *scene, ern_isa isa, int threads) {
  struct stage stage;
  stage_make(&stage, scene, isa, threads);
  const double seconds = seconds_of(bench_run, &stage);
  stage_free(&stage);
  return seconds;
}

/* Head and shoulders: a disc over a half ellipse, 46% of the cells. */
static size_t bench_occupancy(struct scene *scene) {
  for (int c = 0; c < ERN_TORSO_SIDE; c++) {
    for (int r = 0; r < ERN_TORSO_SIDE; r++) {
      const double x = (c - 63.5) / 64, y = (r - 63.5) / 64;
      const bool shoulders = y > 0.1 && x * x + (y - 1.1) * (y - 1.1) < 1, neck = fabs(x) < 0.3 && y > -0.2;
      scene->occupancy[c * ERN_TORSO_SIDE + r] = shoulders || neck ? 1 : 0;
    }
  }
  float *planes = result(scene, ERN_ISA_REF, 2);
  size_t chosen = 0;
  for (size_t i = 0; i < scene->pixels; i++) chosen += planes[3 * scene->stride + i] != 0;
  free(planes);
  return chosen;
}

static int measure(void) {
  static const machine_isa machine[ERN_ISAS] = {
      [ERN_ISA_AVX2] = MACHINE_AVX2, [ERN_ISA_AVX512] = MACHINE_AVX512, [ERN_ISA_NEON] = MACHINE_NEON};
  const double operations = 2 * (3 * 32 * 32 + 32 * 2 + 32 * 4); /* of the layers that are left, a pixel */
  struct scene scene;
  double first = 0;
  scene_make(&scene, 450, 450, CHOOSE_SOME, true, 0.1f, 1);
  const size_t chosen = bench_occupancy(&scene);
  printf("450 x 450 pixels, %.0f %% chosen\n", 100 * (double)chosen / (double)scene.pixels);
  for (ern_isa isa = ERN_ISA_REF; isa < ERN_ISAS; isa++) {
    if (isa == ERN_ISA_REF64 || !ern_isa_available(isa)) continue;
    const double one = bench_of(&scene, isa, 1), two = bench_of(&scene, isa, 2);
    const double peak = isa == ERN_ISA_REF ? 0 : peak_flops(machine[isa]);
    if (isa == ERN_ISA_REF) first = one;
    printf("%-6s: %7.2f ms a frame, %7.2f with two threads, %5.1f times ref", ern_isa_name(isa), one * 1e3, two * 1e3,
           first / one);
    if (peak > 0) printf(", layers at %2.0f %% of the peak", 100 * operations * (double)chosen / one / peak);
    printf("\n");
  }
  scene_free(&scene);
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) return measure();
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_trained),      cmocka_unit_test(test_placed),  cmocka_unit_test(test_rough),
      cmocka_unit_test(test_not_a_number), cmocka_unit_test(test_threads), cmocka_unit_test(test_other_shapes),
      cmocka_unit_test(test_no_memory),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
