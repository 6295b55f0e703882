/* SPDX-License-Identifier: MIT */
#include "render/thin.h"

#include "core/memory.h"
#include "core/status.h"
#include "render/morton.h"
#include "train/train_ops.h"

enum { EIGHTHS = 8, CHUNK = 1 << 13 /* cells looked at in one go */ };

/* What a speech sounds like to the field. */
static ern_status hear(struct ern_stream *stream, const struct ern_field *field, ern_span parameters,
                       const struct ern_thin_speech *speech, ern_span *code) {
  const size_t values = (size_t)ERN_AUDIO_WINDOWS * (size_t)speech->window_length * (size_t)field->config.feature_width;
  struct ern_audio_args args = {.parameters = parameters, .net = field->audio};
  ern_status status = ERN_OK;
  args.net.window_length = speech->window_length;
  ERN_TRY(ern_take(stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &args.code));
  ERN_TRY(ern_take(stream, ERN_ELEMENT_REAL, values, &args.windows));
  ERN_TRY(stream->backend->upload_reals(stream, args.windows, speech->windows, values));
  ERN_TRY(stream->backend->audio_fwd(stream, &args));
  *code = args.code;
fail:
  return status;
}

/* Coordinate `axis` of the middles of the cells' eighths, [n][EIGHTHS]. */
static void eighths(float *x, const uint32_t *cell, size_t n, int axis, float bound) {
  for (size_t i = 0; i < n; i++) {
    const float corner = (float)ern_morton_gather(cell[i] >> axis);
    for (int e = 0; e < EIGHTHS; e++) {
      const float inside = (e >> axis & 1) != 0 ? 0.75f : 0.25f;
      x[i * EIGHTHS + (size_t)e] = ((corner + inside) / (ERN_OCCUPANCY_SIDE / 2) - 1) * bound;
    }
  }
}

/* dense[i] is set where cell i reaches `least`. */
static ern_status look_at(struct ern_stream *stream, struct ern_head_density_args *args, const uint32_t *cell, size_t n,
                          float least, float *room, bool *dense) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  args->n = n * EIGHTHS;
  ERN_TRY(ern_take_rows(stream, 3, args->n, &args->x));
  ERN_TRY(ern_take(stream, ERN_ELEMENT_REAL, args->n, &args->sigma));
  for (int axis = 0; axis < 3; axis++) {
    eighths(room, cell, n, axis, args->field->config.bound);
    ERN_TRY(stream->backend->upload_reals(stream, ern_span_of_row(args->x, axis, args->n), room, args->n));
  }
  ERN_TRY(stream->backend->head_density(stream, args));
  ERN_TRY(stream->backend->download_reals(stream, room, args->sigma, args->n));
  for (size_t i = 0; i < args->n; i++) dense[i / EIGHTHS] |= room[i] >= least;
fail:
  ern_arena_release(stream, mark);
  return status;
}

static size_t list(uint32_t *cell, const uint8_t *bits) {
  size_t count = 0;
  for (uint32_t number = 0; number < ERN_OCCUPANCY_CELLS; number++)
    if (bits[number >> 3] >> (number & 7) & 1) cell[count++] = number;
  return count;
}

ern_status ern_occupancy_thin(struct ern_stream *stream, const struct ern_field *field, ern_span parameters,
                              const struct ern_thin_speech *speech, size_t speeches, float least, uint8_t *bits) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_context *context = stream->backend->context;
  void *cells = NULL, *dense = NULL, *room = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ern_allocate(context, ERN_OCCUPANCY_CELLS, sizeof(uint32_t), &cells));
  ERN_TRY(ern_allocate(context, ERN_OCCUPANCY_CELLS, sizeof(bool), &dense));
  ERN_TRY(ern_allocate(context, (size_t)CHUNK * EIGHTHS, sizeof(float), &room));
  const uint32_t *cell = cells;
  const size_t count = list(cells, bits);
  for (size_t s = 0; s < speeches; s++) {
    struct ern_head_density_args args = {.parameters = parameters, .field = field, .eye_value = speech[s].eye};
    ERN_TRY(hear(stream, field, parameters, &speech[s], &args.code));
    for (size_t begin = 0; begin < count; begin += CHUNK)
      ERN_TRY(look_at(stream, &args, cell + begin, count - begin < CHUNK ? count - begin : CHUNK, least, room,
                      (bool *)dense + begin));
  }
  for (size_t i = 0; i < count; i++)
    if (!((bool *)dense)[i]) bits[cell[i] >> 3] &= (uint8_t) ~(1u << (cell[i] & 7));
fail:
  ern_release(context, room);
  ern_release(context, dense);
  ern_release(context, cells);
  ern_arena_release(stream, mark);
  return status;
}
