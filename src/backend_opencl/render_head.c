/* SPDX-License-Identifier: MIT
 * The head of a picture in one kernel: prepares data once for a model and once for a frame, and launches. The network
 * has the form of the CPU's (frame_net.h): the audio code scales a matrix over the hidden attention, the last density
 * layer and the first colour layer are merged into one matrix, and grids are unhashed. */
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "backend_opencl/render_head.h"

#include "backend_opencl/device/buffer.h"
#include "backend_opencl/portrait.h"
#include "core/memory.h"
#include "model/field.h"
#include "render/march_ops.h"
#include "render/render_ops.h"
#include "render/tile_culling_ops.h"

enum {
  WIDEST = 64, /* outputs of a layer at most */
  UNIT = 8,    /* outputs are a multiple of it */
  WARP = 32,   /* items that compute a layer by tensor cores together */
  OPTIONS_BYTES = 1024
};

typedef enum matrix_name {
  ATTENTION1,
  EYE1,
  EYE2,
  VALUE,
  DENSITY1,
  DENSITY2,
  LOG_SIGMA,
  COLOUR1,
  COLOUR2,
  START,
  PARTS
} matrix_name;

struct level { /* as in render.cl */
  float scale;
  uint32_t row, at, unused;
};
static_assert(sizeof(struct level) == 16, "as in render.cl");

struct frame { /* as in render.cl */
  float pose[12], focal, cx, cy, bound, inverse_bound, dt_gamma, near, shortest, longest, stop, eye_value, fade[2];
  int32_t width, height, max_steps, picture;
  uint32_t across, rays, tickets;
};
static_assert(sizeof(struct frame) == 128, "as in render.cl");

struct ern_cl_head {
  struct ern_cl_form form;
  size_t features, attention, eye_hidden, density, colour, values; /* widths */
  size_t harmonics; /* of the direction, in the colour's input: 16 or 0 */
  bool eye;
  size_t at[PARTS]; /* in net */
  size_t net_count;
  struct ern_buffer *net, *dense, *levels, *counter; /* reals, reals, bytes, two int32 */
  uint8_t *bits;                                     /* host: [ERN_OCCUPANCY_BYTES], of the last frame */
  size_t bits_written, bits_at;                      /* version of the buffer then; 0: none yet */
  float *nearest;                                    /* host: one distance per block of pixels */
  size_t nearest_capacity;
  char options[OPTIONS_BYTES];
};

void ern_cl_head_free(struct ern_cl_stream *stream, struct ern_cl_head *p) {
  struct ern_backend *table = &stream->owner->table;
  if (p == NULL) return;
  table->buffer_free(table, p->net);
  table->buffer_free(table, p->dense);
  table->buffer_free(table, p->levels);
  table->buffer_free(table, p->counter);
  ern_release(table->context, p->bits);
  ern_release(table->context, p->nearest);
  ern_release(table->context, p);
}

/* ---- the shape of a model ---------------------------------------------------------------------------------------- */

static bool has_layers(const struct ern_mlp *mlp, int layers) {
  if (mlp->layers != layers) return false;
  for (int l = 1; l < layers; l++)
    if (mlp->width[l] > WIDEST || mlp->width[l] % UNIT != 0) return false;
  return true;
}

/* Whether the kernel can be built for a model of this shape. */
static bool fits(const struct ern_field *field) {
  return ern_field_is_standard(field) && has_layers(&field->attention, 2) && has_layers(&field->density, 3) &&
         has_layers(&field->colour, 2) && field->attention.width[2] % UNIT == 0 &&
         field->attention.width[2] <= WIDEST && (!field->config.eye || has_layers(&field->eye, 2));
}

struct matrix {
  size_t outputs, inputs;
  bool wide; /* a WIDE_LAYER of the kernel */
};

static void shapes_of(const struct ern_cl_head *p, struct matrix shape[PARTS]) {
  const size_t eye = p->eye;
  const struct matrix all[PARTS] = {
      [ATTENTION1] = {p->attention, p->features, true},
      [EYE1] = {p->eye_hidden, p->features, true},
      [EYE2] = {eye, p->eye_hidden, false},
      [VALUE] = {p->values, p->attention, false},
      [DENSITY1] = {p->density, p->features + p->attention + eye, true},
      [DENSITY2] = {p->density, p->density, true},
      [LOG_SIGMA] = {1, p->density, false},
      [COLOUR1] = {p->colour, p->density + p->harmonics, true},
      [COLOUR2] = {3, p->colour, false},
      [START] = {p->colour, 1, false},
  };
  memcpy(shape, all, sizeof all);
}

/* Columns of a matrix as it is packed. */
static size_t packed_width(const struct ern_cl_head *p, const struct matrix *of) {
  return of->wide && p->form.tensor ? (of->inputs + 7) / 8 * 8 : of->inputs;
}

static void measure(struct ern_cl_head *p, const struct ern_field *field) {
  p->eye = field->config.eye;
  p->features = (size_t)field->feature_rows;
  p->attention = (size_t)field->attention.width[1];
  p->values = (size_t)field->attention.width[2];
  p->eye_hidden = p->eye ? (size_t)field->eye.width[1] : 0;
  p->density = (size_t)field->density.width[1];
  p->harmonics = (size_t)ern_field_view_rows(field);
  p->colour = (size_t)field->colour.width[1];
}

static void place_parts(struct ern_cl_head *p) {
  struct matrix shape[PARTS];
  shapes_of(p, shape);
  for (int i = 0; i < PARTS; i++) {
    const size_t values = shape[i].outputs * packed_width(p, &shape[i]) * (shape[i].wide && p->form.tensor ? 2 : 1);
    p->at[i] = p->net_count;
    p->net_count += (values + ERN_CL_ALIGN - 1) / ERN_CL_ALIGN * ERN_CL_ALIGN;
  }
}

/* Rows of a lane's column. Where all outputs of a layer are one block, they overwrite its inputs; else layers alternate
 * between two areas after them. */
struct column {
  size_t first, second, rows;
};

static struct column column_of(const struct ern_cl_head *p) {
  const size_t inputs = p->features + p->attention + p->eye, wide = p->density > p->colour ? p->density : p->colour;
  const size_t second = p->density + p->harmonics;
  struct column column = {0, 0, inputs};
  if (p->form.outputs < WIDEST) column = (struct column){inputs, inputs + wide, inputs + wide};
  const size_t end = column.second + (second > wide ? second : wide), eye = p->features + p->eye_hidden;
  if (column.rows < end) column.rows = end;
  if (column.rows < eye) column.rows = eye;
  return column;
}

/* The form for a device. Tensor cores take whole fragments of a layer; in local memory a row has eight more values, and
 * the kernel a flag. */
static void choose_form(const struct ern_cl_backend *backend, struct ern_cl_head *p) {
  const struct ern_cl_device *device = &backend->device;
  p->form.outputs = ern_cl_outputs(device, WIDEST);
  const size_t rows = column_of(p).rows;
  p->form = ern_cl_form_for(backend, ERN_CL_SIZE_rays_tile, p->form.outputs, rows);
  const size_t group = (size_t)p->form.group / WARP * WARP;
  const bool whole = (p->attention | p->eye_hidden | p->density | p->colour) % 16 == 0;
  if (!device->tensor || !whole || group == 0 ||
      (group + 8) * rows * sizeof(float) + sizeof(cl_int) > device->local_bytes)
    return;
  p->form.group = (int)group;
  p->form.tensor = true;
}

static ern_status write_options(ern_context *context, struct ern_cl_head *p, const struct ern_field *field) {
  const struct column column = column_of(p);
  const int length = snprintf(
      p->options, sizeof p->options,
      "-D GROUP=%d -D VECTORS=%d -D OUTPUTS=%d -D LEVELS=%d -D FEATURES=%zu -D ATTENTION=%zu -D VALUES=%zu -D EYE=%d "
      "-D EYE_HIDDEN=%zu -D DENSITY=%zu -D COLOUR=%zu -D SH=%zu -D AT_ATTENTION1=%zu -D AT_EYE1=%zu -D AT_EYE2=%zu "
      "-D AT_VALUE=%zu -D AT_DENSITY1=%zu -D AT_DENSITY2=%zu -D AT_SIGMA=%zu -D AT_COLOUR1=%zu -D AT_COLOUR2=%zu "
      "-D AT_START=%zu -D ROW_FIRST=%zu -D ROW_SECOND=%zu -D TILE_ROWS=%zu -D A0=%d -D B0=%d "
      "-D A1=%d -D B1=%d -D A2=%d -D B2=%d -D TENSOR=%d",
      p->form.group, p->form.vectors, p->form.outputs, field->config.levels, p->features, p->attention, p->values,
      p->eye, p->eye_hidden, p->density, p->colour, p->harmonics, p->at[ATTENTION1], p->at[EYE1], p->at[EYE2],
      p->at[VALUE], p->at[DENSITY1], p->at[DENSITY2], p->at[LOG_SIGMA], p->at[COLOUR1], p->at[COLOUR2], p->at[START],
      column.first, column.second, column.rows, field->encoder.axis[0][0], field->encoder.axis[0][1],
      field->encoder.axis[1][0], field->encoder.axis[1][1], field->encoder.axis[2][0], field->encoder.axis[2][1],
      p->form.tensor);
  if (length < 0 || (size_t)length >= sizeof p->options)
    return ern_fail(context, ERN_E_ARGUMENT, "OpenCL: the options of render are too long");
  return ERN_OK;
}

/* ---- laying out -------------------------------------------------------------------------------------------------- */

static ern_status make_dense(struct ern_stream *stream, struct ern_cl_head *p, const struct ern_field *field,
                             ern_span parameters) {
  struct ern_backend *table = &ern_cl_backend_of(stream)->table;
  struct level level[ERN_PLANES * ERN_GRID_MAX_LEVELS];
  size_t count = 0, levels = 0;
  ern_status status = ERN_OK;
  for (int plane = 0; plane < ERN_PLANES; plane++) {
    for (int l = 0; l < field->config.levels; l++) {
      const struct ern_grid_level *of = &field->encoder.grid[plane].level[l];
      const size_t side = (size_t)of->resolution + 1;
      level[levels++] = (struct level){of->scale, (uint32_t)side, (uint32_t)count, 0};
      count += side * side;
    }
  }
  ERN_TRY(table->buffer_make(table, ERN_ELEMENT_REAL, count, &p->dense));
  ERN_TRY(table->buffer_make(table, ERN_ELEMENT_BYTE, levels * sizeof *level, &p->levels));
  ERN_TRY(table->upload_bytes(stream, ern_cl_whole(p->levels), (const uint8_t *)level, levels * sizeof *level));
  for (size_t i = 0; i < levels; i++) {
    const size_t plane = i / (size_t)field->config.levels;
    const struct ern_grid *grid = &field->encoder.grid[plane];
    const struct ern_grid_level *of = &grid->level[i % (size_t)field->config.levels];
    const size_t n = (size_t)level[i].row * level[i].row;
    struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_portrait, "unhash", "");
    ERN_CL_ARGS(&call, ern_span_part(ern_cl_whole(p->dense), level[i].at, n),
                ern_cl_from(parameters, field->encoder.table[plane] + of->offset), (int)level[i].row, (int)of->size,
                grid->hashed && n > of->size, n);
    ERN_TRY(ern_cl_each(&call, n));
  }
fail:
  return status;
}

static struct ern_cl_place place_of(const struct ern_cl_head *p, matrix_name name, size_t column) {
  struct matrix shape[PARTS];
  shapes_of(p, shape);
  return (struct ern_cl_place){ern_cl_from(ern_cl_whole(p->net), p->at[name]), packed_width(p, &shape[name]), column,
                               shape[name].wide && p->form.tensor ? 0 : p->form.outputs};
}

static ern_span weights(const struct ern_mlp *mlp, int l, ern_span parameters) {
  return ern_cl_from(parameters, mlp->weight[l]);
}

/* The colour's first layer reads [SH, geometry, code]; the density's last one gives [log sigma, geometry]. In the net
 * the colour's first layer takes [hidden density, SH]. */
static ern_status pack_model(struct ern_stream *stream, struct ern_cl_head *p, const struct ern_field *field,
                             ern_span parameters) {
  const size_t wide = (size_t)field->density.width[0], inputs = (size_t)field->colour.width[0];
  const ern_span density = weights(&field->density, 0, parameters), last = weights(&field->density, 2, parameters);
  const ern_span colour = weights(&field->colour, 0, parameters), none = {0};
  ern_status status = ERN_OK;
#define PACK(name, column, a, step, rows, columns)                \
  do {                                                            \
    const struct ern_cl_place place = place_of(p, name, column);  \
    ERN_TRY(ern_cl_pack(stream, &place, a, step, rows, columns)); \
  } while (0)
  PACK(ATTENTION1, 0, weights(&field->attention, 0, parameters), p->features, p->attention, p->features);
  PACK(VALUE, 0, weights(&field->attention, 1, parameters), p->attention, p->values, p->attention);
  if (p->eye) {
    PACK(EYE1, 0, weights(&field->eye, 0, parameters), p->features, p->eye_hidden, p->features);
    PACK(EYE2, 0, weights(&field->eye, 1, parameters), p->eye_hidden, 1, p->eye_hidden);
    PACK(DENSITY1, p->features + p->attention, ern_cl_from(density, p->features + p->values), wide, p->density, 1);
  }
  PACK(DENSITY1, 0, density, wide, p->density, p->features);
  PACK(DENSITY2, 0, weights(&field->density, 1, parameters), p->density, p->density, p->density);
  PACK(LOG_SIGMA, 0, last, p->density, 1, p->density);
  if (p->harmonics > 0) PACK(COLOUR1, p->density, colour, inputs, p->colour, p->harmonics);
  PACK(COLOUR2, 0, weights(&field->colour, 1, parameters), p->colour, 3, p->colour);
#undef PACK
  const struct ern_cl_place geometry = place_of(p, COLOUR1, 0);
  status = ern_cl_multiply(stream, &geometry, ern_cl_from(colour, p->harmonics), inputs, none,
                           ern_cl_from(last, p->density), p->colour, ERN_GEOMETRY, p->density);
fail:
  return status;
}

/* Computes the parts of the network that depend on the frame's audio code and individual code. */
static ern_status fold(struct ern_stream *stream, const struct ern_cl_head *p, const struct ern_render_rays_args *a) {
  const struct ern_field *field = a->field;
  const size_t wide = (size_t)field->density.width[0], inputs = (size_t)field->colour.width[0];
  const struct ern_cl_place audio = place_of(p, DENSITY1, p->features), own = place_of(p, START, 0);
  const ern_status status =
      ern_cl_multiply(stream, &audio, ern_cl_from(weights(&field->density, 0, a->parameters), p->features), wide,
                      a->code, weights(&field->attention, 1, a->parameters), p->density, p->values, p->attention);
  if (status != ERN_OK || field->config.codes == 0) return status; /* without codes the bias stays zero */
  return ern_cl_multiply(stream, &own,
                         ern_cl_from(weights(&field->colour, 0, a->parameters), p->harmonics + ERN_GEOMETRY), inputs,
                         (ern_span){0}, ern_cl_from(a->parameters, field->codes + a->individual * ERN_CODE_WIDTH),
                         p->colour, ERN_CODE_WIDTH, 1);
}

ern_status ern_cl_head_make(struct ern_stream *stream, const struct ern_render_prepare_args *a,
                            struct ern_cl_head **head) {
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  struct ern_backend *table = &own->owner->table;
  ern_status status = ERN_OK;
  *head = NULL;
  if (!fits(a->field)) return ERN_OK;
  ERN_TRY(ERN_NEW(table->context, 1, head));
  struct ern_cl_head *p = *head;
  ERN_TRY(ERN_NEW(table->context, ERN_OCCUPANCY_BYTES, &p->bits));
  measure(p, a->field);
  choose_form(own->owner, p);
  place_parts(p);
  ERN_TRY(write_options(table->context, p, a->field));
  ERN_TRY(table->buffer_make(table, ERN_ELEMENT_REAL, p->net_count, &p->net));
  ERN_TRY(table->buffer_make(table, ERN_ELEMENT_INT32, 2, &p->counter));
  ERN_TRY(make_dense(stream, p, a->field, a->parameters));
  ERN_TRY(pack_model(stream, p, a->field, a->parameters));
  return ERN_OK;
fail:
  ern_cl_head_free(own, *head);
  *head = NULL;
  return status;
}

/* ---- a frame ----------------------------------------------------------------------------------------------------- */

static const double two_root_three = 3.46410161513775459; /* the diagonal of [-1, 1]^3 */

/* Step sizes as in the march (march_ref.c). */
static struct frame frame_of(const struct ern_render_rays_args *a) {
  const struct ern_march_settings *s = &a->settings;
  struct frame f = {.focal = a->view.focal,
                    .cx = a->view.cx,
                    .cy = a->view.cy,
                    .bound = s->bound,
                    .inverse_bound = 1 / s->bound,
                    .dt_gamma = s->dt_gamma,
                    .near = s->near,
                    .shortest = (float)(two_root_three / s->max_steps),
                    .longest = (float)(two_root_three / ERN_OCCUPANCY_SIDE),
                    .stop = a->transmittance_stop,
                    .eye_value = a->eye_value,
                    .width = a->view.width,
                    .height = a->view.height,
                    .max_steps = s->max_steps,
                    .across = (uint32_t)ern_tile_count(a->view.width),
                    .rays = (uint32_t)a->n,
                    .tickets = (uint32_t)a->n};
  if (f.shortest > f.longest) f.shortest = f.longest;
  memcpy(f.pose, a->view.pose, sizeof f.pose);
  memcpy(f.fade, a->field->config.voice_fade, sizeof f.fade);
  f.picture = a->n == (size_t)f.width * (size_t)f.height;
  if (f.picture) f.tickets = f.across * (uint32_t)ern_tile_count(a->view.height) * ERN_TILE_SIDE * ERN_TILE_SIDE;
  return f;
}

/* For each block of the picture the distance before which no ray has a sample. */
static ern_status find_nearest(struct ern_stream *stream, struct ern_cl_head *p, const struct ern_render_rays_args *a,
                               ern_span *nearest) {
  struct ern_backend *table = &ern_cl_backend_of(stream)->table;
  const size_t blocks = ern_tile_count(a->view.width) * ern_tile_count(a->view.height);
  ern_status status = ERN_OK;
  if (p->nearest_capacity < blocks) {
    ern_release(table->context, p->nearest);
    p->nearest_capacity = 0;
    ERN_TRY(ERN_NEW(table->context, blocks, &p->nearest));
    p->nearest_capacity = blocks;
  }
  const size_t written = atomic_load(&a->bits.buffer->written);
  if (p->bits_written != written || p->bits_at != a->bits.at) {
    p->bits_written = 0;
    ERN_TRY(table->download_bytes(stream, p->bits, a->bits, ERN_OCCUPANCY_BYTES));
    p->bits_written = written, p->bits_at = a->bits.at;
  }
  ern_tile_culling(p->nearest, p->bits, &a->view, a->settings.bound);
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, blocks, nearest));
  ERN_TRY(table->upload_reals(stream, *nearest, p->nearest, blocks));
fail:
  return status;
}

/* Where rays are taken from: on a CPU all of them, with `nearest`; on a GPU those that find_rays lists. */
struct rays {
  ern_span nearest, listed_ray, listed_t;
};

static void give_rays(struct ern_cl_call *call, const struct ern_cl_head *p, const struct ern_render_rays_args *a,
                      const struct rays *rays) {
  ERN_CL_ARGS(call, a->pixel, a->colour, a->opacity, a->depth, a->attention, p->eye ? a->eye : (ern_span){0},
              a->background, a->pixel_number, a->bits, rays->nearest, ern_cl_whole(p->counter), rays->listed_ray,
              rays->listed_t);
}

static ern_status list_rays(struct ern_stream *stream, struct ern_cl_head *p, const struct ern_render_rays_args *a,
                            const struct frame *frame, struct rays *rays) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_INT32, a->n, &rays->listed_ray));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, a->n, &rays->listed_t));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_render, "find_rays", p->options);
  give_rays(&call, p, a, rays);
  ern_cl_value(&call, frame, sizeof *frame);
  status = ern_cl_each(&call, frame->tickets);
fail:
  return status;
}

ern_status ern_cl_head_render(struct ern_stream *stream, struct ern_cl_head *p, const struct ern_render_rays_args *a) {
  const struct ern_cl_backend *backend = ern_cl_backend_of(stream);
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const struct frame frame = frame_of(a);
  struct rays rays = {0};
  ern_status status = ERN_OK;
  ERN_TRY(fold(stream, p, a));
  ERN_TRY(backend->table.zero(stream, ern_cl_whole(p->counter)));
  if (backend->device.cpu)
    ERN_TRY(find_nearest(stream, p, a, &rays.nearest));
  else
    ERN_TRY(list_rays(stream, p, a, &frame, &rays));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_render, "render_rays", p->options);
  give_rays(&call, p, a, &rays);
  ERN_CL_ARGS(&call, ern_cl_whole(p->net), ern_cl_whole(p->dense), ern_cl_whole(p->levels));
  ern_cl_value(&call, &frame, sizeof frame);
  ERN_TRY(ern_cl_run(&call, ern_cl_groups(backend, ERN_CL_SIZE_rays_groups), (size_t)p->form.group));
fail:
  ern_arena_release(stream, mark);
  return status;
}
