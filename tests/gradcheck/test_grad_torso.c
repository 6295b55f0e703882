/* SPDX-License-Identifier: MIT
 * Backward of the torso's own stages (pose encoding, deformation, compositing) against central differences in double.
 */
#define ERN_DOUBLE
#include "difference.h"
#include "model/torso_ops.h"

enum { ANCHORS = 4 * ERN_TORSO_POINTS, KEYS = 2 * ERN_TORSO_POINTS };

/* ---- pose ---- */

struct pose {
  float matrix[16];
  double anchors[ANCHORS], gamma, k[KEYS], dk[KEYS], danchors[ANCHORS], dgamma;
};

static double pose_loss(void *user) {
  struct pose *p = user;
  ern_torso_pose_fwd_ref64(p->k, p->anchors, &p->gamma, p->matrix);
  double loss = 0;
  for (int i = 0; i < KEYS; i++) loss += p->k[i] * p->dk[i];
  return loss;
}

/* A camera in front of the face, not quite a rotation, so that transpose and inverse are not the same. */
static void pose_fill(struct pose *p) {
  static const double anchors[ANCHORS] = {0.01, 0.01, 0.1, 1, -0.1, -0.1, 0.1, 1.1, 0.1, -0.1, 0.2, 0.9};
  static const float matrix[16] = {0.1f, -0.99f, -0.03f, 0.19f, 0.06f,  0.04f, -1.02f, 3.04f,
                                   1.0f, 0.09f,  0.07f,  -0.2f, 0.003f, 0.01f, -0.02f, 1.0f};
  memset(p, 0, sizeof *p);
  memcpy(p->anchors, anchors, sizeof anchors);
  memcpy(p->matrix, matrix, sizeof matrix);
  p->gamma = 1.3;
  difference_fill(p->dk, KEYS, 1, 1);
}

static void test_pose(void **state) {
  (void)state;
  struct pose p;
  pose_fill(&p);
  ern_torso_pose_bwd_ref64(p.danchors, &p.dgamma, p.dk, p.anchors, &p.gamma, p.matrix);
  const struct difference of = {pose_loss, NULL, &p};
  difference_check(&of, "anchors", p.anchors, p.danchors, ANCHORS, 1);
  difference_check(&of, "gamma", &p.gamma, &p.dgamma, 1, 1);
}

/* X solves pose X = anchor; without gamma k is as with 1; gradients accumulate. */
static void test_pose_values(void **state) {
  (void)state;
  struct pose p, plain;
  pose_fill(&p);
  p.gamma = 1;
  plain = p;
  pose_loss(&p);
  ern_torso_pose_fwd_ref64(plain.k, plain.anchors, NULL, plain.matrix);
  assert_memory_equal(p.k, plain.k, sizeof p.k);
  for (int point = 0; point < ERN_TORSO_POINTS; point++) {
    /* with k0 = X0/X3/X2 and k1 = X1/X3/X2: rows of pose X = anchor in the unknowns X2 X3, X2, X3 are
     * m_i0 k0 X2 X3 + m_i1 k1 X2 X3 + m_i2 X2 + m_i3 X3 = a_i; any three of the four rows give them */
    double rows[4][4];
    for (int i = 0; i < 4; i++) {
      rows[i][0] = (double)p.matrix[4 * i] * p.k[2 * point] + (double)p.matrix[4 * i + 1] * p.k[2 * point + 1];
      rows[i][1] = (double)p.matrix[4 * i + 2];
      rows[i][2] = (double)p.matrix[4 * i + 3];
      rows[i][3] = p.anchors[4 * point + i];
    }
    double determinant = 0; /* of the 4 x 4 system rows * (X2 X3, X2, X3, -1) = 0: it has a solution */
    for (int a = 0; a < 4; a++) {
      const int b = (a + 1) % 4, c = (a + 2) % 4, d = (a + 3) % 4;
      const double minor = rows[b][0] * (rows[c][1] * rows[d][2] - rows[c][2] * rows[d][1]) -
                           rows[b][1] * (rows[c][0] * rows[d][2] - rows[c][2] * rows[d][0]) +
                           rows[b][2] * (rows[c][0] * rows[d][1] - rows[c][1] * rows[d][0]);
      determinant += (a % 2 ? -1 : 1) * rows[a][3] * minor;
    }
    assert_true(fabs(determinant) < 1e-12);
  }
  for (int k = 0; k < 2; k++) {
    ern_torso_pose_bwd_ref64(plain.danchors, NULL, plain.dk, plain.anchors, NULL, plain.matrix);
  }
  ern_torso_pose_bwd_ref64(p.danchors, &p.dgamma, p.dk, p.anchors, &p.gamma, p.matrix);
  for (int i = 0; i < ANCHORS; i++) assert_true(fabs(plain.danchors[i] - 2 * p.danchors[i]) < 1e-12);
}

/* ---- deformation ---- */

enum { POINTS = 200, STRIDE = 208 };

struct deform {
  double q[2 * STRIDE], d[2 * STRIDE], x[2 * STRIDE], dx[2 * STRIDE], dd[2 * STRIDE];
};

static double deform_loss(void *user) {
  struct deform *f = user;
  ern_torso_deform_fwd_ref64(f->x, f->q, f->d, STRIDE, POINTS);
  double loss = 0;
  for (int row = 0; row < 2; row++) {
    for (int i = 0; i < POINTS; i++) loss += f->x[row * STRIDE + i] * f->dx[row * STRIDE + i];
  }
  return loss;
}

static uint64_t deform_piece(void *user) {
  const struct deform *f = user;
  uint64_t hash = 0;
  for (int i = 0; i < 2 * STRIDE; i++) hash = difference_hash(hash, fabs(f->q[i] + f->d[i]) <= 1);
  return hash;
}

static void test_deform(void **state) {
  (void)state;
  static struct deform f;
  difference_fill(f.q, 2 * STRIDE, 0.8, 1);
  difference_fill(f.d, 2 * STRIDE, 0.8, 2);
  difference_fill(f.dx, 2 * STRIDE, 1, 3);
  /* the ends of the clamp let the gradient pass */
  f.q[5] = 0.75, f.d[5] = 0.25, f.q[6] = -0.75, f.d[6] = -0.25;
  deform_loss(&f);
  ern_torso_deform_bwd_ref64(f.dd, f.dx, f.q, f.d, STRIDE, POINTS);
  assert_true(f.x[5] == 1 && f.dd[5] == f.dx[5] && f.x[6] == -1 && f.dd[6] == f.dx[6]);
  const struct difference of = {deform_loss, deform_piece, &f};
  size_t held = 0;
  for (size_t row = 0; row < 2; row++) {
    for (size_t i = 0; i < POINTS; i++) held += f.dd[row * STRIDE + i] == 0;
    difference_check(&of, "deformation", f.d + row * STRIDE, f.dd + row * STRIDE, POINTS, 1);
  }
  assert_true(held > 10 && held < POINTS);
}

/* ---- compositing ---- */

enum { RAYS = 50, LISTED = 31, LAYER_STRIDE = 33, RAY_STRIDE = 52 };

struct layers {
  int32_t index[LISTED];
  double layer[4 * LAYER_STRIDE], background[3 * RAY_STRIDE], pixel[3 * RAY_STRIDE], opacity[RAYS];
  double dpixel[3 * RAY_STRIDE], dlayer[4 * LAYER_STRIDE];
};

static double layers_loss(void *user) {
  struct layers *l = user;
  memcpy(l->pixel, l->background, sizeof l->pixel);
  memset(l->opacity, 0, sizeof l->opacity);
  ern_torso_composite_fwd_ref64(l->pixel, l->opacity, l->layer, LAYER_STRIDE, l->index, l->background, RAY_STRIDE,
                                LISTED);
  double loss = 0;
  for (int c = 0; c < 3; c++) {
    for (int r = 0; r < RAYS; r++) loss += l->pixel[c * RAY_STRIDE + r] * l->dpixel[c * RAY_STRIDE + r];
  }
  return loss;
}

static void test_composite(void **state) {
  (void)state;
  static struct layers l;
  for (int i = 0; i < LISTED; i++) l.index[i] = (int32_t)(i + i / 2);
  difference_fill(l.layer, 4 * LAYER_STRIDE, 1, 1);
  difference_fill(l.background, 3 * RAY_STRIDE, 1, 2);
  difference_fill(l.dpixel, 3 * RAY_STRIDE, 1, 3);
  difference_fill(l.dlayer, 4 * LAYER_STRIDE, 1, 4);
  layers_loss(&l);
  for (int r = 0, i = 0; r < RAYS; r++) {
    const bool listed = i < LISTED && l.index[i] == r;
    assert_true(l.opacity[r] == (listed ? l.layer[i] : 0));
    assert_true((l.pixel[r] == l.background[r]) == !listed);
    i += listed;
  }
  ern_torso_composite_bwd_ref64(l.dlayer, LAYER_STRIDE, l.dpixel, l.layer, l.index, l.background, RAY_STRIDE, LISTED);
  const struct difference of = {layers_loss, NULL, &l};
  for (size_t row = 0; row < 4; row++) {
    difference_check(&of, row == 0 ? "alpha" : "colour", l.layer + row * LAYER_STRIDE, l.dlayer + row * LAYER_STRIDE,
                     LISTED, 1);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_pose),
      cmocka_unit_test(test_pose_values),
      cmocka_unit_test(test_deform),
      cmocka_unit_test(test_composite),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
