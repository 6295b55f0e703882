/* SPDX-License-Identifier: MIT
 * The memory slots, and the table put together. */
#include "backend_cpu/slots.h"
#include "core/kernels.h"

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

static ern_status zero(struct ern_stream *stream, ern_span span) {
  (void)stream;
  if (span.buffer == NULL) return ERN_OK;
  switch (span.buffer->element) {
    case ERN_ELEMENT_REAL: memset(reals(span), 0, span.count * sizeof(ern_real)); break;
    case ERN_ELEMENT_INT32: memset(int32s(span), 0, span.count * sizeof(int32_t)); break;
    case ERN_ELEMENT_BYTE: memset(bytes(span), 0, span.count); break;
  }
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

/* Figures are there when a slot returns. */
static ern_status settle(struct ern_stream *stream) {
  (void)stream;
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
  backend->settle = settle;
#define ERN_SLOT_FILL(name) backend->name = ERN_REF(ern_cpu_##name);
  ERN_SLOTS(ERN_SLOT_FILL)
#undef ERN_SLOT_FILL
#define ERN_KERNEL_FILL(name) k->name = ERN_REF(ern_##name);
  ERN_KERNELS(ERN_KERNEL_FILL)
#undef ERN_KERNEL_FILL
}
