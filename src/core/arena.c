/* SPDX-License-Identifier: MIT
 * Scratch memory of a stream: a chain of blocks for each element type, so that a span never moves. */
#include "core/backend.h"
#include "core/memory.h"

enum {
  MAX_BLOCKS = 256,
  FIRST_BLOCK = 1 << 16, /* elements; blocks double up to LARGE_BLOCK, and are larger only for a larger span */
  LARGE_BLOCK = 1 << 26
};

struct ern_arena {
  struct ern_backend *backend;
  struct {
    struct ern_buffer *block[MAX_BLOCKS];
    size_t size[MAX_BLOCKS];
    size_t blocks, current, used;
  } chain[3];
};

ern_status ern_arena_make(struct ern_backend *backend, struct ern_arena **arena) {
  const ern_status status = ERN_NEW(backend->context, 1, arena);
  if (status == ERN_OK) (*arena)->backend = backend;
  return status;
}

void ern_arena_free(struct ern_arena *arena) {
  if (arena == NULL) return;
  for (int e = 0; e < 3; e++)
    for (size_t b = 0; b < arena->chain[e].blocks; b++)
      arena->backend->buffer_free(arena->backend, arena->chain[e].block[b]);
  ern_release(arena->backend->context, arena);
}

struct ern_arena_mark ern_arena_mark(const struct ern_stream *stream) {
  struct ern_arena_mark mark;
  for (int e = 0; e < 3; e++) {
    mark.block[e] = stream->arena->chain[e].current;
    mark.used[e] = stream->arena->chain[e].used;
  }
  return mark;
}

void ern_arena_release(struct ern_stream *stream, struct ern_arena_mark mark) {
  for (int e = 0; e < 3; e++) {
    stream->arena->chain[e].current = mark.block[e];
    stream->arena->chain[e].used = mark.used[e];
  }
}

void ern_arena_trim(struct ern_stream *stream) {
  struct ern_arena *arena = stream->arena;
  for (int e = 0; e < 3; e++) {
    const size_t keep = arena->chain[e].current + (arena->chain[e].used > 0);
    while (arena->chain[e].blocks > keep)
      arena->backend->buffer_free(arena->backend, arena->chain[e].block[--arena->chain[e].blocks]);
  }
}

ern_status ern_scratch_take(struct ern_stream *stream, ern_element element, size_t count, ern_span *span) {
  struct ern_arena *arena = stream->arena;
  ern_context *context = arena->backend->context;
  *span = (ern_span){0};
  size_t need = 0;
  if (!ern_size_add(count, 63, &need))
    return ern_fail(context, ERN_E_NO_MEMORY, "scratch: %zu elements do not fit", count);
  need = need / 64 * 64;
  while (arena->chain[element].current < arena->chain[element].blocks) {
    const size_t b = arena->chain[element].current;
    if (arena->chain[element].size[b] - arena->chain[element].used >= need) break;
    arena->chain[element].current++;
    arena->chain[element].used = 0;
  }
  const size_t b = arena->chain[element].current;
  if (b == arena->chain[element].blocks) {
    if (b == MAX_BLOCKS) return ern_fail(context, ERN_E_NO_MEMORY, "scratch: more than %d blocks", MAX_BLOCKS);
    size_t size = b == 0 ? FIRST_BLOCK : 2 * arena->chain[element].size[b - 1];
    if (size > LARGE_BLOCK) size = LARGE_BLOCK;
    if (size < need) size = need;
    ern_status status = arena->backend->buffer_make(arena->backend, element, size, &arena->chain[element].block[b]);
    if (status == ERN_E_NO_MEMORY && size > need) {
      size = need;
      status = arena->backend->buffer_make(arena->backend, element, size, &arena->chain[element].block[b]);
    }
    if (status != ERN_OK) return status;
    arena->chain[element].size[b] = size;
    arena->chain[element].blocks++;
    arena->chain[element].used = 0;
  }
  *span = (ern_span){arena->chain[element].block[b], arena->chain[element].used, count};
  arena->chain[element].used += need;
  return ERN_OK;
}

ern_status ern_scratch_take_rows(struct ern_stream *stream, int rows, size_t n, ern_rows *out) {
  size_t count = 0;
  *out = (ern_rows){0};
  if (n > SIZE_MAX - 63 || !ern_size_multiply(ern_scratch_stride(n), (size_t)rows, &count))
    return ern_fail(stream->backend->context, ERN_E_NO_MEMORY, "scratch: %d rows of %zu do not fit", rows, n);
  out->stride = ern_scratch_stride(n);
  out->rows = rows;
  out->per = ERN_PER_SAMPLE;
  return ern_scratch_take(stream, ERN_ELEMENT_REAL, count, &out->span);
}
