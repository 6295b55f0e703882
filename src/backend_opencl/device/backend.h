/* SPDX-License-Identifier: MIT
 * An OpenCL device as a backend, and its streams, as plain data. */
#ifndef ERN_OPENCL_BACKEND_DATA_H
#define ERN_OPENCL_BACKEND_DATA_H

#include <pthread.h>
#include <stdatomic.h>

#include "backend_opencl/device/device.h"
#include "backend_opencl/device/kernel_sources.h"
#include "core/backend.h"

#define ERN_CL_SOURCE_NUMBER(name) ERN_CL_##name,
typedef enum ern_cl_source { ERN_CL_SOURCES(ERN_CL_SOURCE_NUMBER) ERN_CL_SOURCE_COUNT } ern_cl_source;
#undef ERN_CL_SOURCE_NUMBER

/* Work sizes that kernels are built with: a standard for the device's form, or a size measured to be faster
 * (tune.c). */
#define ERN_CL_TUNABLES(TUNABLE)                                                \
  TUNABLE(mlp_fwd)     /* CPU: vectors of an item; GPU: items of a group */     \
  TUNABLE(mlp_bwd)     /* likewise */                                           \
  TUNABLE(grid_fwd)    /* CPU: vectors that an item goes through; GPU: items */ \
  TUNABLE(grid_bwd)    /* likewise */                                           \
  TUNABLE(rays_tile)   /* of render_rays, CPU: vectors; GPU: items */           \
  TUNABLE(rays_groups) /* groups a compute unit */                              \
  TUNABLE(torso_tile)  /* of render_torso, likewise */                          \
  TUNABLE(torso_groups)

#define ERN_CL_TUNABLE_NUMBER(name) ERN_CL_SIZE_##name,
typedef enum ern_cl_tunable { ERN_CL_TUNABLES(ERN_CL_TUNABLE_NUMBER) ERN_CL_TUNABLE_COUNT } ern_cl_tunable;
#undef ERN_CL_TUNABLE_NUMBER

struct ern_cl_measured { /* of one tunable */
  int32_t standard, best;
  int64_t standard_ns, best_ns; /* of a synthetic call; 0: not measured */
};

struct ern_buffer {
  ern_element element;
  size_t count;
  cl_mem memory;
  atomic_size_t written; /* version of the contents, unique among the backend's buffers: changes when the host writes,
                            clears or copies to the buffer, or when a refresh updates occupancy bits */
};

struct ern_cl_program { /* one source built with one set of options */
  ern_cl_source source;
  char *options; /* beside those that every program is built with */
  cl_program program;
};

struct ern_cl_backend {
  struct ern_backend table; /* first: a backend is one */
  struct ern_cl_device device;
  cl_context context;
  cl_command_queue queue;         /* for what belongs to no stream: clearing new buffers */
  cl_mem probe;                   /* 4 bytes, written to see whether the device still answers */
  atomic_size_t writes;           /* numbers given to buffers */
  atomic_size_t taken;            /* bytes of all buffers */
  int size[ERN_CL_TUNABLE_COUNT]; /* that kernels are built with */
  struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT];
  pthread_mutex_t lock; /* of the programs */
  struct ern_cl_program *programs;
  size_t program_count, program_capacity;
};

struct ern_cl_kernel {
  cl_program program;
  const char *name; /* a literal */
  cl_kernel kernel;
};

enum { ERN_CL_PENDING = 32 };

/* Results that a slot leaves on the device until `synchronize`. */
struct ern_cl_pending {
  void (*deliver)(void *args, const float *values, size_t count); /* in the order of the calls */
  void *args;
  size_t at, count;
};

/* Pinned host memory that transfers go through: the host need not wait for an upload. */
struct ern_cl_staging {
  cl_mem memory;
  uint8_t *bytes; /* [ERN_CL_STAGING]; NULL: not made yet, or refused */
  size_t used;
  cl_event last; /* the last transfer from it; NULL: none */
};
enum { ERN_CL_STAGING = 1 << 23 }; /* three batches of 65,536 rays */

struct ern_cl_stream {
  struct ern_stream base; /* first: an ern_cl_stream is an ern_stream; its table may be a wrapper that observes the
                             calls (src/lab/bench) */
  struct ern_cl_backend *owner; /* the backend that made it */
  cl_command_queue queue;
  struct ern_cl_kernel *kernels; /* made when first launched: kernel objects are not shared between threads */
  size_t kernel_count, kernel_capacity;
  struct ern_buffer *figures; /* real; the pending results, contiguous */
  float *figures_host;
  size_t figures_used;
  struct ern_cl_pending pending[ERN_CL_PENDING];
  size_t pending_count;
  cl_event mark[ERN_MARKS];         /* NULL: not set */
  struct ern_cl_portrait *portrait; /* of render_prepare; NULL: nothing was prepared */
  struct ern_cl_staging staging[2]; /* one is filled while the device reads the other */
  int staging_at;                   /* the one that is filled */
  size_t rays_at_once;              /* rays for which a training step had enough memory; 0: all */
};

static inline struct ern_cl_stream *ern_cl_stream_of(struct ern_stream *stream) {
  return (struct ern_cl_stream *)stream;
}
static inline struct ern_cl_backend *ern_cl_backend_of(struct ern_stream *stream) {
  return ern_cl_stream_of(stream)->owner;
}

/* Notes that the buffer's bytes change. */
static inline void ern_cl_touch(struct ern_cl_backend *backend, struct ern_buffer *buffer) {
  atomic_store(&buffer->written, atomic_fetch_add(&backend->writes, 1) + 1);
}

#endif
