/* SPDX-License-Identifier: MIT
 * The torso of a picture in one kernel: prepares data once for a model and once for a frame, and launches. */
#include <assert.h>
#include <stdio.h>
#include <string.h>

#include "backend_opencl/render_torso.h"

#include "backend_opencl/device/buffer.h"
#include "backend_opencl/portrait.h"
#include "core/memory.h"
#include "mlp/encoding_ops.h"
#include "model/field.h"
#include "model/torso_ops.h"
#include "render/render_ops.h"

enum {
  HIDDEN = 32, /* as in render_torso.cl */
  TERMS = 2 * HIDDEN,
  PATCH = 32,
  OPTIONS_BYTES = 512
};

typedef enum matrix_name { DEFORM1, DEFORM2, LAYER0, LAYER1, LAYER2, PARTS } matrix_name;

struct torso_frame { /* as in render_torso.cl */
  int32_t width, height;
  float threshold, shrink;
  uint32_t across, patches;
};
static_assert(sizeof(struct torso_frame) == 24, "as in render_torso.cl");

struct torso_level { /* as in render_torso.cl */
  float scale;
  uint32_t step, mask, at;
};
static_assert(sizeof(struct torso_level) == 16, "as in render_torso.cl");

struct first_layers { /* as in render_torso.cl */
  uint64_t at[2], step[2];
};
static_assert(sizeof(struct first_layers) == 32, "as in render_torso.cl");

struct ern_cl_torso {
  struct ern_cl_form form;
  size_t features;  /* of the grid */
  size_t at[PARTS]; /* in net */
  size_t net_count;
  struct ern_buffer *net, *levels, *counter; /* reals, bytes, one int32 */
  char options[OPTIONS_BYTES];
};

void ern_cl_torso_free(struct ern_cl_stream *stream, struct ern_cl_torso *p) {
  struct ern_backend *table = &stream->owner->table;
  if (p == NULL) return;
  table->buffer_free(table, p->net);
  table->buffer_free(table, p->levels);
  table->buffer_free(table, p->counter);
  ern_release(table->context, p);
}

/* ---- the shape of a model ---------------------------------------------------------------------------------------- */

static size_t encoded_rows(const struct ern_field *field) {
  return ERN_Q_ROWS + ERN_K_ROWS + (field->config.codes > 0 ? ERN_TORSO_CODE_WIDTH : 0);
}

static bool has_widths(const struct ern_mlp *mlp, size_t ins, int outs) {
  return mlp->layers == 3 && mlp->width[0] == (int)ins && mlp->width[1] == HIDDEN && mlp->width[2] == HIDDEN &&
         mlp->width[3] == outs;
}

/* Entries (row, column) at (row + column*(resolution + 1)) while that fits the level, else modulo a power of two. False
 * where a level has another form. */
static bool fill_levels(struct torso_level *level, const struct ern_grid *grid) {
  if (grid->dims != 2 || grid->features != 2 || grid->hashed || !(grid->bound == 1)) return false;
  for (int l = 0; l < grid->levels; l++) {
    const struct ern_grid_level *of = &grid->level[l];
    const uint64_t side = (uint64_t)of->resolution + 1;
    level[l] = (struct torso_level){.scale = of->scale,
                                    .step = side <= of->size ? (uint32_t)side : 0,
                                    .mask = side * side <= of->size ? UINT32_MAX : of->size - 1,
                                    .at = of->offset * 2};
    if (level[l].mask != UINT32_MAX && (of->size & (of->size - 1)) != 0) return false;
  }
  return true;
}

/* Whether the kernel can be built for a model of this shape. */
static bool fits(const struct ern_field *field, struct torso_level *level) {
  const size_t encoded = encoded_rows(field);
  return field->config.torso && has_widths(&field->torso_deform, encoded, 2) &&
         has_widths(&field->torso_net, 2 * (size_t)field->torso_grid.levels + encoded, 4) &&
         fill_levels(level, &field->torso_grid);
}

struct matrix {
  size_t outputs, inputs;
};

static struct matrix shape_of(const struct ern_cl_torso *p, matrix_name name) {
  const struct matrix shape[PARTS] = {[DEFORM1] = {HIDDEN, HIDDEN},
                                      [DEFORM2] = {2, HIDDEN},
                                      [LAYER0] = {HIDDEN, p->features},
                                      [LAYER1] = {HIDDEN, HIDDEN},
                                      [LAYER2] = {4, HIDDEN}};
  return shape[name];
}

/* A tile holds the inputs of a layer; its outputs, unless they may overwrite the inputs (all of them are one block);
 * and the initial values of the network's first layer. */
static ern_status write_options(const struct ern_cl_backend *backend, struct ern_cl_torso *p) {
  ern_context *context = backend->table.context;
  const int outputs = ern_cl_outputs(&backend->device, HIDDEN);
  const size_t inputs = p->features > HIDDEN ? p->features : HIDDEN;
  const size_t second = outputs < HIDDEN ? inputs : 0, begin = second > 0 ? second + HIDDEN : inputs;
  p->form = ern_cl_form_for(backend, ERN_CL_SIZE_torso_tile, outputs, begin + HIDDEN);
  const int length =
      snprintf(p->options, sizeof p->options,
               "-D GROUP=%d -D VECTORS=%d -D OUTPUTS=%d -D LEVELS=%zu -D AT_DEFORM1=%zu -D AT_DEFORM2=%zu "
               "-D AT_LAYER0=%zu -D AT_LAYER1=%zu -D AT_LAYER2=%zu -D ROW_SECOND=%zu -D ROW_BEGIN=%zu -D TILE_ROWS=%zu",
               p->form.group, p->form.vectors, p->form.outputs, p->features / 2, p->at[DEFORM1], p->at[DEFORM2],
               p->at[LAYER0], p->at[LAYER1], p->at[LAYER2], second, begin, begin + HIDDEN);
  if (length < 0 || (size_t)length >= sizeof p->options)
    return ern_fail(context, ERN_E_ARGUMENT, "OpenCL: the options of render_torso are too long");
  return ERN_OK;
}

/* ---- laying out -------------------------------------------------------------------------------------------------- */

/* The first columns of W [outputs][step]. */
static ern_status pack(struct ern_stream *stream, const struct ern_cl_torso *p, matrix_name name, ern_span w,
                       size_t step) {
  const struct matrix shape = shape_of(p, name);
  const struct ern_cl_place place = {ern_cl_from(ern_cl_whole(p->net), p->at[name]), shape.inputs, 0, p->form.outputs};
  return ern_cl_pack(stream, &place, w, step, shape.outputs, shape.inputs);
}

static ern_status pack_model(struct ern_stream *stream, const struct ern_cl_torso *p, const struct ern_field *field,
                             ern_span parameters) {
  const struct ern_mlp *deform = &field->torso_deform, *net = &field->torso_net;
  ern_status status = ERN_OK;
  ERN_TRY(pack(stream, p, DEFORM1, ern_cl_from(parameters, deform->weight[1]), HIDDEN));
  ERN_TRY(pack(stream, p, DEFORM2, ern_cl_from(parameters, deform->weight[2]), HIDDEN));
  ERN_TRY(pack(stream, p, LAYER0, ern_cl_from(parameters, net->weight[0]), (size_t)net->width[0]));
  ERN_TRY(pack(stream, p, LAYER1, ern_cl_from(parameters, net->weight[1]), HIDDEN));
  ERN_TRY(pack(stream, p, LAYER2, ern_cl_from(parameters, net->weight[2]), HIDDEN));
fail:
  return status;
}

ern_status ern_cl_torso_make(struct ern_stream *stream, const struct ern_render_prepare_args *a,
                             struct ern_cl_torso **torso) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  struct ern_backend *table = &own->owner->table;
  struct torso_level level[ERN_GRID_MAX_LEVELS];
  ern_status status = ERN_OK;
  *torso = NULL;
  if (!fits(a->field, level)) return ERN_OK;
  const size_t levels = (size_t)a->field->torso_grid.levels;
  ERN_TRY(ERN_NEW(table->context, 1, torso));
  struct ern_cl_torso *p = *torso;
  p->features = 2 * levels;
  for (int i = 0; i < PARTS; i++) {
    const struct matrix shape = shape_of(p, (matrix_name)i);
    p->at[i] = p->net_count;
    p->net_count += (shape.outputs * shape.inputs + ERN_CL_ALIGN - 1) / ERN_CL_ALIGN * ERN_CL_ALIGN;
  }
  ERN_TRY(write_options(own->owner, p));
  ERN_TRY(table->buffer_make(table, ERN_ELEMENT_REAL, p->net_count, &p->net));
  ERN_TRY(table->buffer_make(table, ERN_ELEMENT_BYTE, levels * sizeof *level, &p->levels));
  ERN_TRY(table->buffer_make(table, ERN_ELEMENT_INT32, 1, &p->counter));
  ERN_TRY(table->upload_bytes(stream, ern_cl_whole(p->levels), (const uint8_t *)level, levels * sizeof *level));
  ERN_TRY(pack_model(stream, p, a->field, a->parameters));
  return ERN_OK;
fail:
  ern_cl_torso_free(own, *torso);
  *torso = NULL;
  return status;
}

/* ---- a frame ----------------------------------------------------------------------------------------------------- */

/* Contributions of the picture's rows and columns to the first layers. */
struct terms {
  ern_span rows, columns; /* [height][TERMS], [TERMS][padded] */
  size_t padded;
};

static struct first_layers first_layers(const struct ern_field *field, size_t features) {
  return (struct first_layers){{field->torso_deform.weight[0], field->torso_net.weight[0] + features},
                               {(uint64_t)field->torso_deform.width[0], (uint64_t)field->torso_net.width[0]}};
}

/* bias [TERMS]: the contribution of the pose and of the individual code. */
static ern_status find_bias(struct ern_stream *stream, const struct ern_cl_torso *p,
                            const struct ern_render_torso_args *a, ern_span bias) {
  struct ern_backend *table = &ern_cl_backend_of(stream)->table;
  const struct ern_field *field = a->field;
  const struct first_layers first = first_layers(field, p->features);
  const bool codes = field->config.codes > 0;
  ern_rows k, encoded;
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take_rows(stream, 2 * ERN_TORSO_POINTS, 1, &k));
  ERN_TRY(ern_scratch_take_rows(stream, ERN_K_ROWS, 1, &encoded));
  k.stride = encoded.stride = 1;
  struct ern_torso_pose_fwd_args pose = {.k = k.span, .anchors = ern_span_part(a->parameters, field->anchors, 12)};
  if (field->config.torso_gamma) pose.gamma = ern_span_part(a->parameters, field->gamma, 1);
  memcpy(pose.pose, a->pose, sizeof pose.pose);
  ERN_TRY(table->torso_pose_fwd(stream, &pose));
  struct ern_freq_fwd_args encode = {.y = encoded, .x = k, .octaves = ERN_K_OCTAVES, .n = 1};
  ERN_TRY(table->freq_fwd(stream, &encode));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_render_torso, "torso_bias", p->options);
  ERN_CL_ARGS(
      &call, bias, a->parameters, encoded.span,
      codes ? ern_cl_from(a->parameters, field->torso_codes + a->individual * ERN_TORSO_CODE_WIDTH) : (ern_span){0},
      ERN_K_ROWS, codes ? ERN_TORSO_CODE_WIDTH : 0);
  ern_cl_value(&call, &first, sizeof first);
  status = ern_cl_each(&call, TERMS);
fail:
  return status;
}

static ern_status find_terms(struct ern_stream *stream, const struct ern_cl_torso *p,
                             const struct ern_render_torso_args *a, const struct torso_frame *frame,
                             struct terms *terms) {
  const struct first_layers first = first_layers(a->field, p->features);
  const size_t unit = (size_t)ern_cl_backend_of(stream)->device.width;
  ern_span bias;
  ern_status status = ERN_OK;
  terms->padded = ((size_t)a->width + unit - 1) / unit * unit;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, TERMS, &bias));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, (size_t)a->height * TERMS, &terms->rows));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, terms->padded * TERMS, &terms->columns));
  ERN_TRY(find_bias(stream, p, a, bias));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_render_torso, "torso_terms", p->options);
  ERN_CL_ARGS(&call, terms->rows, terms->columns, bias, a->parameters);
  ern_cl_value(&call, frame, sizeof *frame);
  ern_cl_int(&call, (int)terms->padded);
  ern_cl_value(&call, &first, sizeof first);
  status = ern_cl_each(&call, (size_t)a->height + terms->padded);
fail:
  return status;
}

static struct torso_frame frame_of(const struct ern_cl_device *device, const struct ern_render_torso_args *a) {
  const uint32_t wide = (uint32_t)device->width, high = device->width > 1 ? PATCH : 1;
  const uint32_t across = ((uint32_t)a->width + wide - 1) / wide, down = ((uint32_t)a->height + high - 1) / high;
  return (struct torso_frame){a->width, a->height, a->threshold, a->shrink, across, across * down};
}

ern_status ern_cl_torso_render(struct ern_stream *stream, struct ern_cl_torso *p,
                               const struct ern_render_torso_args *a) {
  const struct ern_cl_device *device = &ern_cl_backend_of(stream)->device;
  struct ern_backend *table = &ern_cl_backend_of(stream)->table;
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const struct torso_frame frame = frame_of(device, a);
  struct terms terms;
  ern_span motion;
  ern_status status = ERN_OK;
  ERN_TRY(find_terms(stream, p, a, &frame, &terms));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_MOTION_VALUES, &motion));
  ERN_TRY(table->upload_reals(stream, motion, a->motion, ERN_MOTION_VALUES));
  if (a->opacity.buffer != NULL)
    ERN_TRY(table->zero(stream, ern_span_part(a->opacity, 0, (size_t)a->width * (size_t)a->height)));
  ERN_TRY(table->zero(stream, ern_cl_whole(p->counter)));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_render_torso, "render_torso", p->options);
  ERN_CL_ARGS(&call, a->pixel, a->opacity, a->grid, terms.rows, terms.columns, (int)terms.padded, ern_cl_whole(p->net),
              ern_cl_whole(p->levels), ern_cl_from(a->parameters, a->field->torso_table), motion,
              ern_cl_whole(p->counter));
  ern_cl_value(&call, &frame, sizeof frame);
  status = ern_cl_run(&call, ern_cl_groups(ern_cl_backend_of(stream), ERN_CL_SIZE_torso_groups), (size_t)p->form.group);
fail:
  ern_arena_release(stream, mark);
  return status;
}
