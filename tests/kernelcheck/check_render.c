/* SPDX-License-Identifier: MIT
 * The fused pass of rendering, as each instruction set's table does it, against the stages in double. `--bench`
 * measures a 450 x 450 view of a made-up head. */
#include "kernelcheck.h"

#include "backend_cpu/backend_cpu.h"
#include "backend_cpu/cpu_kernels.h"
#include "bf16_kernels.h"
#include "core/profile.h"
#include "model/parameters.h"
#include "render/morton.h"
#include "render/stages.h"

enum { OUTPUTS = 10 /* pixel 3, colour 3, opacity, depth, attention, eye */ };
static const char *const output_name[OUTPUTS] = {"red",         "green",   "blue",  "sum of red", "sum of green",
                                                 "sum of blue", "opacity", "depth", "attention",  "eye"};

struct scene {
  ern_context *context;
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
  struct scene scene = {.context = support_context(), .stop = 1e-4f, .log_sigma = log_sigma, .eye_value = 0.4f};
  struct ern_parameter_table rows;
  scene.config = (struct ern_model_config){.levels = levels,
                                           .feature_width = 29,
                                           .window_length = 16,
                                           .head = true,
                                           .eye = eye,
                                           .no_view = !view,
                                           .codes = codes,
                                           .bound = 1};
  support_ok(scene.context, ern_parameters_build(scene.context, &scene.config, &scene.field, &rows));
  scene.block = room(scene.field.parameters, sizeof(float));
  ern_parameters_init(scene.block, &rows, false, 11);
  for (int plane = 0; plane < ERN_PLANES; plane++)
    for (size_t i = 0; i < scene.field.encoder.grid[plane].entries; i++)
      scene.block[scene.field.encoder.table[plane] + i] = random_at(3 + (uint64_t)plane, i, 1);
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
  for (size_t c = 0; c < ERN_AUDIO_CODE; c++) scene.code[c] = random_at(5, c, 1);
  scene.rays = (size_t)width * (size_t)height;
  scene.pixel = room(scene.rays, sizeof(int32_t));
  scene.background = room(3 * scene.rays, sizeof(float));
  for (size_t i = 0; i < scene.rays; i++) scene.pixel[i] = (int32_t)i;
  for (size_t i = 0; i < 3 * scene.rays; i++) scene.background[i] = 0.5f + random_at(6, i, 0.5f);
  return scene;
}
static struct scene scene_make(int levels, bool eye, int codes, int width, int height, float log_sigma) {
  return scene_make_of(true, levels, eye, codes, width, height, log_sigma);
}

static void scene_free(struct scene *scene) {
  free(scene->block), free(scene->background), free(scene->bits), free(scene->pixel);
  ern_context_free(&scene->context);
}

static ern_rows take_rows(const struct scene *scene, struct ern_stream *stream, int rows) {
  ern_rows taken;
  support_ok(scene->context, ern_take_rows(stream, rows, scene->rays, &taken));
  return taken;
}

static struct ern_buffer *buffer_of(struct ern_stream *stream, const float *values, size_t count) {
  struct ern_buffer *buffer = NULL;
  struct ern_backend *backend = stream->backend;
  assert_int_equal(backend->buffer_make(backend, ERN_ELEMENT_REAL, count, &buffer), ERN_OK);
  assert_int_equal(backend->upload_reals(stream, (ern_span){buffer, 0, count}, values, count), ERN_OK);
  return buffer;
}

/* Who renders. */
struct renderer {
  ern_isa isa;
  machine_isa machine;
  const char *name;
  bool bf16;
  ern_render_lane_kernel *lane; /* in place of the table's own; NULL: that */
};
static const struct renderer truthful = {ERN_ISA_REF64, MACHINE_REF, "ref64", false, NULL};
static const struct renderer plain = {ERN_ISA_REF, MACHINE_REF, "ref", false, NULL};
static const struct renderer fast[] = {
#if defined(__aarch64__)
    {ERN_ISA_NEON, MACHINE_NEON, "neon", false, NULL},
#else
    {ERN_ISA_AVX2, MACHINE_AVX2, "avx2", false, NULL},
    {ERN_ISA_AVX512, MACHINE_AVX512, "avx512", false, NULL},
#if defined(ERN_X86_KERNELS)
    {ERN_ISA_AVX512, MACHINE_AVX512, "avx512bf16, emulated", true, ern_render_lane_bf16_emulated},
#endif
    {ERN_ISA_AVX512BF16, MACHINE_AVX512BF16, "avx512bf16", true, NULL},
#endif
};
enum { FAST = sizeof fast / sizeof *fast };

/* A table with the scene on it. */
struct stage {
  struct ern_backend *backend;
  struct ern_stream *stream;
  struct ern_buffer *parameters, *code, *bits;
  ern_rows out;
  struct ern_render_rays_args args;
};

static struct stage stage_make(const struct scene *scene, const struct renderer *who, int threads, bool all) {
  struct stage stage = {0};
  support_ok(scene->context, ern_cpu_backend_make(scene->context, who->isa, &stage.backend));
  if (who->lane != NULL) {
    struct ern_cpu_backend *cpu = (struct ern_cpu_backend *)stage.backend;
    cpu->render_lane = who->lane;
    cpu->render_pairs = who->bf16;
  }
  support_ok(scene->context, stage.backend->stream_make(stage.backend, threads, &stage.stream));
  struct ern_backend *backend = stage.backend;
  struct ern_stream *stream = stage.stream;
  stage.parameters = buffer_of(stream, scene->block, scene->field.parameters);
  stage.code = buffer_of(stream, scene->code, ERN_AUDIO_CODE);
  support_ok(scene->context, backend->buffer_make(backend, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &stage.bits));
  const ern_span bits = {stage.bits, 0, ERN_OCCUPANCY_BYTES}, block = {stage.parameters, 0, scene->field.parameters};
  support_ok(scene->context, backend->upload_bytes(stream, bits, scene->bits, ERN_OCCUPANCY_BYTES));
  ern_span pixel;
  support_ok(scene->context, ern_take(stream, ERN_ELEMENT_INT32, scene->rays, &pixel));
  support_ok(scene->context, backend->upload_int32(stream, pixel, scene->pixel, scene->rays));
  const ern_rows background = take_rows(scene, stream, 3);
  for (int c = 0; c < 3; c++)
    support_ok(scene->context, backend->upload_reals(stream, ern_span_of_row(background, c, scene->rays),
                                                     scene->background + (size_t)c * scene->rays, scene->rays));
  stage.out = take_rows(scene, stream, OUTPUTS);
  support_ok(scene->context, backend->zero(stream, stage.out.span));
  stage.args = (struct ern_render_rays_args){.pixel = ern_rows_part(stage.out, 0, 3),
                                             .opacity = ern_span_of_row(stage.out, 6, scene->rays),
                                             .pixel_number = pixel,
                                             .view = scene->view,
                                             .background = background,
                                             .bits = bits,
                                             .parameters = block,
                                             .field = &scene->field,
                                             .code = {stage.code, 0, ERN_AUDIO_CODE},
                                             .eye_value = scene->eye_value,
                                             .individual = 1,
                                             .settings = scene->settings,
                                             .transmittance_stop = scene->stop,
                                             .n = scene->rays};
  if (all) {
    stage.args.colour = ern_rows_part(stage.out, 3, 3);
    stage.args.depth = ern_span_of_row(stage.out, 7, scene->rays);
    stage.args.attention = ern_span_of_row(stage.out, 8, scene->rays);
    stage.args.eye = ern_span_of_row(stage.out, 9, scene->rays);
  }
  struct ern_render_prepare_args prepare = {block, &scene->field};
  support_ok(scene->context, backend->render_prepare(stream, &prepare));
  return stage;
}

static void stage_free(struct stage *stage) {
  struct ern_buffer *const buffers[] = {stage->parameters, stage->code, stage->bits};
  for (size_t i = 0; i < 3; i++) stage->backend->buffer_free(stage->backend, buffers[i]);
  stage->backend->stream_free(stage->stream);
  stage->backend->free(stage->backend);
}

/* [OUTPUTS][rays] */
static float *render(const struct scene *scene, const struct renderer *who, int threads, bool all) {
  struct stage stage = stage_make(scene, who, threads, all);
  float *out = room(OUTPUTS * scene->rays, sizeof(float));
  support_ok(scene->context, stage.backend->render_rays(stage.stream, &stage.args));
  for (int k = 0; k < OUTPUTS; k++)
    support_ok(scene->context, stage.backend->download_reals(stage.stream, out + (size_t)k * scene->rays,
                                                             ern_span_of_row(stage.out, k, scene->rays), scene->rays));
  stage_free(&stage);
  return out;
}

/* Folding two layers and the audio code changes the order of sums: of numbers of about 1, some hundred roundings of
 * 2^-24. A transmittance within rounding of the stop may let one sample more or less count: `stop` of a colour, and of
 * the unweighted sums a whole sample, which is why those are held only where nothing stops.
 * With bf16 each factor is off by up to 2^-9. What comes out of a layer, a sum of terms of either sign, is off by about
 * as much of its size, and by 2^-8 after all layers: of the colours a quarter of it arrives behind the sigmoid. Of the
 * exponent's error, of sums of about 1/10 times log_sigma, no more than 1/e arrives in the opacity. */
static double allowed_of(const struct scene *scene, bool bf16) {
  const double rounding = bf16 ? 0x1p-9 + 0x1p-13 * (double)scene->log_sigma : 4e-5;
  return rounding + 2 * (double)scene->stop;
}

/* Of one output: everywhere, and at a quarter of that in the mean square, where no stop decides. */
static void check_output(const struct scene *scene, const char *what, const struct renderer *who, size_t k,
                         const float *out, const float *truth) {
  const double allowed = allowed_of(scene, who->bf16);
  double sum = 0;
  for (size_t i = 0; i < scene->rays; i++) {
    const double is = (double)out[k * scene->rays + i], expected = (double)truth[k * scene->rays + i];
    const double error = fabs(is - expected) / (1 + fabs(expected));
    if (!(error <= allowed))
      fail_msg("%s, %s: %s of ray %zu is %.9g, expected %.9g", what, who->name, output_name[k], i, is, expected);
    sum += error * error;
  }
  const double root = sqrt(sum / (double)scene->rays);
  if (scene->stop < 1e-3f && !(root <= allowed / 4))
    fail_msg("%s, %s: %s is off by %.3g, root of the mean square", what, who->name, output_name[k], root);
}

static void check_against_double(const struct scene *scene, const char *what) {
  float *truth = render(scene, &truthful, 2, true);
  for (size_t f = 0; f < FAST; f++) {
    if (!machine_has(fast[f].machine)) continue;
    float *out = render(scene, &fast[f], 2, true);
    for (size_t k = 0; k < OUTPUTS; k++) {
      if ((k == 8 || k == 9) && scene->stop > 0) continue;
      if (k == 9 && !scene->config.eye) continue;
      check_output(scene, what, &fast[f], k, out, truth);
    }
    free(out);
  }
  free(truth);
}

static size_t hits(const struct scene *scene) {
  float *truth = render(scene, &plain, 1, true);
  size_t count = 0;
  for (size_t i = 0; i < scene->rays; i++) count += truth[6 * scene->rays + i] > 0;
  free(truth);
  return count;
}

static void test_models(void **state) {
  (void)state;
  for (int variant = 0; variant < 8; variant++) {
    if (is_emulated() && variant % 7 != 0) continue; /* the least and the most */
    const int levels = variant & 1 ? 14 : variant & 2 ? 12 : 2;
    struct scene scene =
        scene_make(levels, (variant & 2) != 0, variant & 4 ? 3 : 0, emulated_side(45), emulated_side(37), 8);
    char what[64];
    snprintf(what, sizeof what, "levels %d, eye %d, codes %d", levels, scene.config.eye, scene.config.codes);
    if (scene.config.codes == 0) assert_true(hits(&scene) > scene.rays / 8); /* the check looks at something */
    check_against_double(&scene, what);
    scene.stop = 0;
    check_against_double(&scene, what);
    scene_free(&scene);
  }
}

/* Heads whose colour is not told the direction, with and without what else its first layer may read. */
static void test_without_view(void **state) {
  (void)state;
  for (int codes = 0; codes <= 2; codes += 2) {
    struct scene scene = scene_make_of(false, 12, codes > 0, codes, emulated_side(33), emulated_side(26), 8);
    assert_int_equal(scene.field.colour.width[0], ERN_GEOMETRY + (codes > 0 ? ERN_CODE_WIDTH : 0));
    assert_true(hits(&scene) > scene.rays / 8);
    check_against_double(&scene, codes > 0 ? "no view" : "no view, no codes, no eye");
    scene_free(&scene);
  }
}

static void test_occupancies_and_densities(void **state) {
  (void)state;
  for (int variant = 0; variant < 6; variant++) {
    if (is_emulated() && variant % 3 != 1) continue;
    static const float log_sigma[] = {0.01f, 40, 200};
    struct scene scene = scene_make(12, true, 2, emulated_side(33), emulated_side(26), log_sigma[variant % 3]);
    if (variant >= 3) memset(scene.bits, 0xff, ERN_OCCUPANCY_BYTES);
    char what[64];
    snprintf(what, sizeof what, "%s occupied, exponents of %g", variant >= 3 ? "all" : "a shell",
             (double)log_sigma[variant % 3]);
    /* exponents of 200 lose four digits before exp() sees them: only what the light leaves of that is held */
    if (variant % 3 != 2) check_against_double(&scene, what);
    scene.stop = 0.3f;
    check_against_double(&scene, what);
    scene_free(&scene);
  }
  struct scene scene = scene_make(12, true, 2, 20, 20, 8);
  memset(scene.bits, 0, ERN_OCCUPANCY_BYTES);
  assert_int_equal(hits(&scene), 0);
  check_against_double(&scene, "nothing occupied");
  scene_free(&scene);
}

static void test_settings(void **state) {
  (void)state;
  static const int steps[] = {1, 2, 16, 300, ERN_MAX_STEPS};
  for (size_t k = 0; k < sizeof steps / sizeof *steps; k++) {
    if (is_emulated() && k % 2 == 0) continue;
    struct scene scene = scene_make(12, true, 2, emulated_side(24), emulated_side(24), 4);
    scene.settings.max_steps = steps[k];
    char what[64];
    snprintf(what, sizeof what, "%d steps", steps[k]);
    check_against_double(&scene, what);
    scene_free(&scene);
  }
}

static void test_lists_of_pixels(void **state) {
  (void)state;
  static const size_t counts[] = {1, 2, 47, 48, 49, 500, 899};
  for (size_t k = 0; k < sizeof counts / sizeof *counts; k++) {
    if (is_emulated() && counts[k] != 1 && counts[k] != 49) continue;
    struct scene scene = scene_make(12, true, 2, 30, 30, 8);
    scene.rays = counts[k];
    for (size_t i = 0; i < scene.rays; i++)
      scene.pixel[i] = (int32_t)ern_below(ern_random_at(9, 0, (uint32_t)i, ERN_RNG_INIT).word[0], 900);
    char what[64];
    snprintf(what, sizeof what, "%zu pixels in any order, some twice", counts[k]);
    check_against_double(&scene, what);
    scene_free(&scene);
  }
}

static void test_threads_and_outputs(void **state) {
  (void)state;
  struct scene scene = scene_make(14, true, 2, emulated_side(90), emulated_side(70), 8);
  for (size_t f = 0; f < FAST; f++) {
    if (!machine_has(fast[f].machine)) continue;
    float *one = render(&scene, &fast[f], 1, true);
    for (int threads = 2; threads <= 4; threads++) {
      float *more = render(&scene, &fast[f], threads, true);
      assert_memory_equal(one, more, OUTPUTS * scene.rays * sizeof(float));
      free(more);
    }
    float *some = render(&scene, &fast[f], 2, false);
    assert_memory_equal(one, some, 3 * scene.rays * sizeof(float));
    assert_memory_equal(one + 6 * scene.rays, some + 6 * scene.rays, scene.rays * sizeof(float));
    for (size_t i = 3 * scene.rays; i < 6 * scene.rays; i++) assert_true(some[i] == 0);
    free(some), free(one);
  }
  scene_free(&scene);
}

/* A frame may follow another with other speech, eyes and code on the same stream. */
static void test_frames_follow(void **state) {
  (void)state;
  struct scene scene = scene_make(12, true, 3, emulated_side(40), emulated_side(40), 8);
  for (size_t f = 0; f < FAST; f++) {
    if (!machine_has(fast[f].machine)) continue;
    struct stage stage = stage_make(&scene, &fast[f], 2, true);
    support_ok(scene.context, stage.backend->render_rays(stage.stream, &stage.args));
    float other[ERN_AUDIO_CODE];
    for (size_t c = 0; c < ERN_AUDIO_CODE; c++) other[c] = -2 * scene.code[c];
    support_ok(scene.context, stage.backend->upload_reals(stage.stream, stage.args.code, other, ERN_AUDIO_CODE));
    stage.args.eye_value = 0;
    support_ok(scene.context, stage.backend->render_rays(stage.stream, &stage.args));
    support_ok(scene.context, stage.backend->upload_reals(stage.stream, stage.args.code, scene.code, ERN_AUDIO_CODE));
    stage.args.eye_value = 0.4f;
    support_ok(scene.context, stage.backend->render_rays(stage.stream, &stage.args));
    float *again = room(scene.rays, sizeof(float)), *once = render(&scene, &fast[f], 2, true);
    support_ok(scene.context, stage.backend->download_reals(stage.stream, again,
                                                            ern_span_of_row(stage.out, 0, scene.rays), scene.rays));
    assert_memory_equal(again, once, scene.rays * sizeof(float));
    free(again), free(once);
    stage_free(&stage);
  }
  scene_free(&scene);
}

/* Speech and eyes so strong that each of them decides what is seen: none of the density's inputs may be lost. */
static void test_every_input_counts(void **state) {
  (void)state;
  for (int levels = 11; levels <= 14; levels++) {
    struct scene scene = scene_make(levels, true, 2, emulated_side(30), emulated_side(26), 3);
    float *weak = render(&scene, &truthful, 1, true);
    scene.eye_value = 16;
    float *eyes = render(&scene, &truthful, 1, true);
    check_against_double(&scene, "strong eyes");
    scene.eye_value = 0.4f;
    for (size_t c = 0; c < ERN_AUDIO_CODE; c++) scene.code[c] *= 16;
    float *speech = render(&scene, &truthful, 1, true);
    check_against_double(&scene, "strong speech");
    double most[2] = {0};
    for (size_t i = 0; i < 3 * scene.rays; i++) {
      most[0] = fmax(most[0], fabs((double)eyes[i] - (double)weak[i]));
      most[1] = fmax(most[1], fabs((double)speech[i] - (double)weak[i]));
    }
    assert_true(most[0] > 3 * allowed_of(&scene, true) && most[1] > 3 * allowed_of(&scene, true));
    free(weak), free(eyes), free(speech);
    scene_free(&scene);
  }
}

static void bench(void) {
  struct scene scene = scene_make(14, true, 2, 450, 450, 8);
  for (size_t f = 0; f < FAST; f++) {
    if (!machine_has(fast[f].machine)) continue;
    struct stage stage = stage_make(&scene, &fast[f], 1, false);
    struct ern_profile best = {{1e9}, {0}};
    for (int repeat = 0; repeat < 5; repeat++) {
      struct ern_profile profile = {{0}, {0}};
      stage.args.profile = &profile;
      support_ok(scene.context, stage.backend->render_rays(stage.stream, &stage.args));
      if (profile.seconds[ERN_PROFILE_FORWARD] < best.seconds[ERN_PROFILE_FORWARD] || repeat == 0) best = profile;
    }
    const double samples = (double)best.count[ERN_PROFILE_SAMPLES];
    printf(
        "%-7s %.0f samples: march %.1f ms, encode %.1f ms, MLPs %.1f ms (%.2f M samples/s, %.0f %% of peak), "
        "composite %.1f ms\n",
        fast[f].name, samples, 1e3 * best.seconds[ERN_PROFILE_MARCH], 1e3 * best.seconds[ERN_PROFILE_ENCODE],
        1e3 * best.seconds[ERN_PROFILE_FORWARD], 1e-6 * samples / best.seconds[ERN_PROFILE_FORWARD],
        100 * 2 * 18672 * samples / best.seconds[ERN_PROFILE_FORWARD] / peak_flops(fast[f].machine),
        1e3 * best.seconds[ERN_PROFILE_COMPOSITE]);
    stage_free(&stage);
  }
  scene_free(&scene);
}

int main(int argc, char **argv) {
  if (argc > 1 && strcmp(argv[1], "--bench") == 0) {
    bench();
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_models),
      cmocka_unit_test(test_without_view),
      cmocka_unit_test(test_occupancies_and_densities),
      cmocka_unit_test(test_settings),
      cmocka_unit_test(test_lists_of_pixels),
      cmocka_unit_test(test_frames_follow),
      cmocka_unit_test(test_threads_and_outputs),
      cmocka_unit_test(test_every_input_counts),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
