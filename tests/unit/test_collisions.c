/* SPDX-License-Identifier: MIT
 * The count of hash collisions: worked examples, the same count in a plain way, and the paper's claim on a made-up
 * head.
 */
#include "../support.h"

#include <math.h>
#include <stdlib.h>

#include "core/rng.h"
#include "ernerf-lab/bench.h"
#include "lab/bench/collisions.h"

static ern_context *context;

static int set_up(void **state) {
  (void)state;
  context = support_context();
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static struct ern_collision_count count_of(const float *x, const float *y, const float *z, size_t n,
                                           struct ern_collision_level level) {
  struct ern_collision_count count;
  support_ok(context, ern_collisions_count(context, (const float *const[]){x, y, z}, n, &level, &count));
  return count;
}

static void test_worked(void **state) {
  (void)state;
  const struct ern_collision_level plane = {.dims = 2, .axis = {0, 1}, .resolution = 4, .entries = 1u << 20};
  const float x[] = {0.1f, 0.2f, 0.3f, 1.0f, -5, NAN}, y[] = {0.1f, 0.1f, 0.1f, 1.0f, 0, 0};
  /* cells (0,0) twice, (1,0), and the last one; -5 and NaN are (0,0) again; neighbours share two vertices */
  struct ern_collision_count count = count_of(x, y, NULL, 6, plane);
  assert_int_equal(count.cells, 3);
  assert_int_equal(count.lookups, 12);
  assert_int_equal(count.colliding, 0);

  /* one entry for all: the first vertex has it, and is looked up once more by no other cell */
  const struct ern_collision_level one = {.dims = 2, .axis = {0, 1}, .resolution = 4, .entries = 1};
  assert_int_equal(count_of(x, y, NULL, 6, one).colliding, 11);
  const struct ern_collision_level cube = {.dims = 3, .axis = {0, 1, 2}, .resolution = 512, .entries = 1};
  assert_int_equal(count_of(x, y, y, 1, cube).lookups, 8);
  assert_int_equal(count_of(x, y, y, 1, cube).colliding, 7);
  assert_int_equal(count_of(x, y, y, 0, cube).lookups, 0);
}

/* What the other axis is does not matter to a plane; which two, does. */
static void test_axes(void **state) {
  (void)state;
  const float a[] = {0.1f, 0.9f}, b[] = {0.5f, 0.5f}, c[] = {0.3f, 0.3f};
  const struct ern_collision_level ab = {.dims = 2, .axis = {0, 1}, .resolution = 8, .entries = 64},
                                   bc = {.dims = 2, .axis = {1, 2}, .resolution = 8, .entries = 64};
  assert_int_equal(count_of(a, b, c, 2, ab).cells, 2);
  assert_int_equal(count_of(a, b, c, 2, bc).cells, 1);
}

enum { POINTS = 400, SIDE = 13, ENTRIES = 97 };

/* Cells in the order of their numbers, each entry remembering its first vertex. */
static size_t plain_count(const float u[3][POINTS]) {
  static bool seen[SIDE * SIDE * SIDE];
  static int owner[ENTRIES];
  size_t colliding = 0;
  memset(seen, 0, sizeof seen);
  memset(owner, 0, sizeof owner);
  for (int i = 0; i < POINTS; i++)
    seen[(int)(u[0][i] * SIDE) + SIDE * ((int)(u[1][i] * SIDE) + SIDE * (int)(u[2][i] * SIDE))] = true;
  for (int cell = 0; cell < SIDE * SIDE * SIDE; cell++)
    for (int b = 0; seen[cell] && b < 8; b++) {
      const uint32_t x = (uint32_t)(cell % SIDE + (b & 1)), y = (uint32_t)(cell / SIDE % SIDE + (b >> 1 & 1)),
                     z = (uint32_t)(cell / SIDE / SIDE + (b >> 2));
      const uint32_t entry = (x ^ y * 2654435761u ^ z * 805459861u) % ENTRIES;
      const int name = 1 + (int)(x + (SIDE + 1) * (y + (SIDE + 1) * z));
      if (owner[entry] == 0) owner[entry] = name;
      colliding += owner[entry] != name;
    }
  return colliding;
}

static void test_random(void **state) {
  (void)state;
  static float u[3][POINTS];
  for (uint32_t i = 0; i < 3 * POINTS; i++)
    u[i / POINTS][i % POINTS] = ern_uniform(ern_random_at(7, 0, i, ERN_RNG_INIT).word[0]);
  const struct ern_collision_level level = {.dims = 3, .axis = {0, 1, 2}, .resolution = SIDE, .entries = ENTRIES};
  const struct ern_collision_count count = count_of(u[0], u[1], u[2], POINTS, level);
  assert_int_equal(count.colliding, plain_count((const float(*)[POINTS])u));
  assert_true(count.colliding > count.lookups / 2 && count.colliding < count.lookups);
}

/* The paper's claim: three planes of a third of the entries collide less than one volume, the frontal one most. */
static void test_head(void **state) {
  (void)state;
  ern_backend *backend = NULL;
  ern_bench_scene *scene = NULL;
  ern_bench_collision_table table;
  support_ok(context, ern_backend_create(&backend, context, NULL));
  support_ok(context, ern_bench_scene_make(&scene, context, 200, 200, 1));
  support_ok(context, ern_bench_collisions(backend, scene, &table));
  double planes = 0;
  for (int p = 0; p < 3; p++) {
    planes += table.plane[p].collisions;
    assert_true(table.plane[p].cells > 0 && table.plane[p].cells <= table.volume.cells);
    assert_true(table.plane[p].collisions <= (double)table.plane[p].cells);
  }
  assert_true(table.volume.cells <= table.points);
  assert_true(planes < table.volume.collisions);
  assert_true(table.scale > 1 && table.scale < 4); /* a head of 0.84 in a cube of 2 */
  ern_bench_scene_free(&scene);
  ern_backend_free(&backend);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_worked), cmocka_unit_test(test_axes),
                                     cmocka_unit_test(test_random), cmocka_unit_test(test_head)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
