/* SPDX-License-Identifier: MIT
 * The heads of the paper's ablation, which go through the stages: a hashed volume, planes of one level, a network of
 * waves; attention by one weight, or none (docs/numerics.md). */
#include "machines.h"
#include "model/parameters.h"
#include "render/render_ops.h"
#include "render/stages.h"
#include "train/step_ops.h"

struct kind {
  const char *name;
  ern_backbone backbone;
  ern_attention attention;
  ern_eye_attention eye;
  int levels;
};
static const struct kind kinds[] = {
    {"hash3d", ERN_BACKBONE_HASH3D, ERN_ATTENTION_CHANNEL, ERN_EYE_ATTENTION_SIGMOID, 2},
    {"triplane", ERN_BACKBONE_TRIPLANE, ERN_ATTENTION_FEATURE, ERN_EYE_ATTENTION_CONCAT, 1},
    {"mlp", ERN_BACKBONE_MLP, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_SIGMOID, 0},
};

static const float ends[] = {0,      -0.0f,        1,    -1,         1 + FLT_EPSILON, -1 - FLT_EPSILON, NAN, INFINITY,
                             -3e38f, FLT_TRUE_MIN, 0.5f, -0.9999999f};
enum { ENDS = COUNT_OF(ends), POINTS = ENDS * ENDS + 1 };

struct head {
  struct ern_field field;
  struct ern_parameter_table table;
  float *block;
};
static struct head head_of(const struct kind *kind) {
  struct head head = {0};
  const struct ern_model_config config = {.backbone = kind->backbone,
                                          .attention = kind->attention,
                                          .eye_attention = kind->eye,
                                          .levels = kind->levels,
                                          .feature_width = 5,
                                          .window_length = 16,
                                          .head = true,
                                          .eye = true,
                                          .bound = 1};
  support_ok(machines.context, ern_parameters_build(machines.context, &config, &head.field, &head.table));
  head.block = calloc(head.field.parameters, sizeof(float));
  assert_non_null(head.block);
  ern_parameters_init(head.block, &head.table, false, 5);
  for (int r = 0; r < head.table.rows; r++)
    if (head.table.row[r].group == ERN_GROUP_GRID && head.table.row[r].range < 1e-3f)
      for (size_t i = 0; i < head.table.row[r].count; i++) head.block[head.table.row[r].at + i] *= 1e4f;
  machines_clear();
  return head;
}

static struct many densities(const struct head *head) {
  float x[3 * POINTS], code[ERN_AUDIO_CODE];
  for (size_t i = 0; i < POINTS; i++)
    x[i] = ends[i % ENDS], x[POINTS + i] = ends[i / ENDS % ENDS], x[2 * POINTS + i] = ends[(i + i / ENDS) % ENDS];
  for (size_t c = 0; c < ERN_AUDIO_CODE; c++) code[c] = machines_random(5, c, 1);
  const struct many parameters = many_reals(head->block, head->field.parameters), codes = many_reals(code, 32);
  const struct many at = many_reals(x, 3 * POINTS), sigma = many_empty(POINTS);
  ON_EACH(head_density, ern_head_density_args,
          {.sigma = sigma.on[k],
           .x = {at.on[k], POINTS, 3, ERN_PER_SAMPLE},
           .parameters = parameters.on[k],
           .field = &head->field,
           .code = codes.on[k],
           .eye_value = 0.4f,
           .n = POINTS})
  return sigma;
}

/* The largest coordinate's size, infinite where one is NaN. */
static float reach_of(size_t point) {
  const float x[3] = {ends[point % ENDS], ends[point / ENDS % ENDS], ends[(point + point / ENDS) % ENDS]};
  float most = 0;
  for (size_t d = 0; d < 3; d++) most = fabsf(x[d]) <= FLT_MAX ? fmaxf(most, fabsf(x[d])) : INFINITY;
  return most;
}

/* case: volume, planes, waves: points at the ends, outside, NaN | plain code: a cell outside the table | here: as
 * inside the tables' rows; NaN for waves of NaN alone | bound: 2^-16 */
/* Grids have no cell for what is no number; waves are NaN there, and finite for all that is near. What lies 3e38 away,
 * where marching has no sample, leaves float in a network. */
static void test_backbones_at_odd_points(void **state) {
  (void)state;
  for (size_t b = 0; b < COUNT_OF(kinds); b++) {
    struct head head = head_of(&kinds[b]);
    const bool waves = kinds[b].backbone == ERN_BACKBONE_MLP;
    const struct many sigma = densities(&head);
    double *truth = many_values(0, sigma);
    for (int k = 0; k < machines.count; k++) {
      double *values = many_values(k, sigma);
      for (size_t i = 0; i < POINTS; i++) {
        const double found = values[MACHINE_GUARD + i], expected = truth[MACHINE_GUARD + i];
        const bool lost = waves && isinf(reach_of(i));
        if (waves && !lost && reach_of(i) > 1e30f) continue;
        if (lost ? !isnan(found) : !(found >= 0 && found <= 5.6e34))
          fail_msg("%s: %s: point %zu: %g", machines.name[k], kinds[b].name, i, found);
        if (!waves && !(fabs(found - expected) <= 0x1p-16 * expected))
          fail_msg("%s: %s: point %zu: %.9g, in double %.9g", machines.name[k], kinds[b].name, i, found, expected);
      }
      free(values);
    }
    free(truth), free(head.block);
  }
}

/* case: their exponents of +-1e30 | plain code: `exp` infinite | here: exp(80) and 0 | bound: 2^-16 */
/* Exponents driven to both ends. */
static void test_backbones_with_exponents_of_200(void **state) {
  (void)state;
  static const float times[] = {1e30f, -1e30f};
  for (size_t b = 0; b < 2; b++) {
    for (size_t t = 0; t < 2; t++) {
      struct head head = head_of(&kinds[b]);
      const struct ern_mlp *net = &head.field.density;
      for (int i = 0; i < net->width[2]; i++) {
        float *weight = head.block + net->weight[2] + i;
        *weight = times[t] * fabsf(*weight);
      }
      const struct many sigma = densities(&head);
      const double end = t == 0 ? exp(80) : 0;
      expect_within("sigma", sigma, end * (1 - 0x1p-16), end * (1 + 0x1p-16));
      free(head.block);
    }
  }
}

/* case: one of their weights NaN | plain code: hidden by ReLU | here: no density is a number | bound: exact */
/* A NaN among the weights of encoder, attention or density: no density is a number. */
static void test_backbones_with_a_nan_among_the_weights(void **state) {
  (void)state;
  for (size_t b = 0; b < COUNT_OF(kinds); b++) {
    for (int which = 0; which < 3; which++) {
      struct head head = head_of(&kinds[b]);
      const struct ern_mlp *net = which == 0 ? &head.field.density : which == 1 ? &head.field.attention : NULL;
      if (which == 2 && kinds[b].backbone == ERN_BACKBONE_MLP) net = &head.field.encoder.trunk[0];
      if (net != NULL && net->layers > 0) {
        head.block[net->weight[0]] = NAN;
        const struct many sigma = densities(&head);
        for (int k = 0; k < machines.count; k++) {
          double *values = many_values(k, sigma);
          for (size_t i = 0; i < POINTS; i++)
            if (!isnan(values[MACHINE_GUARD + i]))
              fail_msg("%s: %s: point %zu: %g", machines.name[k], kinds[b].name, i, values[MACHINE_GUARD + i]);
          free(values);
        }
      }
      free(head.block);
    }
  }
}

/* Building kernels of three more models takes a device minutes; it has the same stages, each with rows of its own. */
static int open_all(void **state) {
  (void)state;
  machines_open_on(getenv("ERNERF_TEST_LONG") != NULL);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_backbones_at_odd_points),
      cmocka_unit_test(test_backbones_with_exponents_of_200),
      cmocka_unit_test(test_backbones_with_a_nan_among_the_weights),
  };
  return cmocka_run_group_tests(tests, open_all, close_machines);
}
