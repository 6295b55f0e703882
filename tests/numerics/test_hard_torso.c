/* SPDX-License-Identifier: MIT
 * The torso: key points that have no projection, poses that are no rotations, pixels and deformations at their ends
 * (docs/numerics.md). */
#include "machines.h"
#include "model/torso_ops.h"

static const float usual_pose[16] = {1, 0, 0, 0.1f, 0, 1, 0, -0.2f, 0, 0, 1, 3, 0, 0, 0, 1};
static const float usual_anchors[12] = {0.01f, 0.01f, 0.1f, 1, -0.1f, -0.1f, 0.1f, 1, 0.1f, -0.1f, 0.1f, 1};

struct points {
  struct many k, danchors, dgamma;
};
static struct points project(const float *anchors, const float *pose, float gradient) {
  machines_clear();
  const float one = 1, gradients[6] = {gradient, -gradient, gradient, gradient, gradient, gradient};
  const struct many at = many_reals(anchors, 12), gamma = many_reals(&one, 1), dk = many_reals(gradients, 6);
  const struct points out = {many_empty(6), many_zeros(12), many_zeros(1)};
  struct ern_torso_pose_fwd_args forward[MACHINES];
  for (int k = 0; k < machines.count; k++) {
    forward[k] = (struct ern_torso_pose_fwd_args){.k = out.k.on[k], .anchors = at.on[k], .gamma = gamma.on[k]};
    memcpy(forward[k].pose, pose, sizeof forward[k].pose);
  }
  ON_EACH(torso_pose_fwd, ern_torso_pose_fwd_args, forward[k])
  ON_EACH(torso_pose_bwd, ern_torso_pose_bwd_args,
          {.danchors = out.danchors.on[k], .dgamma = out.dgamma.on[k], .dk = dk.on[k], .forward = forward[k]})
  return out;
}

/* k is 1e6 at most, its gradients that over the nearest distance, 1e-3, for each of two coordinates. */
static void expect_bounded(const struct points *p, double gradient) {
  expect_within("k", p->k, -1e6, 1e6);
  expect_within("danchors", p->danchors, -2.1e9 * gradient, 2.1e9 * gradient);
  expect_within("dgamma", p->dgamma, -6.1e6 * gradient, 6.1e6 * gradient);
}

/* case: a key point on the camera's plane, a hair off it | plain code: X/0, sine NaN | here: 1e-3 off the plane on its
 * side, no gradient along it | bound: k to 1e6, gradients to 2e9 */
/* The camera stands in the plane of a key point, exactly and by a hair on either side. */
static void test_key_point_on_the_camera_plane(void **state) {
  (void)state;
  static const float off[] = {0, -0.0f, FLT_TRUE_MIN, -1e-30f, 1e-7f, -1e-5f, 9e-4f, -1.1e-3f};
  for (size_t i = 0; i < COUNT_OF(off); i++) {
    float anchors[12], pose[16];
    memcpy(anchors, usual_anchors, sizeof anchors);
    memcpy(pose, usual_pose, sizeof pose);
    for (size_t p = 0; p < 3; p++) anchors[4 * p + 2] = off[i];
    pose[11] = 0;
    const struct points out = project(anchors, pose, 1);
    expect_bounded(&out, 1);
    expect_truth("k", out.k, 16 * 0x1p-23, 1e-6);
    expect_truth("danchors", out.danchors, 64 * 0x1p-23, 1e-2); /* of numbers up to 1e5 */
    /* held at 1e-3 on the side where it is: (0.01 - 0.1)/1/0.001 */
    if (i < 7) expect_at("k", out.k, 0, off[i] < 0 ? 90 : -90, 1e-4);
  }
}

/* case: a key point behind the camera | plain code: a root of a negative | here: mirrored through the centre | bound:
 * 16 x 2^-23 */
static void test_key_point_behind_the_camera(void **state) {
  (void)state;
  float anchors[12];
  memcpy(anchors, usual_anchors, sizeof anchors);
  for (size_t p = 0; p < 3; p++) anchors[4 * p + 2] = 3 + 10.0f * (float)(p + 1);
  const struct points out = project(anchors, usual_pose, 1);
  expect_bounded(&out, 1);
  expect_truth("k", out.k, 16 * 0x1p-23, 1e-7);
  expect_at("k", out.k, 0, (0.01 - 0.1) / 10, 1e-6);
  expect_truth("danchors", out.danchors, 64 * 0x1p-23, 1e-6);
}

/* case: its last coordinate at 0, 1e-20, -1e30 | plain code: X/0 | here: 1e-3 off 0 | bound: k to 1e6 */
/* The last coordinate of a key point is learnt: at 0 it lies at infinity. */
static void test_key_point_at_infinity(void **state) {
  (void)state;
  static const float last[] = {0, -0.0f, 1e-20f, -1e-4f, 1e6f, -1e30f};
  for (size_t i = 0; i < COUNT_OF(last); i++) {
    float anchors[12];
    memcpy(anchors, usual_anchors, sizeof anchors);
    for (size_t p = 0; p < 3; p++) anchors[4 * p + 3] = last[i];
    const struct points out = project(anchors, usual_pose, 1);
    expect_bounded(&out, 1);
    expect_truth("k", out.k, 64 * 0x1p-23, 1e-3);
  }
}

/* case: key points at 1e10 .. 1e37 | plain code: 1e37/1e-3 infinite | here: held at 1e6, no gradient | bound: k to 1e6
 */
/* Key points that a learning rate has thrown far away: no product of them leaves float. */
static void test_key_point_far_away(void **state) {
  (void)state;
  static const float scale[] = {1e10f, 1e20f, 1e30f, 1e37f};
  for (size_t i = 0; i < COUNT_OF(scale); i++) {
    float anchors[12];
    for (size_t k = 0; k < 12; k++) anchors[k] = usual_anchors[k] * (k % 4 == 3 ? 1 : scale[i]);
    expect_bounded(&(struct points[]){project(anchors, usual_pose, 1)}[0], 1);
    anchors[2] = anchors[6] = anchors[10] = 3; /* the plane of the camera, far to the side */
    const struct points aside = project(anchors, usual_pose, 1);
    expect_bounded(&aside, 1);
    if (scale[i] > 1e15f) expect_at("k", aside.k, 0, 1e6, 0);
    if (scale[i] > 1e15f) expect_within("danchors", aside.danchors, 0, 0); /* held: no gradient */
  }
}

/* case: poses mirrored, stretched, sheared, odd last row | plain code: the transpose as inverse | here: Gauss and
 * Jordan with pivots in double; on devices in pairs of floats | bound: 64 x 2^-23 */
/* Mirrored, stretched, sheared, and one with a last row that is not 0, 0, 0, 1. */
static void test_pose_mirrored_and_not_rigid(void **state) {
  (void)state;
  static const float poses[][16] = {{-1, 0, 0, 0.1f, 0, 1, 0, -0.2f, 0, 0, 1, 3, 0, 0, 0, 1},
                                    {5, 0, 0, 0.1f, 0, 0.2f, 0, -0.2f, 0, 0, 3, 3, 0, 0, 0, 1},
                                    {1, 0.9f, 0.5f, 0.1f, 0, 1, 0.7f, -0.2f, 0, 0, 1, 3, 0, 0, 0, 1},
                                    {1e3f, 0, 0, 0, 0, 1e-3f, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1},
                                    {1, 0, 0, 0.1f, 0, 1, 0, -0.2f, 0, 0, 1, 3, 0.1f, 0.2f, 0.3f, 2}};
  for (size_t i = 0; i < COUNT_OF(poses); i++) {
    const struct points out = project(usual_anchors, poses[i], 1);
    expect_bounded(&out, 1);
    expect_truth("k", out.k, 64 * 0x1p-23, 1e-6);
    expect_truth("danchors", out.danchors, 256 * 0x1p-23, 1e-4);
  }
}

/* case: poses of determinant 1e-2 to 1e-6 | plain code: no digit left in float | here: the inverse in double | bound:
 * 64 x 2^-23 of k */
/* Nearly singular: what the callers let through has a determinant of 1e-6; further below it is the caller's to refuse.
 */
static void test_pose_nearly_singular(void **state) {
  (void)state;
  static const float small[] = {1e-2f, 1e-4f, 1e-6f};
  for (size_t i = 0; i < COUNT_OF(small); i++) {
    const float pose[16] = {1, 1, 0, 0.1f, 1, 1 + small[i], 0, -0.2f, 0, 0, 1, 3, 0, 0, 0, 1};
    const struct points out = project(usual_anchors, pose, 1e-3f);
    expect_within("k", out.k, -1e6, 1e6);
    expect_within("danchors", out.danchors, -1e13, 1e13);
    expect_truth("k", out.k, 64 * 0x1p-23, 1e-4);
  }
}

/* ---- pixels ---- */

/* case: a picture of one pixel, row or column; of 8192 x 8192 | plain code: `2j/(H - 1)` is 0/0 | here: a side of one
 * pixel is at 0 | bound: same bits */
/* 2j/(H-1) - 1 is 0/0 for a picture of one row. */
static void test_picture_of_one_pixel_a_side(void **state) {
  (void)state;
  static const int sides[][2] = {{1, 1}, {1, 450}, {450, 1}, {2, 2}, {8192, 8192}};
  for (size_t s = 0; s < COUNT_OF(sides); s++) {
    const int width = sides[s][0], height = sides[s][1];
    const int32_t pixel[3] = {0, width * height - 1, width * height / 2};
    machines_clear();
    const struct many numbers = many_int32s(pixel, 3), q = many_empty(6);
    ON_EACH(torso_coords, ern_torso_coords_args,
            {.q = {q.on[k], 3, 2, ERN_PER_SAMPLE},
             .pixel = numbers.on[k],
             .width = width,
             .height = height,
             .shrink = 0.8f,
             .n = 3})
    expect_truth("q", q, 0, 0);
    expect_within("q", q, -0.8f, 0.8f);
    expect_at("first row", q, 0, height > 1 ? -0.8f : 0, 0);
    expect_at("last column", q, 4, width > 1 ? 0.8f : 0, 0);
  }
}

/* case: deformations of 1e30, infinity, NaN | plain code: a cell number of 1e30 | here: clamped without a gradient; NaN
 * has no cell | bound: exact */
/* x = clamp(q + d, -1, 1): infinite deformations end at the border, without a gradient; NaN stays one. */
static void test_deformation_without_end(void **state) {
  (void)state;
  static const float d[] = {0, 1e30f, -1e30f, INFINITY, -INFINITY, FLT_TRUE_MIN, 0.2f, -1.8f, NAN, 5, 0.1f};
  enum { N = 2 * 11 };
  float q[N], by[N], gradient[N];
  for (size_t i = 0; i < N; i++) q[i] = 0.8f, by[i] = d[i % 11], gradient[i] = 3;
  machines_clear();
  const struct many from = many_reals(q, N), move = many_reals(by, N), dx = many_reals(gradient, N);
  const struct many x = many_empty(N), dd = many_empty(N);
  struct ern_torso_deform_fwd_args forward[MACHINES];
  for (int k = 0; k < machines.count; k++)
    forward[k] = (struct ern_torso_deform_fwd_args){.x = {x.on[k], 11, 2, ERN_PER_SAMPLE},
                                                    .q = {from.on[k], 11, 2, ERN_PER_SAMPLE},
                                                    .d = {move.on[k], 11, 2, ERN_PER_SAMPLE},
                                                    .n = 11};
  ON_EACH(torso_deform_fwd, ern_torso_deform_fwd_args, forward[k])
  ON_EACH(torso_deform_bwd, ern_torso_deform_bwd_args,
          {.dd = {dd.on[k], 11, 2, ERN_PER_SAMPLE}, .dx = {dx.on[k], 11, 2, ERN_PER_SAMPLE}, .forward = forward[k]})
  expect_truth("x", x, 2 * 0x1p-23, 0);
  expect_within("dd", dd, 0, 3);
  for (size_t i = 1; i < 5; i++) expect_at("x", x, i, i % 2 ? 1 : -1, 0), expect_at("dd", dd, i, 0, 0);
  expect_at("NaN", x, 8, (double)NAN, 0);
  expect_at("inside", dd, 10, 3, 0);
}

/* case: alpha of -0.001, 0, 1, 1.001, NaN | plain code: un-premultiplying divides by 0 | here: nothing is divided |
 * bound: 4 x 2^-23 */
/* alpha is in [-0.001, 1.001]: at its ends, and at broken values, the pixel is what the formula says, alone. */
static void test_torso_alpha_at_its_ends(void **state) {
  (void)state;
  static const float alpha[] = {-0.001f, 0, 1, 1.001f, FLT_TRUE_MIN, 0.5f, NAN};
  enum { N = 7, RAYS = 9 };
  float layer[4 * N], background[3 * RAYS], gradient[3 * RAYS];
  int32_t index[N];
  for (size_t i = 0; i < N; i++) layer[i] = alpha[i], layer[N + i] = 1, layer[2 * N + i] = 0, layer[3 * N + i] = 1.001f;
  for (size_t i = 0; i < N; i++) index[i] = (int32_t)(8 - i);
  for (size_t i = 0; i < COUNT_OF(background); i++) background[i] = 0.5f, gradient[i] = 1;
  machines_clear();
  const struct many layers = many_reals(layer, 4 * N), at = many_int32s(index, N),
                    back = many_reals(background, 3 * RAYS);
  const struct many dpixel = many_reals(gradient, 3 * RAYS), dlayer = many_empty(4 * N), pixel = many_empty(3 * RAYS),
                    opacity = many_empty(RAYS);
  struct ern_torso_composite_fwd_args forward[MACHINES];
  for (int k = 0; k < machines.count; k++)
    forward[k] = (struct ern_torso_composite_fwd_args){.pixel = {pixel.on[k], RAYS, 3, ERN_PER_RAY},
                                                       .opacity = opacity.on[k],
                                                       .layer = {layers.on[k], N, 4, ERN_PER_SAMPLE},
                                                       .index = at.on[k],
                                                       .background = {back.on[k], RAYS, 3, ERN_PER_RAY},
                                                       .rays = RAYS,
                                                       .n = N};
  ON_EACH(torso_composite_fwd, ern_torso_composite_fwd_args, forward[k])
  ON_EACH(torso_composite_bwd, ern_torso_composite_bwd_args,
          {.dlayer = {dlayer.on[k], N, 4, ERN_PER_SAMPLE},
           .dpixel = {dpixel.on[k], RAYS, 3, ERN_PER_RAY},
           .forward = forward[k]})
  expect_truth("pixel", pixel, 4 * 0x1p-23, 0x1p-24);
  expect_truth("dlayer", dlayer, 4 * 0x1p-23, 0x1p-23);
  expect_at("alpha 0", pixel, 7, 0.5, 0);
  expect_at("alpha 1", pixel, 6, 1, 0);
  expect_at("not listed", pixel, 0, 0.5, 0);
  expect_at("NaN", pixel, 2, (double)NAN, 0);
  expect_at("opacity not listed", opacity, 1, 0, 0);
}

/* case: a refresh that meets NaN and negatives | plain code: depends on the order of arguments | here: NaN never is the
 * largest | bound: exact */
/* A refresh that meets NaN, infinity and denormals: the largest number counts, and NaN never does. */
static void test_torso_occupancy_of_odd_values(void **state) {
  (void)state;
  float *grid = calloc(ERN_TORSO_CELLS, sizeof *grid), *alpha = malloc(ERN_TORSO_CELLS * sizeof *alpha);
  assert_true(grid != NULL && alpha != NULL);
  for (size_t i = 0; i < ERN_TORSO_CELLS; i++)
    grid[i] = i % 100 == 0 ? FLT_TRUE_MIN : 0.01f, alpha[i] = i % 7 == 0 ? NAN : i % 11 == 0 ? -0.001f : 0.25f;
  machines_clear();
  const struct many cells = many_reals(grid, ERN_TORSO_CELLS), fresh = many_reals(alpha, ERN_TORSO_CELLS);
  for (int k = 0; k < machines.count; k++) {
    struct ern_torso_update_args args = {.grid = cells.on[k], .alpha = fresh.on[k], .decay = 0.95f};
    support_ok(machines.context, machines.backend[k]->torso_update(machines.stream[k], &args));
    assert_true(fabs(args.mean - 0.25) < 1e-6);
  }
  expect_within("grid", cells, 0.25, 0.25);
  free(grid);
  free(alpha);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_key_point_on_the_camera_plane), cmocka_unit_test(test_key_point_behind_the_camera),
      cmocka_unit_test(test_key_point_at_infinity),         cmocka_unit_test(test_key_point_far_away),
      cmocka_unit_test(test_pose_mirrored_and_not_rigid),   cmocka_unit_test(test_pose_nearly_singular),
      cmocka_unit_test(test_picture_of_one_pixel_a_side),   cmocka_unit_test(test_deformation_without_end),
      cmocka_unit_test(test_torso_alpha_at_its_ends),       cmocka_unit_test(test_torso_occupancy_of_odd_values),
  };
  return cmocka_run_group_tests(tests, open_machines, close_machines);
}
