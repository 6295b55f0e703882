/* SPDX-License-Identifier: MIT
 * The memory slots, and the function that fills the table. */
#include "backend_cpu/slots.h"

static ern_status upload_reals(struct ern_stream *stream, ern_span to, const float *from, size_t count) {
  (void)stream;
  ern_real *out = reals(to);
  for (size_t i = 0; i < count; i++) out[i] = from[i];
  return ERN_OK;
}
static ern_status download_reals(struct ern_stream *stream, float *to, ern_span from, size_t count) {
  (void)stream;
  const ern_real *in = reals(from);
  for (size_t i = 0; i < count; i++) to[i] = (float)in[i];
  return ERN_OK;
}
static ern_status upload_int32(struct ern_stream *stream, ern_span to, const int32_t *from, size_t count) {
  (void)stream;
  memcpy(int32s(to), from, count * sizeof *from);
  return ERN_OK;
}
static ern_status download_int32(struct ern_stream *stream, int32_t *to, ern_span from, size_t count) {
  (void)stream;
  memcpy(to, int32s(from), count * sizeof *to);
  return ERN_OK;
}
static ern_status upload_bytes(struct ern_stream *stream, ern_span to, const uint8_t *from, size_t count) {
  (void)stream;
  memcpy(bytes(to), from, count);
  return ERN_OK;
}
static ern_status download_bytes(struct ern_stream *stream, uint8_t *to, ern_span from, size_t count) {
  (void)stream;
  memcpy(to, bytes(from), count);
  return ERN_OK;
}

struct zero_job {
  char *memory;
  size_t bytes;
};
static void zero_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct zero_job *job = user;
  const struct range r = shard(job->bytes, 4096, k);
  memset(job->memory + r.begin, 0, r.end - r.begin);
}
static ern_status zero(struct ern_stream *stream, ern_span span) {
  enum { ALONE = 1 << 18 /* below this, one thread is done before another has woken up */ };
  struct zero_job job = {0};
  if (span.buffer == NULL) return ERN_OK;
  switch (span.buffer->element) {
    case ERN_ELEMENT_REAL: job = (struct zero_job){(char *)reals(span), span.count * sizeof(ern_real)}; break;
    case ERN_ELEMENT_INT32: job = (struct zero_job){(char *)int32s(span), span.count * sizeof(int32_t)}; break;
    case ERN_ELEMENT_BYTE: job = (struct zero_job){(char *)bytes(span), span.count}; break;
  }
  ern_pool_run(job.bytes > ALONE ? pool_of(stream) : NULL, ERN_SHARDS, zero_task, &job);
  return ERN_OK;
}
static ern_status copy(struct ern_stream *stream, ern_span to, ern_span from, size_t count) {
  (void)stream;
  switch (to.buffer->element) {
    case ERN_ELEMENT_REAL: memmove(reals(to), reals(from), count * sizeof(ern_real)); break;
    case ERN_ELEMENT_INT32: memmove(int32s(to), int32s(from), count * sizeof(int32_t)); break;
    case ERN_ELEMENT_BYTE: memmove(bytes(to), bytes(from), count); break;
  }
  return ERN_OK;
}

/* Slots are synchronous: results are ready when a slot returns. */
static ern_status synchronize(struct ern_stream *stream) {
  (void)stream;
  return ERN_OK;
}

/* A CPU's work is done when a call returns: the host's own times are right. */
static ern_status mark(struct ern_stream *stream, int index) {
  (void)stream, (void)index;
  return ERN_OK;
}
static ern_status marks_read(struct ern_stream *stream, double *ms, int count) {
  (void)stream, (void)ms, (void)count;
  return ERN_OK;
}

void ERN_REF(ern_cpu_fill)(struct ern_backend *backend, void *kernels) {
  struct ern_cpu_kernels *k = kernels;
  backend->real_bytes = sizeof(ern_real);
  backend->upload_reals = upload_reals;
  backend->download_reals = download_reals;
  backend->upload_int32 = upload_int32;
  backend->download_int32 = download_int32;
  backend->upload_bytes = upload_bytes;
  backend->download_bytes = download_bytes;
  backend->zero = zero;
  backend->copy = copy;
  backend->synchronize = synchronize;
  backend->mark = mark;
  backend->marks_read = marks_read;
#define ERN_SLOT_FILL(name) backend->name = ERN_REF(ern_cpu_##name);
  ERN_SLOTS(ERN_SLOT_FILL)
#undef ERN_SLOT_FILL
#define ERN_KERNEL_FILL(name) k->name = ERN_REF(ern_##name);
  ERN_KERNELS(ERN_KERNEL_FILL)
#undef ERN_KERNEL_FILL
}
