/* SPDX-License-Identifier: MIT
 * THE dispatch table: what a device must be able to do for a portrait to be trained and rendered on it.
 *
 * A backend is immutable once made; a stream is one renderer's or trainer's own queue and scratch on it. A slot is
 * ern_status f(stream, args): sizes and spans in, spans filled, and a few figures for the host in the args. No slot is
 * NULL. */
#ifndef ERN_CORE_BACKEND_H
#define ERN_CORE_BACKEND_H

#include "core/operations.h"

struct ern_backend {
  ern_context *context;
  const char *name; /* "cpu" */
  const char *isa;  /* "ref", "ref64", "avx2", ... */
  size_t real_bytes;
  bool deterministic; /* same inputs, same bytes, whatever the number of threads */
  bool trains_bf16;   /* head_step and head_density can multiply in bf16, for the paper's own head */

  /* Zeroed memory. The caller owns *buffer. */
  ern_status (*buffer_make)(struct ern_backend *, ern_element, size_t count, struct ern_buffer **buffer);
  void (*buffer_free)(struct ern_backend *, struct ern_buffer *); /* accepts NULL */

  ern_status (*stream_make)(struct ern_backend *, int threads, struct ern_stream **);
  void (*stream_free)(struct ern_stream *); /* accepts NULL */
  void (*free)(struct ern_backend *);

  /* Between the host and the device. An upload has read `from` when it returns, a download has written `to`. Reals are
   * converted. `count` elements at the start of the span. */
  ern_status (*upload_reals)(struct ern_stream *, ern_span to, const float *from, size_t count);
  ern_status (*download_reals)(struct ern_stream *, float *to, ern_span from, size_t count);
  ern_status (*upload_int32)(struct ern_stream *, ern_span to, const int32_t *from, size_t count);
  ern_status (*download_int32)(struct ern_stream *, int32_t *to, ern_span from, size_t count);
  ern_status (*upload_bytes)(struct ern_stream *, ern_span to, const uint8_t *from, size_t count);
  ern_status (*download_bytes)(struct ern_stream *, uint8_t *to, ern_span from, size_t count);
  ern_status (*zero)(struct ern_stream *, ern_span);
  ern_status (*copy)(struct ern_stream *, ern_span to, ern_span from, size_t count);
  /* The losses' results on the host (`term`, `terms`) are valid only after this: a device reads all of them back at
   * once. Their args must live until then, synchronized or not. */
  ern_status (*synchronize)(struct ern_stream *);
  /* mark: notes the time at which the work begun so far is done, as number `index`. marks_read: ms[count] = those times
   * by one clock, where the backend has a better one than the host's; else ms is left as it is. */
  ern_status (*mark)(struct ern_stream *, int index);
  ern_status (*marks_read)(struct ern_stream *, double *ms, int count);

#define ERN_SLOT_MEMBER(name) ern_status (*name)(struct ern_stream *, struct ern_##name##_args *);
  ERN_SLOTS(ERN_SLOT_MEMBER)
#undef ERN_SLOT_MEMBER
};

enum { ERN_MARKS = 5 };

/* Every backend's stream begins with this. */
struct ern_stream {
  struct ern_backend *backend;
  struct ern_arena *arena;
};

/* ---- scratch memory of a stream, a stack: release frees everything taken since a mark ---- */

struct ern_arena;
ern_status ern_arena_make(struct ern_backend *backend, struct ern_arena **arena);
void ern_arena_free(struct ern_arena *arena); /* accepts NULL */

struct ern_arena_mark {
  size_t block[3], used[3]; /* by element */
};
struct ern_arena_mark ern_arena_mark(const struct ern_stream *stream);
void ern_arena_release(struct ern_stream *stream, struct ern_arena_mark mark);
/* Frees the blocks that are not in use; no work on the device may still use them. */
void ern_arena_trim(struct ern_stream *stream);

/* *span = room for `count` elements, at a multiple of 64; contents undefined. */
ERN_NODISCARD ern_status ern_scratch_take(struct ern_stream *stream, ern_element element, size_t count, ern_span *span);
/* The same as `rows` channels of n values. */
ERN_NODISCARD ern_status ern_scratch_take_rows(struct ern_stream *stream, int rows, size_t n, ern_rows *out);
/* Their stride. n <= SIZE_MAX - 63 */
static inline size_t ern_scratch_stride(size_t n) { return (n + 63) / 64 * 64; }

/* The rows [first, first + count) of `from`. */
static inline ern_rows ern_rows_part(ern_rows from, int first, int count) {
  const size_t skip = (size_t)first * from.stride;
  return (ern_rows){{from.span.buffer, from.span.at + skip, from.span.count - skip}, from.stride, count, from.per};
}
static inline ern_span ern_span_part(ern_span from, size_t first, size_t count) {
  return (ern_span){from.buffer, from.at + first, count};
}
static inline ern_span ern_span_of_row(ern_rows from, int row, size_t n) {
  return (ern_span){from.span.buffer, from.span.at + (size_t)row * from.stride, n};
}

#endif
