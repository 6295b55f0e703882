/* SPDX-License-Identifier: MIT
 * Backward of the MLPs, the output activations and the frequency encoding against central differences in double. */
#define ERN_DOUBLE
#include "difference.h"

#include <float.h>

#include "core/memory.h"
#include "mlp/activation_ops.h"
#include "mlp/encoding_ops.h"
#include "mlp/mlp_tile.h"

enum { MAX_N = 53, RAYS = 5, MAX_VALUES = 20000, MAX_ROWS = 96, WIDEST = 96 };

/* An MLP with up to three pieces; the loss is a random combination of its outputs. */
struct stack {
  struct ern_mlp mlp;
  struct ern_rows_view x[3];
  int pieces;
  size_t n, y_stride;
  int32_t ray[MAX_N];
  double *scratch;
  double parameters[MAX_VALUES], dparameters[MAX_VALUES];
  double input[3][MAX_ROWS * (MAX_N + 3)], dinput[3][MAX_ROWS * (MAX_N + 3)];
  double y[MAX_ROWS * (MAX_N + 5)], dy[MAX_ROWS * (MAX_N + 5)];
};

static double input_at(const struct stack *stack, size_t i, int row) {
  for (int p = 0; p < stack->pieces; p++) {
    const struct ern_rows_view *x = &stack->x[p];
    if (row >= x->rows) {
      row -= x->rows;
      continue;
    }
    const size_t at = x->per == ERN_PER_SAMPLE ? i : x->per == ERN_PER_RAY ? (size_t)stack->ray[i] : 0;
    return x->data[(size_t)row * x->stride + at];
  }
  return NAN;
}

/* The equations once more, sample by sample: `out` of sample i; returns a hash of which units are on. */
static uint64_t evaluate(const struct stack *stack, size_t i, double *out) {
  const struct ern_mlp *mlp = &stack->mlp;
  double h[2][WIDEST];
  uint64_t hash = 0xcbf29ce484222325u;
  for (int k = 0; k < mlp->width[0]; k++) h[0][k] = input_at(stack, i, k);
  for (int l = 0; l < mlp->layers; l++) {
    const double *from = h[l % 2], *w = stack->parameters + mlp->weight[l];
    double *to = h[(l + 1) % 2];
    for (int j = 0; j < mlp->width[l + 1]; j++) {
      to[j] = 0;
      for (int k = 0; k < mlp->width[l]; k++) to[j] += w[j * mlp->width[l] + k] * from[k];
      if (l + 1 == mlp->layers) continue;
      hash = difference_hash(hash, to[j] > 0);
      if (to[j] < 0) to[j] = 0;
    }
  }
  memcpy(out, h[mlp->layers % 2], (size_t)mlp->width[mlp->layers] * sizeof *out);
  return hash;
}

static uint64_t stack_piece(void *user) {
  const struct stack *stack = user;
  double out[WIDEST];
  uint64_t hash = 0;
  for (size_t i = 0; i < stack->n; i++) hash = difference_hash(hash, evaluate(stack, i, out));
  return hash;
}

static double stack_loss(void *user) {
  struct stack *stack = user;
  ern_mlp_fwd_ref64(stack->y, stack->y_stride, stack->x, stack->pieces, stack->ray, stack->parameters, &stack->mlp,
                    stack->n, stack->scratch);
  double loss = 0;
  for (size_t j = 0; j < (size_t)stack->mlp.width[stack->mlp.layers]; j++) {
    for (size_t i = 0; i < stack->n; i++)
      loss += stack->y[j * stack->y_stride + i] * stack->dy[j * stack->y_stride + i];
  }
  return loss;
}

/* Forward equals the equations; both backward outputs equal the differences, and come on top of what was there. */
static void check_stack(struct stack *stack, const int *width, const int *rows, const ern_per *per, size_t step) {
  ern_context *context = support_context();
  stack->y_stride = stack->n + 5;
  stack->mlp = (struct ern_mlp){.layers = -1};
  size_t at = 3; /* the block may hold other things before */
  for (int l = 0; width[l] != 0; l++) {
    stack->mlp.width[l] = width[l];
    stack->mlp.layers = l;
    if (l == 0) continue;
    stack->mlp.weight[l - 1] = at;
    difference_fill(stack->parameters + at, (size_t)(width[l] * width[l - 1]), sqrt(6.0 / width[l - 1]), (uint64_t)l);
    at += (size_t)(width[l] * width[l - 1]);
  }
  assert_true(at <= MAX_VALUES);
  struct ern_rows_view dx[3];
  for (stack->pieces = 0; rows[stack->pieces] != 0; stack->pieces++) {
    const int p = stack->pieces;
    const size_t stride = per[p] == ERN_PER_SAMPLE ? stack->n + 3 : per[p] == ERN_PER_RAY ? RAYS : 1;
    stack->x[p] = (struct ern_rows_view){stack->input[p], stride, rows[p], per[p]};
    dx[p] = (struct ern_rows_view){per[p] == ERN_PER_RAY ? NULL : stack->dinput[p], stride, rows[p], per[p]};
    difference_fill(stack->input[p], (size_t)rows[p] * stride, 1, 100 + (uint64_t)p);
    for (size_t i = 0; i < (size_t)rows[p] * stride; i++) stack->dinput[p][i] = 1;
  }
  for (size_t i = 0; i < stack->n; i++) stack->ray[i] = (int32_t)(i * RAYS / stack->n);
  const size_t outs = (size_t)stack->mlp.width[stack->mlp.layers];
  difference_fill(stack->dy, outs * stack->y_stride, 1, 77);
  for (size_t i = 0; i < at; i++) stack->dparameters[i] = 1;
  assert_int_equal(ERN_NEW(context, ern_mlp_scratch(&stack->mlp), &stack->scratch), ERN_OK);

  stack_loss(stack);
  for (size_t i = 0; i < stack->n; i++) {
    double out[WIDEST];
    evaluate(stack, i, out);
    for (size_t j = 0; j < outs; j++) assert_true(fabs(out[j] - stack->y[j * stack->y_stride + i]) <= 1e-12);
  }
  ern_mlp_bwd_ref64(dx, stack->dparameters, stack->dy, stack->y_stride, stack->x, stack->pieces, stack->ray,
                    stack->parameters, &stack->mlp, stack->n, stack->scratch);
  const struct difference of = {stack_loss, stack_piece, stack};
  for (size_t i = 0; i < at; i++) stack->dparameters[i] -= 1;
  for (size_t i = 0; i < 3; i++) assert_true(stack->dparameters[i] == 0);
  for (int l = 0; l < stack->mlp.layers; l++) {
    const size_t first = stack->mlp.weight[l];
    difference_check(&of, "dW", stack->parameters + first, stack->dparameters + first,
                     (size_t)(width[l] * width[l + 1]), step);
  }
  for (int p = 0; p < stack->pieces; p++) {
    const size_t count = (size_t)rows[p] * stack->x[p].stride;
    for (size_t i = 0; i < count; i++) stack->dinput[p][i] -= 1;
    if (per[p] == ERN_PER_RAY) continue;
    difference_check(&of, "dx", stack->input[p], stack->dinput[p], count, step);
  }
  ern_release(context, stack->scratch);
  ern_context_free(&context);
}

static void test_one_layer(void **state) {
  (void)state;
  static struct stack stack = {.n = 1};
  check_stack(&stack, (const int[]){3, 2, 0}, (const int[]){3, 0}, (const ern_per[]){ERN_PER_SAMPLE}, 1);
}

static void test_pieces(void **state) {
  (void)state;
  static struct stack stack = {.n = 53}; /* a whole tile and part of one */
  check_stack(&stack, (const int[]){12, 9, 7, 3, 0}, (const int[]){5, 4, 3, 0},
              (const ern_per[]){ERN_PER_SAMPLE, ERN_PER_RAY, ERN_PER_BATCH}, 1);
}

static void test_density_stack(void **state) {
  (void)state;
  static struct stack stack = {.n = 6};
  check_stack(&stack, (const int[]){75, 64, 64, 65, 0}, (const int[]){42, 32, 1, 0},
              (const ern_per[]){ERN_PER_SAMPLE, ERN_PER_SAMPLE, ERN_PER_SAMPLE}, 37);
}

static void test_colour_stack(void **state) {
  (void)state;
  static struct stack stack = {.n = 11};
  check_stack(&stack, (const int[]){84, 64, 3, 0}, (const int[]){16, 64, 4, 0},
              (const ern_per[]){ERN_PER_RAY, ERN_PER_SAMPLE, ERN_PER_BATCH}, 11);
}

/* A gradient that nobody wants is not made, and the others do not change for it. */
static void test_unwanted(void **state) {
  (void)state;
  ern_context *context = support_context();
  const struct ern_mlp mlp = {.layers = 2, .width = {4, 5, 2}, .weight = {0, 20}};
  double parameters[30], x[2][2 * 7], dy[2 * 7], dx[2 * 7] = {0}, full[2][30] = {{0}}, both[2][2 * 7] = {{0}};
  difference_fill(parameters, 30, 1, 1);
  difference_fill(x[0], 14, 1, 2);
  difference_fill(x[1], 14, 1, 3);
  difference_fill(dy, 14, 1, 4);
  double *scratch = NULL;
  assert_int_equal(ERN_NEW(context, ern_mlp_scratch(&mlp), &scratch), ERN_OK);
  const struct ern_rows_view views[2] = {{x[0], 7, 2, ERN_PER_SAMPLE}, {x[1], 7, 2, ERN_PER_SAMPLE}};
  const struct ern_rows_view wanted[3][2] = {{{both[0], 7, 2, ERN_PER_SAMPLE}, {both[1], 7, 2, ERN_PER_SAMPLE}},
                                             {{NULL, 0, 2, ERN_PER_SAMPLE}, {dx, 7, 2, ERN_PER_SAMPLE}},
                                             {{NULL, 0, 2, ERN_PER_SAMPLE}, {NULL, 0, 2, ERN_PER_SAMPLE}}};
  for (int k = 0; k < 3; k++) {
    memset(full[k > 0], 0, sizeof full[0]);
    ern_mlp_bwd_ref64(wanted[k], full[k > 0], dy, 7, views, 2, NULL, parameters, &mlp, 7, scratch);
    assert_memory_equal(full[0], full[k > 0], sizeof full[0]);
  }
  assert_memory_equal(dx, both[1], sizeof dx);
  ern_release(context, scratch);
  ern_context_free(&context);
}

enum { ACT_N = 400 };

struct activation {
  ern_activation kind;
  double x[ACT_N], y[ACT_N], dy[ACT_N], dx[ACT_N];
};

static double activation_loss(void *user) {
  struct activation *act = user;
  ern_activate_fwd_ref64(act->y, act->x, act->kind, ACT_N);
  double loss = 0;
  for (size_t i = 0; i < ACT_N; i++) loss += act->y[i] * act->dy[i];
  return loss;
}

/* Within the range where the density's gradient is the true one. Large values would drown the others in the loss's
 * rounding, so each has its turn alone. */
static void test_activations(void **state) {
  (void)state;
  static struct activation act;
  static const char *const name[] = {"density", "colour", "sigmoid", "softplus", "relu"};
  for (act.kind = ERN_ACT_DENSITY; act.kind <= ERN_ACT_RELU; act.kind++) {
    difference_fill(act.x, ACT_N, act.kind == ERN_ACT_DENSITY ? 4 : 12, 5);
    difference_fill(act.dy, ACT_N, 1, 6);
    ern_activate_bwd_ref64(act.dx, act.dy, act.x, act.kind, ACT_N);
    const struct difference of = {activation_loss, NULL, &act};
    difference_check(&of, name[act.kind], act.x, act.dx, ACT_N, 1);
    ern_activate_bwd_ref64(act.dy, act.dy, act.x, act.kind, ACT_N); /* in place */
    assert_memory_equal(act.dx, act.dy, sizeof act.dx);
  }
}

/* In place, and back from what it left: the backbone `mlp` keeps the rectified values alone. */
static void test_relu_in_place(void **state) {
  (void)state;
  const double x[] = {-3, -0.0, 0, 1e-300, 2}, expected[] = {0, -0.0, 0, 1e-300, 2}, gradient[] = {0, 0, 0, 7, 7};
  enum { COUNT = sizeof x / sizeof *x };
  double y[COUNT], dx[COUNT];
  for (size_t i = 0; i < COUNT; i++) y[i] = x[i], dx[i] = 7;
  ern_activate_fwd_ref64(y, y, ERN_ACT_RELU, COUNT);
  ern_activate_bwd_ref64(dx, dx, y, ERN_ACT_RELU, COUNT);
  for (size_t i = 0; i < COUNT; i++) assert_true(y[i] == expected[i] && dx[i] == gradient[i]);
}

/* dx = dy exp(clamp(x, -15, 15)), which is the derivative of exp(min(x, 80)) only inside. */
static void test_clamped_density(void **state) {
  (void)state;
  const double x[] = {-1e308, -90, -15.5, -15, -14.5, 0, 14.5, 15, 15.5, 79, 80, 81, 1e308};
  enum { COUNT = sizeof x / sizeof *x };
  double y[COUNT], dx[COUNT], dy[COUNT];
  for (size_t i = 0; i < COUNT; i++) dy[i] = -2;
  ern_activate_fwd_ref64(y, x, ERN_ACT_DENSITY, COUNT);
  ern_activate_bwd_ref64(dx, dy, x, ERN_ACT_DENSITY, COUNT);
  for (size_t i = 0; i < COUNT; i++) {
    const double gradient = exp(fmin(fmax(x[i], -15), 15)), value = exp(fmin(x[i], 80));
    assert_true(fabs(dx[i] + 2 * gradient) <= 4 * DBL_EPSILON * 2 * gradient);
    assert_true(fabs(y[i] - value) <= 4 * DBL_EPSILON * value);
    if (fabs(x[i]) >= 15) continue;
    double sides[2];
    const double h = 1e-5 * fmax(1, fabs(x[i])), near_by[2] = {x[i] - h, x[i] + h};
    ern_activate_fwd_ref64(sides, near_by, ERN_ACT_DENSITY, 2);
    const double found = -2 * (sides[1] - sides[0]) / (2 * h);
    assert_true(fabs(dx[i] - found) <= 1e-6 * fabs(found));
  }
}

/* Finite in, finite out, in both builds' arithmetic; a NaN is not hidden. */
static void test_activations_finite(void **state) {
  (void)state;
  const double x[] = {-DBL_MAX, -1e4, -745, -100, -88, 0, 88, 100, 745, 1e4, DBL_MAX, -HUGE_VAL, HUGE_VAL, NAN};
  enum { COUNT = sizeof x / sizeof *x };
  for (ern_activation kind = ERN_ACT_DENSITY; kind <= ERN_ACT_RELU; kind++) {
    double y[COUNT], dx[COUNT], one[COUNT];
    for (size_t i = 0; i < COUNT; i++) one[i] = 1;
    ern_activate_fwd_ref64(y, x, kind, COUNT);
    ern_activate_bwd_ref64(dx, one, x, kind, COUNT);
    for (size_t i = 0; i < COUNT - 1; i++) {
      assert_true(isfinite(y[i]) || (kind >= ERN_ACT_SOFTPLUS && x[i] == HUGE_VAL));
      assert_true(isfinite(dx[i]) && dx[i] >= 0);
    }
    assert_true(isnan(y[COUNT - 1]));
    assert_true(isnan(dx[COUNT - 1]) || kind == ERN_ACT_RELU); /* whose gradient is 0 or 1 */
  }
}

enum { FREQ_DIMS = 6, FREQ_OCTAVES = 8, FREQ_N = 9, FREQ_ROWS = FREQ_DIMS * (1 + 2 * FREQ_OCTAVES) };

struct frequency {
  double x[FREQ_DIMS * (FREQ_N + 1)], dx[FREQ_DIMS * (FREQ_N + 1)];
  double y[FREQ_ROWS * (FREQ_N + 2)], dy[FREQ_ROWS * (FREQ_N + 2)];
};

static double frequency_loss(void *user) {
  struct frequency *freq = user;
  ern_freq_fwd_ref64(freq->y, FREQ_N + 2, freq->x, FREQ_N + 1, FREQ_DIMS, FREQ_OCTAVES, FREQ_N);
  double loss = 0;
  for (size_t r = 0; r < FREQ_ROWS; r++) {
    for (size_t i = 0; i < FREQ_N; i++) loss += freq->y[r * (FREQ_N + 2) + i] * freq->dy[r * (FREQ_N + 2) + i];
  }
  return loss;
}

static void test_frequency(void **state) {
  (void)state;
  static struct frequency freq;
  difference_fill(freq.x, sizeof freq.x / sizeof *freq.x, 1, 8);
  difference_fill(freq.dy, sizeof freq.dy / sizeof *freq.dy, 1, 9);
  for (size_t i = 0; i < sizeof freq.dx / sizeof *freq.dx; i++) freq.dx[i] = 1;
  const struct difference of = {frequency_loss, NULL, &freq};
  frequency_loss(&freq);
  /* row 6 + 2*6*o + d is sin(2^o x_d), six rows on is the cosine */
  assert_true(fabs(freq.y[(6 + 12 * 3 + 2) * (FREQ_N + 2) + 4] - sin(8 * freq.x[2 * (FREQ_N + 1) + 4])) < 1e-14);
  assert_true(fabs(freq.y[(12 + 12 * 3 + 2) * (FREQ_N + 2) + 4] - cos(8 * freq.x[2 * (FREQ_N + 1) + 4])) < 1e-14);
  ern_freq_bwd_ref64(freq.dx, FREQ_N + 1, freq.dy, FREQ_N + 2, freq.x, FREQ_N + 1, FREQ_DIMS, FREQ_OCTAVES, FREQ_N);
  for (size_t i = 0; i < sizeof freq.dx / sizeof *freq.dx; i++) freq.dx[i] -= 1;
  difference_check(&of, "frequency dx", freq.x, freq.dx, sizeof freq.x / sizeof *freq.x, 1);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_one_layer),          cmocka_unit_test(test_pieces),
      cmocka_unit_test(test_density_stack),      cmocka_unit_test(test_colour_stack),
      cmocka_unit_test(test_unwanted),           cmocka_unit_test(test_activations),
      cmocka_unit_test(test_relu_in_place),      cmocka_unit_test(test_clamped_density),
      cmocka_unit_test(test_activations_finite), cmocka_unit_test(test_frequency),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
