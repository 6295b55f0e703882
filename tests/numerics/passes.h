/* SPDX-License-Identifier: MIT
 * A head and a torso, and rays from outside, for tests of the fused passes with extreme values in a copy of the
 * parameters. Half of the rays hit the occupied ball, the others nothing. */
#ifndef ERN_TEST_PASSES_H
#define ERN_TEST_PASSES_H

#include "machines.h"
#include "model/parameters.h"
#include "render/march_ops.h"
#include "render/morton.h"
#include "render/stages.h"

enum { PASS_SIDE = 16, PASS_RAYS = PASS_SIDE * PASS_SIDE, PASS_WIDTH = 5, PASS_WINDOWS = 8 * 16 * PASS_WIDTH };

struct passes {
  struct ern_field field;
  struct ern_parameter_table table;
  float *usual, *block; /* [parameters]; the tests modify the second */
  uint8_t *ball, *nothing;
  struct ern_view view;
  struct ern_march_settings settings;
};
static struct passes passes;

static inline void passes_open(bool eye, int codes, bool torso) {
  const struct ern_model_config config = {.levels = 2,
                                          .feature_width = PASS_WIDTH,
                                          .window_length = 16,
                                          .head = true,
                                          .eye = eye,
                                          .codes = codes,
                                          .torso = torso,
                                          .bound = 1};
  support_ok(machines.context, ern_parameters_build(machines.context, &config, &passes.field, &passes.table));
  const struct ern_field *field = &passes.field;
  passes.usual = calloc(field->parameters, sizeof(float));
  passes.block = calloc(field->parameters, sizeof(float));
  passes.ball = calloc(ERN_OCCUPANCY_BYTES, 1);
  passes.nothing = calloc(ERN_OCCUPANCY_BYTES, 1);
  assert_true(passes.usual != NULL && passes.block != NULL && passes.ball != NULL && passes.nothing != NULL);
  ern_parameters_init(passes.usual, &passes.table, false, 5);
  if (torso) ern_parameters_init(passes.usual, &passes.table, true, 5);
  for (int plane = 0; plane < ERN_PLANES; plane++)
    for (uint32_t i = 0; i < field->encoder.grid[plane].entries; i++)
      passes.usual[field->encoder.table[plane] + i] = machines_random(9 + (uint64_t)plane, i, 1);
  for (size_t i = 0; torso && i < (size_t)field->torso_grid.entries * 2; i++)
    passes.usual[field->torso_table + i] = machines_random(8, i, 1);
  for (uint32_t c = 0; c < ERN_OCCUPANCY_CELLS; c++) { /* of radius 1/4 */
    const float x = (float)ern_morton_gather(c) / 64 - 1, y = (float)ern_morton_gather(c >> 1) / 64 - 1,
                z = (float)ern_morton_gather(c >> 2) / 64 - 1;
    if (x * x + y * y + z * z < 0.0625f) passes.ball[c >> 3] |= (uint8_t)(1u << (c & 7));
  }
  passes.view = (struct ern_view){.pose = {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1},
                                  .focal = 3 * PASS_SIDE,
                                  .cx = PASS_SIDE / 2,
                                  .cy = PASS_SIDE / 2,
                                  .width = PASS_SIDE,
                                  .height = PASS_SIDE};
  passes.settings = (struct ern_march_settings){.bound = 1, .max_steps = 16, .dt_gamma = 1.0f / 256, .near = 0.05f};
}
static inline int close_passes(void **state) {
  free(passes.usual), free(passes.block), free(passes.ball), free(passes.nothing);
  return close_machines(state);
}
/* The model of test_hard_frames, so that its kernels are already built. */
static inline int open_passes(void **state) {
  open_hosts(state);
  passes_open(false, 0, true);
  return 0;
}

/* Restores the block. */
static inline void passes_reset(void) {
  memcpy(passes.block, passes.usual, passes.field.parameters * sizeof(float));
  machines_clear();
}

/* ---- weights: a layer's are [outs][ins] ---- */

static inline size_t layer_weights(const struct ern_mlp *net, int layer) {
  return (size_t)net->width[layer] * (size_t)net->width[layer + 1];
}
static inline void scale_layer(const struct ern_mlp *net, int layer, float times) {
  for (size_t i = 0; i < layer_weights(net, layer); i++) passes.block[net->weight[layer] + i] *= times;
}
/* Sets all weights from the inputs [first, first + count) of a layer. */
static inline void set_inputs(const struct ern_mlp *net, int layer, int first, int count, float value) {
  for (int r = 0; r < net->width[layer + 1]; r++)
    for (int c = first; c < first + count; c++)
      passes.block[net->weight[layer] + (size_t)(r * net->width[layer] + c)] = value;
}
/* Makes row `row` of a layer factor |w|: for positive inputs the sign of its output is known. */
static inline void set_row_sign(const struct ern_mlp *net, int layer, int row, float factor) {
  float *w = passes.block + net->weight[layer] + (size_t)row * (size_t)net->width[layer];
  for (int c = 0; c < net->width[layer]; c++) w[c] = factor * fabsf(w[c]);
}
/* Makes all units of a hidden layer inactive. */
static inline void kill_units(const struct ern_mlp *net, int layer) {
  for (int r = 0; r < net->width[layer + 1]; r++) set_row_sign(net, layer, r, -1);
}

/* ---- what is expected ---- */

static inline bool in_bf16(int k) { return strcmp(machines.name[k], "avx512bf16") == 0; }

/* As expect_truth; with bf16 products, the tolerance is `rough` times the value. */
static inline void expect_near_truth(const char *what, struct many span, double relative, double absolute,
                                     double rough) {
  double *truth = many_values(0, span);
  for (int k = 1; k < machines.count; k++) {
    double *values = many_values(k, span);
    for (size_t i = MACHINE_GUARD; i < span.on[k].count + MACHINE_GUARD; i++) {
      const double found = values[i], expected = truth[i];
      const double allowed = (in_bf16(k) ? rough : relative) * fabs(expected) + absolute;
      if ((isnan(found) && isnan(expected)) || (float)found == (float)expected) continue;
      if (fabs(found - expected) <= allowed) continue;
      fail_msg("%s: %s [%zu]: found %.9g, in double %.9g +- %.1e", machines.name[k], what, i - MACHINE_GUARD, found,
               expected, allowed);
    }
    free(values);
  }
  free(truth);
}

#endif
