/* SPDX-License-Identifier: MIT
 * Rays, marching, scans and samples on an OpenCL device against the reference: nothing but the same bits is accepted,
 * so that all backends look at the same points. */
#include "twin.h"

#include "march_scenes.h"

static ern_context *context;
static struct twin twin;
static struct scene scene; /* too large for a stack */

/* ---- rays ---- */

static void check_rays(const struct ern_view *view, const int32_t *pixel, size_t n) {
  const struct twin_rows dir = twin_rows_of(&twin, NULL, 3, n, ERN_PER_RAY);
  const struct twin_span numbers = twin_int32s(&twin, pixel, n);
  struct ern_rays_args args[2];
  for (int k = 0; k < 2; k++)
    args[k] = (struct ern_rays_args){.dir = dir.on[k], .pixel = numbers.on[k], .view = *view, .n = n};
  TWIN_RUN(&twin, rays, args);
  twin_same_bits(&twin, "dir", (struct twin_span){{dir.on[0].span, dir.on[1].span}});
  twin_clear(&twin);
}

static void test_rays(void **state) {
  (void)state;
  struct ern_view view;
  int32_t pixel[TWIN_MOST] = {0};
  for (size_t w = 0; w < WIDTHS; w++) {
    for (uint64_t seed = 0; seed < (twin_is_small() ? 4 : 40); seed++) {
      aim_camera(&view, pixel, widths[w], seed);
      check_rays(&view, pixel, sizes[seed % SIZES]);
    }
  }
  for (size_t i = MOST; i < TWIN_MOST; i++) pixel[i] = (int32_t)(200 * i);
  aim_camera(&view, pixel, 450, 0);
  for (size_t s = 0; s < TWIN_SIZES; s++) check_rays(&view, pixel, twin_sizes[s]);
  check_rays(&view, pixel, 0);
}

/* ---- march and samples ---- */

static void check_samples(size_t n, struct twin_span t, struct twin_span first, struct twin_rows dir, size_t total,
                          const struct ern_march_settings *settings) {
  const struct twin_rows x = twin_rows_of(&twin, NULL, 3, total, ERN_PER_SAMPLE);
  const struct twin_span dt = twin_take(&twin, ERN_ELEMENT_REAL, total),
                         depth = twin_take(&twin, ERN_ELEMENT_REAL, total),
                         ray = twin_take(&twin, ERN_ELEMENT_INT32, total);
  struct ern_samples_args args[2];
  for (int k = 0; k < 2; k++)
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
  TWIN_RUN(&twin, samples, args);
  twin_same_bits(&twin, "x", (struct twin_span){{x.on[0].span, x.on[1].span}});
  twin_same_bits(&twin, "dt", dt);
  twin_same_bits(&twin, "depth", depth);
  twin_same_int32(&twin, "ray", ray);
}

/* The first n rays of the scene; returns their samples. bits: of the scene. */
static size_t check_march(size_t n, struct twin_span bits, const struct ern_march_settings *settings,
                          bool with_jitter) {
  const size_t kept = twin.spans;
  float rows[3 * MOST];
  for (size_t a = 0; a < 3; a++) memcpy(rows + a * n, scene.dir + a * MOST, n * sizeof *rows);
  const struct twin_rows dir = twin_rows_of(&twin, rows, 3, n, ERN_PER_RAY);
  const struct twin_span none = {0}, jitter = with_jitter ? twin_reals(&twin, scene.jitter, n) : none,
                         t = twin_take(&twin, ERN_ELEMENT_REAL, n * (size_t)settings->max_steps),
                         count = twin_take(&twin, ERN_ELEMENT_INT32, n),
                         first = twin_take(&twin, ERN_ELEMENT_INT32, n + 1);
  struct ern_march_args march[2];
  struct ern_scan_args scan[2];
  for (int k = 0; k < 2; k++) {
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
  TWIN_RUN(&twin, march, march);
  twin_same_int32(&twin, "count", count);
  twin_same_bits(&twin, "t", t); /* past a ray's samples: poison in both */
  TWIN_RUN(&twin, scan, scan);
  assert_int_equal(scan[1].total, scan[0].total);
  twin_same_int32(&twin, "first", first);
  check_samples(n, t, first, dir, scan[0].total, settings);
  while (twin.spans > kept) {
    twin.spans--;
    for (int k = 0; k < 2; k++) twin.backend[k]->buffer_free(twin.backend[k], twin.span[twin.spans].on[k].buffer);
  }
  return scan[0].total;
}

/* On simulators one origin and few rays for each of the settings. */
static void march_all(size_t least) {
  const struct twin_span bits = twin_bytes(&twin, scene.bits, sizeof scene.bits);
  size_t total = 0;
  for (size_t k = 0; k < SETTINGS; k++) {
    for (size_t o = 0; o < ORIGINS; o++) {
      if (twin_is_small() && o != k % ORIGINS) continue;
      memcpy(scene.origin, origins[o], sizeof scene.origin);
      const size_t n = twin_is_small() ? sizes[(3 * k + o) % 11] : o < 2 ? MOST : sizes[(k * ORIGINS + o) % SIZES];
      aim(&scene, settings_list[k].bound, 100 * k + o);
      for (int with_jitter = 0; with_jitter < 2; with_jitter++)
        total += check_march(n, bits, &settings_list[k], with_jitter);
    }
  }
  assert_int_equal(check_march(0, bits, &settings_list[0], true), 0);
  assert_true(twin_is_small() || total >= least);
  twin_clear(&twin);
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
  for (uint64_t k = 0; k < (twin_is_small() ? 1 : 4); k++) {
    fill_random(scene.bits, per_mille[k], k);
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
    const struct twin_span bits = twin_bytes(&twin, scene.bits, sizeof scene.bits);
    for (size_t k = 0; k < ODD; k++) {
      for (uint64_t seed = 0; seed < 30; seed += twin_is_small() ? 13 : 1) {
        const size_t n = seed % 3 == 1 && !twin_is_small() ? MOST : sizes[seed % SIZES];
        aim_oddly(&scene, seed);
        check_march(n, bits, &odd_settings[k], seed % 2 == 0);
      }
    }
    twin_clear(&twin);
  }
}

/* ---- scan ---- */

enum { COUNTS = (1 << 21) + 5 };

static void check_scan(const int32_t *counts, size_t n) {
  const struct twin_span count = twin_int32s(&twin, counts, n), first = twin_take(&twin, ERN_ELEMENT_INT32, n + 1);
  struct ern_scan_args args[2];
  for (int k = 0; k < 2; k++) args[k] = (struct ern_scan_args){.first = first.on[k], .count = count.on[k], .n = n};
  TWIN_RUN(&twin, scan, args);
  assert_int_equal(args[1].total, args[0].total);
  twin_same_int32(&twin, "first", first);
  twin_same_int32(&twin, "count", count);
  twin_clear(&twin);
}

static void refuse_scan(const int32_t *counts, size_t n) {
  const struct twin_span count = twin_int32s(&twin, counts, n), first = twin_take(&twin, ERN_ELEMENT_INT32, n + 1);
  for (int k = 0; k < 2; k++) {
    struct ern_scan_args args = {.first = first.on[k], .count = count.on[k], .n = n};
    support_expect(context, twin.backend[k]->scan(twin.stream[k], &args), ERN_E_NO_MEMORY, "march", "2147483647", NULL);
  }
  twin_clear(&twin);
}

static void test_scan(void **state) {
  (void)state;
  static const size_t large[] = {0,     1023,  1024,  1025,  2047,   2048,   2049,   4097,
                                 65535, 65536, 65537, 66000, 131072, 131073, 200001, COUNTS};
  static int32_t counts[COUNTS];
  for (size_t i = 0; i < COUNTS; i++) counts[i] = (int32_t)(word_at(5, i) % 1025);
  for (size_t s = 0; s < TWIN_SIZES; s++) check_scan(counts + s, twin_sizes[s]);
  for (size_t s = 0; s < (twin_is_small() ? 11 : sizeof large / sizeof *large); s++) check_scan(counts, large[s]);
  memset(counts, 0, sizeof counts);
  check_scan(counts, 70000);
  /* as many as there may be, and one more: in one place, in two, and in all */
  for (size_t n = 2; n < (twin_is_small() ? 3000 : 150000); n = 10 * n + 1) {
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

struct bench {
  int with;
  const char *slot;
  struct ern_rays_args rays[2];
  struct ern_march_args march[2];
  struct ern_scan_args scan[2];
  struct ern_samples_args samples[2];
};

static void bench_run(void *user) {
  struct bench *b = user;
  const int k = b->with;
  struct ern_backend *backend = twin.backend[k];
  struct ern_stream *stream = twin.stream[k];
  int32_t last;
  if (strcmp(b->slot, "rays") == 0) support_ok(context, backend->rays(stream, &b->rays[k]));
  if (strcmp(b->slot, "march") == 0) support_ok(context, backend->march(stream, &b->march[k]));
  if (strcmp(b->slot, "scan") == 0) support_ok(context, backend->scan(stream, &b->scan[k]));
  if (strcmp(b->slot, "samples") == 0) support_ok(context, backend->samples(stream, &b->samples[k]));
  /* a small blocking read: the time is of work that is done */
  support_ok(context, backend->download_int32(stream, &last, b->scan[k].count, 1));
}

/* 65,536 rays of a camera in front of a head-like shell. */
static void measure(void) {
  static const char *const slot[] = {"rays", "march", "scan", "samples"};
  static const struct ern_march_settings settings = {1, STEPS, 1 / 256.0f, 0.05f};
  static const struct ern_view view = {{0.0515f, -0.9978f, -0.0413f, 0.044f, 0.0596f, 0.0443f, -0.9972f, 3.602f,
                                        0.9969f, 0.0489f, 0.0617f, -0.229f, 0, 0, 0, 1},
                                       614,
                                       128,
                                       128,
                                       256,
                                       256};
  static int32_t pixel[RAYS];
  struct bench bench;
  for (int32_t i = 0; i < RAYS; i++) pixel[i] = i;
  fill_shell(scene.bits, (float[]){0.1f, -0.05f, 0}, (float[]){0.45f, 0.35f, 0.35f}, 0.25f);
  const struct twin_span numbers = twin_int32s(&twin, pixel, RAYS),
                         bits = twin_bytes(&twin, scene.bits, sizeof scene.bits),
                         t = twin_take(&twin, ERN_ELEMENT_REAL, RAYS * STEPS),
                         count = twin_take(&twin, ERN_ELEMENT_INT32, RAYS),
                         first = twin_take(&twin, ERN_ELEMENT_INT32, RAYS + 1),
                         dt = twin_take(&twin, ERN_ELEMENT_REAL, RAYS * STEPS),
                         depth = twin_take(&twin, ERN_ELEMENT_REAL, RAYS * STEPS),
                         ray = twin_take(&twin, ERN_ELEMENT_INT32, RAYS * STEPS);
  const struct twin_rows dir = twin_rows_of(&twin, NULL, 3, RAYS, ERN_PER_RAY),
                         x = twin_rows_of(&twin, NULL, 3, RAYS * STEPS, ERN_PER_SAMPLE);
  for (int k = 0; k < 2; k++) {
    bench.rays[k] = (struct ern_rays_args){dir.on[k], numbers.on[k], view, RAYS};
    bench.march[k] = (struct ern_march_args){
        t.on[k], count.on[k], dir.on[k], {0}, bits.on[k], {view.pose[3], view.pose[7], view.pose[11]}, settings, RAYS};
    bench.scan[k] = (struct ern_scan_args){first.on[k], count.on[k], RAYS, 0};
    bench.samples[k] =
        (struct ern_samples_args){x.on[k],  dt.on[k],    depth.on[k], ray.on[k],
                                  t.on[k],  first.on[k], dir.on[k],   {view.pose[3], view.pose[7], view.pose[11]},
                                  settings, RAYS};
  }
  for (size_t s = 0; s < 4; s++) {
    double seconds[2];
    bench.slot = slot[s];
    for (bench.with = 0; bench.with < 2; bench.with++) seconds[bench.with] = seconds_of(bench_run, &bench);
    printf("%-8s reference %8.3f ms, device %8.3f ms: %.2f times\n", slot[s], 1e3 * seconds[0], 1e3 * seconds[1],
           seconds[0] / seconds[1]);
  }
  printf("%d rays, %zu samples\n", RAYS, bench.scan[1].total);
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
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) {
    set_up(NULL);
    measure();
    tear_down(NULL);
    return 0;
  }
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_rays),        cmocka_unit_test(test_scan),  cmocka_unit_test(test_empty),
      cmocka_unit_test(test_full),        cmocka_unit_test(test_shell), cmocka_unit_test(test_random_bits),
      cmocka_unit_test(test_adversarial),
  };
  return cmocka_run_group_tests_name("opencl march", tests, set_up, tear_down);
}
