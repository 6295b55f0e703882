/* SPDX-License-Identifier: MIT
 * Makes the backend: fills the table with the reference kernels, then overwrites those that the instruction set has
 * faster. */
#include "backend_cpu/backend_cpu.h"

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/cpu_state.h"
#include "backend_cpu/fused/render.h"
#include "backend_cpu/fused/step.h"
#include "backend_cpu/fused/step_kernels.h"
#include "backend_cpu/fused/torso.h"
#include "core/memory.h"

/* Large enough for the kernels of either scalar type: all members are pointers. */
enum { KERNEL_TABLE_BYTES = sizeof(struct ern_cpu_kernels) };

static ern_status buffer_make(struct ern_backend *backend, ern_element element, size_t count,
                              struct ern_buffer **buffer) {
  static const size_t fixed[] = {[ERN_ELEMENT_REAL] = 0, [ERN_ELEMENT_INT32] = 4, [ERN_ELEMENT_BYTE] = 1};
  struct ern_buffer *made = NULL;
  *buffer = NULL;
  ern_status status = ERN_NEW(backend->context, 1, &made);
  if (status != ERN_OK) return status;
  made->element = element;
  made->count = count;
  made->memory =
      ern_allocate(backend->context, count, element == ERN_ELEMENT_REAL ? backend->real_bytes : fixed[element]);
  if (made->memory == NULL) {
    ern_release(backend->context, made);
    return ERN_E_NO_MEMORY;
  }
  *buffer = made;
  return ERN_OK;
}

static void buffer_free(struct ern_backend *backend, struct ern_buffer *buffer) {
  if (buffer == NULL) return;
  ern_release(backend->context, buffer->memory);
  ern_release(backend->context, buffer);
}

static void stream_free(struct ern_stream *stream) {
  if (stream == NULL) return;
  struct ern_cpu_stream *cpu = (struct ern_cpu_stream *)stream;
  ern_context *context = stream->backend->context;
  for (int i = 0; i < cpu->workers; i++) stream_free(cpu->worker[i] != NULL ? &cpu->worker[i]->base : NULL);
  ern_frame_net_free(context, cpu->net);
  ern_train_workspace_free(context, cpu->train_workspace);
  ern_release(context, cpu->worker);
  ern_pool_free(cpu->pool);
  ern_arena_free(stream->arena);
  ern_release(context, cpu);
}

/* Makes a worker: a stream without a pool. */
static ern_status serial_stream_make(struct ern_backend *backend, struct ern_cpu_stream **stream) {
  ern_status status = ERN_NEW(backend->context, 1, stream);
  if (status != ERN_OK) return status;
  (*stream)->base.backend = backend;
  return ern_arena_make(backend, &(*stream)->base.arena);
}

static ern_status stream_make(struct ern_backend *backend, int threads, struct ern_stream **stream) {
  struct ern_cpu_stream *made = NULL;
  ern_status status = ERN_OK;
  *stream = NULL;
  ERN_TRY(serial_stream_make(backend, &made));
  ERN_TRY(ern_pool_make(backend->context, threads, &made->pool));
  const int workers = ern_pool_threads(made->pool);
  ERN_TRY(ERN_NEW(backend->context, (size_t)workers, &made->worker));
  made->workers = workers;
  for (int i = 0; i < workers; i++) ERN_TRY(serial_stream_make(backend, &made->worker[i]));
  *stream = &made->base;
  return ERN_OK;
fail:
  stream_free(made != NULL ? &made->base : NULL);
  return status;
}

static void backend_free(struct ern_backend *backend) {
  if (backend == NULL) return;
  struct ern_cpu_backend *cpu = (struct ern_cpu_backend *)backend;
  ern_release(backend->context, cpu->kernel_memory);
  ern_release(backend->context, cpu);
}

/* Overwrites what an instruction set does faster than the reference: kernels, and the slots that fuse several stages.
 */
#define FASTER(isa)                                       \
  static void faster_##isa(struct ern_cpu_backend *cpu) { \
    struct ern_cpu_kernels *k = cpu->kernel_memory;       \
    ERN_FAST_KERNELS(FASTER_##isa)                        \
    cpu->render_worker = ern_render_worker_##isa;         \
    cpu->train = &ern_train_kernels_##isa;                \
    cpu->torso = &ern_torso_kernels_##isa;                \
    ern_cpu_fuse_render(&cpu->table);                     \
    ern_cpu_fuse_torso(&cpu->table);                      \
    ern_cpu_fuse_step(&cpu->table);                       \
  }
#define FASTER_avx2(name) k->name = ern_##name##_avx2;
#define FASTER_avx512(name) k->name = ern_##name##_avx512;
#define FASTER_neon(name) k->name = ern_##name##_neon;

#if defined(ERN_X86_KERNELS)
FASTER(avx2)
FASTER(avx512)
#endif
#if defined(ERN_ARM_KERNELS)
FASTER(neon)
#endif

ern_status ern_cpu_backend_make(ern_context *context, ern_isa isa, struct ern_backend **backend) {
  struct ern_cpu_backend *made = NULL;
  *backend = NULL;
  ern_status status = ERN_NEW(context, 1, &made);
  if (status != ERN_OK) return status;
  struct ern_backend *table = &made->table;
  table->context = context;
  made->kernel_memory = ern_allocate(context, 1, KERNEL_TABLE_BYTES);
  if (made->kernel_memory == NULL) {
    ern_release(context, made);
    return ERN_E_NO_MEMORY;
  }
  made->kernels = made->kernel_memory;
  table->name = "cpu";
  table->isa = ern_isa_name(isa);
  table->deterministic = true;
  table->buffer_make = buffer_make;
  table->buffer_free = buffer_free;
  table->stream_make = stream_make;
  table->stream_free = stream_free;
  table->free = backend_free;
  (isa == ERN_ISA_REF64 ? ern_cpu_fill_ref64 : ern_cpu_fill_ref)(table, made->kernel_memory);
#if defined(ERN_X86_KERNELS)
  made->render_pairs = isa == ERN_ISA_AVX512BF16;
  if (isa == ERN_ISA_AVX2) faster_avx2(made);
  if (isa == ERN_ISA_AVX512 || made->render_pairs) faster_avx512(made);
  if (made->render_pairs) {
    made->render_worker = ern_render_worker_avx512bf16;
    made->train_pairs = &ern_train_kernels_avx512bf16;
    table->trains_bf16 = true;
  }
#endif
#if defined(ERN_ARM_KERNELS)
  if (isa == ERN_ISA_NEON) faster_neon(made);
#endif
  *backend = table;
  return ERN_OK;
}
