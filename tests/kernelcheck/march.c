/* SPDX-License-Identifier: MIT
 * Rays, marching, scans and samples: nothing but the same bits is accepted, so that all machines look at the same
 * points. */
#include "harness.h"

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/cpu_state.h"
#include "march_scenes.h"

static struct scene scene; /* too large for a stack */

/* ---- rays ---- */

static void check_rays(const struct ern_view *view, const int32_t *pixel, size_t n) {
  const struct many_rows dir = many_strided(NULL, 3, n, ERN_PER_RAY);
  const struct many numbers = many_exact(ERN_ELEMENT_INT32, pixel, n);
  struct ern_rays_args args[MACHINES];
  EACH_MACHINE (k) args[k] = (struct ern_rays_args){.dir = dir.on[k], .pixel = numbers.on[k], .view = *view, .n = n};
  RUN(rays, args);
  expect_bits("dir", of_rows(dir));
  machines_clear();
}

static void test_rays(void **state) {
  (void)state;
  struct ern_view view;
  int32_t pixel[MOST_SIZE] = {0};
  for (size_t w = 0; w < WIDTHS; w++) {
    for (uint64_t seed = 0; seed < (is_small() ? 4 : is_emulated() ? 12 : 40); seed++) {
      aim_camera(&view, pixel, widths[w], seed);
      check_rays(&view, pixel, sizes[seed % SIZES]);
    }
  }
  for (size_t i = MOST; i < MOST_SIZE; i++) pixel[i] = (int32_t)(200 * i);
  aim_camera(&view, pixel, 450, 0);
  for (size_t s = 0; s < size_count(); s++) check_rays(&view, pixel, test_sizes[s]);
  check_rays(&view, pixel, 0);
}

/* ---- march and samples ---- */

static void check_samples(size_t n, struct many t, struct many first, struct many_rows dir, size_t total,
                          const struct ern_march_settings *settings) {
  const struct many_rows x = many_strided(NULL, 3, total, ERN_PER_SAMPLE);
  const struct many dt = many_empty(total), depth = many_empty(total), ray = many_of(ERN_ELEMENT_INT32, NULL, total);
  struct ern_samples_args args[MACHINES];
  EACH_MACHINE (k)
    args[k] = (struct ern_samples_args){.x = x.on[k],
                                        .dt = dt.on[k],
                                        .depth = depth.on[k],
                                        .ray = ray.on[k],
                                        .t = t.on[k],
                                        .first = first.on[k],
                                        .dir = dir.on[k],
                                        .origin = {scene.origin[0], scene.origin[1], scene.origin[2]},
                                        .settings = *settings,
                                        .n = n};
  RUN(samples, args);
  expect_bits("x", of_rows(x));
  expect_bits("dt", dt);
  expect_bits("depth", depth);
  expect_same_int32s("ray", ray);
  const struct many_rows d = many_strided(NULL, 3, total, ERN_PER_SAMPLE);
  ON_EACH(spread_rays, ern_spread_rays_args, {d.on[k], dir.on[k], ray.on[k], total})
  expect_bits("d", of_rows(d));
}

/* The kernel that render_rays calls, which looks at no cell before a distance, on the CPU's machines: any distances. */
static void check_march_from(size_t n, struct many t, struct many count, struct many_rows dir, struct many jitter,
                             struct many bits, const struct ern_march_settings *settings) {
  const struct many not_before = many_exact(ERN_ELEMENT_REAL, scene.not_before, n), t_from = many_empty(t.on[0].count),
                    count_from = many_of(ERN_ELEMENT_INT32, NULL, count.on[0].count);
  EACH_MACHINE (k) {
    if (kernels_of(k) == NULL) continue;
    kernels_of(k)->march_from(host_reals(k, t_from.on[k]), host_memory(k, count_from.on[k]),
                              host_reals(k, dir.on[k].span), dir.on[k].stride,
                              jitter.on[k].buffer != NULL ? host_reals(k, jitter.on[k]) : NULL,
                              host_reals(k, not_before.on[k]), host_memory(k, bits.on[k]), scene.origin, settings, n);
    if (k == 0) continue;
    const int32_t *found = int32s_of(k, count_from), *expected = int32s_of(0, count_from);
    assert_memory_equal(found, expected, n * sizeof *found);
    expect_near_on(k, "t, not before", t_from, 0, 0);
  }
}

/* The first n rays of the scene; returns their samples. bits: of the scene. */
static size_t check_march(size_t n, struct many bits, const struct ern_march_settings *settings, bool with_jitter,
                          bool from) {
  const struct machines_mark kept = machines_mark();
  float rows[3 * MOST];
  for (size_t a = 0; a < 3; a++) memcpy(rows + a * n, scene.dir + a * MOST, n * sizeof *rows);
  const struct many_rows dir = many_strided(rows, 3, n, ERN_PER_RAY);
  const struct many none = {0}, jitter = with_jitter ? many_exact(ERN_ELEMENT_REAL, scene.jitter, n) : none,
                    t = many_empty(n * (size_t)settings->max_steps), count = many_of(ERN_ELEMENT_INT32, NULL, n),
                    first = many_of(ERN_ELEMENT_INT32, NULL, n + 1);
  struct ern_march_args march[MACHINES];
  struct ern_scan_args scan[MACHINES];
  EACH_MACHINE (k) {
    march[k] = (struct ern_march_args){.t = t.on[k],
                                       .count = count.on[k],
                                       .dir = dir.on[k],
                                       .jitter = jitter.on[k],
                                       .bits = bits.on[k],
                                       .origin = {scene.origin[0], scene.origin[1], scene.origin[2]},
                                       .settings = *settings,
                                       .n = n};
    scan[k] = (struct ern_scan_args){.first = first.on[k], .count = count.on[k], .n = n};
  }
  RUN(march, march);
  expect_same_int32s("count", count);
  expect_bits("t", t); /* past a ray's samples: poison in both */
  RUN(scan, scan);
  EACH_OTHER (k) assert_int_equal(scan[k].total, scan[0].total);
  expect_same_int32s("first", first);
  check_samples(n, t, first, dir, scan[0].total, settings);
  if (from) check_march_from(n, t, count, dir, jitter, bits, settings);
  machines_clear_to(kept);
  return scan[0].total;
}

/* On simulators one origin and few rays for each of the settings. */
static void march_all(size_t least) {
  const struct many bits = many_of(ERN_ELEMENT_BYTE, scene.bits, sizeof scene.bits);
  size_t total = 0;
  for (size_t k = 0; k < SETTINGS; k++) {
    for (size_t o = 0; o < ORIGINS; o++) {
      if (is_small() && o != k % ORIGINS) continue;
      memcpy(scene.origin, origins[o], sizeof scene.origin);
      const size_t n = is_small() ? sizes[(3 * k + o) % 11] : o < 2 ? MOST : sizes[(k * ORIGINS + o) % SIZES];
      aim(&scene, settings_list[k].bound, 100 * k + o);
      for (int with_jitter = 0; with_jitter < 2; with_jitter++)
        total += check_march(n, bits, &settings_list[k], with_jitter, with_jitter == 0 || (k + o) % 2 == 0);
    }
  }
  assert_int_equal(check_march(0, bits, &settings_list[0], true, false), 0);
  assert_true(is_small() || total >= least);
  machines_clear();
}

static void test_empty(void **state) {
  (void)state;
  memset(scene.bits, 0, sizeof scene.bits);
  march_all(0);
}
static void test_full(void **state) {
  (void)state;
  memset(scene.bits, 0xff, sizeof scene.bits);
  march_all(200000);
}
static void test_random_bits(void **state) {
  (void)state;
  static const uint32_t per_mille[] = {300, 1, 20, 900};
  for (uint64_t k = 0; k < (is_small() ? 1 : 4); k++) {
    fill_bits(scene.bits, per_mille[k], k);
    march_all(400);
  }
}
static void test_shell(void **state) {
  (void)state;
  fill_shell(scene.bits, (float[]){0.1f, -0.05f, 0}, (float[]){0.5f, 0.35f, 0.4f}, 0.2f);
  march_all(10000);
}
static void test_adversarial(void **state) {
  (void)state;
  for (int full = 0; full < 2; full++) {
    memset(scene.bits, full ? 0xff : 0x10, sizeof scene.bits);
    const struct many bits = many_of(ERN_ELEMENT_BYTE, scene.bits, sizeof scene.bits);
    for (size_t k = 0; k < ODD; k++) {
      for (uint64_t seed = 0; seed < 30; seed += is_small() ? 13 : is_emulated() ? 7 : 1) {
        const size_t n = seed % 3 == 1 && !is_small() ? MOST : sizes[seed % SIZES];
        aim_oddly(&scene, seed);
        check_march(n, bits, &odd_settings[k], seed % 2 == 0, seed % 5 == 0);
      }
    }
    machines_clear();
  }
}

/* Whether rounding decides which cell the rung at t is in. In units of the box p = o + t d, the cell's number and the
 * way to its border are off by 8 u of |o| + |t d| + bound at most (u = 2^-24): no more operations see any of the three.
 */
static bool at_border(const struct ern_march_settings *settings, size_t r, float t) {
  const double bound = (double)settings->bound;
  bool found = false;
  for (size_t a = 0; a < 3; a++) {
    const double o = (double)scene.origin[a], way = (double)t * (double)scene.dir[a * MOST + r];
    const double cell = SIDE / 2 * ((o + way) / bound + 1);
    const double error = SIDE / 2 * 8 * 0x1p-24 * (fabs(o) + fabs(way) + bound) / bound;
    found = found || fabs(cell - round(cell)) <= error;
  }
  return found;
}

/* Samples of ray r, in rising order: those that one of the two alone has are at borders. Where a ray is full one more
 * at its begin is one less at its end. */
static size_t expect_same_samples(const struct ern_march_settings *settings, size_t r, const float *a, int32_t count_a,
                                  const float *b, int32_t count_b) {
  size_t others = 0;
  for (int32_t i = 0, j = 0; i < count_a || j < count_b;) {
    if (i < count_a && j < count_b && a[i] == b[j]) {
      i++, j++;
      continue;
    }
    if (i == settings->max_steps || j == settings->max_steps) break;
    const float t = j == count_b || (i < count_a && a[i] < b[j]) ? a[i++] : b[j++];
    if (!at_border(settings, r, t)) fail_msg("ray %zu: the sample at %.9g is not on both", r, (double)t);
    others++;
  }
  return others;
}

/* What is said about the cells before a distance, where it is true, changes nothing; nor does any machine see a
 * difference. With steps shorter than the way through a cell a rung within rounding of a border may be counted to
 * either cell, by where the steps that come to it begin: few rays have one. */
static void test_not_before(void **state) {
  (void)state;
  size_t others = 0, samples = 0;
  fill_shell(scene.bits, (float[]){0.1f, -0.05f, 0}, (float[]){0.5f, 0.35f, 0.4f}, 0.2f);
  for (size_t s = 0; s < 9; s++) {
    for (size_t o = 0; o < ORIGINS; o++) {
      const struct ern_march_settings *settings = &settings_list[s];
      const size_t row = (size_t)settings->max_steps;
      static float whole[MOST * ERN_MAX_STEPS], t[2][MOST * ERN_MAX_STEPS];
      static int32_t all[MOST], count[2][MOST];
      memcpy(scene.origin, origins[o], sizeof scene.origin);
      aim(&scene, settings->bound, 7 * s + o);
      kernels_of(0)->march(whole, all, scene.dir, MOST, scene.jitter, scene.bits, scene.origin, settings, MOST);
      for (size_t r = 0; r < MOST; r++) {
        const float sure = all[r] > 0 ? whole[r * row] : INFINITY;
        scene.not_before[r] = r % 3 == 0 ? sure : sure * ern_uniform(word_at(s, r));
      }
      EACH_MACHINE (k) {
        if (kernels_of(k) == NULL) continue;
        kernels_of(k)->march_from(t[k > 0], count[k > 0], scene.dir, MOST, scene.jitter, scene.not_before, scene.bits,
                                  scene.origin, settings, MOST);
        assert_memory_equal(count[0], count[k > 0], sizeof count[0]);
        for (size_t r = 0; r < MOST; r++)
          assert_memory_equal(t[0] + r * row, t[k > 0] + r * row, (size_t)count[0][r] * sizeof(float));
        machines.checks += k > 0 ? 2 : 0;
      }
      for (size_t r = 0; r < MOST; r++) {
        const size_t here = expect_same_samples(settings, r, whole + r * row, all[r], t[0] + r * row, count[0][r]);
        if (r % 3 == 0) assert_int_equal(here, 0); /* it begins at its first sample */
        others += here, samples += (size_t)all[r];
      }
    }
  }
  print_message("%zu of %zu samples by where the steps begin\n", others, samples);
  assert_true(10000 * others < samples);
}

/* ---- scan ---- */

enum { COUNTS = (1 << 21) + 5 };

static void check_scan(const int32_t *counts, size_t n) {
  const struct many count = many_int32s(counts, n), first = many_of(ERN_ELEMENT_INT32, NULL, n + 1);
  struct ern_scan_args args[MACHINES];
  EACH_MACHINE (k) args[k] = (struct ern_scan_args){.first = first.on[k], .count = count.on[k], .n = n};
  RUN(scan, args);
  EACH_OTHER (k) assert_int_equal(args[k].total, args[0].total);
  expect_same_int32s("first", first);
  expect_same_int32s("count", count);
  machines_clear();
}

static void refuse_scan(const int32_t *counts, size_t n) {
  const struct many count = many_int32s(counts, n), first = many_of(ERN_ELEMENT_INT32, NULL, n + 1);
  EACH_MACHINE (k) {
    struct ern_scan_args args = {.first = first.on[k], .count = count.on[k], .n = n};
    support_expect(machines.context, machines.backend[k]->scan(machines.stream[k], &args), ERN_E_NO_MEMORY, "march",
                   "2147483647", NULL);
  }
  machines_clear();
}

static void test_scan(void **state) {
  (void)state;
  static const size_t large[] = {0,     1023,  1024,  1025,  2047,   2048,   2049,   4097,
                                 65535, 65536, 65537, 66000, 131072, 131073, 200001, COUNTS};
  static int32_t counts[COUNTS];
  for (size_t i = 0; i < COUNTS; i++) counts[i] = (int32_t)(word_at(5, i) % 1025);
  for (size_t s = 0; s < size_count(); s++) check_scan(counts + s, test_sizes[s]);
  for (size_t s = 0; s < (is_small() ? 11 : COUNT_OF(large)); s++) check_scan(counts, large[s]);
  memset(counts, 0, sizeof counts);
  check_scan(counts, 70000);
  /* as many as there may be, and one more: in one place, in two, and in all */
  for (size_t n = 2; n < (is_small() ? 3000 : 150000); n = 10 * n + 1) {
    memset(counts, 0, sizeof counts);
    counts[(n - 1) / 2] = INT32_MAX;
    check_scan(counts, n);
    counts[n - 1] = 1;
    refuse_scan(counts, n);
    counts[n - 1] = INT32_MAX;
    refuse_scan(counts, n);
    for (size_t i = 0; i < n; i++) counts[i] = INT32_MAX / (int32_t)n;
    counts[n / 3] += INT32_MAX % (int32_t)n;
    check_scan(counts, n);
    counts[0]++;
    refuse_scan(counts, n);
    for (size_t i = 0; i < n; i++) counts[i] = INT32_MAX; /* a multiple of 2^32 and less than one */
    refuse_scan(counts, n);
  }
}

/* ---- speed ---- */

enum { RAYS = 1 << 16, STEPS = 16 };

/* 65,536 rays of a camera in front of a head-like shell. */
static void bench(void) {
  static const struct ern_march_settings settings = {1, STEPS, 1 / 256.0f, 0.05f};
  static const struct ern_view view = {{0.0515f, -0.9978f, -0.0413f, 0.044f, 0.0596f, 0.0443f, -0.9972f, 3.602f,
                                        0.9969f, 0.0489f, 0.0617f, -0.229f, 0, 0, 0, 1},
                                       614,
                                       128,
                                       128,
                                       256,
                                       256};
  static int32_t pixel[RAYS];
  struct ern_rays_args rays[MACHINES];
  struct ern_march_args march[MACHINES];
  struct ern_scan_args scan[MACHINES];
  struct ern_samples_args samples[MACHINES];
  for (int32_t i = 0; i < RAYS; i++) pixel[i] = i;
  fill_shell(scene.bits, (float[]){0.1f, -0.05f, 0}, (float[]){0.45f, 0.35f, 0.35f}, 0.25f);
  const struct many numbers = many_int32s(pixel, RAYS), bits = many_of(ERN_ELEMENT_BYTE, scene.bits, sizeof scene.bits),
                    t = many_empty(RAYS * STEPS), count = many_of(ERN_ELEMENT_INT32, NULL, RAYS),
                    first = many_of(ERN_ELEMENT_INT32, NULL, RAYS + 1), dt = many_empty(RAYS * STEPS),
                    depth = many_empty(RAYS * STEPS), ray = many_of(ERN_ELEMENT_INT32, NULL, RAYS * STEPS);
  const struct many_rows dir = many_strided(NULL, 3, RAYS, ERN_PER_RAY),
                         x = many_strided(NULL, 3, RAYS * STEPS, ERN_PER_SAMPLE);
  EACH_MACHINE (k) {
    rays[k] = (struct ern_rays_args){dir.on[k], numbers.on[k], view, RAYS};
    march[k] = (struct ern_march_args){
        t.on[k], count.on[k], dir.on[k], {0}, bits.on[k], {view.pose[3], view.pose[7], view.pose[11]}, settings, RAYS};
    scan[k] = (struct ern_scan_args){first.on[k], count.on[k], RAYS, 0};
    samples[k] =
        (struct ern_samples_args){x.on[k],  dt.on[k],    depth.on[k], ray.on[k],
                                  t.on[k],  first.on[k], dir.on[k],   {view.pose[3], view.pose[7], view.pose[11]},
                                  settings, RAYS};
  }
  BENCH("rays", RAYS, rays, rays);
  BENCH("march, by ray", RAYS, march, march);
  BENCH("scan", RAYS, scan, scan);
  BENCH("samples", scan[0].total, samples, samples);
  printf("%d rays, %zu samples\n", RAYS, scan[0].total);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_rays),        cmocka_unit_test(test_scan),       cmocka_unit_test(test_empty),
    cmocka_unit_test(test_full),        cmocka_unit_test(test_shell),      cmocka_unit_test(test_random_bits),
    cmocka_unit_test(test_adversarial), cmocka_unit_test(test_not_before),
};
NOUN(march, bench, .isa = NULL)
