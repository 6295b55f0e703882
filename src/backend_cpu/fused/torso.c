/* SPDX-License-Identifier: MIT
 * Prepares a frame for the torso's kernels: tables of rows and columns, packed weights. They are computed for each
 * frame, in the stream's scratch memory. */
#include "backend_cpu/fused/torso.h"

#include "backend_cpu/fused/pack.h"
#include "backend_cpu/slots.h"
#include "core/status.h"
#include "mlp/encoding_ops.h"
#include "model/field.h"
#include "model/torso_ops.h"
#include "render/stages.h"

static const int last_cell = ERN_TORSO_SIDE - 1;

/* ---- a coordinate of the picture --------------------------------------------------------------------------------- */

struct axis {
  float *q, *weight, *encoding, *terms;
  int32_t *cell;
  const float *bias, *matrix; /* first layers: [ERN_TORSO_TERMS], [ERN_TORSO_AXIS_ROWS][ERN_TORSO_TERMS] */
  int count;                  /* pixels of the picture */
  int first, side;            /* the frame's first pixel and side, in pixels */
  size_t padded;
};

struct job_of_axes {
  ern_freq_fwd_kernel *encode;
  ern_torso_terms_kernel *terms;
  struct axis axis[2];
  float shrink;
};

enum { AXIS_CHUNK = 64 };

/* Rounds as the reference does: which pixels are chosen depends on the last bit. */
static void place(const struct axis *axis, size_t i, float shrink) {
  const int side = axis->side, from = (int)i - axis->first;
  const int twice = 2 * (from < 0 ? 0 : from < side ? from : side - 1) - (side - 1);
  const float coordinate = side > 1 ? (float)twice / (float)(side - 1) : 0.0f;
  const float at = (coordinate + 1) / 2 * (float)last_cell;
  const int cell = (int)at < last_cell - 1 ? (int)at : last_cell - 1;
  axis->q[i] = shrink * coordinate;
  axis->cell[i] = cell;
  axis->weight[i] = at - (float)cell;
}

static void axis_task(void *user, size_t task, int worker) {
  (void)worker;
  const struct job_of_axes *job = user;
  const struct axis *axis = &job->axis[task % 2];
  const size_t begin = task / 2 * AXIS_CHUNK;
  if (begin >= axis->padded) return;
  const size_t end = axis->padded - begin < AXIS_CHUNK ? axis->padded : begin + AXIS_CHUNK;
  for (size_t i = begin; i < end; i++) {
    if (i < (size_t)axis->count) {
      place(axis, i, job->shrink);
    } else {
      axis->q[i] = axis->weight[i] = 0;
      axis->cell[i] = 0;
    }
  }
  job->encode(axis->encoding + begin, axis->padded, axis->q + begin, axis->padded, 1, ERN_Q_OCTAVES, end - begin);
  job->terms(axis->terms + begin * ERN_TORSO_TERMS, axis->bias, axis->matrix, axis->encoding + begin, axis->padded,
             end - begin);
}

static ern_status take(struct ern_stream *stream, size_t count, float **out) {
  ern_span span;
  const ern_status status = ern_scratch_take(stream, ERN_ELEMENT_REAL, count, &span);
  *out = reals(span);
  return status;
}

static ern_status axis_take(struct ern_stream *stream, int count, int first, int side, struct axis *axis) {
  ern_span cell;
  ern_status status = ERN_OK;
  axis->count = count;
  axis->first = first;
  axis->side = side;
  axis->padded = ((size_t)count + ERN_TORSO_AXIS_UNIT - 1) / ERN_TORSO_AXIS_UNIT * ERN_TORSO_AXIS_UNIT;
  ERN_TRY(take(stream, axis->padded, &axis->q));
  ERN_TRY(take(stream, axis->padded, &axis->weight));
  ERN_TRY(take(stream, axis->padded * ERN_TORSO_AXIS_ROWS, &axis->encoding));
  ERN_TRY(take(stream, axis->padded * ERN_TORSO_TERMS, &axis->terms));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, axis->padded, &cell));
  axis->cell = int32s(cell);
fail:
  return status;
}

static struct ern_torso_axis axis_of(const struct axis *axis) {
  return (struct ern_torso_axis){axis->q, axis->cell, axis->weight, axis->terms};
}

/* ---- first layers ------------------------------------------------------------------------------------------------ */

/* Combines both first layers into one of ERN_TORSO_TERMS units: their matrices without the grid's columns. */
static void first_layers(const struct ern_render_torso_args *a, const float *w[2], size_t step[2]) {
  const struct ern_field *field = a->field;
  const float *parameters = reals(a->parameters);
  const size_t features = (size_t)(field->torso_grid.levels * field->torso_grid.features);
  w[0] = parameters + field->torso_deform.weight[0];
  w[1] = parameters + field->torso_net.weight[0] + features;
  step[0] = (size_t)field->torso_deform.width[0];
  step[1] = (size_t)field->torso_net.width[0];
}

/* matrix[d][c][j]: the weight of value c of the encoding of coordinate d. Inputs are [q, k, code]; those of q are
 * ordered (value, coordinate). */
static void fill_matrices(float *matrix, const struct ern_render_torso_args *a) {
  const float *w[2];
  size_t step[2];
  first_layers(a, w, step);
  for (size_t d = 0; d < 2; d++) {
    for (size_t c = 0; c < ERN_TORSO_AXIS_ROWS; c++) {
      for (size_t j = 0; j < ERN_TORSO_TERMS; j++) {
        const size_t net = j / ERN_TORSO_HIDDEN;
        matrix[(d * ERN_TORSO_AXIS_ROWS + c) * ERN_TORSO_TERMS + j] =
            w[net][j % ERN_TORSO_HIDDEN * step[net] + 2 * c + d];
      }
    }
  }
}

/* bias_j = the contribution of k and of the code. */
static void fill_bias(struct ern_stream *stream, float bias[ERN_TORSO_TERMS], const struct ern_render_torso_args *a) {
  const struct ern_field *field = a->field;
  const float *parameters = reals(a->parameters);
  const size_t codes = field->config.codes > 0 ? ERN_TORSO_CODE_WIDTH : 0;
  float k[2 * ERN_TORSO_POINTS], value[ERN_K_ROWS + ERN_TORSO_CODE_WIDTH];
  kernels_of(stream)->torso_pose_fwd(k, parameters + field->anchors,
                                     field->config.torso_gamma ? parameters + field->gamma : NULL, a->pose);
  kernels_of(stream)->freq_fwd(value, 1, k, 1, 2 * ERN_TORSO_POINTS, ERN_K_OCTAVES, 1);
  for (size_t i = 0; i < codes; i++)
    value[ERN_K_ROWS + i] = parameters[field->torso_codes + a->individual * ERN_TORSO_CODE_WIDTH + i];
  const float *w[2];
  size_t step[2];
  first_layers(a, w, step);
  for (size_t j = 0; j < ERN_TORSO_TERMS; j++) {
    const size_t net = j / ERN_TORSO_HIDDEN;
    const float *row = w[net] + j % ERN_TORSO_HIDDEN * step[net] + ERN_Q_ROWS;
    double sum = 0;
    for (size_t i = 0; i < ERN_K_ROWS + codes; i++) sum += (double)row[i] * (double)value[i];
    bias[j] = (float)sum;
  }
}

/* ---- a frame ----------------------------------------------------------------------------------------------------- */

/* The last entry from which a window of 4 columns and 4 rows lies inside the table, or before the end of a level that
 * is indexed modulo its size; -1: none. */
static int32_t last_window(const struct ern_grid *grid, const struct ern_grid_level *from,
                           const struct ern_torso_level *level) {
  const int64_t entries = level->mask == UINT32_MAX ? (int64_t)grid->entries - from->offset : (int64_t)from->size;
  const int64_t last = entries - 4 - 3 * (int64_t)level->column_step;
  return last < 0 ? -1 : last < INT32_MAX ? (int32_t)last : INT32_MAX;
}

/* Entries [row + column*(resolution + 1)] while that fits the level, else modulo a power of two. */
static bool fill_levels(struct ern_torso_frame *frame, const struct ern_grid *grid, const float *table) {
  if (grid->dims != 2 || grid->features != 2 || grid->hashed || !(grid->bound == 1)) return false;
  for (int l = 0; l < ERN_TORSO_LEVELS; l++) frame->abreast.last[l] = -1;
  for (int l = 0; l < grid->levels; l++) {
    const struct ern_grid_level *from = &grid->level[l];
    struct ern_torso_level *level = &frame->level[l];
    const uint64_t side = (uint64_t)from->resolution + 1;
    *level = (struct ern_torso_level){.scale = from->scale,
                                      .column_step = side <= from->size ? (uint32_t)side : 0,
                                      .mask = side * side <= from->size ? UINT32_MAX : from->size - 1,
                                      .table = table + (size_t)from->offset * 2};
    if (level->mask != UINT32_MAX && (from->size & (from->size - 1)) != 0) return false;
    frame->abreast.scale[l] = level->scale;
    frame->abreast.column_step[l] = (int32_t)level->column_step;
    frame->abreast.mask[l] = (int32_t)level->mask;
    frame->abreast.last[l] = last_window(grid, from, level);
  }
  return true;
}

static bool has_widths(const struct ern_mlp *mlp, int ins, int outs) {
  return mlp->layers == 3 && mlp->width[0] == ins && mlp->width[1] == ERN_TORSO_HIDDEN &&
         mlp->width[2] == ERN_TORSO_HIDDEN && mlp->width[3] == outs;
}

/* Whether the kernels support a field of this shape. */
static bool fits(const struct ern_field *field) {
  const int encoded = ERN_Q_ROWS + ERN_K_ROWS + (field->config.codes > 0 ? ERN_TORSO_CODE_WIDTH : 0);
  return has_widths(&field->torso_deform, encoded, 2) &&
         has_widths(&field->torso_net, 2 * field->torso_grid.levels + encoded, 4);
}

/* W [rows][columns], its rows `step` apart, packed for gemm_tile.h. */
static ern_status take_packed(struct ern_stream *stream, const float *w, size_t step, size_t rows, size_t columns,
                              const float **packed) {
  float *made = NULL;
  const ern_status status = take(stream, ern_pack_count(rows, columns), &made);
  if (status == ERN_OK) ern_pack_columns(made, columns, 0, w, step, 1, rows, columns);
  *packed = made;
  return status;
}

static ern_status take_weights(struct ern_stream *stream, const struct ern_render_torso_args *a,
                               struct ern_torso_frame *frame) {
  const float *parameters = reals(a->parameters);
  const struct ern_mlp *deform = &a->field->torso_deform, *net = &a->field->torso_net;
  const size_t hidden = ERN_TORSO_HIDDEN, features = 2 * (size_t)frame->levels;
  ern_status status = ERN_OK;
  ERN_TRY(take_packed(stream, parameters + deform->weight[1], hidden, hidden, hidden, &frame->deform1));
  ERN_TRY(take_packed(stream, parameters + deform->weight[2], hidden, 2, hidden, &frame->deform2));
  ERN_TRY(take_packed(stream, parameters + net->weight[0], (size_t)net->width[0], hidden, features, &frame->layer0));
  ERN_TRY(take_packed(stream, parameters + net->weight[1], hidden, hidden, hidden, &frame->layer1));
  ERN_TRY(take_packed(stream, parameters + net->weight[2], hidden, 4, hidden, &frame->layer2));
fail:
  return status;
}

static ern_status take_axes(struct ern_stream *stream, const struct ern_render_torso_args *a,
                            ern_torso_terms_kernel *terms, struct ern_torso_frame *frame) {
  struct job_of_axes job = {.encode = kernels_of(stream)->freq_fwd, .terms = terms, .shrink = a->shrink};
  const struct ern_torso_place frame_at = ern_torso_place_of(a);
  const size_t matrix_count = (size_t)ERN_TORSO_AXIS_ROWS * ERN_TORSO_TERMS;
  float *bias = NULL, *matrix = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(take(stream, 2 * ERN_TORSO_TERMS, &bias));
  ERN_TRY(take(stream, 2 * matrix_count, &matrix));
  ERN_TRY(axis_take(stream, a->height, frame_at.top, frame_at.height, &job.axis[0]));
  ERN_TRY(axis_take(stream, a->width, frame_at.left, frame_at.width, &job.axis[1]));
  memset(bias, 0, ERN_TORSO_TERMS * sizeof *bias); /* the columns' terms include it */
  fill_bias(stream, bias + ERN_TORSO_TERMS, a);
  fill_matrices(matrix, a);
  size_t chunks = 0;
  for (size_t d = 0; d < 2; d++) {
    struct axis *axis = &job.axis[d];
    axis->bias = bias + d * ERN_TORSO_TERMS;
    axis->matrix = matrix + d * matrix_count;
    const size_t count = (axis->padded + AXIS_CHUNK - 1) / AXIS_CHUNK;
    chunks = count > chunks ? count : chunks;
  }
  ern_pool_run(pool_of(stream), 2 * chunks, axis_task, &job);
  frame->row = axis_of(&job.axis[0]);
  frame->column = axis_of(&job.axis[1]);
fail:
  return status;
}

struct job_of_bands {
  const struct ern_torso_frame *frame;
  ern_torso_band_kernel *kernel;
};

static void band_task(void *user, size_t band, int worker) {
  (void)worker;
  const struct job_of_bands *job = user;
  job->kernel(job->frame, band);
}

static ern_status render_torso(struct ern_stream *stream, struct ern_render_torso_args *a) {
  const struct ern_torso_kernels *torso = ((const struct ern_cpu_backend *)stream->backend)->torso;
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct ern_torso_frame frame = {.width = a->width,
                                  .height = a->height,
                                  .levels = a->field->torso_grid.levels,
                                  .motion = a->motion,
                                  .control = (ERN_MOTION_SIDE - 1) / 2.0f / a->shrink,
                                  .occupancy = reals(a->grid),
                                  .threshold = a->threshold,
                                  .pixel = reals(a->pixel.span),
                                  .stride = a->pixel.stride,
                                  .opacity = reals(a->opacity)};
  ern_status status = ERN_OK;
  if (!fits(a->field) || !fill_levels(&frame, &a->field->torso_grid, reals(a->parameters) + a->field->torso_table))
    return ern_render_torso_stages(stream, a);
  ERN_TRY(take_weights(stream, a, &frame));
  ERN_TRY(take_axes(stream, a, torso->terms, &frame));
  struct job_of_bands job = {&frame, torso->band};
  ern_pool_run(pool_of(stream), ((size_t)a->height + ERN_TORSO_BAND - 1) / ERN_TORSO_BAND, band_task, &job);
fail:
  ern_arena_release(stream, mark);
  return status;
}

void ern_cpu_fuse_torso(struct ern_backend *backend) { backend->render_torso = render_torso; }
