/* SPDX-License-Identifier: MIT
 * Rays and marching against the plain definition: every rung of the ladder t_{k+1} = t_k + dt(t_k) inside the box whose
 * cell, found in double without Morton numbers, is occupied. */
#include "../support.h"

#include <math.h>

#include "core/rng.h"
#include "render/march_ops.h"
#include "render/morton.h"

/* The double build of the same kernel. */
void ern_march_ref64(double *t, int32_t *count, const double *dir, size_t stride, const double *jitter,
                     const uint8_t *bits, const float origin[3], const struct ern_march_settings *settings, size_t n);

enum { SIDE = ERN_OCCUPANCY_SIDE, RAYS = 600, MOST_RUNGS = 8192 };

/* Rungs nearer than this to the border of a cell or the end of the box may be counted either way in float. */
static const double doubtful = 1e-6;

static float uniform(uint64_t seed, uint32_t at) {
  return ern_uniform(ern_random_at(seed, 0, at, ERN_RNG_INIT).word[0]);
}
static float around(uint64_t seed, uint32_t at) { return 2 * uniform(seed, at) - 1; }

/* ---- the definition ---- */

struct world {
  bool occupied[SIDE][SIDE][SIDE]; /* x, y, z */
  uint8_t bits[ERN_OCCUPANCY_BYTES];
};

static void pack(struct world *world) {
  memset(world->bits, 0, sizeof world->bits);
  for (uint32_t x = 0; x < SIDE; x++) {
    for (uint32_t y = 0; y < SIDE; y++) {
      for (uint32_t z = 0; z < SIDE; z++) {
        uint32_t number = 0;
        for (uint32_t bit = 0; bit < 7; bit++) {
          number |= (x >> bit & 1) << 3 * bit | (y >> bit & 1) << (3 * bit + 1) | (z >> bit & 1) << (3 * bit + 2);
        }
        if (world->occupied[x][y][z]) world->bits[number / 8] |= (uint8_t)(1 << number % 8);
      }
    }
  }
}

static void fill(struct world *world, float share, uint64_t seed) {
  for (uint32_t x = 0; x < SIDE; x++) {
    for (uint32_t y = 0; y < SIDE; y++) {
      for (uint32_t z = 0; z < SIDE; z++) {
        world->occupied[x][y][z] = uniform(seed, (x * SIDE + y) * SIDE + z) < share;
      }
    }
  }
  pack(world);
}

/* A ball of radius 0.3 around (0.1, 0, -0.1): what a head looks like. */
static void fill_ball(struct world *world) {
  for (int x = 0; x < SIDE; x++) {
    for (int y = 0; y < SIDE; y++) {
      for (int z = 0; z < SIDE; z++) {
        world->occupied[x][y][z] = hypot(hypot((x - 63.5) / 64 - 0.1, (y - 63.5) / 64), (z - 63.5) / 64 + 0.1) < 0.3;
      }
    }
  }
  pack(world);
}

static float step_of(const struct ern_march_settings *s, float t) {
  const float longest = (float)(2 * sqrt(3) / SIDE), shortest = fminf(longest, (float)(2 * sqrt(3) / s->max_steps));
  return fminf(fmaxf(t * s->dt_gamma, shortest), longest);
}

/* Slabs in double; false where the ray misses. */
static bool box(double *near, double *far, const float o[3], const float d[3], double bound) {
  *near = -INFINITY, *far = INFINITY;
  for (int axis = 0; axis < 3; axis++) {
    const double half = axis == 1 ? bound / 2 : bound;
    if (d[axis] == 0) {
      if (fabs((double)o[axis]) >= half) return false;
      continue;
    }
    const double a = (-half - (double)o[axis]) / (double)d[axis], b = (half - (double)o[axis]) / (double)d[axis];
    *near = fmax(*near, fmin(a, b));
    *far = fmin(*far, fmax(a, b));
  }
  return *near <= *far;
}

/* Number of samples, their distances in t; -1 where rounding decides. */
static int define(float *t_out, const struct world *world, const float o[3], const float d[3], float jitter,
                  const struct ern_march_settings *s) {
  double near, far;
  if (!box(&near, &far, o, d, (double)s->bound)) return 0;
  near = fmax(near, (double)s->near);
  int count = 0;
  float t = (float)near;
  t += step_of(s, t) * jitter;
  for (; (double)t < far + doubtful && count < s->max_steps; t += step_of(s, t)) {
    if (fabs((double)t - far) <= doubtful) return -1;
    int cell[3];
    for (int axis = 0; axis < 3; axis++) {
      double p = ((double)o[axis] + (double)t * (double)d[axis]) / (double)s->bound;
      p = fmin(fmax(p, -1), 1) * (SIDE / 2) + SIDE / 2;
      if (p > 0.01 && p < SIDE - 0.01 && fabs(p - round(p)) < doubtful * SIDE / 2) return -1;
      cell[axis] = (int)fmin(floor(p), SIDE - 1);
    }
    if (world->occupied[cell[0]][cell[1]][cell[2]]) t_out[count++] = t;
  }
  return count;
}

/* ---- comparison ---- */

struct bundle {
  float origin[3];
  float dir[3 * RAYS], jitter[RAYS];
};

/* Toward random points of the cube, from the origin. */
static void aim(struct bundle *bundle, float x, float y, float z, uint64_t seed) {
  bundle->origin[0] = x, bundle->origin[1] = y, bundle->origin[2] = z;
  for (uint32_t r = 0; r < RAYS; r++) {
    float d[3], square = 0;
    for (uint32_t axis = 0; axis < 3; axis++) {
      d[axis] = 1.2f * around(seed, 3 * r + axis) - bundle->origin[axis];
      square += d[axis] * d[axis];
    }
    for (uint32_t axis = 0; axis < 3; axis++) bundle->dir[axis * RAYS + r] = d[axis] / sqrtf(square);
    bundle->jitter[r] = uniform(seed + 1, r);
  }
}

/* Both builds against the definition. Returns the samples; at most a tenth of the rays may be decided by rounding. */
static size_t compare(const struct world *world, const struct bundle *bundle, const float *jitter,
                      const struct ern_march_settings *s) {
  const size_t most = (size_t)s->max_steps;
  float *t = malloc(RAYS * most * sizeof *t), *expected = malloc(most * sizeof *expected);
  double *t64 = malloc(RAYS * most * sizeof *t64);
  static double dir64[3 * RAYS], jitter64[RAYS];
  int32_t count[RAYS], count64[RAYS];
  assert_true(t != NULL && expected != NULL && t64 != NULL);
  ern_march_ref(t, count, bundle->dir, RAYS, jitter, world->bits, bundle->origin, s, RAYS);
  for (size_t i = 0; i < 3 * RAYS; i++) dir64[i] = (double)bundle->dir[i];
  for (size_t r = 0; jitter && r < RAYS; r++) jitter64[r] = (double)jitter[r];
  ern_march_ref64(t64, count64, dir64, RAYS, jitter ? jitter64 : NULL, world->bits, bundle->origin, s, RAYS);
  size_t total = 0, skipped = 0;
  for (size_t r = 0; r < RAYS; r++) {
    const float d[3] = {bundle->dir[r], bundle->dir[RAYS + r], bundle->dir[2 * RAYS + r]};
    const int found = define(expected, world, bundle->origin, d, jitter ? jitter[r] : 0, s);
    assert_int_equal(count[r], count64[r]);
    total += (size_t)count[r];
    if (found < 0) skipped++;
    if (found >= 0) assert_int_equal(count[r], found);
    for (int k = 0; k < count[r]; k++) {
      assert_true((double)t[r * most + (size_t)k] == t64[r * most + (size_t)k]);
      /* near is rounded otherwise in double, and the ladder adds up the difference */
      if (found >= 0) assert_true(fabsf(t[r * most + (size_t)k] - expected[k]) <= 2e-6f * expected[k]);
    }
  }
  assert_true(10 * skipped < RAYS);
  free(t), free(t64), free(expected);
  return total;
}

static const struct ern_march_settings usual = {1, 16, 1 / 256.0f, 0.05f};

static void test_random_grids(void **state) {
  (void)state;
  struct world *world = malloc(sizeof *world);
  static struct bundle bundle;
  assert_non_null(world);
  static const struct ern_march_settings settings[] = {{1, 16, 1 / 256.0f, 0.05f},  {1, 1, 1 / 256.0f, 0.05f},
                                                       {1, 200, 1 / 256.0f, 0.05f}, {1, 250, 0, 0.05f},
                                                       {2, 16, 1 / 256.0f, 0.05f},  {1, 300, 0.1f, 0.5f}};
  static const float origin[][3] = {{0.2f, 3.1f, -0.2f}, {0.05f, 0.1f, -0.1f}, {-2.5f, 0.3f, 2.0f}};
  for (uint32_t grid = 0; grid < 4; grid++) {
    if (grid == 3) fill_ball(world);
    if (grid < 3) fill(world, grid == 0 ? 0.01f : grid == 1 ? 0.3f : 1, grid);
    for (size_t k = 0; k < sizeof settings / sizeof *settings; k++) {
      size_t total = 0;
      for (uint32_t from = 0; from < 3; from++) {
        aim(&bundle, origin[from][0], origin[from][1], origin[from][2], 100 + from);
        /* from outside and without jitter the first rung is on a face of the box, which is the border of cells */
        total += compare(world, &bundle, from == 1 ? NULL : bundle.jitter, &settings[k]);
      }
      assert_true(total > 50);
    }
  }
  memset(world, 0, sizeof *world);
  aim(&bundle, 0.2f, 3.1f, -0.2f, 5);
  assert_int_equal(compare(world, &bundle, bundle.jitter, &usual), 0);
  free(world);
}

/* Rays along an axis, with zeros of both signs in the other two components. */
static void test_axis_parallel(void **state) {
  (void)state;
  struct world *world = malloc(sizeof *world);
  static struct bundle bundle;
  assert_non_null(world);
  fill(world, 0.2f, 9);
  size_t total = 0;
  for (uint32_t k = 0; k < 12; k++) {
    const uint32_t axis = k % 3;
    const float way = k < 6 ? 1.0f : -1.0f, zero = k % 2 ? 0.0f : -0.0f;
    for (uint32_t i = 0; i < 3; i++) {
      bundle.origin[i] = i == axis ? -way * (k % 4 < 2 ? 3.0f : 0.1f) : 0.4f * around(40 + k, i);
      for (uint32_t r = 0; r < RAYS; r++) bundle.dir[i * RAYS + r] = i == axis ? way : zero;
    }
    for (uint32_t r = 0; r < RAYS; r++) bundle.jitter[r] = uniform(60 + k, r);
    total += compare(world, &bundle, bundle.jitter, &usual);
  }
  assert_true(total > 12 * RAYS);
  free(world);
}

static int march_one(const uint8_t *bits, const float origin[3], float x, float y, float z,
                     const struct ern_march_settings *settings, float *t) {
  const float dir[3] = {x, y, z};
  int32_t count;
  ern_march_ref(t, &count, dir, 1, NULL, bits, origin, settings, 1);
  return count;
}

/* In a full grid the number of samples is the number of steps that fit between the faces of the box. */
static void test_box_faces(void **state) {
  (void)state;
  static uint8_t bits[ERN_OCCUPANCY_BYTES];
  static float t[ERN_MAX_STEPS];
  memset(bits, 0xff, sizeof bits);
  const struct ern_march_settings long_ray = {1, 100, 1 / 256.0f, 0.05f}, constant = {1, ERN_MAX_STEPS, 0, 0.05f};
  const double longest = 2 * sqrt(3) / 128, least = 2 * sqrt(3) / ERN_MAX_STEPS;

  /* across y: a way of 1 from 0.5 to -0.5, at distance 2.5 */
  const float above[3] = {0, 3, 0};
  assert_int_equal(march_one(bits, above, 0, -1, 0, &long_ray, t), (int)ceil(1 / longest));
  assert_true(t[0] == 2.5f);
  assert_int_equal(march_one(bits, above, 0, -1, 0, &usual, t), 16);
  assert_int_equal(march_one(bits, above, 0, -1, 0, &constant, t), (int)ceil(1 / least));
  /* across z: a way of 2 */
  const float beside[3] = {0, 0.1f, -3};
  assert_int_equal(march_one(bits, beside, 0, 0, 1, &long_ray, t), (int)ceil(2 / longest));
  /* away from the box, past it, and just outside its faces in y */
  assert_int_equal(march_one(bits, above, 0, 1, 0, &usual, t), 0);
  assert_int_equal(march_one(bits, above, 1, 0, 0, &usual, t), 0);
  const float outside[3] = {-3, 0.50001f, 0}, inside[3] = {-3, 0.49999f, 0};
  assert_int_equal(march_one(bits, outside, 1, 0, 0, &long_ray, t), 0);
  assert_int_equal(march_one(bits, inside, 1, 0, 0, &long_ray, t), (int)ceil(2 / longest));
  /* starting on a face inward; within the plane of a face: none (0 * infinity, as in the specification) */
  const float face[3] = {0, 0.5f, 0};
  assert_int_equal(march_one(bits, face, 0, -1, 0, &long_ray, t), (int)ceil(0.95 / longest));
  assert_true(t[0] == 0.05f);
  const float lower_face[3] = {0, -0.5f, 0};
  for (int sign = 0; sign < 2; sign++) {
    assert_int_equal(march_one(bits, face, 1, sign ? -0.0f : 0.0f, 0, &long_ray, t), 0);
    assert_int_equal(march_one(bits, lower_face, 1, sign ? -0.0f : 0.0f, 0, &long_ray, t), 0);
  }
  /* inside: the smallest distance is `near` */
  const float middle[3] = {0, 0, 0};
  assert_int_equal(march_one(bits, middle, 1, 0, 0, &long_ray, t), (int)ceil(0.95 / longest));
  assert_true(t[0] == 0.05f);
}

/* Whatever comes in, the march ends and says a number of samples that there is room for. */
static void test_termination(void **state) {
  (void)state;
  static uint8_t full[ERN_OCCUPANCY_BYTES], empty[ERN_OCCUPANCY_BYTES];
  static float t[ERN_MAX_STEPS];
  memset(full, 0xff, sizeof full);
  static const float value[] = {0,      -0.0f, 1,      -1,   1e-30f,   -1e-30f,   1e-6f,
                                1e-40f, 1e30f, -1e30f, 1e7f, INFINITY, -INFINITY, NAN};
  enum { VALUES = sizeof value / sizeof *value };
  static const struct ern_march_settings settings[] = {
      {1, 16, 1 / 256.0f, 0.05f}, {1, ERN_MAX_STEPS, 0, 0}, {100, ERN_MAX_STEPS, 0, 0.05f}, {1, 7, 1e30f, 1e30f}};
  for (size_t k = 0; k < sizeof settings / sizeof *settings; k++) {
    for (size_t i = 0; i < VALUES * VALUES * VALUES; i++) {
      const float a = value[i % VALUES], b = value[i / VALUES % VALUES], c = value[i / VALUES / VALUES];
      const float from_here[3] = {a, b, c}, middle[3] = {0.1f, 0.2f, 0.3f};
      const int32_t counts[4] = {march_one(full, middle, a, b, c, &settings[k], t),
                                 march_one(empty, middle, a, b, c, &settings[k], t),
                                 march_one(full, from_here, 0.6f, -0.8f, 0, &settings[k], t),
                                 march_one(empty, from_here, 0, 0.6f, -0.8f, &settings[k], t)};
      for (int n = 0; n < 4; n++) assert_in_range(counts[n], 0, settings[k].max_steps);
      assert_int_equal(counts[1] + counts[3], 0);
    }
  }
}

/* Packed ray by ray; in two parts the same; x on the ray, in the cube, in an occupied cell. */
static void test_samples(void **state) {
  (void)state;
  struct world *world = malloc(sizeof *world);
  static struct bundle bundle;
  static float t[RAYS * 16];
  static int32_t count[RAYS], first[RAYS + 1];
  assert_non_null(world);
  fill(world, 0.3f, 3);
  aim(&bundle, 0.2f, 3.1f, -0.2f, 77);
  ern_march_ref(t, count, bundle.dir, RAYS, bundle.jitter, world->bits, bundle.origin, &usual, RAYS);
  for (size_t r = 0; r < RAYS; r++) first[r + 1] = first[r] + count[r];
  const size_t total = (size_t)first[RAYS], stride = total + 3, half = 251;
  assert_true(total > 500);
  float *x[2], *dt[2], *depth[2];
  int32_t *ray[2];
  for (int k = 0; k < 2; k++) {
    x[k] = calloc(3 * stride, sizeof(float)), dt[k] = calloc(total, sizeof(float));
    depth[k] = calloc(total, sizeof(float)), ray[k] = calloc(total, sizeof(int32_t));
    assert_true(x[k] != NULL && dt[k] != NULL && depth[k] != NULL && ray[k] != NULL);
  }
  ern_samples_ref(x[0], stride, dt[0], depth[0], ray[0], t, first, bundle.dir, RAYS, bundle.origin, &usual, 0, RAYS);
  ern_samples_ref(x[1], stride, dt[1], depth[1], ray[1], t + half * 16, first + half, bundle.dir + half, RAYS,
                  bundle.origin, &usual, half, RAYS - half);
  ern_samples_ref(x[1], stride, dt[1], depth[1], ray[1], t, first, bundle.dir, RAYS, bundle.origin, &usual, 0, half);
  assert_memory_equal(x[0], x[1], 3 * stride * sizeof(float));
  assert_memory_equal(dt[0], dt[1], total * sizeof(float));
  assert_memory_equal(depth[0], depth[1], total * sizeof(float));
  assert_memory_equal(ray[0], ray[1], total * sizeof(int32_t));
  for (size_t r = 0; r < RAYS; r++) {
    for (int32_t i = first[r]; i < first[r + 1]; i++) {
      const float distance = t[r * 16 + (size_t)(i - first[r])];
      uint32_t cell[3];
      assert_int_equal(ray[0][i], r);
      assert_true(dt[0][i] == step_of(&usual, distance) && depth[0][i] == distance + dt[0][i]);
      for (size_t axis = 0; axis < 3; axis++) {
        const float found = x[0][axis * stride + (size_t)i];
        assert_true(fabsf(found) <= 1);
        assert_true(fabsf(found - (bundle.origin[axis] + distance * bundle.dir[axis * RAYS + r])) < 1e-6f);
        cell[axis] = (uint32_t)fminf(64 * (found + 1), 127);
      }
      const uint32_t number = ern_morton(cell[0], cell[1], cell[2]);
      assert_true(world->bits[number / 8] >> number % 8 & 1);
    }
  }
  for (int k = 0; k < 2; k++) free(x[k]), free(dt[k]), free(depth[k]), free(ray[k]);
  free(world);
}

/* Unit vectors through pixel centres: the pixel of the principal point looks along the third column of the pose. */
static void test_rays(void **state) {
  (void)state;
  const struct ern_view view = {{0, -1, 0, 5, 0, 0, -1, 6, 1, 0, 0, 7, 0, 0, 0, 1}, 300, 10.5f, 20.5f, 64, 48};
  static const int32_t pixel[] = {20 * 64 + 10, 0, 63, 47 * 64, 47 * 64 + 63};
  enum { COUNT = sizeof pixel / sizeof *pixel, STRIDE = 7 };
  float dir[3 * STRIDE];
  ern_rays_ref(dir, STRIDE, pixel, &view, COUNT);
  assert_true(dir[0] == 0 && dir[STRIDE] == -1 && dir[2 * STRIDE] == 0);
  for (int r = 0; r < COUNT; r++) {
    const double x = (pixel[r] % 64 + 0.5 - 10.5) / 300, y = (pixel[r] / 64 + 0.5 - 20.5) / 300;
    const double length = sqrt(x * x + y * y + 1), expected[3] = {-y / length, -1 / length, x / length};
    for (int axis = 0; axis < 3; axis++) assert_true(fabs((double)dir[axis * STRIDE + r] - expected[axis]) < 2e-7);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_random_grids), cmocka_unit_test(test_axis_parallel), cmocka_unit_test(test_box_faces),
      cmocka_unit_test(test_termination),  cmocka_unit_test(test_samples),       cmocka_unit_test(test_rays),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
