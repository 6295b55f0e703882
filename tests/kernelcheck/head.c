/* SPDX-License-Identifier: MIT
 * Heads of the paper's ablation, forward and backward, stage by stage: fused passes do not know them. */
#include "harness.h"

#include "model/head.h"
#include "model/parameters.h"

enum { N = 50 /* samples */, LEVELS = 2, FEATURES = 5, CODES = 2 };

struct kinds {
  ern_backbone backbone;
  ern_attention attention;
  ern_eye_attention eye_attention;
};

/* A batch of samples on a machine. */
struct batch {
  struct ern_head_inputs in;
  ern_rows x;
  struct ern_head_batch value, gradient;
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
  support_ok(machines.context, ern_parameters_build(machines.context, &config, &field, table));
  return field;
}

/* Tables of about 1, layers that keep the size of what goes through them. */
static float *values_of(const struct ern_field *field, const struct ern_parameter_table *table) {
  float *values = floats(field->parameters);
  for (int r = 0; r < table->rows; r++) {
    const struct ern_parameter *row = &table->row[r];
    const float scale = row->group == ERN_GROUP_GRID || row->dims < 2 ? 1 : sqrtf(6.0f / (float)row->shape[1]);
    fill_random(values + row->at, row->count, 20 + (uint64_t)r, scale);
  }
  return values;
}

static void fill_rows(struct ern_stream *stream, ern_rows rows, uint64_t seed) {
  float values[N];
  for (int c = 0; c < rows.rows; c++) {
    fill_random(values, N, seed + (uint64_t)c, 1);
    support_ok(machines.context, stream->backend->upload_reals(stream, ern_span_of_row(rows, c, N), values, N));
  }
}

/* Density and regions forward; back from gradients of the density, of the attention's norm and of the eye's. */
static void run(struct batch *b, struct ern_stream *stream, const struct ern_field *field, struct many parameters,
                struct many code, struct many_rows x, struct many dparameters, struct many dcode, int k) {
  const struct ern_backend *backend = stream->backend;
  *b = (struct batch){
      .in = {.field = field, .parameters = parameters.on[k], .code = code.on[k], .eye = 0.4f, .individual = 1},
      .x = x.on[k],
      .dcode = dcode.on[k],
      .dparameters = dparameters.on[k]};
  const int parts = ERN_BATCH_DENSITY | ERN_BATCH_COLOUR;
  support_ok(machines.context, ern_head_batch_take(stream, field, N, parts, &b->value));
  support_ok(machines.context, ern_head_batch_take(stream, field, N, parts, &b->gradient));
  support_ok(machines.context, ern_head_density_fwd(stream, &b->in, b->x, &b->value));
  support_ok(machines.context, backend->zero(stream, b->gradient.f.span));
  fill_rows(stream, b->gradient.h, 60);
  fill_rows(stream, b->gradient.sigma, 80);
  if (b->gradient.norm.span.buffer != NULL) fill_rows(stream, b->gradient.norm, 81);
  if (b->gradient.eye.span.buffer != NULL) fill_rows(stream, b->gradient.eye, 82);
  support_ok(machines.context,
             ern_head_density_bwd(stream, &b->in, b->x, &b->value, &b->gradient, b->dparameters, b->dcode));
  support_ok(machines.context, backend->synchronize(stream));
}

/* |found - reference|_2 / |reference|_2 of rows. Sums of up to 319 terms, in other orders, over up to 12 layers of sums
 * that keep their size: a few roundings of 2^-24 each. ReLU's kinks: a unit whose sum is next to 0 may be on for one
 * and off for the other, with a value that is next to 0, but with a gradient that is not: see near_gradient. */
static void near_rows(const char *what, const struct batch *batch, size_t member, double most) {
  const ern_rows *a = (const ern_rows *)((const char *)&batch[0].value + member);
  if (a->span.buffer == NULL) return;
  EACH_OTHER (k) {
    const ern_rows *b = (const ern_rows *)((const char *)&batch[k].value + member);
    double difference = 0, size = 0;
    for (int c = 0; c < a->rows; c++) {
      float expected[N], found[N];
      support_ok(machines.context,
                 machines.backend[0]->download_reals(machines.stream[0], expected, ern_span_of_row(*a, c, N), N));
      support_ok(machines.context,
                 machines.backend[k]->download_reals(machines.stream[k], found, ern_span_of_row(*b, c, N), N));
      for (size_t i = 0; i < N; i++) {
        difference += pow((double)found[i] - (double)expected[i], 2);
        size += pow((double)expected[i], 2);
      }
    }
    if (!(sqrt(difference) <= most * sqrt(size)) || size == 0)
      fail_msg("%s: %s: off by %.2e of its size", machines.name[k], what, sqrt(difference / size));
    machines.checks++;
  }
}

/* As above: of some 1e5 units that 50 samples have, one in 1e6 is within the rounding of its kink, and one unit's
 * gradient is 1e-3 of the gradient's size at most. */
static void near_gradient(const char *what, struct many gradient) {
  EACH_OTHER (k) {
    const double distance = distance_of(k, gradient);
    if (!(distance <= 1e-3)) fail_msg("%s: %s: off by %.2e of its size", machines.name[k], what, distance);
  }
}

static void check(struct kinds kinds) {
  struct ern_parameter_table table;
  const struct ern_field field = field_of(kinds, &table);
  float *values = values_of(&field, &table), *nothing = floats(field.parameters), x[3 * N], code[32];
  fill_random(x, 3 * N, 3, 0.99f);
  fill_random(code, 32, 4, 1);
  const struct many parameters = many_reals(values, field.parameters), audio = many_reals(code, ERN_AUDIO_CODE),
                    dparameters = many_reals(nothing, field.parameters), dcode = many_reals(nothing, ERN_AUDIO_CODE);
  const struct many_rows points = many_strided(x, 3, N, ERN_PER_SAMPLE);
  struct batch batch[MACHINES];
  struct ern_arena_mark mark[MACHINES];
  print_message("%s, %s, %s\n", ern_backbone_name(kinds.backbone), ern_attention_name(kinds.attention),
                ern_eye_attention_name(kinds.eye_attention));
  EACH_MACHINE (k) {
    mark[k] = ern_arena_mark(machines.stream[k]);
    run(&batch[k], machines.stream[k], &field, parameters, audio, points, dparameters, dcode, k);
  }
  near_rows("features", batch, offsetof(struct ern_head_batch, f), 1e-5);
  near_rows("norm", batch, offsetof(struct ern_head_batch, norm), 1e-5);
  near_rows("eye attention", batch, offsetof(struct ern_head_batch, eye), 1e-5);
  near_rows("density and geometry", batch, offsetof(struct ern_head_batch, h), 1e-5);
  near_gradient("parameters", dparameters);
  near_gradient("speech", dcode);
  EACH_MACHINE (k) ern_arena_release(machines.stream[k], mark[k]);
  machines_clear();
}

/* PoCL builds a shape for seconds: on a device one head without ERNERF_TEST_LONG, of the kinds that are furthest from
 * the paper's own. */
static void test_heads(void **state) {
  (void)state;
  check((struct kinds){ERN_BACKBONE_HASH3D, ERN_ATTENTION_FEATURE, ERN_EYE_ATTENTION_CONCAT});
  if (!is_long() && is_device(machines.count - 1)) return;
  check((struct kinds){ERN_BACKBONE_TRIHASH, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_SIGMOID});
  check((struct kinds){ERN_BACKBONE_TRIHASH, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_CONCAT});
  check((struct kinds){ERN_BACKBONE_TRIPLANE, ERN_ATTENTION_CHANNEL, ERN_EYE_ATTENTION_SIGMOID});
  bool at_once = true; /* PoCL builds its form for GPUs for minutes */
  EACH_OTHER (k) at_once = at_once && (!is_device(k) || compiles_for_cpus(k));
  if (at_once) check((struct kinds){ERN_BACKBONE_MLP, ERN_ATTENTION_CONCAT, ERN_EYE_ATTENTION_SIGMOID});
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_heads)};
NOUN(head, NULL, .tensor = true)
