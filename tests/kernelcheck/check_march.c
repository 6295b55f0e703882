/* SPDX-License-Identifier: MIT
 * Rays, marching and samples of each instruction set against the reference: nothing but the same bits is accepted. */
#include "kernelcheck.h"
#include "march_scenes.h"

#include "core/kernels.h"
#include "render/visible_ops.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_rays_kernel *rays;
  ern_march_kernel *march;
  ern_march_from_kernel *march_from;
  ern_samples_kernel *samples;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_rays_ref, ern_march_ref, ern_march_from_ref, ern_samples_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_rays_avx2, ern_march_avx2, ern_march_from_avx2, ern_samples_avx2},
    {"avx512", MACHINE_AVX512, ern_rays_avx512, ern_march_avx512, ern_march_from_avx512, ern_samples_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_rays_neon, ern_march_neon, ern_march_from_neon, ern_samples_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

/* Floats of the same bits; zeros of different signs are different. */
static void expect_same(const char *kernel, const char *what, const float *found, const float *expected, size_t count) {
  if (memcmp(found, expected, count * sizeof *found) == 0) return;
  for (size_t i = 0; i < count; i++) {
    uint32_t a, b;
    memcpy(&a, found + i, sizeof a);
    memcpy(&b, expected + i, sizeof b);
    /* which NaN comes of an operation is not settled */
    if (a == b || (isnan(found[i]) && isnan(expected[i]) && !is_poison(found[i]) && !is_poison(expected[i]))) continue;
    fail_msg("%s %s [%zu]: %.9g, reference %.9g", kernel, what, i, (double)found[i], (double)expected[i]);
  }
}

/* ---- rays ---- */

static void check_rays(const struct ern_view *view, const int32_t *pixel, size_t n) {
  const size_t stride = n + 5;
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    struct guarded expected = guarded_make(3 * stride), found = guarded_make(3 * stride);
    int32_t *exact = malloc(n * sizeof *exact); /* so that a sanitizer sees what is read past its end */
    assert_non_null(exact);
    memcpy(exact, pixel, n * sizeof *exact);
    kernels[0].rays(expected.data, stride, exact, view, n);
    kernels[k].rays(found.data, stride, exact, view, n);
    expect_same(kernels[k].name, "dir", found.data, expected.data, found.count);
    guarded_check(&found, 3, stride, n, "dir");
    free(exact);
    guarded_free(&expected);
    guarded_free(&found);
  }
}

static void test_rays(void **state) {
  (void)state;
  struct ern_view view;
  int32_t pixel[MOST];
  for (size_t w = 0; w < WIDTHS; w++) {
    for (uint64_t seed = 0; seed < 40; seed++) {
      aim_camera(&view, pixel, widths[w], seed);
      check_rays(&view, pixel, sizes[seed % SIZES]);
    }
  }
}

/* ---- march and samples ---- */

/* Copies of inputs that end where the n rays do. */
static float *exact_rows(const float *from, size_t rows, size_t n) {
  float *to = malloc(rows * n * sizeof *to);
  assert_non_null(to);
  for (size_t k = 0; k < rows; k++) memcpy(to + k * n, from + k * MOST, n * sizeof *to);
  return to;
}

static void check_samples(const struct kernel *kernel, const struct scene *scene, const float *dir, const float *t,
                          const int32_t *count, const struct ern_march_settings *settings) {
  const size_t n = scene->n;
  int32_t first[MOST + 1] = {3}; /* as if other rays had samples before */
  for (size_t r = 0; r < n; r++) first[r + 1] = first[r] + count[r];
  const size_t total = (size_t)first[n], stride = total + 9;
  struct guarded array[2][4]; /* x, dt, depth, ray */
  for (int k = 0; k < 2; k++) {
    for (int a = 0; a < 4; a++) array[k][a] = guarded_make(a == 0 ? 3 * stride : stride);
    (k == 0 ? ern_samples_ref : kernel->samples)(array[k][0].data, stride, array[k][1].data, array[k][2].data,
                                                 (int32_t *)(void *)array[k][3].data, t, first, dir, n, scene->origin,
                                                 settings, 1000, n);
  }
  for (int a = 0; a < 4; a++) {
    expect_same(kernel->name, a == 0 ? "x" : "a row of samples", array[1][a].data, array[0][a].data, array[0][a].count);
    guarded_check(&array[1][a], a == 0 ? 3 : 1, stride, total, "samples");
    guarded_free(&array[0][a]);
    guarded_free(&array[1][a]);
  }
}

/* Every kernel, with jitter and without, as one more than the reference needs not_before. Returns all samples. */
static size_t check_march(const struct scene *scene, const struct ern_march_settings *settings, bool with_jitter,
                          bool from) {
  const size_t n = scene->n, row = (size_t)settings->max_steps;
  struct guarded t[2] = {guarded_make(n * row), guarded_make(n * row)};
  struct guarded count[2] = {guarded_make(n), guarded_make(n)};
  float *dir = exact_rows(scene->dir, 3, n), *jitter = exact_rows(scene->jitter, 1, n),
        *not_before = exact_rows(scene->not_before, 1, n);
  const float *start = with_jitter ? jitter : NULL;
  size_t total = 0;
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    const int to = k > 0;
    int32_t *counts = (int32_t *)(void *)count[to].data;
    poison(t[to].data, t[to].count);
    poison(count[to].data, n);
    if (from) {
      kernels[k].march_from(t[to].data, counts, dir, n, start, not_before, scene->bits, scene->origin, settings, n);
    } else {
      kernels[k].march(t[to].data, counts, dir, n, start, scene->bits, scene->origin, settings, n);
    }
    if (k == 0) {
      for (size_t r = 0; r < n; r++) total += (size_t)counts[r];
      continue;
    }
    for (size_t r = 0; r < n; r++) {
      const int32_t expected = ((int32_t *)(void *)count[0].data)[r];
      if (counts[r] != expected) {
        fail_msg("%s ray %zu: %d samples, reference %d (max_steps %d, gamma %g)", kernels[k].name, r, counts[r],
                 expected, settings->max_steps, (double)settings->dt_gamma);
      }
    }
    expect_same(kernels[k].name, "t", t[1].data, t[0].data, t[0].count); /* past a ray's samples: poison in both */
    guarded_check(&t[1], 1, t[1].count, t[1].count, "t");
    guarded_check(&count[1], 1, n, n, "count");
    check_samples(&kernels[k], scene, dir, t[0].data, counts, settings);
  }
  free(dir), free(jitter), free(not_before);
  for (int k = 0; k < 2; k++) guarded_free(&t[k]), guarded_free(&count[k]);
  return total;
}

static void march_all(struct scene *scene, size_t least) {
  size_t total = 0;
  for (size_t k = 0; k < SETTINGS; k++) {
    for (size_t o = 0; o < ORIGINS; o++) {
      memcpy(scene->origin, origins[o], sizeof scene->origin);
      scene->n = sizes[(k * ORIGINS + o) % SIZES];
      if (o < 2) scene->n = MOST;
      aim(scene, settings_list[k].bound, 100 * k + o);
      total += check_march(scene, &settings_list[k], false, false);
      total += check_march(scene, &settings_list[k], true, (k + o) % 2 == 0);
      check_march(scene, &settings_list[k], false, true);
    }
  }
  assert_true(total >= least);
}

static struct scene scene; /* too large for a stack */

static void test_empty(void **state) {
  (void)state;
  memset(scene.bits, 0, sizeof scene.bits);
  march_all(&scene, 0);
}
static void test_full(void **state) {
  (void)state;
  memset(scene.bits, 0xff, sizeof scene.bits);
  march_all(&scene, 200000);
}
static void test_random_bits(void **state) {
  (void)state;
  static const uint32_t per_mille[] = {1, 20, 300, 900};
  for (uint64_t k = 0; k < 4; k++) {
    fill_random(scene.bits, per_mille[k], k);
    march_all(&scene, 400);
  }
}
static void test_shell(void **state) {
  (void)state;
  fill_shell(scene.bits, (float[]){0.1f, -0.05f, 0}, (float[]){0.5f, 0.35f, 0.4f}, 0.2f);
  march_all(&scene, 10000);
}

static void test_adversarial(void **state) {
  (void)state;
  for (size_t k = 0; k < ODD; k++) {
    for (int full = 0; full < 2; full++) {
      memset(scene.bits, full ? 0xff : 0x10, sizeof scene.bits);
      for (uint64_t seed = 0; seed < 30; seed++) {
        aim_oddly(&scene, seed);
        scene.n = seed % 3 == 1 ? MOST : sizes[seed % SIZES];
        check_march(&scene, &odd_settings[k], seed % 2 == 0, seed % 5 == 0);
      }
    }
  }
}

/* What is said about the cells before a distance, where it is true, changes nothing. With steps shorter than the way
 * through a cell a rung within rounding of a border may be counted to either cell: none of these rays has one. */
static void test_not_before(void **state) {
  (void)state;
  static float t[2][MOST * ERN_MAX_STEPS];
  int32_t count[2][MOST];
  fill_shell(scene.bits, (float[]){0.1f, -0.05f, 0}, (float[]){0.5f, 0.35f, 0.4f}, 0.2f);
  for (size_t k = 0; k < 9; k++) {
    for (size_t o = 0; o < ORIGINS; o++) {
      const struct ern_march_settings *settings = &settings_list[k];
      const size_t row = (size_t)settings->max_steps;
      memcpy(scene.origin, origins[o], sizeof scene.origin);
      aim(&scene, settings->bound, 7 * k + o);
      ern_march_ref(t[0], count[0], scene.dir, MOST, scene.jitter, scene.bits, scene.origin, settings, MOST);
      for (size_t r = 0; r < MOST; r++) {
        const float sure = count[0][r] > 0 ? t[0][r * row] : INFINITY;
        scene.not_before[r] = r % 3 == 0 ? sure : sure * ern_uniform(word_at(k, r));
      }
      for (size_t i = 0; i < KERNELS; i++) {
        if (!machine_has(kernels[i].isa)) continue;
        kernels[i].march_from(t[1], count[1], scene.dir, MOST, scene.jitter, scene.not_before, scene.bits, scene.origin,
                              settings, MOST);
        assert_memory_equal(count[0], count[1], sizeof count[0]);
        for (size_t r = 0; r < MOST; r++) {
          assert_memory_equal(t[0] + r * row, t[1] + r * row, (size_t)count[0][r] * sizeof(float));
        }
      }
    }
  }
}

/* ---- speed ---- */

/* A frame of 450 x 450 pixels, as the blocks of 8 x 8 that a renderer deals out. */
enum { FRAME = 450, TILE = 1024, PIXELS = FRAME * FRAME };

struct bench {
  const struct kernel *kernel;
  struct ern_view view;
  struct ern_march_settings settings;
  float origin[3];
  const int32_t *pixel;
  const float *not_before; /* by pixel of the list, or NULL */
  size_t n, samples;
  float dir[3 * TILE], t[TILE * 16], x[3 * TILE * 16], row[2][TILE * 16];
  int32_t count[TILE], first[TILE + 1], ray[TILE * 16];
  double part[3]; /* seconds of rays, march, samples */
};

static void bench_run(void *user) {
  struct bench *b = user;
  b->samples = 0;
  memset(b->part, 0, sizeof b->part);
  for (size_t begin = 0; begin < b->n; begin += TILE) {
    const size_t n = b->n - begin < TILE ? b->n - begin : TILE;
    const double at0 = seconds_now();
    b->kernel->rays(b->dir, TILE, b->pixel + begin, &b->view, n);
    const double at1 = seconds_now();
    b->kernel->march_from(b->t, b->count, b->dir, TILE, NULL, b->not_before ? b->not_before + begin : NULL, scene.bits,
                          b->origin, &b->settings, n);
    const double at2 = seconds_now();
    for (size_t r = 0; r < n; r++) b->first[r + 1] = b->first[r] + b->count[r];
    b->kernel->samples(b->x, TILE * 16, b->row[0], b->row[1], b->ray, b->t, b->first, b->dir, TILE, b->origin,
                       &b->settings, 0, n);
    b->part[0] += at1 - at0, b->part[1] += at2 - at1, b->part[2] += seconds_now() - at2;
    b->samples += (size_t)b->first[n];
  }
}

enum { BLOCKS = (FRAME + 7) / 8 };

/* Blocks of 8 x 8 one after the other, row by row in each; of distances other than infinity, which each pixel gets. */
static size_t list_blocks(int32_t *pixel, float *distance, const float *by_block) {
  size_t n = 0;
  for (int b = 0; b < BLOCKS * BLOCKS; b++) {
    for (int i = 0; i < 64 && by_block[b] < INFINITY; i++) {
      const int x = b % BLOCKS * 8 + i % 8, y = b / BLOCKS * 8 + i / 8;
      if (x >= FRAME || y >= FRAME) continue;
      distance[n] = by_block[b];
      pixel[n++] = y * FRAME + x;
    }
  }
  return n;
}

static float by_block[BLOCKS * BLOCKS];
static void visible_run(void *user) {
  const struct bench *b = user;
  ern_visible_blocks(by_block, scene.bits, &b->view, b->settings.bound);
}

static void measure_kernels(struct bench *bench, const char *what) {
  double first = 0;
  for (size_t k = 0; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) continue;
    bench->kernel = &kernels[k];
    const double seconds = seconds_of(bench_run, bench);
    if (k == 0) first = seconds;
    printf("%s, %-6s: %6.2f ms a frame (rays %.2f, march %.2f, samples %.2f), %.1f million rays/s, %.2f times ref\n",
           what, kernels[k].name, 1e3 * seconds, 1e3 * bench->part[0], 1e3 * bench->part[1], 1e3 * bench->part[2],
           1e-6 * (double)bench->n / seconds, first / seconds);
  }
  printf("%s: %zu rays, %zu samples\n", what, bench->n, bench->samples);
}

/* A head-like shell, or the bits of a file. */
static int measure(const char *bits_path) {
  static struct bench bench = {.view = {{0.0515f, -0.9978f, -0.0413f, 0.044f, 0.0596f, 0.0443f, -0.9972f, 3.602f,
                                         0.9969f, 0.0489f, 0.0617f, -0.229f, 0, 0, 0, 1},
                                        1080,
                                        225,
                                        225,
                                        FRAME,
                                        FRAME},
                               .settings = {1, 16, 1 / 256.0f, 0.05f},
                               .origin = {0.044f, 3.602f, -0.229f}};
  static int32_t pixel[PIXELS];
  static float distance[PIXELS];
  fill_shell(scene.bits, (float[]){0.1f, -0.05f, 0}, (float[]){0.45f, 0.35f, 0.35f}, 0.25f);
  FILE *file = bits_path != NULL ? fopen(bits_path, "rb") : NULL;
  if (file != NULL) {
    if (fread(scene.bits, 1, sizeof scene.bits, file) != sizeof scene.bits) return 1;
    fclose(file);
  }
  bench.pixel = pixel;
  bench.n = list_blocks(pixel, distance, by_block);
  measure_kernels(&bench, "all rays");
  printf("visible blocks: %.3f ms\n", 1e3 * seconds_of(visible_run, &bench));
  bench.n = list_blocks(pixel, distance, by_block);
  measure_kernels(&bench, "visible blocks");
  bench.not_before = distance;
  measure_kernels(&bench, "visible blocks, not before");
  return 0;
}

int main(int argc, char **argv) {
  if (argc >= 2 && strcmp(argv[1], "--bench") == 0) return measure(argv[2]);
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_rays),        cmocka_unit_test(test_empty), cmocka_unit_test(test_full),
      cmocka_unit_test(test_random_bits), cmocka_unit_test(test_shell), cmocka_unit_test(test_adversarial),
      cmocka_unit_test(test_not_before),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
