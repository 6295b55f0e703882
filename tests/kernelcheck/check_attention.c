/* SPDX-License-Identifier: MIT
 * Region attention of each instruction set against the reference: the forward pass to the bit, the gradient to
 * rounding. */
#include "kernelcheck.h"

#include <float.h>

#include "core/kernels.h"

struct kernel {
  const char *name;
  machine_isa isa;
  ern_attention_fwd_kernel *fwd;
  ern_attention_bwd_kernel *bwd;
};

static const struct kernel kernels[] = {
    {"ref", MACHINE_REF, ern_attention_fwd_ref, ern_attention_bwd_ref},
#if defined(ERN_X86_KERNELS)
    {"avx2", MACHINE_AVX2, ern_attention_fwd_avx2, ern_attention_bwd_avx2},
    {"avx512", MACHINE_AVX512, ern_attention_fwd_avx512, ern_attention_bwd_avx512},
#elif defined(ERN_ARM_KERNELS)
    {"neon", MACHINE_NEON, ern_attention_fwd_neon, ern_attention_bwd_neon},
#endif
};
enum { KERNELS = sizeof kernels / sizeof *kernels };

static const size_t sizes[] = {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33, 100, 511, 512, 513, 1100};
enum { SIZES = sizeof sizes / sizeof *sizes, MOST_CHANNELS = 130 };

/* A row of values of one sample each: what they are, by kind, is a sample's own matter. */
static float value_of(uint64_t seed, size_t c, size_t i, int kind) {
  static const float scales[] = {1, 0, 1e-30f, 1e-42f, 1e25f, 3e38f, 1e-18f, 4};
  const float value = random_at(seed, c * 4096 + i, 1);
  if (kind == 0) return value;
  if (i % 29 == 7 && c == i % 5) return i % 2 ? NAN : INFINITY;
  return value * scales[i % 8];
}

struct scene {
  struct ern_attention_shape shape;
  int kind;
  size_t n, stride;
  float code[MOST_CHANNELS], eye;
  struct guarded v, eye_attention, dregion, dnorm, dregion_eye;
};

static struct scene scene_make(int channels, int values, size_t n, int kind) {
  struct scene s = {.shape = {channels, values}, .kind = kind, .n = n, .stride = n + 7, .eye = 0.37f};
  const size_t rows = (size_t)channels, v_rows = (size_t)values;
  for (size_t c = 0; c < rows; c++) s.code[c] = random_at(1, c, 2);
  s.v = guarded_make(v_rows * s.stride);
  s.dregion = guarded_make(rows * s.stride);
  s.eye_attention = guarded_make(n);
  s.dnorm = guarded_make(n);
  s.dregion_eye = guarded_make(n);
  for (size_t c = 0; c < v_rows; c++) {
    for (size_t i = 0; i < n; i++) s.v.data[c * s.stride + i] = value_of(2, c, i, kind);
  }
  random_rows(&s.dregion, rows, s.stride, n, 1, 3);
  random_rows(&s.dnorm, 1, n, n, 1, 4);
  random_rows(&s.eye_attention, 1, n, n, 1, 5);
  random_rows(&s.dregion_eye, 1, n, n, 1, 6);
  return s;
}

static void scene_free(struct scene *s) {
  struct guarded *const arrays[] = {&s->v, &s->dregion, &s->eye_attention, &s->dnorm, &s->dregion_eye};
  for (size_t k = 0; k < sizeof arrays / sizeof *arrays; k++) guarded_free(arrays[k]);
}

/* Same bits, or both no number. */
static void expect_same(const char *kernel, const char *what, const struct guarded *found,
                        const struct guarded *expected) {
  for (size_t i = 0; i < found->count; i++) {
    if (memcmp(&found->data[i], &expected->data[i], sizeof(float)) == 0) continue;
    if (isnan(found->data[i]) && isnan(expected->data[i]) && !is_poison(found->data[i])) continue;
    fail_msg("%s %s [%zu]: %.9g, reference %.9g", kernel, what, i, found->data[i], expected->data[i]);
  }
}

static void check_fwd(const struct scene *s, const struct kernel *kernel, bool eye) {
  const size_t rows = (size_t)s->shape.channels;
  struct guarded region[2], norm[2], region_eye[2];
  for (int with = 0; with < 2; with++) {
    region[with] = guarded_make(rows * s->stride);
    norm[with] = guarded_make(s->n);
    region_eye[with] = guarded_make(s->n);
    (with == 0 ? &kernels[0] : kernel)
        ->fwd(region[with].data, norm[with].data, eye ? region_eye[with].data : NULL, s->v.data, s->code,
              eye ? s->eye_attention.data : NULL, s->eye, s->shape, s->stride, s->n);
  }
  expect_same(kernel->name, "region", &region[1], &region[0]);
  expect_same(kernel->name, "norm", &norm[1], &norm[0]);
  expect_same(kernel->name, "region_eye", &region_eye[1], &region_eye[0]);
  guarded_check(&region[1], rows, s->stride, s->n, "region");
  guarded_check(&norm[1], 1, s->n, s->n, "norm");
  for (int with = 0; with < 2; with++) {
    guarded_free(&region[with]);
    guarded_free(&norm[with]);
    guarded_free(&region_eye[with]);
  }
}

struct gradients {
  struct guarded dv, dcode, deye;
};

static struct gradients gradients_of(const struct scene *s, const struct kernel *kernel, const float *norm,
                                     unsigned parts) {
  const size_t rows = (size_t)s->shape.channels;
  struct gradients g = {guarded_make((size_t)s->shape.values * s->stride), guarded_make(rows), guarded_make(s->n)};
  random_rows(&g.dcode, 1, rows, rows, 1, 8);
  random_rows(&g.deye, 1, s->n, s->n, 1, 9);
  kernel->bwd(g.dv.data, parts & 4 ? g.dcode.data : NULL, g.deye.data, parts & 1 ? s->dregion.data : NULL,
              parts & 2 ? s->dnorm.data : NULL, parts & 4 ? s->dregion_eye.data : NULL, s->v.data, norm, s->code,
              s->eye, s->shape, s->stride, s->n);
  return g;
}

/* What the terms of dv (row r, sample i) add up to in size. */
static double dv_size(const struct scene *s, size_t r, size_t i) {
  const size_t end = s->shape.values == 1 ? (size_t)s->shape.channels : r + 1;
  double size = fabs((double)s->dnorm.data[i]);
  for (size_t c = r; c < end; c++) size += fabs((double)s->code[c] * (double)s->dregion.data[c * s->stride + i]);
  return size;
}

/* dv: a product for the region; for the norm the inverse, its product with v and that with dnorm, so 3 roundings of
 * half a unit where the reference has 2; the sum. All terms are of the sizes below; of one v for all channels those of
 * the region are added up as in the reference. dcode: sums in double, half a unit for its rounding to float and half
 * for the sum with what was there. */
static void check_bwd(const struct scene *s, const struct kernel *kernel, unsigned parts) {
  const size_t rows = (size_t)s->shape.channels, v_rows = (size_t)s->shape.values;
  struct guarded norm = guarded_make(s->n), region = guarded_make(rows * s->stride);
  kernels[0].fwd(region.data, norm.data, NULL, s->v.data, s->code, NULL, 0, s->shape, s->stride, s->n);
  struct gradients found = gradients_of(s, kernel, norm.data, parts),
                   expected = gradients_of(s, &kernels[0], norm.data, parts);
  for (size_t r = 0; r < v_rows; r++) {
    for (size_t i = 0; i < s->n; i++) {
      const size_t at = r * s->stride + i;
      const double a = (double)found.dv.data[at], b = (double)expected.dv.data[at];
      if (!(fabs(a - b) <= 4 * 0x1p-23 * dv_size(s, r, i)) && !(isnan(a) && isnan(b)) && !(a == b))
        fail_msg("%s dv [%zu][%zu]: %.9g, reference %.9g", kernel->name, r, i, a, b);
    }
  }
  for (size_t c = 0; c < rows; c++) {
    const double a = (double)found.dcode.data[c], b = (double)expected.dcode.data[c];
    if (!(fabs(a - b) <= 0x1p-22 * fabs(b) + 0x1p-24) && !(isnan(a) && isnan(b)) && !(a == b))
      fail_msg("%s dcode [%zu]: %.9g, reference %.9g", kernel->name, c, a, b);
  }
  expect_same(kernel->name, "deye", &found.deye, &expected.deye);
  guarded_check(&found.dv, v_rows, s->stride, s->n, "dv");
  guarded_check(&found.dcode, 1, rows, rows, "dcode");
  guarded_free(&norm);
  guarded_free(&region);
  struct guarded *const used[] = {&found.dv, &found.dcode, &found.deye, &expected.dv, &expected.dcode, &expected.deye};
  for (size_t k = 0; k < sizeof used / sizeof *used; k++) guarded_free(used[k]);
}

/* Without v the eye alone; nothing else is touched. */
static void check_eye(const struct kernel *kernel, size_t n) {
  struct scene s = scene_make(1, 1, n, 0);
  struct guarded region_eye[2] = {guarded_make(n), guarded_make(n)}, deye[2] = {guarded_make(n), guarded_make(n)};
  const struct ern_attention_shape none = {0, 0};
  for (int with = 0; with < 2; with++) {
    const struct kernel *one = with == 0 ? &kernels[0] : kernel;
    random_rows(&deye[with], 1, n, n, 1, 9);
    one->fwd(NULL, NULL, region_eye[with].data, NULL, s.code, s.eye_attention.data, s.eye, none, 0, n);
    one->bwd(NULL, NULL, deye[with].data, NULL, NULL, s.dregion_eye.data, NULL, NULL, s.code, s.eye, none, 0, n);
  }
  expect_same(kernel->name, "region_eye alone", &region_eye[1], &region_eye[0]);
  expect_same(kernel->name, "deye alone", &deye[1], &deye[0]);
  for (int with = 0; with < 2; with++) {
    guarded_free(&region_eye[with]);
    guarded_free(&deye[with]);
  }
  scene_free(&s);
}

static void check_kind(int kind) {
  static const struct ern_attention_shape shapes[] = {
      {1, 1}, {32, 32}, {64, 64}, {65, 65}, {MOST_CHANNELS, MOST_CHANNELS}, {2, 1}, {32, 1}, {MOST_CHANNELS, 1}};
  if (KERNELS == 1) skip(); /* built without instruction sets */
  for (size_t k = 1; k < KERNELS; k++) {
    if (!machine_has(kernels[k].isa)) {
      print_message("%s: not on this machine\n", kernels[k].name);
      continue;
    }
    for (size_t n = 0; n < SIZES; n++) check_eye(&kernels[k], sizes[n]);
    for (size_t c = 0; c < sizeof shapes / sizeof *shapes; c++) {
      for (size_t n = 0; n < SIZES; n++) {
        struct scene s = scene_make(shapes[c].channels, shapes[c].values, sizes[n], kind);
        check_fwd(&s, &kernels[k], n % 2 == 0);
        for (unsigned parts = 0; parts < 8; parts++) check_bwd(&s, &kernels[k], parts);
        scene_free(&s);
      }
    }
  }
}

static void test_usual(void **state) {
  (void)state;
  check_kind(0);
}

/* Vectors of nothing, of denormal, tiny and the largest numbers, whose squares are no floats; no numbers. */
static void test_extreme(void **state) {
  (void)state;
  check_kind(1);
}

/* ---- measure ---- */

struct bench {
  const struct kernel *kernel;
  struct scene scene;
  struct guarded region, norm;
  bool backward;
};

static void bench_run(void *user) {
  struct bench *b = user;
  const struct scene *s = &b->scene;
  static float dcode[MOST_CHANNELS];
  if (b->backward) {
    b->kernel->bwd(b->region.data, dcode, NULL, s->dregion.data, s->dnorm.data, NULL, s->v.data, b->norm.data, s->code,
                   s->eye, s->shape, s->stride, s->n);
  } else {
    b->kernel->fwd(b->region.data, b->norm.data, NULL, s->v.data, s->code, NULL, s->eye, s->shape, s->stride, s->n);
  }
}

/* n samples: of a tile, in the cache, or of a batch, in memory. */
static void measure(size_t n) {
  struct bench bench = {.scene = scene_make(32, 32, n, 0)};
  bench.region = guarded_make(32 * bench.scene.stride);
  bench.norm = guarded_make(bench.scene.n);
  for (int backward = 0; backward < 2; backward++) {
    double first = 0;
    bench.backward = backward != 0;
    for (size_t k = 0; k < KERNELS; k++) {
      if (!machine_has(kernels[k].isa)) continue;
      bench.kernel = &kernels[k];
      const double seconds = seconds_of(bench_run, &bench);
      if (k == 0) first = seconds;
      printf("attention of 32 channels, %zu samples, %s %-6s: %6.2f ns a sample, %.1f times ref\n", n,
             backward ? "backward" : "forward ", kernels[k].name, seconds * 1e9 / (double)bench.scene.n,
             first / seconds);
    }
  }
  guarded_free(&bench.region);
  guarded_free(&bench.norm);
  scene_free(&bench.scene);
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    measure(1024);
    measure(1 << 17);
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_usual),
      cmocka_unit_test(test_extreme),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
