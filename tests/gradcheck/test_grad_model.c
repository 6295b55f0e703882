/* SPDX-License-Identifier: MIT
 * Gradients of whole training steps, head and torso, through the double reference's table, against central differences.
 *
 * Some losses stop gradients on purpose (docs/maths.md, Losses of the head), so each run switches on the terms that do
 * not, or looks only at the parameters that the stopped paths do not reach. */
#define ERN_DOUBLE
#include "../support.h"

#include <math.h>

#include "backend_cpu/backend_cpu.h"
#include "backend_cpu/cpu_state.h"
#include "core/rng.h"
#include "model/parameters.h"
#include "model/torso_ops.h"
#include "render/march_ops.h"
#include "train/losses_ops.h"
#include "train/step.h"
#include "train/step_ops.h"

enum { RAYS = 12, SIDE = 16, TORSO_RAYS = 10, PROBES = 24 /* values looked at in a tensor */ };

struct scene {
  ern_context *context;
  struct ern_backend *backend;
  struct ern_stream *stream;
  struct ern_field field;
  struct ern_parameter_table table;
  double *values, *gradient;
  struct ern_head_step_args head;
  struct ern_torso_step_args torso;
  struct ern_view view;
  struct ern_march_settings settings;
  size_t most; /* values looked at in a tensor, up to PROBES: all in the long test */
};

/* What the head is made of. */
struct kinds {
  ern_backbone backbone;
  ern_attention attention;
  ern_eye_attention eye_attention;
  bool no_view, fade; /* fade: the voice ends within the rays' heights */
};

static double *reals_of(ern_span span) { return (double *)span.buffer->memory + span.at; }

static ern_span take(struct scene *s, size_t count) {
  ern_span span;
  support_ok(s->context, ern_scratch_take(s->stream, ERN_ELEMENT_REAL, count, &span));
  memset(reals_of(span), 0, count * sizeof(double));
  return span;
}

static double random_at(uint32_t at, uint64_t seed) {
  return ern_uniform(ern_random_at(seed, 7, at, ERN_RNG_PIXEL).word[0]);
}

static ern_rows random_rows(struct scene *s, int rows, size_t n, uint64_t seed) {
  ern_rows out;
  support_ok(s->context, ern_scratch_take_rows(s->stream, rows, n, &out));
  for (int r = 0; r < rows; r++)
    for (size_t i = 0; i < n; i++)
      reals_of(out.span)[(size_t)r * out.stride + i] = 0.1 + 0.8 * random_at((uint32_t)(100 * r) + (uint32_t)i, seed);
  return out;
}

/* Fresh values, but tables 1e3, speech network 4 and layers of a backbone 2.4 times as large as a training begins with:
 * what hardly matters to the loss cannot be told from its rounding, 1e-16/h = 1e-11. */
static double enlarged(const struct ern_parameter *row) {
  if (row->group == ERN_GROUP_GRID) return 1e3;
  if (strncmp(row->name, "encoder_mlp", 11) == 0) return 2.4; /* about sqrt(6), what a rectified layer shrinks by */
  return strncmp(row->name, "audio_net", 9) == 0 ? 4 : 1;
}

/* A model of every effect; a camera before the face; all cells occupied. */
static void scene_open_of(struct scene *s, struct kinds kinds) {
  static const int levels[] = {[ERN_BACKBONE_TRIHASH] = 4, [ERN_BACKBONE_HASH3D] = 3, [ERN_BACKBONE_TRIPLANE] = 1, 0};
  const struct ern_model_config config = {.backbone = kinds.backbone,
                                          .attention = kinds.attention,
                                          .eye_attention = kinds.eye_attention,
                                          .levels = levels[kinds.backbone],
                                          .feature_width = 5,
                                          .window_length = 16,
                                          .head = true,
                                          .eye = true,
                                          .no_view = kinds.no_view,
                                          .voice_fade = {0, kinds.fade ? 0.2f : 0},
                                          .torso = true,
                                          .torso_gamma = true,
                                          .codes = 3,
                                          .bound = 1};
  *s = (struct scene){.context = support_context(), .most = getenv("ERNERF_TEST_LONG") != NULL ? PROBES : 3};
  support_ok(s->context, ern_cpu_backend_make(s->context, ERN_ISA_REF64, &s->backend));
  support_ok(s->context, s->backend->stream_make(s->backend, 2, &s->stream));
  support_ok(s->context, ern_parameters_build(s->context, &config, &s->field, &s->table));
  const ern_span values = take(s, s->field.parameters), gradient = take(s, s->field.parameters);
  float *fresh = (float *)calloc(s->field.parameters, sizeof *fresh);
  ern_parameters_init(fresh, &s->table, false, 3);
  ern_parameters_init(fresh, &s->table, true, 3);
  s->values = reals_of(values);
  s->gradient = reals_of(gradient);
  for (int r = 0; r < s->table.rows; r++) {
    const struct ern_parameter *row = &s->table.row[r];
    for (size_t i = row->at; i < row->at + row->count; i++) s->values[i] = enlarged(row) * (double)fresh[i];
  }
  free(fresh);
  s->settings = (struct ern_march_settings){.bound = 1, .max_steps = 16, .dt_gamma = 1.0f / 256, .near = 0.05f};
  s->view = (struct ern_view){.pose = {1, 0, 0, 0.02f, 0, 0, -1, 3.4f, 0, 1, 0, 0.03f, 0, 0, 0, 1},
                              .focal = 40,
                              .cx = 8,
                              .cy = 8,
                              .width = SIDE,
                              .height = SIDE};

  ern_span pixel, bits;
  support_ok(s->context, ern_scratch_take(s->stream, ERN_ELEMENT_INT32, RAYS, &pixel));
  support_ok(s->context, ern_scratch_take(s->stream, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &bits));
  memset(bits.buffer->memory, 0xff, bits.at + ERN_OCCUPANCY_BYTES);
  for (int i = 0; i < RAYS; i++)
    ((int32_t *)pixel.buffer->memory)[pixel.at + (size_t)i] = (i * 37 + 60) % (SIDE * SIDE);
  s->head = (struct ern_head_step_args){.dparameters = gradient,
                                        .parameters = values,
                                        .field = &s->field,
                                        .view = &s->view,
                                        .settings = &s->settings,
                                        .bits = bits,
                                        .pixel_number = pixel,
                                        .truth = random_rows(s, 3, RAYS, 1),
                                        .background = random_rows(s, 3, RAYS, 2),
                                        .face = random_rows(s, 1, RAYS, 3).span,
                                        .windows = random_rows(s, 1, 8 * 16 * 5, 4).span,
                                        .eye_value = 0.4f,
                                        .individual = 1,
                                        .transmittance_stop = 1e-4f,
                                        .n = RAYS};
  for (int i = 0; i < RAYS; i++) reals_of(s->head.face)[i] = i % 3 == 0;
  const ern_span grid = take(s, ERN_TORSO_CELLS);
  static float motion[ERN_MOTION_VALUES];
  for (int i = 0; i < ERN_TORSO_CELLS; i++) reals_of(grid)[i] = 1;
  for (int i = 0; i < ERN_MOTION_VALUES; i++) motion[i] = 0.02f * (float)(i % 5 - 2);
  s->torso = (struct ern_torso_step_args){.dparameters = gradient,
                                          .parameters = values,
                                          .field = &s->field,
                                          .view = &s->view,
                                          .grid = grid,
                                          .threshold = 0.01f,
                                          .shrink = 0.8f,
                                          .pixel_number = pixel,
                                          .truth = s->head.truth,
                                          .background = s->head.background,
                                          .individual = 2,
                                          .motion = motion,
                                          .n = TORSO_RAYS};
}

static void scene_open(struct scene *s) { scene_open_of(s, (struct kinds){0}); }

static void scene_close(struct scene *s) {
  s->backend->stream_free(s->stream);
  s->backend->free(s->backend);
  ern_context_free(&s->context);
}

static double loss(struct scene *s, bool torso) {
  double sum = 0;
  memset(s->gradient, 0, s->field.parameters * sizeof(double));
  support_ok(s->context,
             torso ? s->backend->torso_step(s->stream, &s->torso) : s->backend->head_step(s->stream, &s->head));
  for (int t = 0; t < ERN_LOSS_TERMS; t++) sum += torso ? s->torso.terms[t] : s->head.terms[t];
  return sum;
}

static double difference(struct scene *s, bool torso, size_t at, double h) {
  const double kept = s->values[at];
  s->values[at] = kept + h;
  const double above = loss(s, torso);
  s->values[at] = kept - h;
  const double below = loss(s, torso);
  s->values[at] = kept;
  return (above - below) / (2 * h);
}

/* The values of a tensor with the largest gradients: random ones of a table would all be 0. */
static void largest(const double *gradient, size_t count, size_t found[PROBES], size_t *probes) {
  *probes = 0;
  for (size_t i = 0; i < count; i++) {
    size_t at = *probes < PROBES ? (*probes)++ : PROBES - 1;
    if (at == PROBES - 1 && *probes == PROBES && fabs(gradient[found[at]]) >= fabs(gradient[i]) && i >= PROBES)
      continue;
    for (; at > 0 && fabs(gradient[found[at - 1]]) < fabs(gradient[i]); at--) found[at] = found[at - 1];
    found[at] = i;
  }
}

/* What the rounding of the loss does to a difference: a few units of its last place over 2 h, by value, summed as an L2
 * norm. */
static double difference_rounding(double loss_value, size_t probes) {
  return 4 * 2.2e-16 * fabs(loss_value) / 2e-5 * sqrt((double)probes);
}

/* |g - g_fd| / |g_fd| <= 1e-6 by tensor, h = 1e-5 max(1, |x|), beside the rounding of the loss. A value that is off by
 * more than its part of that, 1e-7 of the tensor's largest, is near a kink (ReLU, clamp, cell border) where the
 * differences over h and over 10 h differ by more than a smooth function's: 1e-6 of the largest. */
static void check(struct scene *s, bool torso, const char *prefix) {
  int tensors = 0, faint = 0; /* faint: the rounding leaves less than five digits of the difference */
  size_t looked = 0, skipped = 0;
  double *gradient = (double *)calloc(s->field.parameters, sizeof *gradient);
  const double value = loss(s, torso);
  memcpy(gradient, s->gradient, s->field.parameters * sizeof *gradient);
  for (int r = 0; r < s->table.rows; r++) {
    const struct ern_parameter *row = &s->table.row[r];
    size_t found[PROBES] = {0}, probes = 0, near = 0;
    if (row->torso != torso || strncmp(row->name, prefix, strlen(prefix)) != 0) continue;
    largest(gradient + row->at, row->count, found, &probes);
    if (probes > s->most) probes = s->most;
    const double top = fabs(gradient[row->at + found[0]]);
    if (top == 0) continue;
    double error = 0, norm = 0;
    for (size_t p = 0; p < probes; p++) {
      const size_t at = row->at + found[p];
      const double h = 1e-5 * fmax(1, fabs(s->values[at])), fine = difference(s, torso, at, h);
      if (fabs(gradient[at] - fine) > 1e-7 * top && fabs(difference(s, torso, at, 10 * h) - fine) > 1e-6 * top) {
        near++;
        continue;
      }
      error += (gradient[at] - fine) * (gradient[at] - fine);
      norm += fine * fine;
    }
    tensors++;
    looked += probes;
    skipped += near;
    const double rounding = difference_rounding(value, probes);
    if (rounding > 1e-5 * sqrt(norm)) faint++;
    if (near < probes && !(sqrt(error) <= 1e-6 * sqrt(norm) + rounding))
      fail_msg("%s: off by %.2e (largest %.2e)", row->name, sqrt(error / norm), top);
  }
  print_message("%d tensors, %d of them faint, %zu values, %zu near a kink\n", tensors, faint, looked, skipped);
  assert_true(tensors > 0);
  assert_true(3 * faint <= tensors);
  assert_true(2 * skipped < looked);
  free(gradient);
}

static void test_head_photometric_entropy_ambient(void **state) {
  (void)state;
  struct scene s;
  scene_open(&s);
  s.head.weights = (struct ern_loss_weights){.s = 0.5f, .entropy = 0.5f, .audio_ambient = 0.1f};
  check(&s, false, "");
  scene_close(&s);
}

/* The uncertainty net reaches the loss by its own output alone. */
static void test_head_uncertainty(void **state) {
  (void)state;
  struct scene s;
  scene_open(&s);
  s.head.weights = (struct ern_loss_weights){.s = 0.5f, .uncertainty = 1, .static_uncertainty = 0.5f};
  check(&s, false, "unc_net");
  scene_close(&s);
}

/* The eye term stops the gradient of |v|, which the eye branch does not change. */
static void test_head_eye_ambient(void **state) {
  (void)state;
  struct scene s;
  scene_open(&s);
  s.head.weights = (struct ern_loss_weights){.s = 0.5f, .eye_ambient = 0.5f};
  check(&s, false, "eye_att_net");
  scene_close(&s);
}

/* ---- what the paper's ablation has in the place of the tri-plane hash and of the region attention ---- */

static void check_kinds(struct kinds kinds, const char *prefix, size_t rays, size_t most) {
  struct scene s;
  scene_open_of(&s, kinds);
  s.head.n = rays;
  s.most = most;
  s.head.weights = (struct ern_loss_weights){.s = 0.5f, .entropy = 0.5f, .audio_ambient = 0.1f};
  check(&s, false, prefix);
  const bool attends = kinds.attention != ERN_ATTENTION_CONCAT;
  const struct ern_parameter *colour = ern_parameters_find(&s.table, "color_net.net.0.weight");
  assert_int_equal(colour->shape[1], (kinds.no_view ? 0 : ERN_SH_ROWS) + ERN_GEOMETRY + ERN_CODE_WIDTH);
  assert_true((s.head.terms[ERN_LOSS_AUDIO_AMBIENT] > 0) == attends);
  assert_true((ern_parameters_find(&s.table, "aud_ch_att_net.net.0.weight") != NULL) == attends);
  assert_true((ern_parameters_find(&s.table, "eye_att_net.net.0.weight") != NULL) ==
              (kinds.eye_attention == ERN_EYE_ATTENTION_SIGMOID));
  scene_close(&s);
}

/* A voice that ends at a height, of one weight for each channel and of one for all. */
static void test_fade_long(void **state) {
  (void)state;
  check_kinds((struct kinds){.fade = true}, "", 3, 4);
  check_kinds((struct kinds){.attention = ERN_ATTENTION_FEATURE, .fade = true}, "", 3, 4);
}

static void test_attentions_long(void **state) {
  (void)state;
  const ern_backbone backbone = ERN_BACKBONE_TRIHASH;
  check_kinds((struct kinds){backbone, ERN_ATTENTION_FEATURE, ERN_EYE_ATTENTION_SIGMOID, false, false}, "", 3, 4);
  check_kinds((struct kinds){backbone, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_SIGMOID, false, false}, "", 3, 4);
  check_kinds((struct kinds){backbone, ERN_ATTENTION_CHANNEL, ERN_EYE_ATTENTION_CONCAT, false, false}, "", 3, 4);
  check_kinds((struct kinds){backbone, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_CONCAT, false, false}, "", 3, 4);
}

/* A colour that is not told the direction. */
static void test_view_long(void **state) {
  (void)state;
  check_kinds((struct kinds){.no_view = true}, "", 3, 4);
}

static void test_grids_long(void **state) {
  (void)state;
  check_kinds((struct kinds){ERN_BACKBONE_HASH3D, ERN_ATTENTION_CHANNEL, ERN_EYE_ATTENTION_SIGMOID, false, false}, "",
              3, 4);
  check_kinds((struct kinds){ERN_BACKBONE_TRIPLANE, ERN_ATTENTION_FEATURE, ERN_EYE_ATTENTION_SIGMOID, false, false}, "",
              3, 4);
}

/* Half a million weights: three rays make one tile of samples. What comes after the features is checked above. */
static void test_mlp_long(void **state) {
  (void)state;
  check_kinds((struct kinds){ERN_BACKBONE_MLP, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_CONCAT, false, false},
              "encoder_mlp", 3, 3);
}

/* ---- the camera: a rotation vector and a move, about the scene's origin ---- */

/* pose' = exp([w]) pose + m, by the series: |w| is small */
static void move_camera(float pose[16], const double from[16], int k, double by) {
  double turn[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  const int b = (k + 1) % 3, c = (k + 2) % 3;
  if (k < 3) turn[b][b] = turn[c][c] = cos(by), turn[c][b] = sin(by), turn[b][c] = -sin(by);
  for (int r = 0; r < 3; r++)
    for (int col = 0; col < 4; col++) {
      double sum = k >= 3 && r == k - 3 && col == 3 ? by : 0;
      for (int i = 0; i < 3; i++) sum += turn[r][i] * from[4 * i + col];
      pose[4 * r + col] = (float)sum;
    }
}

/* Rays that start within the box meet samples at the same distances whatever the pose is: 16 steps of at most 0.0271
 * from the near plane on end before the box does. Tables that are bilinear over all of a level have no kinks at its
 * borders, and of the waves two octaves are looked at. What is left of the difference is the rounding of positions,
 * which are floats in every build: 2^-25 of sizes up to 1 over h = 1e-4, by sample, at random; beside it terms of h^2,
 * and units that are switched within h: 1 % of the largest difference has room for them. A wrong sign or factor is off
 * by 100 %. */
static void check_pose(struct kinds kinds) {
  const double from[16] = {0.8, 0, 0.6, 0.05, 0.6, 0, -0.8, 0.1, 0, 1, 0, -0.08, 0, 0, 0, 1}, h = 1e-4;
  struct scene s;
  double dpose[ERN_POSE_PARAMETERS], difference_of[ERN_POSE_PARAMETERS], most[2] = {0, 0};
  scene_open_of(&s, kinds);
  s.head.weights = (struct ern_loss_weights){.s = 0, .entropy = 0.5f};
  s.view.focal = 20;
  for (int g = 0; g < s.field.encoder.grids; g++) {
    const struct ern_grid *grid = &s.field.encoder.grid[g];
    const struct ern_grid_level *level = &grid->level[0];
    const uint32_t side = level->resolution + 1;
    double *table = s.values + s.field.encoder.table[g];
    memset(table, 0, (size_t)grid->entries * sizeof *table);
    for (uint32_t i = 0; i < level->size; i++) {
      const double u = (double)(i % side) / side, v = (double)(i / side) / side;
      table[level->offset + i] = (g == 1 ? -3 : 3) * u + (2 - g) * v + 4 * u * v;
    }
  }
  for (int m = 0; m < 2 && s.field.encoder.grids == 0; m++) {
    const struct ern_mlp *trunk = &s.field.encoder.trunk[m];
    for (int unit = 0; unit < trunk->width[1]; unit++)
      for (int c = 3 * 5; c < ERN_X_ROWS; c++) s.values[trunk->weight[0] + (size_t)(unit * trunk->width[0] + c)] = 0;
  }
  for (int i = 0; i < 16; i++) s.view.pose[i] = (float)from[i];
  s.head.dpose = dpose;
  (void)loss(&s, false);
  assert_int_equal(s.head.samples, 16 * RAYS);
  s.head.dpose = NULL;
  for (int k = 0; k < ERN_POSE_PARAMETERS; k++) {
    move_camera(s.view.pose, from, k, h);
    const double above = loss(&s, false);
    move_camera(s.view.pose, from, k, -h);
    difference_of[k] = (above - loss(&s, false)) / (2 * h);
    most[k / 3] = fmax(most[k / 3], fabs(difference_of[k]));
  }
  for (int k = 0; k < ERN_POSE_PARAMETERS; k++) {
    print_message("difference %d: %.6e, by differences %.6e\n", k, dpose[k], difference_of[k]);
    assert_true(fabs(difference_of[k]) <= 1 && most[k / 3] > 1e-6);
    assert_true(fabs(dpose[k] - difference_of[k]) <= 0.01 * most[k / 3]);
  }
  scene_close(&s);
}

static void test_pose(void **state) {
  (void)state;
  check_pose((struct kinds){0});
  check_pose((struct kinds){.no_view = true});
  check_pose((struct kinds){.attention = ERN_ATTENTION_CONCAT, .eye_attention = ERN_EYE_ATTENTION_CONCAT});
  check_pose((struct kinds){ERN_BACKBONE_MLP, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_CONCAT, false, false});
}

static void test_torso(void **state) {
  (void)state;
  struct scene s;
  scene_open(&s);
  check(&s, true, "");
  scene_close(&s);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_head_photometric_entropy_ambient),
                                     cmocka_unit_test(test_head_uncertainty),
                                     cmocka_unit_test(test_head_eye_ambient),
                                     cmocka_unit_test(test_fade_long),
                                     cmocka_unit_test(test_attentions_long),
                                     cmocka_unit_test(test_view_long),
                                     cmocka_unit_test(test_grids_long),
                                     cmocka_unit_test(test_mlp_long),
                                     cmocka_unit_test(test_pose),
                                     cmocka_unit_test(test_torso)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
