/* SPDX-License-Identifier: MIT
 * Heads of the paper's ablation on an OpenCL device, forward and backward, stage by stage: fused passes do not know
 * them. */
#include "kernelcheck.h"
#include "twin.h"

#include "backend_opencl/opencl.h"
#include "model/head.h"
#include "model/parameters.h"

static ern_context *context;
static struct twin twin;

enum { N = 50 /* samples */, LEVELS = 2, FEATURES = 5, CODES = 2 };

struct kinds {
  ern_backbone backbone;
  ern_attention attention;
  ern_eye_attention eye_attention;
};

/* A batch of samples on one of the two. */
struct batch {
  struct ern_head_inputs in;
  ern_rows x;
  struct ern_head_batch value, slope;
  ern_span dcode, dparameters;
};

static struct ern_field field_of(struct kinds kinds, struct ern_parameter_table *table) {
  static const int levels[] = {LEVELS, LEVELS, 1, 0};
  const struct ern_model_config config = {.backbone = kinds.backbone,
                                          .attention = kinds.attention,
                                          .eye_attention = kinds.eye_attention,
                                          .levels = levels[kinds.backbone],
                                          .feature_width = FEATURES,
                                          .window_length = 16,
                                          .head = true,
                                          .eye = true,
                                          .codes = CODES,
                                          .bound = 1};
  struct ern_field field;
  support_ok(context, ern_parameters_build(context, &config, &field, table));
  return field;
}

/* Tables of about 1, layers that keep the size of what goes through them. */
static float *values_of(const struct ern_field *field, const struct ern_parameter_table *table) {
  float *values = calloc(field->parameters, sizeof *values);
  assert_non_null(values);
  for (int r = 0; r < table->rows; r++) {
    const struct ern_parameter *row = &table->row[r];
    const float scale = row->group == ERN_GROUP_GRID || row->dims < 2 ? 1 : sqrtf(6.0f / (float)row->shape[1]);
    twin_fill(values + row->at, row->count, 20 + (uint64_t)r, scale);
  }
  return values;
}

static void fill_rows(struct ern_stream *stream, ern_rows rows, uint64_t seed) {
  float values[N];
  for (int c = 0; c < rows.rows; c++) {
    twin_fill(values, N, seed + (uint64_t)c, 1);
    support_ok(context, stream->backend->upload_reals(stream, ern_span_of_row(rows, c, N), values, N));
  }
}

/* Density and regions forward; back from slopes of the density, of the attention's norm and of the eye's. */
static void run(struct batch *b, struct ern_stream *stream, const struct ern_field *field, struct twin_span parameters,
                struct twin_span code, struct twin_rows x, struct twin_span dparameters, struct twin_span dcode,
                int k) {
  const struct ern_backend *backend = stream->backend;
  *b = (struct batch){
      .in = {.field = field, .parameters = parameters.on[k], .code = code.on[k], .eye = 0.4f, .individual = 1},
      .x = x.on[k],
      .dcode = dcode.on[k],
      .dparameters = dparameters.on[k]};
  const int parts = ERN_BATCH_DENSITY | ERN_BATCH_COLOUR;
  support_ok(context, ern_head_batch_take(stream, field, N, parts, &b->value));
  support_ok(context, ern_head_batch_take(stream, field, N, parts, &b->slope));
  support_ok(context, ern_head_density_fwd(stream, &b->in, b->x, &b->value));
  support_ok(context, backend->zero(stream, b->slope.f.span));
  fill_rows(stream, b->slope.h, 60);
  fill_rows(stream, b->slope.sigma, 80);
  if (b->slope.norm.span.buffer != NULL) fill_rows(stream, b->slope.norm, 81);
  if (b->slope.eye.span.buffer != NULL) fill_rows(stream, b->slope.eye, 82);
  support_ok(context, ern_head_density_bwd(stream, &b->in, b->x, &b->value, &b->slope, b->dparameters, b->dcode));
  support_ok(context, backend->settle(stream));
}

/* |device - reference|_2 / |reference|_2 of rows. Sums of up to 319 terms, in other orders, over up to 12 layers of
 * sums that keep their size: a few roundings of 2^-24 each. ReLU's kinks: a unit whose sum is next to 0 may be on for
 * one and off for the other, with a value that is next to 0, but with a slope that is not: see near_gradient. */
static void near_rows(const char *what, const struct batch both[2], size_t member, double most) {
  const ern_rows *a = (const ern_rows *)((const char *)&both[0].value + member),
                 *b = (const ern_rows *)((const char *)&both[1].value + member);
  double difference = 0, size = 0;
  if (a->span.buffer == NULL) return;
  for (int c = 0; c < a->rows; c++) {
    float expected[N], found[N];
    support_ok(context, twin.backend[0]->download_reals(twin.stream[0], expected, ern_span_of_row(*a, c, N), N));
    support_ok(context, twin.backend[1]->download_reals(twin.stream[1], found, ern_span_of_row(*b, c, N), N));
    for (size_t i = 0; i < N; i++) {
      difference += pow((double)found[i] - (double)expected[i], 2);
      size += pow((double)expected[i], 2);
    }
  }
  if (!(sqrt(difference) <= most * sqrt(size)) || size == 0)
    fail_msg("%s: off by %.2e of its size", what, sqrt(difference / size));
}

/* As above: of some 1e5 units that 50 samples have, one in 1e6 is within the rounding of its kink, and one unit's slope
 * is 1e-3 of the gradient's size at most. */
static void near_gradient(const char *what, struct twin_span gradient) {
  const double distance = twin_distance(&twin, gradient);
  if (!(distance <= 1e-3)) fail_msg("%s: off by %.2e of its size", what, distance);
}

static void check(struct kinds kinds) {
  struct ern_parameter_table table;
  const struct ern_field field = field_of(kinds, &table);
  float *values = values_of(&field, &table), *nothing = calloc(field.parameters, sizeof *nothing), x[3 * N], code[32];
  assert_non_null(nothing);
  twin_fill(x, 3 * N, 3, 0.99f);
  twin_fill(code, 32, 4, 1);
  const struct twin_span parameters = twin_reals(&twin, values, field.parameters),
                         audio = twin_reals(&twin, code, ERN_AUDIO_CODE),
                         dparameters = twin_reals(&twin, nothing, field.parameters),
                         dcode = twin_reals(&twin, nothing, ERN_AUDIO_CODE);
  const struct twin_rows points = twin_rows_of(&twin, x, 3, N, ERN_PER_SAMPLE);
  struct batch both[2];
  struct ern_arena_mark mark[2];
  print_message("%s, %s, %s\n", ern_backbone_name(kinds.backbone), ern_attention_name(kinds.attention),
                ern_eye_attention_name(kinds.eye_attention));
  for (int k = 0; k < 2; k++) {
    mark[k] = ern_arena_mark(twin.stream[k]);
    run(&both[k], twin.stream[k], &field, parameters, audio, points, dparameters, dcode, k);
  }
  near_rows("features", both, offsetof(struct ern_head_batch, f), 1e-5);
  near_rows("norm", both, offsetof(struct ern_head_batch, norm), 1e-5);
  near_rows("eye attention", both, offsetof(struct ern_head_batch, eye), 1e-5);
  near_rows("density and geometry", both, offsetof(struct ern_head_batch, h), 1e-5);
  near_gradient("parameters", dparameters);
  near_gradient("speech", dcode);
  for (int k = 0; k < 2; k++) ern_arena_release(twin.stream[k], mark[k]);
  free(values), free(nothing);
  twin_clear(&twin);
}

static bool is_long(void) {
  const char *text = getenv("ERNERF_TEST_LONG");
  return text != NULL && text[0] != 0;
}

/* PoCL builds a shape for seconds: one head without ERNERF_TEST_LONG, of the kinds that are furthest from the paper's
 * own. */
static void test_heads(void **state) {
  (void)state;
  check((struct kinds){ERN_BACKBONE_HASH3D, ERN_ATTENTION_FEATURE, ERN_EYE_ATTENTION_CONCAT});
  if (!is_long()) return;
  check((struct kinds){ERN_BACKBONE_TRIHASH, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_SIGMOID});
  check((struct kinds){ERN_BACKBONE_TRIHASH, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_CONCAT});
  check((struct kinds){ERN_BACKBONE_TRIPLANE, ERN_ATTENTION_CHANNEL, ERN_EYE_ATTENTION_SIGMOID});
  if (((struct ern_cl_backend *)twin.backend[1])->device.cpu) /* PoCL builds its form for GPUs for minutes */
    check((struct kinds){ERN_BACKBONE_MLP, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_SIGMOID});
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_heads)};
  return cmocka_run_group_tests_name("opencl heads", tests, set_up, tear_down);
}
