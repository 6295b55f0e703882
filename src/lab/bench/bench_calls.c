/* SPDX-License-Identifier: MIT
 * Name, arithmetic and traffic of one call of a slot, from its arguments; ernerf-lab/bench.h says what counts. Counts
 * other than sums of products follow the equations in docs/maths.md: exact for compute-bound kernels, approximate for
 * memory-bound ones. */
#include "lab/bench/bench_shared.h"
#include "mlp/activation_ops.h"
#include "model/field.h"
#include "model/torso_ops.h"

enum { INT_BYTES = 4, SMALL = 64 /* calls on fewer items are set-up and are not measured */ };

typedef struct ern_bench_call_cost cost;

/* ---- fully connected stacks -------------------------------------------------------------------------------------- */

static const struct {
  size_t mlp; /* offset in struct ern_field */
  const char *fwd, *bwd;
} mlps[] = {
    {offsetof(struct ern_field, attention), "attention_mlp_fwd", "attention_mlp_bwd"},
    {offsetof(struct ern_field, eye), "eye_mlp_fwd", "eye_mlp_bwd"},
    {offsetof(struct ern_field, density), "density_mlp_fwd", "density_mlp_bwd"},
    {offsetof(struct ern_field, colour), "colour_mlp_fwd", "colour_mlp_bwd"},
    {offsetof(struct ern_field, uncertainty), "uncertainty_mlp_fwd", "uncertainty_mlp_bwd"},
    {offsetof(struct ern_field, torso_deform), "torso_deform_mlp_fwd", "torso_deform_mlp_bwd"},
    {offsetof(struct ern_field, torso_net), "torso_mlp_fwd", "torso_mlp_bwd"},
};

static const char *name_mlp(const struct ern_mlp *mlp, const struct ern_field *field, bool backward) {
  for (size_t i = 0; i < sizeof mlps / sizeof *mlps; i++) {
    const struct ern_mlp *known = (const struct ern_mlp *)((const char *)field + mlps[i].mlp);
    const int last = known->layers;
    if (known->layers > 0 && known->weight[0] == mlp->weight[0] && known->width[last] == mlp->width[last])
      return backward ? mlps[i].bwd : mlps[i].fwd;
  }
  return NULL; /* a refresh computes only the density */
}

static double rows_bytes(const ern_rows *rows, size_t n, size_t real) {
  if (rows->span.buffer == NULL) return 0;
  const double values = rows->per == ERN_PER_SAMPLE ? (double)n : rows->per == ERN_PER_RAY ? (double)rows->stride : 1;
  return values * rows->rows * (double)real;
}

static cost cost_mlp(const struct ern_mlp_fwd_args *a, const struct ern_field *field, size_t real) {
  const double n = (double)a->n, macs = ern_bench_mlp_macs(&a->mlp);
  cost c = {.name = name_mlp(&a->mlp, field, false), .item = "sample", .items = n};
  c.flops = c.flops_written = 2 * macs * n;
  c.bytes = (macs + n * a->mlp.width[a->mlp.layers]) * (double)real;
  for (int p = 0; p < a->pieces; p++) c.bytes += rows_bytes(&a->x[p], a->n, real);
  return c;
}

static cost cost_mlp_bwd(const struct ern_mlp_bwd_args *a, const struct ern_field *field, size_t real) {
  const struct ern_mlp_fwd_args *f = &a->forward;
  const double n = (double)f->n, macs = ern_bench_mlp_macs(&f->mlp);
  cost c = {.name = name_mlp(&f->mlp, field, true), .item = "sample", .items = n};
  int wanted = 0;
  c.bytes = (3 * macs + n * f->mlp.width[f->mlp.layers]) * (double)real; /* weights; their gradients in and out */
  for (int p = 0; p < f->pieces; p++) {
    if (a->dx[p].span.buffer != NULL) wanted += f->x[p].rows;
    c.bytes += rows_bytes(&f->x[p], f->n, real) + 2 * rows_bytes(&a->dx[p], f->n, real);
  }
  c.flops_written = 2 * n * ern_bench_mlp_bwd_macs(&f->mlp, wanted, false);
  c.flops = 2 * n * ern_bench_mlp_bwd_macs(&f->mlp, wanted, true);
  return c;
}

/* ---- grids ------------------------------------------------------------------------------------------------------- */

static cost cost_grid(const struct ern_grid_fwd_args *a, size_t real) {
  const double n = (double)a->n, rows = (double)a->grid->levels * a->grid->features;
  cost c = {.name = a->grid->hashed ? "plane_fwd" : "torso_grid_fwd", .item = "sample", .items = n};
  c.flops = c.flops_written = n * ern_bench_grid_flops(a->grid);
  c.bytes = n * (a->grid->dims + rows) * (double)real;
  c.reads = n * ern_bench_grid_reads(a->grid);
  return c;
}
/* Each table entry is read and written; the gradient of the coordinates also reads the table's values. */
static cost cost_grid_bwd(const struct ern_grid_bwd_args *a, size_t real) {
  cost c = cost_grid(&a->forward, real);
  const int passes = (a->dtable.buffer != NULL) + (a->dx[0].buffer != NULL);
  c.name = a->forward.grid->hashed ? "plane_bwd" : "torso_grid_bwd";
  c.flops *= passes;
  c.flops_written = c.flops;
  c.bytes *= passes;
  c.reads *= passes;
  return c;
}

/* ---- functions of one value -------------------------------------------------------------------------------------- */

static cost cost_activate(ern_activation kind, size_t values, bool backward, size_t real) {
  static const struct {
    const char *fwd, *bwd;
    int flops, flops_bwd;
  } of[] = {
      [ERN_ACT_DENSITY] = {"density_activation_fwd", "density_activation_bwd", 1, 2},
      [ERN_ACT_COLOUR] = {"colour_activation_fwd", "colour_activation_bwd", 4, 7},
      [ERN_ACT_SIGMOID] = {"sigmoid_fwd", "sigmoid_bwd", 3, 6},
      [ERN_ACT_SOFTPLUS] = {"softplus_fwd", "softplus_bwd", 3, 4},
      [ERN_ACT_RELU] = {"relu_fwd", "relu_bwd", 1, 1},
  };
  const double n = (double)values, flops = n * (backward ? of[kind].flops_bwd : of[kind].flops);
  return (cost){.name = backward ? of[kind].bwd : of[kind].fwd,
                .item = "value",
                .items = n,
                .flops_written = flops,
                .flops = flops,
                .bytes = n * (backward ? 3 : 2) * (double)real};
}

/* ---- audio ------------------------------------------------------------------------------------------------------- */

static double audio_macs(const struct ern_audio_net *net) {
  const int wide[ERN_AUDIO_CONVS + 1] = {net->width, 32, 32, 64, 64};
  const int att[ERN_AUDIO_ATT_CONVS + 1] = {net->code, 16, 8, 4, 2, 1};
  double window = 64 * 64 + 64.0 * net->code, smooth = ERN_AUDIO_WINDOWS * (ERN_AUDIO_WINDOWS + (double)net->code);
  int length = net->window_length;
  for (int k = 0; k < ERN_AUDIO_CONVS; k++) {
    length = (length + 1) / 2;
    window += 3.0 * wide[k] * wide[k + 1] * length;
  }
  for (int k = 0; k < ERN_AUDIO_ATT_CONVS; k++) smooth += 3.0 * att[k] * att[k + 1] * ERN_AUDIO_WINDOWS;
  return ERN_AUDIO_WINDOWS * window + smooth;
}

static cost cost_audio(const struct ern_audio_net *net, bool backward, size_t real) {
  const double macs = audio_macs(net);
  const double in = (double)ERN_AUDIO_WINDOWS * net->window_length * net->width;
  return (cost){.name = backward ? "audio_bwd" : "audio_fwd",
                .item = "frame",
                .items = 1,
                .flops_written = (backward ? 4 : 2) * macs,
                .flops = (backward ? 6 : 2) * macs,
                .bytes = (in + (backward ? 3 : 1) * (double)net->count) * (double)real};
}

/* ---- the others, whose cost stands with their arguments ---------------------------------------------------------- */

static cost cost_by_item(const struct ern_bench_call *call, size_t real) {
  static const char *const names[] = {
#define NAME(name_) [ERN_BENCH_SLOT_##name_] = #name_,
      ERN_SLOTS(NAME)
#undef NAME
  };
  struct ern_cost c = {0};
  switch (call->slot) {
#define COST(name_) \
  case ERN_BENCH_SLOT_##name_: c = ERN_COST_##name_(&call->args.name_); break;
    ERN_SLOTS(COST)
#undef COST
    default: break;
  }
  return (cost){.name = c.item != NULL ? names[call->slot] : NULL,
                .item = c.item,
                .items = c.items,
                .flops_written = c.items * c.flops,
                .flops = c.items * c.flops,
                .bytes = c.items * (c.reals * (double)real + c.ints * INT_BYTES),
                .reads = c.items * c.reads};
}

struct ern_bench_call_cost ern_bench_call_cost(const struct ern_bench_call *call, const struct ern_field *field,
                                               size_t real) {
  const union ern_bench_args *a = &call->args;
  cost c;
  switch (call->slot) {
    case ERN_BENCH_SLOT_mlp_fwd: c = cost_mlp(&a->mlp_fwd, field, real); break;
    case ERN_BENCH_SLOT_mlp_bwd: c = cost_mlp_bwd(&a->mlp_bwd, field, real); break;
    case ERN_BENCH_SLOT_grid_fwd: c = cost_grid(&a->grid_fwd, real); break;
    case ERN_BENCH_SLOT_grid_bwd: c = cost_grid_bwd(&a->grid_bwd, real); break;
    case ERN_BENCH_SLOT_activate_fwd:
      c = cost_activate(a->activate_fwd.kind, a->activate_fwd.n * (size_t)a->activate_fwd.y.rows, false, real);
      break;
    case ERN_BENCH_SLOT_activate_bwd:
      c = cost_activate(a->activate_bwd.kind, a->activate_bwd.n * (size_t)a->activate_bwd.dx.rows, true, real);
      break;
    case ERN_BENCH_SLOT_audio_fwd: return cost_audio(&a->audio_fwd.net, false, real);
    case ERN_BENCH_SLOT_audio_bwd: return cost_audio(&a->audio_bwd.forward.net, true, real);
    default: c = cost_by_item(call, real);
  }
  if (c.items < SMALL) c.name = NULL;
  return c;
}
