/* SPDX-License-Identifier: MIT
 * What a backend of the CPU, its streams and its buffers hold. */
#ifndef ERN_CPU_STATE_H
#define ERN_CPU_STATE_H

#include <stdatomic.h>

#include "core/backend.h"
#include "core/threads.h"

struct ern_buffer {
  ern_element element;
  size_t count;
  void *memory;
};

struct ern_frame_net;
struct ern_render_work;
struct ern_profile;

/* Renders rays of work->order until none is left (render_worker.h). */
typedef void ern_render_worker_kernel(const struct ern_render_work *work, atomic_size_t *next, void *scratch,
                                      struct ern_profile *profile);

struct ern_torso_kernels;
struct ern_train_kernels;
struct ern_train_workspace;

struct ern_cpu_backend {
  struct ern_backend table; /* first member: a backend points to it */
  const void *kernels;      /* struct ern_cpu_kernels of this build's scalar */
  void *kernel_memory;
  /* the fused rendering pass; NULL: render_rays runs the separate stages */
  ern_render_worker_kernel *render_worker;
  bool render_pairs; /* render_worker needs a net in pairs of bf16 (frame_net.h) */
  ern_status (*render_rays_stages)(struct ern_stream *, struct ern_render_rays_args *);
  const struct ern_torso_kernels *torso; /* of the fused torso; NULL: render_torso runs the separate stages */
  const struct ern_train_kernels *train; /* of the fused training step; NULL: head_step runs the separate stages */
  const struct ern_train_kernels *train_pairs; /* the same with products of pairs of bf16; NULL: none */
};

struct ern_cpu_stream {
  struct ern_stream base;         /* first member: a stream points to it */
  struct ern_pool *pool;          /* NULL in a worker stream, whose work is one task of its owner's pool */
  struct ern_cpu_stream **worker; /* serial streams for tasks that run whole stages; [threads], NULL in a worker */
  int workers;
  struct ern_frame_net *net; /* made by render_prepare from the parameters net_of; NULL: none */
  ern_span net_of;
  struct ern_train_workspace *train_workspace; /* memory of the fused training step; NULL: none */
};

/* Sets the table's slots, copy and fill functions, and the reference kernels of a struct ern_cpu_kernels (memory.c,
 * compiled once for each scalar type). */
void ern_cpu_fill_ref(struct ern_backend *backend, void *kernels);
void ern_cpu_fill_ref64(struct ern_backend *backend, void *kernels);

#endif
