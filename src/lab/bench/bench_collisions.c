/* SPDX-License-Identifier: MIT
 * Counts hash collisions as in the paper, for the samples of a frame. */
#include <math.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/status.h"
#include "lab/bench/bench_shared.h"
#include "lab/bench/collisions.h"
#include "render/stages.h"

enum {
  TILE = 1 << 13, /* pixels marched in one batch */
  STEPS = 16,
  RESOLUTION = 512,
  ENTRIES = 1 << 14
};

/* Positions of all samples of the frame. */
struct points {
  float *x[3];
  size_t n, capacity;
};

static void free_points(ern_context *context, struct points *points) {
  for (int d = 0; d < 3; d++) ern_release(context, points->x[d]);
}

static ern_status reserve(ern_context *context, struct points *points, size_t more) {
  if (points->capacity - points->n >= more) return ERN_OK;
  const size_t capacity = 2 * points->capacity + more;
  for (int d = 0; d < 3; d++) {
    float *larger = NULL;
    const ern_status status = ERN_NEW(context, capacity, &larger);
    if (status != ERN_OK) return status;
    for (size_t i = 0; i < points->n; i++) larger[i] = points->x[d][i];
    ern_release(context, points->x[d]);
    points->x[d] = larger;
  }
  points->capacity = capacity;
  return ERN_OK;
}

static ern_status march_tile(struct ern_stream *stream, const struct ern_bench_scene *scene, ern_span bits,
                             ern_span pixels, struct points *points) {
  const struct ern_march_settings settings = {scene->model->field.config.bound, STEPS, scene->model->view.dt_gamma,
                                              ERN_NEAR_PLANE};
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const struct ern_view view = ern_bench_view(scene);
  struct ern_marched marched;
  ern_status status = ERN_OK;
  ERN_TRY(ern_march_rays(stream, pixels, &view, (ern_span){0}, bits, &settings, pixels.count, &marched));
  ERN_TRY(reserve(stream->backend->context, points, marched.total));
  for (int d = 0; d < 3 && marched.total > 0; d++)
    ERN_TRY(stream->backend->download_reals(stream, points->x[d] + points->n,
                                            ern_span_of_row(marched.x, d, marched.total), marched.total));
  points->n += marched.total;
fail:
  ern_arena_release(stream, mark);
  return status;
}

static ern_status march_frame(struct ern_backend *backend, const struct ern_bench_scene *scene, struct points *points) {
  const size_t pixels = (size_t)scene->frame.camera.width * (size_t)scene->frame.camera.height;
  struct ern_stream *stream = NULL;
  struct ern_buffer *bytes = NULL, *numbers = NULL;
  int32_t number[TILE];
  ern_status status = ERN_OK;
  ERN_TRY(backend->stream_make(backend, 1, &stream));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &bytes));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_INT32, TILE, &numbers));
  const ern_span bits = {bytes, 0, ERN_OCCUPANCY_BYTES};
  ERN_TRY(backend->upload_bytes(stream, bits, scene->model->bits, ERN_OCCUPANCY_BYTES));
  for (size_t begin = 0; begin < pixels; begin += TILE) {
    const size_t n = pixels - begin < TILE ? pixels - begin : TILE;
    for (size_t i = 0; i < n; i++) number[i] = (int32_t)(begin + i);
    ERN_TRY(backend->upload_int32(stream, (ern_span){numbers, 0, n}, number, n));
    ERN_TRY(march_tile(stream, scene, bits, (ern_span){numbers, 0, n}, points));
  }
fail:
  backend->buffer_free(backend, bytes);
  backend->buffer_free(backend, numbers);
  if (stream != NULL) backend->stream_free(stream);
  return status;
}

/* Scales the points into [0, 1] about their centre by one factor, so that the longest side of their bounding box
 * becomes 1. */
static float spread(struct points *points, float bound) {
  float low[3], high[3], side = 0;
  for (int d = 0; d < 3; d++) {
    low[d] = INFINITY;
    high[d] = -INFINITY;
    for (size_t i = 0; i < points->n; i++) {
      low[d] = fminf(low[d], points->x[d][i]);
      high[d] = fmaxf(high[d], points->x[d][i]);
    }
    side = fmaxf(side, high[d] - low[d]);
  }
  const float factor = side > 0 ? 1 / side : 1;
  for (int d = 0; d < 3; d++)
    for (size_t i = 0; i < points->n; i++) points->x[d][i] = (points->x[d][i] - (low[d] + high[d]) / 2) * factor + 0.5f;
  return factor * 2 * bound;
}

static ern_status count_level(ern_context *context, const struct points *points, int dims, const int axis[3],
                              ern_bench_collision_count *out) {
  struct ern_collision_level level = {
      .dims = dims, .resolution = RESOLUTION, .entries = dims == 3 ? ENTRIES : ENTRIES / 3};
  const float *const u[3] = {points->x[0], points->x[1], points->x[2]};
  struct ern_collision_count count;
  for (int d = 0; d < dims; d++) level.axis[d] = axis[d];
  const ern_status status = ern_collisions_count(context, u, points->n, &level, &count);
  if (status != ERN_OK) return status;
  *out = (ern_bench_collision_count){count.cells, (double)count.colliding / (double)(1 << dims)};
  return ERN_OK;
}

ern_status ern_bench_collisions(ern_backend *backend, const ern_bench_scene *scene, ern_bench_collision_table *table) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, backend);
  ERN_NEED(backend->context, scene);
  ERN_NEED(backend->context, table);
  static const int volume[3] = {0, 1, 2}, plane[3][3] = {{0, 2}, {0, 1}, {1, 2}};
  struct points points = {.capacity = 0};
  ern_status status = ERN_OK;
  *table = (ern_bench_collision_table){.points = 0};
  ERN_TRY(march_frame(backend, scene, &points));
  table->points = points.n;
  table->scale = spread(&points, scene->model->field.config.bound);
  ERN_TRY(count_level(backend->context, &points, 3, volume, &table->volume));
  for (int p = 0; p < 3; p++) ERN_TRY(count_level(backend->context, &points, 2, plane[p], &table->plane[p]));
fail:
  free_points(backend->context, &points);
  return status;
}
