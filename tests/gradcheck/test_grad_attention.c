/* SPDX-License-Identifier: MIT
 * Backward of region attention against central differences in double. */
#define ERN_DOUBLE
#include "difference.h"
#include "model/attention_ops.h"

enum { CHANNELS = 7, SAMPLES = 37, STRIDE = 40, ROWS = CHANNELS * STRIDE };

struct attention {
  double v[ROWS], code[CHANNELS], eye_attention[SAMPLES], eye;
  double region[ROWS], norm[SAMPLES], region_eye[SAMPLES];
  double dregion[ROWS], dnorm[SAMPLES], dregion_eye[SAMPLES];
  double dv[ROWS], dcode[CHANNELS], deye_attention[SAMPLES];
  int values; /* rows of v, 0: CHANNELS */
};

static struct ern_attention_shape shape_of(const struct attention *a) {
  return (struct ern_attention_shape){CHANNELS, a->values > 0 ? a->values : CHANNELS};
}

static void fill(struct attention *a) {
  memset(a, 0, sizeof *a);
  difference_fill(a->v, ROWS, 2, 1);
  difference_fill(a->code, CHANNELS, 1, 2);
  difference_fill(a->eye_attention, SAMPLES, 1, 3);
  difference_fill(a->dregion, ROWS, 1, 4);
  difference_fill(a->dnorm, SAMPLES, 1, 5);
  difference_fill(a->dregion_eye, SAMPLES, 1, 6);
  a->eye = 0.7;
}

static double loss_of(void *user) {
  struct attention *a = user;
  ern_attention_fwd_ref64(a->region, a->norm, a->region_eye, a->v, a->code, a->eye_attention, a->eye, shape_of(a),
                          STRIDE, SAMPLES);
  double loss = 0;
  for (int i = 0; i < SAMPLES; i++) {
    loss += a->norm[i] * a->dnorm[i] + a->region_eye[i] * a->dregion_eye[i];
    for (int c = 0; c < CHANNELS; c++) loss += a->region[c * STRIDE + i] * a->dregion[c * STRIDE + i];
  }
  return loss;
}

static void test_all(void **state) {
  (void)state;
  static struct attention a;
  fill(&a);
  loss_of(&a);
  ern_attention_bwd_ref64(a.dv, a.dcode, a.deye_attention, a.dregion, a.dnorm, a.dregion_eye, a.v, a.norm, a.code,
                          a.eye, shape_of(&a), STRIDE, SAMPLES);
  const struct difference of = {loss_of, NULL, &a};
  for (size_t c = 0; c < CHANNELS; c++) {
    difference_check(&of, "v", a.v + c * STRIDE, a.dv + c * STRIDE, SAMPLES, 1);
  }
  difference_check(&of, "code", a.code, a.dcode, CHANNELS, 1);
  difference_check(&of, "eye attention", a.eye_attention, a.deye_attention, SAMPLES, 1);
}

/* One v for all channels; it is away from 0, where |v| has a kink. */
static void test_one(void **state) {
  (void)state;
  static struct attention a;
  fill(&a);
  a.values = 1;
  for (int i = 0; i < SAMPLES; i++) a.v[i] += a.v[i] < 0 ? -0.1 : 0.1;
  loss_of(&a);
  ern_attention_bwd_ref64(a.dv, a.dcode, a.deye_attention, a.dregion, a.dnorm, a.dregion_eye, a.v, a.norm, a.code,
                          a.eye, shape_of(&a), STRIDE, SAMPLES);
  const struct difference of = {loss_of, NULL, &a};
  difference_check(&of, "one v", a.v, a.dv, SAMPLES, 1);
  difference_check(&of, "code of one v", a.code, a.dcode, CHANNELS, 1);
  for (int i = STRIDE; i < ROWS; i++) assert_true(a.dv[i] == 0); /* its row alone is written */
}

/* Without v the eye alone. */
static void test_eye_alone(void **state) {
  (void)state;
  static struct attention a;
  fill(&a);
  const struct ern_attention_shape none = {0, 0};
  ern_attention_fwd_ref64(NULL, NULL, a.region_eye, NULL, a.code, a.eye_attention, a.eye, none, STRIDE, SAMPLES);
  ern_attention_bwd_ref64(NULL, a.dcode, a.deye_attention, NULL, NULL, a.dregion_eye, NULL, NULL, a.code, a.eye, none,
                          STRIDE, SAMPLES);
  for (int i = 0; i < SAMPLES; i++) {
    assert_true(a.region_eye[i] == a.eye * a.eye_attention[i]);
    assert_true(a.deye_attention[i] == a.eye * a.dregion_eye[i]);
  }
  for (int c = 0; c < CHANNELS; c++) assert_true(a.dcode[c] == 0);
}

/* dv is overwritten; dcode and deye_attention grow; what is beyond the samples stays as it was. */
static void test_accumulation(void **state) {
  (void)state;
  static struct attention once, twice;
  fill(&once);
  loss_of(&once);
  difference_fill(once.dv, ROWS, 1, 7);
  twice = once;
  for (int k = 0; k < 3; k++) {
    struct attention *a = k == 0 ? &once : &twice;
    ern_attention_bwd_ref64(a->dv, a->dcode, a->deye_attention, a->dregion, a->dnorm, a->dregion_eye, a->v, a->norm,
                            a->code, a->eye, shape_of(a), STRIDE, SAMPLES);
  }
  assert_memory_equal(once.dv, twice.dv, sizeof once.dv);
  for (int c = 0; c < CHANNELS; c++) {
    assert_true(twice.dcode[c] == 2 * once.dcode[c] && once.dcode[c] != 0);
    for (int i = SAMPLES; i < STRIDE; i++) {
      assert_true(once.dv[c * STRIDE + i] == difference_random(7, (uint32_t)(c * STRIDE + i)));
    }
  }
  for (int i = 0; i < SAMPLES; i++) assert_true(twice.deye_attention[i] == 2 * once.deye_attention[i]);
}

/* Each upstream gradient alone; the three together are their sum. A norm of 0 has gradient 0. */
static void test_parts(void **state) {
  (void)state;
  static struct attention a;
  static double dv_region[ROWS], dv_norm[ROWS];
  fill(&a);
  for (int c = 0; c < CHANNELS; c++) a.v[c * STRIDE + 11] = 0;
  loss_of(&a);
  assert_true(a.norm[11] == 0);
  ern_attention_bwd_ref64(dv_region, NULL, NULL, a.dregion, NULL, NULL, a.v, a.norm, a.code, a.eye, shape_of(&a),
                          STRIDE, SAMPLES);
  ern_attention_bwd_ref64(dv_norm, a.dcode, NULL, NULL, a.dnorm, NULL, a.v, a.norm, a.code, a.eye, shape_of(&a), STRIDE,
                          SAMPLES);
  ern_attention_bwd_ref64(a.dv, NULL, NULL, a.dregion, a.dnorm, NULL, a.v, a.norm, a.code, a.eye, shape_of(&a), STRIDE,
                          SAMPLES);
  for (int c = 0; c < CHANNELS; c++) {
    assert_true(a.dcode[c] == 0);
    assert_true(dv_norm[c * STRIDE + 11] == 0);
    assert_true(dv_region[c * STRIDE + 11] == a.code[c] * a.dregion[c * STRIDE + 11]);
    for (int i = 0; i < SAMPLES; i++) {
      const int at = c * STRIDE + i;
      assert_true(a.dv[at] == dv_region[at] + dv_norm[at]);
    }
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_all),          cmocka_unit_test(test_one),   cmocka_unit_test(test_eye_alone),
      cmocka_unit_test(test_accumulation), cmocka_unit_test(test_parts),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
