/* SPDX-License-Identifier: MIT */
#include "render/occupancy_prune.h"

#include "core/memory.h"
#include "core/status.h"
#include "render/cell_points.h"
#include "render/render_ops.h"

enum { CHUNK = 1 << 13 /* cells evaluated at once */ };

/* dense[i] is set where cell i reaches `least`. */
static ern_status look_at(struct ern_stream *stream, struct ern_head_density_args *args, const uint32_t *cell, size_t n,
                          float least, float *workspace, bool *dense) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  args->n = n * ERN_OCTANTS;
  ERN_TRY(ern_scratch_take_rows(stream, 3, args->n, &args->x));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, args->n, &args->sigma));
  ERN_TRY(ern_cell_points(stream, args->x, cell, n, args->field->config.bound, workspace));
  ERN_TRY(stream->backend->head_density(stream, args));
  ERN_TRY(stream->backend->download_reals(stream, workspace, args->sigma, args->n));
  for (size_t i = 0; i < args->n; i++) dense[i / ERN_OCTANTS] |= !(workspace[i] < least); /* a NaN counts as dense */
fail:
  ern_arena_release(stream, mark);
  return status;
}

ern_status ern_occupancy_prune(struct ern_stream *stream, const struct ern_field *field, ern_span parameters,
                               const struct ern_speech_frame *frame, size_t frames, float least, uint8_t *bits) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_context *context = stream->backend->context;
  uint32_t *cell = NULL;
  bool *dense = NULL;
  float *density = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, ERN_OCCUPANCY_CELLS, &cell));
  ERN_TRY(ERN_NEW(context, ERN_OCCUPANCY_CELLS, &dense));
  ERN_TRY(ERN_NEW(context, (size_t)CHUNK * ERN_OCTANTS, &density));
  const size_t count = ern_cells_list(cell, bits);
  for (size_t s = 0; s < frames; s++) {
    struct ern_head_density_args args = {.parameters = parameters, .field = field, .eye_value = frame[s].eye};
    ERN_TRY(ern_speech_frame_code(stream, field, parameters, &frame[s], &args.code));
    for (size_t begin = 0; begin < count; begin += CHUNK)
      ERN_TRY(look_at(stream, &args, cell + begin, count - begin < CHUNK ? count - begin : CHUNK, least, density,
                      dense + begin));
  }
  for (size_t i = 0; i < count; i++)
    if (!dense[i]) bits[cell[i] >> 3] &= (uint8_t) ~(1u << (cell[i] & 7));
fail:
  ern_release(context, density);
  ern_release(context, dense);
  ern_release(context, cell);
  ern_arena_release(stream, mark);
  return status;
}
