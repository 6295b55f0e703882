/* SPDX-License-Identifier: MIT
 * Slots of the fully connected stacks: a program for each shape, all layers in one launch. */
#include <stdarg.h>
#include <stdio.h>

#include "backend_opencl/opencl.h"
#include "core/format.h"
#include "mlp/mlp_ops.h"

enum {
  OPTION_BYTES = 2048,
  PARTS_CPU = 64, /* most parts of the samples, each with its own sums; a part has LEAST_TILES or more */
  PARTS_GPU = 512,
  LEAST_TILES = 8,     /* on a CPU. On a GPU tiles in a row only cost time: first come as many parts as can be */
  SUMS_MOST = 1 << 24, /* floats of all parts' sums: 64 MiB */
  GPU_ITEMS = 128,     /* of a group: enough to hide the latency of local memory */
  TENSOR_ITEMS = 256,  /* likewise, where tensor cores compute */
  TENSOR_GROUPS = 4, /* of those that a unit holds at a time: as many parts, so that no unit waits for the last ones */
  TENSOR_REGISTERS = 64, /* of an item: what four groups have of 65,536 */
  FEW_COLUMNS = 16,      /* of a GPU's tile, however few samples there are */
  SHARE_MOST = 8,        /* items that share a column at most: each has four rows of a block or more */
  CHUNK = 32,            /* of mlp.cl, as BLOCK */
  BLOCK = 32,
  WARP = 32 /* items that use a tensor core together, and columns of their tiles or a multiple of it */
};

/* Sizes of a program: see mlp.cl. */
struct plan {
  int columns, share, vectors, lanes; /* a group has columns*share items */
  bool tensor;                        /* products by tensor cores */
  size_t tile;                        /* samples of a group */
  char options[OPTION_BYTES];
  size_t used;
};

static void say(struct plan *plan, const char *format, ...) {
  va_list values;
  va_start(values, format);
  const size_t left = sizeof plan->options - plan->used;
  const int length = ern_format_list(plan->options + plan->used, left, format, values);
  va_end(values);
  if (length < 0 || (size_t)length >= left)
    plan->used = sizeof plan->options - 1; /* does not happen: the longest options take a third of it */
  else
    plan->used += (size_t)length;
}

/* Floats of a row of a tile. */
static size_t line(const struct plan *plan, bool cpu) {
  return (size_t)(plan->columns * plan->vectors + (cpu ? 0 : plan->tensor ? 4 : 1)) * (size_t)plan->lanes;
}

/* Bytes of the weights that a GPU's group stages: CHUNK x STAGE_ROW. */
static size_t stage_bytes(const struct plan *plan) {
  if (plan->tensor) return 0;
  const size_t share = (size_t)plan->share, rows = (BLOCK / share + 1 + 3) / 4 * 4;
  return CHUNK * share * rows * sizeof(float);
}

/* Local memory of a tile of `channels`, and of a transposed tile (sample by sample) of `transposed` channels. */
static size_t local_bytes(const struct plan *plan, bool cpu, size_t channels, size_t transposed) {
  const size_t tile = (size_t)(plan->columns * plan->vectors * plan->lanes), lanes = (size_t)plan->lanes;
  const size_t transposed_bytes = tile * ((transposed + lanes - 1) / lanes * lanes) * sizeof(float);
  return channels * line(plan, cpu) * sizeof(float) + (cpu ? transposed_bytes : stage_bytes(plan));
}

/* How many items share a column. */
static int share_for(const struct plan *plan, const struct ern_cl_device *device) {
  const int items = plan->tensor ? TENSOR_ITEMS : GPU_ITEMS, columns = plan->columns;
  int share = 1;
  while (2 * share * columns <= items && (size_t)(2 * share * columns) <= device->group_most && share < SHARE_MOST)
    share *= 2;
  return share;
}

/* Whether a GPU's tile does not fit the device, or n samples in such tiles leave units without work. */
static bool is_too_large(const struct plan *plan, const struct ern_cl_device *device, size_t channels, size_t n) {
  return (size_t)(plan->columns * plan->share) > device->group_most ||
         local_bytes(plan, false, channels, 0) > device->local_bytes ||
         (plan->columns > FEW_COLUMNS && n / (size_t)plan->columns < device->units);
}

/* The largest tile that suits a GPU and n samples, of `most` columns or fewer. */
static void plan_columns(struct plan *plan, const struct ern_cl_device *device, int most, bool tensor, size_t channels,
                         size_t n) {
  plan->tensor = tensor;
  plan->columns = most;
  plan->share = share_for(plan, device);
  while (plan->columns > 1 && is_too_large(plan, device, channels, n)) {
    plan->columns /= 2;
    plan->share = share_for(plan, device);
  }
}

/* The largest tile that suits the device and n samples, at most of the tunable's size. */
static void plan_tile(struct plan *plan, const struct ern_cl_backend *backend, ern_cl_tunable tunable, size_t channels,
                      size_t transposed, size_t n) {
  const struct ern_cl_device *device = &backend->device;
  *plan = (struct plan){.columns = 1, .share = 1, .vectors = 1, .lanes = 1};
  if (device->cpu) {
    plan->lanes = device->width;
    plan->vectors = backend->size[tunable];
    while (local_bytes(plan, true, channels, transposed) > device->local_bytes && plan->vectors * plan->lanes > 1) {
      if (plan->vectors > 1)
        plan->vectors--;
      else
        plan->lanes = plan->lanes > 4 ? plan->lanes / 2 : 1;
    }
  } else {
    plan_columns(plan, device, backend->size[tunable], device->tensor, channels, n);
    if (plan->tensor && plan->columns % WARP != 0)
      plan_columns(plan, device, backend->size[tunable], false, channels, n);
  }
  plan->tile = (size_t)(plan->columns * plan->vectors * plan->lanes);
  say(plan, "-D GROUP=%d -D SHARE=%d -D VECTORS=%d -D LANES=%d -D TENSOR=%d", plan->columns * plan->share, plan->share,
      plan->vectors, plan->lanes, plan->tensor);
  if (plan->tensor && device->nvidia) say(plan, " -cl-nv-maxrregcount=%d", TENSOR_REGISTERS);
}

static size_t plan_items(const struct plan *plan) { return (size_t)(plan->columns * plan->share); }

static void say_shape(struct plan *plan, const struct ern_mlp_fwd_args *a) {
  const struct ern_mlp *mlp = &a->mlp;
  say(plan, " -D LAYERS=%d -D HIDDEN=%d", mlp->layers, mlp->layers - 1);
  for (int l = 0; l <= mlp->layers; l++) say(plan, " -D C%d=%d", l, mlp->width[l]);
  for (int l = 0; l < mlp->layers; l++) say(plan, " -D A%d=%zu", l, mlp->weight[l] - mlp->weight[0]);
  for (int p = 0; p < ERN_MAX_PIECES; p++) {
    const bool there = p < a->pieces;
    say(plan, " -D R%d=%d -D P%d=%d", p, there ? a->x[p].rows : 0, p, there ? (int)a->x[p].per : 0);
  }
}

static void give_inputs(struct ern_cl_call *call, const struct ern_mlp_fwd_args *a) {
  for (int p = 0; p < ERN_MAX_PIECES; p++) ern_cl_rows(call, p < a->pieces ? a->x[p] : (ern_rows){.stride = 0});
  ern_cl_span(call, a->ray);
  const size_t skip = a->mlp.weight[0];
  ern_cl_span(call, ern_span_part(a->parameters, skip, a->parameters.count - skip));
}

ern_status ern_cl_mlp_fwd(struct ern_stream *stream, struct ern_mlp_fwd_args *a) {
  if (a->n == 0) return ERN_OK;
  int widest[2] = {0, 0}; /* among the values of even and of odd layers */
  for (int l = 0; l <= a->mlp.layers; l++)
    if (a->mlp.width[l] > widest[l % 2]) widest[l % 2] = a->mlp.width[l];
  struct plan plan;
  plan_tile(&plan, ern_cl_backend_of(stream), ERN_CL_SIZE_mlp_fwd, (size_t)(widest[0] + widest[1]), 0, a->n);
  say_shape(&plan, a);
  say(&plan, " -D EVEN=%d -D ODD=%d", widest[0], widest[1]);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_mlp, "mlp_fwd", plan.options);
  ern_cl_rows(&call, a->y);
  give_inputs(&call, a);
  ern_cl_size(&call, a->n);
  return ern_cl_run(&call, a->n / plan.tile + (a->n % plan.tile != 0), plan_items(&plan));
}

/* Writes the options: offsets of a part's sums, and which gradients are wanted. Returns the number of sums. */
static size_t say_sums(struct plan *plan, const struct ern_mlp_bwd_args *a, bool cpu) {
  const struct ern_mlp *mlp = &a->forward.mlp;
  const size_t lanes = (size_t)plan->lanes;
  size_t at = 0, transposed = 0;
  int values = 0, from = mlp->width[0], end = 0, row = 0;
  for (int l = 0; l <= mlp->layers; values += mlp->width[l++]) say(plan, " -D V%d=%d", l, values);
  for (int l = 0; l < mlp->layers; l++) {
    const size_t vectors = ((size_t)mlp->width[l] + lanes - 1) / lanes;
    say(plan, " -D G%d=%zu -D E%d=%zu", l, at, l, vectors * lanes);
    at += (size_t)mlp->width[l + 1] * vectors * lanes;
    if (vectors > transposed) transposed = vectors;
  }
  for (int p = 0; p < ERN_MAX_PIECES; p++) {
    const int rows = p < a->forward.pieces ? a->forward.x[p].rows : 0;
    const bool wanted = rows > 0 && a->dx[p].span.buffer != NULL && a->forward.x[p].per != ERN_PER_RAY;
    say(plan, " -D D%d=%d -D B%d=%zu", p, wanted, p, at);
    if (wanted && a->forward.x[p].per == ERN_PER_BATCH) at += (size_t)rows * lanes;
    if (wanted && row < from) from = row;
    row += rows;
    if (wanted) end = row;
  }
  at = (at + 63) / 64 * 64;
  say(plan, " -D VALUES=%d -D TURNED=%zu -D DX_FROM=%d -D DX_ROWS=%d -D PART=%zu", values, cpu ? transposed : 0,
      end > 0 ? from : 0, end > 0 ? end - from : 0, at);
  return at;
}

/* Number of values that the parts' sums are reduced to: see mlp_sum. */
static size_t sums_wanted(const struct ern_mlp_bwd_args *a) {
  const struct ern_mlp *mlp = &a->forward.mlp;
  size_t count = 0;
  for (int l = 0; l < mlp->layers; l++) count += (size_t)mlp->width[l] * (size_t)mlp->width[l + 1];
  for (int p = 0; p < a->forward.pieces; p++)
    if (a->forward.x[p].per == ERN_PER_BATCH && a->dx[p].span.buffer != NULL) count += (size_t)a->forward.x[p].rows;
  return count;
}

static void give_gradients(struct ern_cl_call *call, const struct ern_mlp_bwd_args *a) {
  for (int p = 0; p < ERN_MAX_PIECES; p++)
    ern_cl_rows(call, p < a->forward.pieces ? a->dx[p] : (ern_rows){.stride = 0});
}

ern_status ern_cl_mlp_bwd(struct ern_stream *stream, struct ern_mlp_bwd_args *a) {
  const struct ern_mlp *mlp = &a->forward.mlp;
  const struct ern_cl_backend *backend = ern_cl_backend_of(stream);
  const struct ern_cl_device *device = &backend->device;
  const size_t n = a->forward.n, first = mlp->weight[0];
  if (n == 0) return ERN_OK;
  int values = 0, widest = 0;
  for (int l = 0; l <= mlp->layers; values += mlp->width[l++])
    if (l < mlp->layers && mlp->width[l] > widest) widest = mlp->width[l];
  struct plan plan;
  plan_tile(&plan, backend, ERN_CL_SIZE_mlp_bwd, (size_t)(values + (device->cpu ? device->width - 1 : 0)),
            (size_t)widest, n);
  say_shape(&plan, &a->forward);
  const size_t part = say_sums(&plan, a, device->cpu);
  const size_t tiles = n / plan.tile + (n % plan.tile != 0), fitting = SUMS_MOST / part;
  size_t most = device->cpu ? PARTS_CPU : plan.tensor ? TENSOR_GROUPS * device->units : PARTS_GPU;
  if (most > fitting) most = fitting > 0 ? fitting : 1;
  size_t each = (tiles + most - 1) / most;
  if (device->cpu && each < LEAST_TILES) each = LEAST_TILES;
  const size_t parts = (tiles + each - 1) / each;

  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  ern_span sums;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, parts * part, &sums));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_mlp, "mlp_bwd", plan.options);
  give_gradients(&call, a);
  ERN_CL_ARGS(&call, sums, a->dy);
  give_inputs(&call, &a->forward);
  ERN_CL_ARGS(&call, each, n);
  ERN_TRY(ern_cl_run(&call, parts, plan_items(&plan)));
  struct ern_cl_call sum = ern_cl_begin(stream, ERN_CL_mlp, "mlp_sum", plan.options);
  give_gradients(&sum, a);
  ERN_CL_ARGS(&sum, ern_span_part(a->dparameters, first, a->dparameters.count - first), sums, (int)parts);
  ERN_TRY(ern_cl_each(&sum, sums_wanted(a)));
fail:
  ern_arena_release(stream, mark);
  return status;
}
