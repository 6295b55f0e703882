/* SPDX-License-Identifier: MIT
 * The fused pass of rendering against the stages in double. */
#include "harness.h"

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/cpu_state.h"
#include "bf16_kernels.h"

#include "core/profile.h"
#include "model/parameters.h"
#include "render/morton.h"
#include "render/render_ops.h"

enum { OUTPUTS = 10 /* pixel 3, colour 3, opacity, depth, attention, eye */ };
static const char *const output_name[OUTPUTS] = {"red",         "green",   "blue",  "sum of red", "sum of green",
                                                 "sum of blue", "opacity", "depth", "attention",  "eye"};

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
  support_ok(machines.context, ern_parameters_build(machines.context, &scene.config, &scene.field, &rows));
  scene.block = held_memory(scene.field.parameters, sizeof(float));
  ern_parameters_init(scene.block, &rows, false, machines_seed(11));
  for (int plane = 0; plane < ERN_PLANES; plane++)
    fill_random(scene.block + scene.field.encoder.table[plane], scene.field.encoder.grid[plane].entries,
                3 + (uint64_t)plane, 1);
  const struct ern_mlp *density = &scene.field.density;
  for (size_t i = 0; i < 64; i++) scene.block[density->weight[2] + i] *= log_sigma;
  scene.bits = held_memory(ERN_OCCUPANCY_BYTES, 1);
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
  fill_random(scene.code, ERN_AUDIO_CODE, 5, 1);
  scene.rays = (size_t)width * (size_t)height;
  scene.pixel = held_memory(scene.rays, sizeof(int32_t));
  scene.background = held_memory(3 * scene.rays, sizeof(float));
  for (size_t i = 0; i < scene.rays; i++) scene.pixel[i] = (int32_t)i;
  for (size_t i = 0; i < 3 * scene.rays; i++) scene.background[i] = 0.5f + random_at(6, i, 0.5f);
  return scene;
}
static struct scene scene_make(int levels, bool eye, int codes, int width, int height, float log_sigma) {
  return scene_make_of(true, levels, eye, codes, width, height, log_sigma);
}

/* A scene on all machines, ready to be rendered; all: every output is wanted. */
struct stage {
  struct many_rows out;
  struct many code;
  struct ern_render_rays_args args[MACHINES];
};

static struct stage stage_make(const struct scene *scene, bool all) {
  struct stage stage;
  const struct many block = many_reals(scene->block, scene->field.parameters);
  const struct many bits = many_of(ERN_ELEMENT_BYTE, scene->bits, ERN_OCCUPANCY_BYTES);
  const struct many pixel = many_int32s(scene->pixel, scene->rays);
  const struct many_rows background = many_strided(scene->background, 3, scene->rays, ERN_PER_RAY);
  stage.code = many_reals(scene->code, ERN_AUDIO_CODE);
  stage.out = many_strided(NULL, OUTPUTS, scene->rays, ERN_PER_RAY);
  EACH_MACHINE (k) {
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
                                          .code = stage.code.on[k],
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
    RUN_ON(k, render_prepare, &prepare);
  }
  return stage;
}

static bool in_bf16(int k) { return strncmp(machines.name[k], "avx512bf16", 10) == 0; }

/* Products of bf16 pairs by AVX-512 alone, for machines that lack the instructions. */
static void add_emulated(void) {
#if defined(ERN_X86_KERNELS)
  const int k = machines.count;
  bool wide = false;
  EACH_MACHINE (m) wide = wide || strcmp(machines.name[m], "avx512") == 0;
  if (!wide) return;
  machines_add("avx512bf16, emulated", "avx512", NULL);
  struct ern_cpu_backend *cpu = (struct ern_cpu_backend *)machines.backend[k];
  cpu->render_worker = ern_render_worker_bf16_emulated;
  cpu->render_pairs = true;
#endif
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

/* Of one output: everywhere, and on the CPU at a quarter of that in the mean square, where no stop decides. */
static void check_row(const struct scene *scene, const char *what, int k, size_t row, const float *out,
                      const float *truth) {
  const double allowed = allowed_of(scene, in_bf16(k));
  double sum = 0;
  for (size_t i = 0; i < scene->rays; i++) {
    const double is = (double)out[i], expected = (double)truth[i];
    const double error = fabs(is - expected) / (1 + fabs(expected));
    if (!(error <= allowed))
      fail_msg("%s: %s: %s of ray %zu of %zu is %.9g, expected %.9g", machines.name[k], what, output_name[row], i,
               scene->rays, is, expected);
    sum += error * error;
  }
  const double root = sqrt(sum / (double)scene->rays);
  if (!is_device(k) && scene->stop < 1e-3f && !(root <= allowed / 4))
    fail_msg("%s: %s: %s is off by %.3g, root of the mean square", machines.name[k], what, output_name[row], root);
}

static void check_outputs(const struct scene *scene, const char *what, const struct stage *stage) {
  const float *truth = floats_of(0, of_rows(stage->out));
  const size_t stride = stage->out.on[0].stride;
  EACH_OTHER (k) {
    const float *out = floats_of(k, of_rows(stage->out));
    for (size_t row = 0; row < OUTPUTS; row++) {
      for (size_t i = scene->rays; i < stride; i++) assert_true(is_poison(out[row * stride + i]));
      if (row >= 8 && scene->stop > 0) continue;
      if (row == 9 && !scene->config.eye) continue;
      check_row(scene, what, k, row, out + row * stride, truth + row * stride);
    }
  }
}

static void check_scene(const struct scene *scene, const char *what) {
  const struct machines_mark mark = machines_mark();
  struct stage stage = stage_make(scene, true);
  RUN(render_rays, stage.args);
  check_outputs(scene, what, &stage);
  machines_clear_to(mark);
}

/* Rays that meet something: the check looks at it. */
static size_t hits(const struct scene *scene) {
  const struct machines_mark mark = machines_mark();
  struct stage stage = stage_make(scene, true);
  RUN_ON(1, render_rays, &stage.args[1]);
  const float *opacity = floats_of(1, of_rows(stage.out)) + 6 * stage.out.on[1].stride;
  size_t count = 0;
  for (size_t i = 0; i < scene->rays; i++) count += opacity[i] > 0;
  machines_clear_to(mark);
  return count;
}

static void test_models(void **state) {
  (void)state;
  for (int variant = 0; variant < 8; variant++) {
    if (is_sampled() && variant != 7 && (variant != 0 || is_device(machines.count - 1)))
      continue; /* the most, and the least */
    if (!is_sampled() && !is_long() && (variant ^ variant >> 1 ^ variant >> 2) & 1)
      continue; /* each two choices together */
    const int levels = variant & 1 ? 14 : variant & 2 ? 12 : 2;
    struct scene scene =
        scene_make(levels, (variant & 2) != 0, variant & 4 ? 3 : 0, emulated_side(45), emulated_side(37), 8);
    static const float stops[] = {1e-4f, 3e-3f, 0};
    if (levels == 14) scene.field.config.voice_fade[0] = -0.15f, scene.field.config.voice_fade[1] = 0.2f;
    char what[64];
    snprintf(what, sizeof what, "levels %d, eye %d, codes %d", levels, scene.config.eye, scene.config.codes);
    if (scene.config.codes == 0) assert_true(hits(&scene) > scene.rays / 8);
    for (size_t i = 0; i < COUNT_OF(stops); i++) {
      scene.stop = stops[i];
      check_scene(&scene, what);
    }
    machines_clear();
  }
}

/* Heads whose colour is not told the direction, with and without what else its first layer may read. */
static void test_without_view_long(void **state) {
  (void)state;
  for (int codes = 0; codes <= 2; codes += 2) {
    struct scene scene = scene_make_of(false, 12, codes > 0, codes, emulated_side(33), emulated_side(26), 8);
    assert_int_equal(scene.field.colour.width[0], ERN_GEOMETRY + (codes > 0 ? ERN_CODE_WIDTH : 0));
    assert_true(hits(&scene) > scene.rays / 8);
    check_scene(&scene, codes > 0 ? "no view" : "no view, no codes, no eye");
    machines_clear();
  }
}

static void test_occupancies_and_densities(void **state) {
  (void)state;
  for (int variant = 0; variant < 6; variant++) {
    if (is_emulated() && variant % 3 != 1) continue;
    static const float log_sigma[] = {0.01f, 40, 200};
    struct scene scene = scene_make(14, true, 3, emulated_side(33), emulated_side(26), log_sigma[variant % 3]);
    if (variant >= 3) memset(scene.bits, 0xff, ERN_OCCUPANCY_BYTES);
    char what[64];
    snprintf(what, sizeof what, "%s occupied, exponents of %g", variant >= 3 ? "all" : "a shell",
             (double)log_sigma[variant % 3]);
    /* exponents of 200 lose four digits before exp() sees them: only what the light leaves of that is held */
    if (variant % 3 != 2) check_scene(&scene, what);
    scene.stop = 0.3f;
    check_scene(&scene, what);
    machines_clear();
  }
  struct scene scene = scene_make(14, true, 3, 20, 20, 8);
  memset(scene.bits, 0, ERN_OCCUPANCY_BYTES);
  assert_int_equal(hits(&scene), 0);
  check_scene(&scene, "nothing occupied");
  scene.stop = 0.3f;
  check_scene(&scene, "nothing occupied");
  machines_clear();
}

static void test_settings(void **state) {
  (void)state;
  static const int steps[] = {1, 2, 16, 300, ERN_MAX_STEPS};
  for (size_t i = 0; i < COUNT_OF(steps); i++) {
    if (is_emulated() && i % 2 == 0) continue;
    struct scene scene = scene_make(14, true, 3, emulated_side(24), emulated_side(24), 4);
    char what[64];
    scene.settings.max_steps = steps[i];
    snprintf(what, sizeof what, "%d steps", steps[i]);
    check_scene(&scene, what);
    machines_clear();
  }
}

/* Rays that are no whole picture, and one that is, but in another order. */
static void test_lists_of_pixels(void **state) {
  (void)state;
  static const size_t counts[] = {1, 2, 15, 16, 17, 47, 48, 49, 65, 500, 899, 900};
  struct scene scene = scene_make(14, true, 3, 30, 30, 8);
  for (size_t i = 0; i < COUNT_OF(counts); i++) {
    char what[64];
    if (is_emulated() && counts[i] != 1 && counts[i] != 49) continue;
    scene.rays = counts[i];
    for (size_t r = 0; r < scene.rays; r++) scene.pixel[r] = (int32_t)ern_below(words_at(9, 0, r).word[0], 900);
    snprintf(what, sizeof what, "%zu pixels in any order, some twice", counts[i]);
    check_scene(&scene, what);
  }
  machines_clear();
}

/* No ray; a stream that nothing was prepared on, or for other parameters, goes through the stages. */
static void test_unprepared(void **state) {
  (void)state;
  struct scene scene = is_sampled() ? scene_make(14, true, 3, 9, 8, 8) : scene_make(2, false, 0, 9, 8, 8);
  struct stage stage = stage_make(&scene, true), other = stage_make(&scene, true);
  RUN(render_rays, stage.args);
  check_outputs(&scene, "other parameters", &stage);
  EACH_MACHINE (k) other.args[k].n = 0;
  RUN(render_rays, other.args);
  EACH_MACHINE (k) {
    const float *values = floats_of(k, of_rows(other.out));
    for (size_t i = 0; i < other.out.on[k].span.count; i++) assert_true(is_poison(values[i]));
  }
  machines_clear();
}

/* What machine k renders with so many threads, and what it renders where only the outputs that must be there are
 * wanted; [OUTPUTS][stride]. */
static const float *render(const struct scene *scene, int k, int threads, bool all) {
  struct ern_stream *own = stream_replace(k, threads);
  struct stage stage = stage_make(scene, all);
  RUN_ON(k, render_rays, &stage.args[k]);
  const float *out = floats_of(k, of_rows(stage.out));
  stream_restore(k, own);
  return out;
}

static void test_threads_and_outputs(void **state) {
  (void)state;
  EACH_MACHINE (k) {
    struct scene scene = scene_make(14, true, 3, emulated_side(90), emulated_side(70), 8);
    const size_t stride = scene.rays + 5;
    if (k < 2) continue;
    const float *one = render(&scene, k, 1, true), *some = render(&scene, k, 2, false);
    for (int threads = 2; threads <= 4 && !is_device(k); threads++)
      assert_memory_equal(one, render(&scene, k, threads, true), OUTPUTS * stride * sizeof *one);
    for (size_t row = 0; row < 7; row++)
      for (size_t i = 0; i < scene.rays; i++)
        assert_true(row >= 3 && row < 6 ? is_poison(some[row * stride + i])
                                        : same_bits(some[row * stride + i], one[row * stride + i]));
    machines_clear();
  }
}

/* A frame may follow another with other speech, eyes and code on the same stream. */
static void test_frames_follow(void **state) {
  (void)state;
  const int levels = is_sampled() ? 14 : 12; /* PoCL builds other ones for 5 s */
  struct scene scene = scene_make(levels, true, 3, emulated_side(40), emulated_side(40), 8);
  struct stage stage = stage_make(&scene, true);
  float other[ERN_AUDIO_CODE];
  const float *once[MACHINES];
  for (size_t c = 0; c < ERN_AUDIO_CODE; c++) other[c] = -2 * scene.code[c];
  for (int frame = 0; frame < 3; frame++) {
    many_set(stage.code, 0, frame == 1 ? other : scene.code, ERN_AUDIO_CODE);
    EACH_MACHINE (k) stage.args[k].eye_value = frame == 1 ? 0 : scene.eye_value;
    RUN(render_rays, stage.args);
    EACH_MACHINE (k) {
      const float *found = floats_of(k, of_rows(stage.out));
      if (frame == 0) once[k] = found;
      if (frame == 2) assert_memory_equal(found, once[k], OUTPUTS * stage.out.on[k].stride * sizeof *found);
    }
  }
  machines_clear();
}

/* The largest difference of a colour of `now` from `before`, [OUTPUTS][stride]. */
static double change(const struct scene *scene, const float *now, const float *before) {
  double most = 0;
  for (size_t i = 0; i < 3 * (scene->rays + 5); i++)
    if (!is_poison(before[i])) most = fmax(most, fabs((double)now[i] - (double)before[i]));
  return most;
}

/* Speech and eyes so strong that each of them decides what is seen: none of the density's inputs may be lost. */
static void test_every_input_counts_long(void **state) {
  (void)state;
  for (int levels = 11; levels <= 14; levels++) {
    if (is_sampled() && levels % 3 != 2) continue;
    struct scene scene = scene_make(levels, true, 2, 30, 26, 3);
    const float *weak = render(&scene, 0, 1, true);
    const double seen = 3 * allowed_of(&scene, true);
    double eyes = 0, speech = 0;
    for (int turn = 0; eyes <= seen && turn < 3; turn++) {
      scene.eye_value = ldexpf(16, turn);
      eyes = change(&scene, render(&scene, 0, 1, true), weak);
      check_scene(&scene, "strong eyes");
    }
    scene.eye_value = 0.4f;
    for (int turn = 0; speech <= seen && turn < 3; turn++) {
      for (size_t c = 0; c < ERN_AUDIO_CODE; c++) scene.code[c] *= turn == 0 ? 16 : 2;
      speech = change(&scene, render(&scene, 0, 1, true), weak);
      check_scene(&scene, "strong speech");
    }
    assert_true(eyes > seen && speech > seen);
    machines_clear();
  }
}

/* Multiply-adds of the networks, as a fused pass does them: the density's geometry and the colour's first layer are
 * one, which directions and codes reach once a ray. 0 where no machine tells the samples. */
static double products(const struct scene *scene, struct stage *stage) {
  const struct ern_field *f = &scene->field;
  const int *d = f->density.width, *c = f->colour.width;
  const double sigma = (double)d[0] * d[1] + (double)d[1] * d[2] + d[2], colour = (double)d[2] * c[1] + c[1] * c[2];
  const double regions = products_of(&f->attention, false) + products_of(&f->eye, false);
  double most = 0;
  EACH_OTHER (k) {
    struct ern_profile profile = {.timed = false};
    stage->args[k].profile = &profile;
    RUN_ON(k, render_rays, &stage->args[k]);
    stage->args[k].profile = NULL;
    most = fmax(most, (double)profile.count[ERN_PROFILE_SAMPLES] * (regions + sigma) +
                          (double)profile.count[ERN_PROFILE_COLOURS] * colour);
  }
  return most;
}

/* A 450 x 450 view of a made-up head, by pixel; the reference's stages too. */
static void bench(void) {
  struct scene scene = scene_make(14, true, 2, 450, 450, 8);
  struct stage stage = stage_make(&scene, false);
  BENCH_PRODUCTS("a view of 450 x 450", scene.rays, products(&scene, &stage), render_rays, stage.args);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_models),
    cmocka_unit_test(test_without_view_long),
    cmocka_unit_test(test_settings),
    cmocka_unit_test(test_occupancies_and_densities),
    cmocka_unit_test(test_lists_of_pixels),
    cmocka_unit_test(test_unprepared),
    cmocka_unit_test(test_frames_follow),
    cmocka_unit_test(test_threads_and_outputs),
    cmocka_unit_test(test_every_input_counts_long),
};
NOUN(render, bench, .in_double = true, .bf16 = true, .tensor = true, .more = add_emulated)
