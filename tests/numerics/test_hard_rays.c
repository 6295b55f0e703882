/* SPDX-License-Identifier: MIT
 * Rays that geometry has no good answer for: along axes and borders, in faces and corners, from inside, from nowhere
 * (docs/numerics.md). Marching is in float everywhere, and everywhere the same to the bit. */
#include "machines.h"
#include "render/march_ops.h"
#include "render/morton.h"

enum { MOST_RAYS = 128 };

static uint8_t bits[ERN_OCCUPANCY_BYTES];
static const struct ern_march_settings usual = {.bound = 1, .max_steps = 64, .dt_gamma = 1 / 256.0f, .near = 0.05f};

struct march {
  float dir[3][MOST_RAYS], jitter[MOST_RAYS];
  size_t n;
  struct many t, count, x, dt, depth;
};
static struct march march;

static void fill(bool checkered) {
  memset(bits, 0xFF, sizeof bits);
  for (uint32_t c = 0; checkered && c < ERN_OCCUPANCY_CELLS; c++) /* cells of two and none in turns along x */
    if (ern_morton_gather(c) / 2 % 2) bits[c >> 3] &= (uint8_t) ~(1u << (c & 7));
}
static void begin(void) {
  machines_clear();
  march.n = 0;
}
static void add(float x, float y, float z) {
  assert_true(march.n < MOST_RAYS);
  march.jitter[march.n] = 0;
  march.dir[0][march.n] = x, march.dir[1][march.n] = y, march.dir[2][march.n++] = z;
}

/* Rays, then their samples; both are the same on all machines and inside the box. */
static void go(float x, float y, float z, const struct ern_march_settings *settings) {
  const size_t n = march.n, steps = (size_t)settings->max_steps;
  float rows[3 * MOST_RAYS];
  for (size_t a = 0; a < 3; a++) memcpy(rows + a * n, march.dir[a], n * sizeof *rows);
  const struct many dir = many_reals(rows, 3 * n), jitter = many_reals(march.jitter, n);
  const struct many cells = many_of(ERN_ELEMENT_BYTE, bits, sizeof bits), first = many_int32s(NULL, n + 1);
  march.t = many_zeros(n * steps), march.count = many_int32s(NULL, n);
  size_t total = 0;
  ON_EACH(march, ern_march_args,
          {.t = march.t.on[k],
           .count = march.count.on[k],
           .dir = {dir.on[k], n, 3, ERN_PER_RAY},
           .jitter = jitter.on[k],
           .bits = cells.on[k],
           .origin = {x, y, z},
           .settings = *settings,
           .n = n})
  expect_int32s("samples of a ray", march.count, 0, settings->max_steps);
  expect_truth("t", march.t, 0, 0);
  expect_within("t", march.t, 0, FLT_MAX);
  for (int k = 0; k < machines.count; k++) {
    struct ern_scan_args scan = {.first = first.on[k], .count = march.count.on[k], .n = n};
    support_ok(machines.context, machines.backend[k]->scan(machines.stream[k], &scan));
    total = scan.total;
  }
  march.x = many_zeros(3 * total), march.dt = many_zeros(total), march.depth = many_zeros(total);
  const struct many ray = many_int32s(NULL, total);
  ON_EACH(samples, ern_samples_args,
          {.x = {march.x.on[k], total, 3, ERN_PER_SAMPLE},
           .dt = march.dt.on[k],
           .depth = march.depth.on[k],
           .ray = ray.on[k],
           .t = march.t.on[k],
           .first = first.on[k],
           .dir = {dir.on[k], n, 3, ERN_PER_RAY},
           .origin = {x, y, z},
           .settings = *settings,
           .n = n})
  expect_within("x", march.x, -(double)settings->bound, (double)settings->bound);
  expect_truth("x", march.x, 0, 0);
  expect_within("dt", march.dt, 3.4641 / 1024, 3.4642 / 128);
  expect_within("depth", march.depth, (double)settings->near, FLT_MAX);
  expect_int32s("ray", ray, 0, (int32_t)n);
}

static int32_t samples_of(size_t ray) {
  int32_t *counts = many_int32_values(0, march.count);
  const int32_t count = counts[ray];
  free(counts);
  return count;
}

static const struct ern_march_settings even = {.bound = 1, .max_steps = 1024, .dt_gamma = 1, .near = 0.05f};

/* case: along an axis, both ways | plain code: `0 * (1/0)` is NaN | here: infinite distances order as they should |
 * bound: same bits */
static void test_ray_along_an_axis(void **state) {
  (void)state;
  fill(false), begin();
  for (int sign = -1; sign <= 1; sign += 2)
    for (int axis = 0; axis < 3; axis++)
      add(axis == 0 ? (float)sign : 0, axis == 1 ? (float)sign : 0, axis == 2 ? (float)sign : 0);
  go(0.1f, 0.1f, 0.1f, &even);
  for (size_t r = 0; r < 6; r++) {
    const double side = r % 3 == 1 ? 0.5 : 1, at = r < 3 ? side + 0.1f : side - 0.1f;
    /* shorter steps until t has grown to the longest one */
    if (samples_of(r) < (int32_t)((at - 0.06) / 0.0271)) fail_msg("ray %zu: %d samples", r, samples_of(r));
  }
}

/* case: components 0, -0 and denormal | plain code: the sign of 1/d swaps near and far | here: sorted by comparison,
 * steps by the sign bit | bound: same bits, inside the box */
/* Components of zero of either sign: 1/d is infinite, its products with a way of 0 are no numbers. */
static void test_zero_direction_components(void **state) {
  (void)state;
  static const float zeros[] = {0, -0.0f, FLT_TRUE_MIN, -FLT_TRUE_MIN, FLT_MIN};
  for (int checkered = 0; checkered < 2; checkered++) {
    fill(checkered), begin();
    for (size_t a = 0; a < COUNT_OF(zeros); a++)
      for (size_t b = 0; b < COUNT_OF(zeros); b++)
        add(1, zeros[a], zeros[b]), add(zeros[a], -1, zeros[b]), add(zeros[a], zeros[b], -1);
    go(0, 0, 0, &usual);
    go(0.25f, -0.25f, 2, &usual);
    for (size_t r = 2; r < march.n; r += 3) /* straight at the box, from outside */
      if (zeros[r / 3 / 5] == 0 && zeros[r / 3 % 5] == 0) assert_true(samples_of(r) > 30);
  }
}

/* case: on borders, faces and edges of cells | plain code: an endless loop | here: always on to the next candidate
 * distance (docs/maths.md) | bound: same bits; 30 samples and more where the way is full */
/* Within the plane that two cells share, and along their edge. */
static void test_ray_on_a_cell_border(void **state) {
  (void)state;
  for (int checkered = 0; checkered < 2; checkered++) {
    for (int cell = -64; cell <= 64; cell += 16) {
      const float border = (float)cell / 64;
      fill(checkered), begin();
      add(0, 0, -1), add(-0.0f, 0, -1), add(0, 0.6f, -0.8f), add(0, -0.6f, -0.8f);
      go(border, 0.25f, 3, &usual);
      go(border, border / 2, 3, &usual);
      if (abs(cell) < 64 && !checkered) assert_true(samples_of(0) > 30);
    }
  }
}

/* case: within the plane of a face of the box | plain code: `0 * inf` decides | here: misses; from a face inwards it
 * hits | bound: exact */
/* In a face, (side - origin)/0 is 0/0. Such a ray misses the box: it has no volume there. */
static void test_ray_within_a_face(void **state) {
  (void)state;
  fill(false), begin();
  add(0, 0, -1), add(0, 1, 0), add(0, 0.6f, -0.8f), add(-0.0f, 0, -1);
  go(1, 0, 3, &usual);
  go(-1, 0, 0, &usual);
  for (size_t r = 0; r < march.n; r++) assert_int_equal(samples_of(r), 0);
  begin();
  add(-1, 0, 0), add(1, 0, 0), add(-0.6f, 0, 0.8f); /* from a face inwards, outwards, slanted inwards */
  go(1, 0, 0, &usual);
  assert_true(samples_of(0) > 60 && samples_of(1) == 0 && samples_of(2) > 20);
}

/* case: through the corners, from a corner | plain code: near > far by one rounding | here: hits inwards, misses
 * outwards | bound: same bits */
static void test_ray_through_corners(void **state) {
  (void)state;
  fill(false), begin();
  for (int corner = 0; corner < 8; corner++) {
    const float way[3] = {corner & 1 ? 1 : -1, corner & 2 ? 0.5f : -0.5f, corner & 4 ? 1 : -1};
    add(way[0] / 1.5f, way[1] / 1.5f, way[2] / 1.5f);
  }
  go(0, 0, 0, &even);
  for (size_t r = 0; r < 8; r++) assert_true(samples_of(r) > (int32_t)(1.4 / 0.0271));
  for (int corner = 0; corner < 8; corner++) {
    begin();
    const float at[3] = {corner & 1 ? 1 : -1, corner & 2 ? 0.5f : -0.5f, corner & 4 ? 1 : -1};
    add(-at[0] / 1.5f, -at[1] / 1.5f, -at[2] / 1.5f); /* inwards along the diagonal, outwards, past it */
    add(at[0] / 1.5f, at[1] / 1.5f, at[2] / 1.5f), add(at[0], -at[1], 0);
    go(at[0], at[1], at[2], &even);
    assert_true(samples_of(0) > 100 && samples_of(1) == 0);
  }
}

/* case: starts inside, one ulp inside or outside a face | plain code: samples behind the camera | here: starts at the
 * near plane | bound: t >= 0.05, same bits */
static void test_ray_that_starts_inside(void **state) {
  (void)state;
  fill(false), begin();
  for (size_t r = 0; r < 64; r++) {
    const float x = machines_random(1, 3 * r, 1), y = machines_random(1, 3 * r + 1, 1),
                z = machines_random(1, 3 * r + 2, 1);
    const float length = sqrtf(x * x + y * y + z * z);
    add(x / length, y / length, z / length);
  }
  go(0, 0, 0, &even);
  for (size_t r = 0; r < 64; r++) assert_true(samples_of(r) > 10); /* the box reaches 0.5 at least each way */
  go(0.999f, 0.499f, -0.999f, &usual);
  go(nextafterf(1, 0), nextafterf(0.5f, 0), 0, &usual);
  go(nextafterf(1, 2), nextafterf(0.5f, 1), 0, &usual);
}

/* case: directions of NaN, infinity, FLT_MAX | plain code: `(int)NaN` is a cell | here: no sample; neighbours untouched
 * | bound: exact */
static void test_direction_that_is_no_number(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, -INFINITY, FLT_MAX, -FLT_MAX, 1e-30f};
  fill(false), begin();
  add(0, 0, -1);
  for (size_t a = 0; a < COUNT_OF(odd); a++)
    add(odd[a], 0.6f, -0.8f), add(0, odd[a], -1), add(odd[a], odd[a], odd[a]), add(0, 0, -1);
  for (size_t r = 0; r < march.n; r++) march.jitter[r] = (float)(r % 5) / 5;
  march.jitter[0] = 0;
  go(0, 0, 3, &usual);
  assert_true(samples_of(0) > 60); /* its neighbours do not disturb it */
  for (size_t r = 1; r < 9; r += 4) assert_int_equal(samples_of(r), 0);
}

/* case: a direction of length 0 or denormal | plain code: never leaves the box | here: ends after 4 bounds of distance,
 * misses from outside | bound: at most max_steps samples */
static void test_direction_of_length_zero(void **state) {
  (void)state;
  fill(false), begin();
  add(0, 0, 0), add(-0.0f, 0, -0.0f), add(1e-38f, 0, 0), add(FLT_TRUE_MIN, FLT_TRUE_MIN, FLT_TRUE_MIN), add(0, 0, -1);
  go(0, 0, 0, &usual); /* stays where it is, and ends */
  go(0, 0, 3, &usual);
  for (size_t r = 0; r < 2; r++) assert_int_equal(samples_of(r), 0);
  assert_true(samples_of(4) > 60);
}

/* case: an origin 1e3 to infinity away | plain code: `t + dt = t`: endless | here: ends where t does not grow | bound:
 * same bits */
/* From where t + dt = t, or the way to the box is infinite. */
static void test_origin_far_away(void **state) {
  (void)state;
  static const float far[] = {1e3f, 1e6f, 1e7f, 1e9f, 1e20f, 1e30f, FLT_MAX, INFINITY, NAN};
  for (size_t i = 0; i < COUNT_OF(far); i++) {
    fill(i % 2), begin();
    add(0, 0, -1), add(0, 0, 1), add(-1, 0, 0), add(-0.6f, 0, -0.8f), add(-0.70710678f, 0, -0.70710678f);
    go(0, 0, far[i], &usual);
    go(far[i], 0, far[i], &usual);
    go(far[i], far[i], -far[i], &usual);
  }
}

/* case: steps 1 to 1,024, gamma 0 to 1e30, jitter 1 - ulp | plain code: dt of 0, or over the head | here: dt in 2
 * sqrt(3)/1024 to 2 sqrt(3)/128 | bound: same bits */
static void test_largest_and_smallest_steps(void **state) {
  (void)state;
  static const float gammas[] = {0, FLT_TRUE_MIN, 1 / 256.0f, 1, 1e30f};
  static const int steps[] = {1, 2, 127, 128, 129, 1024};
  fill(false);
  for (size_t i = 0; i < COUNT_OF(gammas); i++) {
    for (size_t s = 0; s < COUNT_OF(steps); s++) {
      begin();
      add(0, 0, -1), add(0.6f, 0, -0.8f), add(0, 0, 1);
      for (size_t r = 0; r < march.n; r++) march.jitter[r] = nextafterf(1, 0);
      const struct ern_march_settings settings = {1, steps[s], gammas[i], 0.05f};
      go(0, 0, 2, &settings);
      assert_true(samples_of(0) >= (steps[s] < 70 ? steps[s] : 70));
    }
  }
  begin(), add(0, 0, -1);
  go(0, 0, 2, &(struct ern_march_settings){1, 1024, 0, 0.05f});
  expect_int32s("shortest steps", march.count, 590, 593); /* 2 / (2 sqrt(3)/1024) */
}

/* case: focal lengths 1e-30 to 3e38, centres to 3e38 | plain code: x/length is inf/inf | here: unit length, or 0 where
 * x^2 is no float | bound: 1 + 1e-6 */
/* A camera's rays: unit length or, where x^2 + y^2 does not fit a float, 0; the same bits everywhere. */
static void test_camera_without_a_view(void **state) {
  (void)state;
  static const float focals[] = {1e-30f, 1e-18f, 1e-10f, 1, 1e10f, 1e30f, FLT_MAX};
  static const float centres[] = {0, -1e9f, 225, 1e30f, FLT_MAX};
  const int32_t pixel[7] = {0, 1, 449, 450, 101250, 202498, 202499};
  for (size_t f = 0; f < COUNT_OF(focals); f++) {
    for (size_t c = 0; c < COUNT_OF(centres); c++) {
      machines_clear();
      const struct many numbers = many_int32s(pixel, 7), dir = many_empty(21);
      ON_EACH(rays, ern_rays_args,
              {.dir = {dir.on[k], 7, 3, ERN_PER_RAY},
               .pixel = numbers.on[k],
               .view = {.pose = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1},
                        .focal = focals[f],
                        .cx = centres[c],
                        .cy = centres[c],
                        .width = 450,
                        .height = 450},
               .n = 7})
      expect_truth("direction", dir, 0, 0);
      if (fabs((double)centres[c]) / (double)focals[f] < 1e18) expect_within("direction", dir, -1 - 1e-6, 1 + 1e-6);
      if (focals[f] >= 1 && fabsf(centres[c]) < 1000) expect_within("direction", dir, -1, 1 + 1e-6);
    }
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_ray_along_an_axis),
      cmocka_unit_test(test_zero_direction_components),
      cmocka_unit_test(test_ray_on_a_cell_border),
      cmocka_unit_test(test_ray_within_a_face),
      cmocka_unit_test(test_ray_through_corners),
      cmocka_unit_test(test_ray_that_starts_inside),
      cmocka_unit_test(test_direction_that_is_no_number),
      cmocka_unit_test(test_direction_of_length_zero),
      cmocka_unit_test(test_origin_far_away),
      cmocka_unit_test(test_largest_and_smallest_steps),
      cmocka_unit_test(test_camera_without_a_view),
  };
  return cmocka_run_group_tests(tests, open_machines, close_machines);
}
