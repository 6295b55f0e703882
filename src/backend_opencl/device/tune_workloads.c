/* SPDX-License-Identifier: MIT
 * The calls that the tuner times: slots on a synthetic head and torso, with just enough work to fill a device. */
#include <string.h>

#include "backend_opencl/device/tune_workloads.h"

#include "backend_opencl/device/peak.h"
#include "core/memory.h"
#include "core/rng.h"
#include "model/parameters.h"

/* Samples, and pixels of a side of the picture. */
enum { HOST_SAMPLES = 1 << 13, GPU_SAMPLES = 1 << 17, HOST_SIDE = 64, GPU_SIDE = 320, WINDOW = 16, WIDTH = 29 };

static const struct ern_model_config config = {.levels = 14,
                                               .feature_width = WIDTH,
                                               .window_length = WINDOW,
                                               .head = true,
                                               .eye = true,
                                               .torso = true,
                                               .bound = 1};

/* Values in (-1, 1). */
static ern_status take_reals(struct ern_cl_workloads *p, size_t count, ern_span *span) {
  struct ern_backend *table = &p->backend->table;
  float *values = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(table->context, count, &values));
  for (size_t i = 0; i < count; i++)
    values[i] = 2 * ern_uniform(ern_random_at(1, 0, (uint32_t)i, ERN_RNG_INIT).word[0]) - 1;
  ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_REAL, count, span));
  status = table->upload_reals(p->stream, *span, values, count);
fail:
  ern_release(table->context, values);
  return status;
}

static ern_status take_rows(struct ern_cl_workloads *p, int rows, size_t n, ern_rows *out) {
  *out = (ern_rows){.stride = n, .rows = rows, .per = ERN_PER_SAMPLE};
  return take_reals(p, (size_t)rows * n, &out->span);
}

static ern_status take_parameters(struct ern_cl_workloads *p, ern_span *span) {
  struct ern_backend *table = &p->backend->table;
  struct ern_parameter_table rows;
  float *block = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ern_parameters_build(table->context, &config, &p->field, &rows));
  ERN_TRY(ERN_NEW(table->context, p->field.parameters, &block));
  ern_parameters_init(block, &rows, false, 1);
  ern_parameters_init(block, &rows, true, 1);
  ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_REAL, p->field.parameters, span));
  status = table->upload_reals(p->stream, *span, block, p->field.parameters);
fail:
  ern_release(table->context, block);
  return status;
}

/* Numbers of all pixels, and an occupancy with every cell in it. */
static ern_status take_view(struct ern_cl_workloads *p, size_t pixels, ern_span *numbers, ern_span *bits) {
  struct ern_backend *table = &p->backend->table;
  int32_t *number = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(table->context, pixels + ERN_OCCUPANCY_BYTES / sizeof *number, &number));
  uint8_t *bytes = (uint8_t *)(number + pixels);
  for (size_t i = 0; i < pixels; i++) number[i] = (int32_t)i;
  memset(bytes, 0xff, ERN_OCCUPANCY_BYTES);
  ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_INT32, pixels, numbers));
  ERN_TRY(table->upload_int32(p->stream, *numbers, number, pixels));
  ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, bits));
  status = table->upload_bytes(p->stream, *bits, bytes, ERN_OCCUPANCY_BYTES);
fail:
  ern_release(table->context, number);
  return status;
}

/* A plane of the head, and the density's layers. */
static ern_status fill_samples(struct ern_cl_workloads *p, size_t n) {
  const struct ern_grid *grid = &p->field.encoder.grid[0];
  const struct ern_mlp *mlp = &p->field.density;
  const ern_span parameters = p->prepare.parameters;
  ern_rows points;
  ern_span gradient;
  ern_status status = ERN_OK;
  ERN_TRY(take_reals(p, p->field.parameters, &gradient));
  ERN_TRY(take_rows(p, 2, n, &points));
  ERN_TRY(take_rows(p, grid->levels * grid->features, n, &p->grid.df));
  struct ern_grid_fwd_args *g = &p->grid.forward;
  g->grid = grid, g->n = n;
  g->table = ern_span_part(parameters, p->field.encoder.table[0], (size_t)grid->entries * (size_t)grid->features);
  for (int d = 0; d < 2; d++) g->x[d] = ern_span_of_row(points, d, n);
  p->grid.dtable = ern_span_part(gradient, p->field.encoder.table[0], g->table.count);
  ERN_TRY(take_rows(p, grid->levels * grid->features, n, &g->f));
  struct ern_mlp_fwd_args *m = &p->mlp.forward;
  m->mlp = *mlp, m->n = n, m->pieces = 1, m->parameters = parameters;
  ERN_TRY(take_rows(p, mlp->width[0], n, &m->x[0]));
  ERN_TRY(take_rows(p, mlp->width[mlp->layers], n, &m->y));
  ERN_TRY(take_rows(p, mlp->width[mlp->layers], n, &p->mlp.dy));
  ERN_TRY(take_rows(p, mlp->width[0], n, &p->mlp.dx[0]));
  p->mlp.dparameters = gradient;
fail:
  return status;
}

static ern_status fill_pictures(struct ern_cl_workloads *p, int side) {
  const size_t pixels = (size_t)side * (size_t)side;
  const float half = (float)side / 2;
  /* the camera is 3.4 units in front of the head */
  const struct ern_view view = {.pose = {1, 0, 0, 0, 0, 0, -1, 3.4f, 0, 1, 0, 0, 0, 0, 0, 1},
                                .focal = 4 * half,
                                .cx = half,
                                .cy = half,
                                .width = side,
                                .height = side};
  struct ern_render_rays_args *r = &p->rays;
  ern_status status = ERN_OK;
  *r = (struct ern_render_rays_args){.view = view,
                                     .parameters = p->prepare.parameters,
                                     .field = &p->field,
                                     .settings = {1, 16, 1.0f / 256, ERN_NEAR_PLANE},
                                     .n = pixels};
  ERN_TRY(take_rows(p, 3, pixels, &r->pixel));
  ERN_TRY(take_rows(p, 3, pixels, &r->background));
  ERN_TRY(take_reals(p, ERN_AUDIO_CODE, &r->code));
  ERN_TRY(take_view(p, pixels, &r->pixel_number, &r->bits));
  struct ern_render_torso_args *t = &p->torso;
  *t = (struct ern_render_torso_args){.pixel = r->pixel,
                                      .threshold = -2, /* all pixels */
                                      .width = side,
                                      .height = side,
                                      .shrink = 0.8f,
                                      .parameters = p->prepare.parameters,
                                      .field = &p->field};
  memcpy(t->pose, view.pose, sizeof t->pose);
  status = take_reals(p, ERN_TORSO_CELLS, &t->grid);
fail:
  return status;
}

ern_status ern_cl_loads_make(struct ern_cl_backend *backend, struct ern_cl_workloads **loads) {
  struct ern_backend *table = &backend->table;
  const bool host = backend->device.host;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(table->context, 1, loads));
  struct ern_cl_workloads *p = *loads;
  p->backend = backend;
  ERN_TRY(table->stream_make(table, 1, &p->stream));
  ERN_TRY(take_parameters(p, &p->prepare.parameters));
  p->prepare.field = &p->field;
  ERN_TRY(fill_samples(p, host ? HOST_SAMPLES : GPU_SAMPLES));
  ERN_TRY(fill_pictures(p, host ? HOST_SIDE : GPU_SIDE));
  ERN_TRY(ern_opencl_finish(p->stream)); /* the calls are made on other streams */
  return ERN_OK;
fail:
  ern_cl_loads_free(*loads);
  *loads = NULL;
  return status;
}

void ern_cl_loads_free(struct ern_cl_workloads *loads) {
  if (loads == NULL) return;
  struct ern_backend *table = &loads->backend->table;
  table->stream_free(loads->stream);
  ern_release(table->context, loads);
}

ern_status ern_cl_workload_prepare(struct ern_cl_workloads *loads, ern_cl_tunable tunable, struct ern_stream *stream) {
  return tunable >= ERN_CL_SIZE_rays_tile ? stream->backend->render_prepare(stream, &loads->prepare) : ERN_OK;
}

ern_status ern_cl_workload_run(struct ern_cl_workloads *loads, ern_cl_tunable tunable, struct ern_stream *stream) {
  const struct ern_backend *table = stream->backend;
  switch (tunable) {
    case ERN_CL_SIZE_mlp_fwd: return table->mlp_fwd(stream, &loads->mlp.forward);
    case ERN_CL_SIZE_mlp_bwd: return table->mlp_bwd(stream, &loads->mlp);
    case ERN_CL_SIZE_grid_fwd: return table->grid_fwd(stream, &loads->grid.forward);
    case ERN_CL_SIZE_grid_bwd: return table->grid_bwd(stream, &loads->grid);
    case ERN_CL_SIZE_torso_tile:
    case ERN_CL_SIZE_torso_groups: return table->render_torso(stream, &loads->torso);
    default: return table->render_rays(stream, &loads->rays);
  }
}
