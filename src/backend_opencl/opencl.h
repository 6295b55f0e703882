/* SPDX-License-Identifier: MIT
 * An OpenCL device as a backend: what its files share. Kernels are in kernels/, a .cl file a subject, each behind
 * kernels/common.cl; slots_*.c fill the table by launching them.
 *
 * A kernel takes a span as two arguments (base, offset) and rows as three (base, offset, stride): see common.cl. */
#ifndef ERN_OPENCL_H
#define ERN_OPENCL_H

#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <pthread.h>
#include <stdatomic.h>

#include "core/backend.h"
#include "core/status.h"

/* The sources, embedded at build time: kernels/NAME.cl. */
#define ERN_CL_SOURCES(SOURCE) \
  SOURCE(scan)                 \
  SOURCE(march)                \
  SOURCE(composite)            \
  SOURCE(occupancy)            \
  SOURCE(picture)              \
  SOURCE(enlarge)              \
  SOURCE(hashgrid)             \
  SOURCE(mlp)                  \
  SOURCE(encoding)             \
  SOURCE(attention)            \
  SOURCE(audio)                \
  SOURCE(torso)                \
  SOURCE(losses)               \
  SOURCE(optimizer)            \
  SOURCE(portrait)             \
  SOURCE(render)               \
  SOURCE(render_torso)         \
  SOURCE(peak)

#define ERN_CL_SOURCE_NUMBER(name) ERN_CL_##name,
typedef enum ern_cl_source { ERN_CL_SOURCES(ERN_CL_SOURCE_NUMBER) ERN_CL_SOURCE_COUNT } ern_cl_source;
#undef ERN_CL_SOURCE_NUMBER

/* Sizes that kernels are cut to: a standard by the device's limits, or what was measured to be faster (tune.c). */
#define ERN_CL_KNOBS(KNOB)                                                   \
  KNOB(mlp_fwd)     /* CPU: vectors of an item; GPU: items of a group */     \
  KNOB(mlp_bwd)     /* likewise */                                           \
  KNOB(grid_fwd)    /* CPU: vectors that an item goes through; GPU: items */ \
  KNOB(grid_bwd)    /* likewise */                                           \
  KNOB(rays_tile)   /* of render_rays, CPU: vectors; GPU: items */           \
  KNOB(rays_groups) /* groups a compute unit */                              \
  KNOB(torso_tile)  /* of render_torso, likewise */                          \
  KNOB(torso_groups)

#define ERN_CL_KNOB_NUMBER(name) ERN_CL_SIZE_##name,
typedef enum ern_cl_knob { ERN_CL_KNOBS(ERN_CL_KNOB_NUMBER) ERN_CL_KNOB_COUNT } ern_cl_knob;
#undef ERN_CL_KNOB_NUMBER

struct ern_cl_measured { /* of one knob */
  int32_t standard, best;
  int64_t standard_ns, best_ns; /* of a made-up call; 0: not measured */
};

struct ern_buffer {
  ern_element element;
  size_t count;
  cl_mem memory;
  atomic_size_t written; /* another number after its bytes were changed: by the host, cleared, copied to, or, of the
                            bits of an occupancy, by a refresh. No two buffers of a backend have the same */
};

/* What is asked of a device once. */
struct ern_cl_device {
  cl_platform_id platform;
  cl_device_id id;
  char name[128], version[128], driver[128], platform_version[128];
  bool host; /* a CPU, whatever the form */
  bool cpu;  /* the kernels' form: a work-item carries a vector of samples, as suits a CPU; false: one, as suits a GPU.
                By the type of the device; ERNERF_OPENCL_FORM=cpu|gpu says otherwise */
  bool keeps_kernels;    /* the driver has a cache of its own that ours would only slow: PoCL compiles each kernel once
                            for its launch and, to hand a binary out, once more for any size of work-group */
  bool exact_divide;     /* division and square root can be correctly rounded */
  bool half;             /* cl_khr_fp16 */
  bool subgroups;        /* cl_khr_subgroups or cl_intel_subgroups */
  int width;             /* samples a work-item carries: the native vector of a CPU, 1 elsewhere */
  size_t group_most;     /* work-items a group at most */
  size_t local_bytes;    /* local memory a group */
  uint64_t memory_bytes; /* global memory */
  uint64_t buffer_bytes; /* one buffer at most */
  cl_uint units;
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
  cl_command_queue queue;      /* for what belongs to no stream: clearing new buffers */
  cl_mem probe;                /* 4 bytes, written to see whether the device still answers */
  atomic_size_t writes;        /* numbers given to buffers */
  atomic_size_t taken;         /* bytes of all buffers */
  int size[ERN_CL_KNOB_COUNT]; /* what kernels are built with */
  struct ern_cl_measured measured[ERN_CL_KNOB_COUNT];
  pthread_mutex_t lock; /* of the programs */
  struct ern_cl_program *programs;
  size_t program_count, program_room;
};

struct ern_cl_kernel {
  cl_program program;
  const char *name; /* a literal */
  cl_kernel kernel;
};

enum { ERN_CL_PENDING = 32 };

/* Figures that a slot leaves on the device until `settle`. */
struct ern_cl_pending {
  void (*settle)(void *args, const float *values, size_t count); /* in the order of the calls */
  void *args;
  size_t at, count;
};

struct ern_cl_stream {
  struct ern_stream base;       /* first: a stream is one; its table may be another that looks on (src/bench) */
  struct ern_cl_backend *owner; /* the backend that made it */
  cl_command_queue queue;
  struct ern_cl_kernel *kernels; /* made when first launched: kernel objects are not shared between threads */
  size_t kernel_count, kernel_room;
  struct ern_buffer *figures; /* real; the pending ones one behind the other */
  float *figures_host;
  size_t figures_used;
  struct ern_cl_pending pending[ERN_CL_PENDING];
  size_t pending_count;
  struct ern_cl_portrait *portrait; /* of render_prepare; NULL: nothing was prepared */
  size_t rays_at_once;              /* of a training step that had memory; 0: all of them had */
};

static inline struct ern_cl_stream *ern_cl_stream_of(struct ern_stream *stream) {
  return (struct ern_cl_stream *)stream;
}
static inline struct ern_cl_backend *ern_cl_backend_of(struct ern_stream *stream) {
  return ern_cl_stream_of(stream)->owner;
}

/* Opens device `number`, as ern_opencl_devices_list counts. ERN_E_UNSUPPORTED names what there is instead. */
ERN_NODISCARD ern_status ern_cl_device_open(ern_context *context, int number, struct ern_cl_device *device);

/* Notes that the buffer's bytes change. */
static inline void ern_cl_touch(struct ern_cl_backend *backend, struct ern_buffer *buffer) {
  atomic_store(&buffer->written, atomic_fetch_add(&backend->writes, 1) + 1);
}

/* ERN_OK, or the error with the device's name and what was being done ("run mlp_fwd"). Out of memory is
 * ERN_E_NO_MEMORY, all else ERN_E_DEVICE; so is out of memory where the device no longer answers at all. */
ern_status ern_cl_check(struct ern_cl_backend *backend, cl_int code, const char *doing);
const char *ern_cl_error_name(cl_int code);

/* The program of a source and options ("" or "-D A=1 -D B=2"), built or from the cache when first asked for. It lives
 * as long as the backend. */
ERN_NODISCARD ern_status ern_cl_program_get(struct ern_cl_backend *backend, ern_cl_source source, const char *options,
                                            cl_program *program);
void ern_cl_programs_free(struct ern_cl_backend *backend);
enum { ERN_CL_KEY_BYTES = 65 };
/* The name of a program's binary, and so of all that it depends on. */
ERN_NODISCARD ern_status ern_cl_program_key(ern_context *context, const struct ern_cl_device *device,
                                            ern_cl_source source, const char *options, char key[ERN_CL_KEY_BYTES]);

/* Binaries of built programs, and what the tuner measured, in the user's cache folder ($XDG_CACHE_HOME/libernerf or
 * ~/.cache/libernerf). An entry that cannot be read, or whose sum is wrong, is as good as none. key: 64 hex digits. */
void ern_cl_cache_read(ern_context *context, const char *key, uint8_t **bytes, size_t *count); /* NULL: none */
bool ern_cl_cache_write(ern_context *context, const char *key, const void *bytes, size_t count);

/* ---- a launch: arguments in order, then run; the first error sticks and comes out of run ---- */

struct ern_cl_call {
  struct ern_cl_stream *stream;
  const char *name;
  cl_kernel kernel;
  cl_uint at; /* number of the next argument */
  ern_status status;
};

struct ern_cl_call ern_cl_begin(struct ern_stream *stream, ern_cl_source source, const char *kernel,
                                const char *options);
void ern_cl_span(struct ern_cl_call *call, ern_span span); /* a zeroed span is a null pointer in the kernel */
void ern_cl_rows(struct ern_cl_call *call, ern_rows rows); /* likewise */
void ern_cl_int(struct ern_cl_call *call, int value);
void ern_cl_size(struct ern_cl_call *call, size_t value); /* ulong */
void ern_cl_float(struct ern_cl_call *call, float value);
void ern_cl_value(struct ern_cl_call *call, const void *value, size_t bytes); /* a struct */
void ern_cl_local(struct ern_cl_call *call, size_t bytes);
/* `groups` work-groups of `group` items; 0 groups: nothing is run. */
ERN_NODISCARD ern_status ern_cl_run(struct ern_cl_call *call, size_t groups, size_t group);
/* At least `items` work-items, in groups that suit the device; a kernel checks its number. */
ERN_NODISCARD ern_status ern_cl_each(struct ern_cl_call *call, size_t items);

/* Blocking read of `count` floats or int32. */
ERN_NODISCARD ern_status ern_cl_read(struct ern_stream *stream, void *to, ern_span from, size_t count);

/* After a call that may have failed: what it left for `settle` would be written to arguments that are gone, and scratch
 * above what is in use is given back, as the next try may need it to be of other sizes. Returns `status`. */
ern_status ern_cl_clean_up(struct ern_stream *stream, ern_status status);

/* Room for `count` figures, which `settle` will hand to the function together with `args` (alive until then). The
 * values may be added up in double by the host: a float for each of a fixed number of groups. */
ERN_NODISCARD ern_status ern_cl_figures(struct ern_stream *stream, size_t count,
                                        void (*settle)(void *args, const float *values, size_t count), void *args,
                                        ern_span *span);

/* What every source is built with, made from the device: "-cl-std=CL1.2 -D WIDTH=16 ...". */
void ern_cl_base_options(const struct ern_cl_device *device, char *text, size_t bytes);

/* first[i] = sum of count[0..i), first[n] = the total, which is read back: the slot `scan`. */
ERN_NODISCARD ern_status ern_cl_scan(struct ern_stream *stream, ern_span first, ern_span count, size_t n,
                                     size_t *total);

/* Groups of a reduction, whatever the device: so that sums are the same everywhere. Each writes one figure. */
enum { ERN_CL_SUMS = 64, ERN_CL_SUM_GROUP = 64 };

/* Each file of slots fills its part of the table. */
void ern_cl_fill_march(struct ern_backend *table);     /* rays, march, scan, samples */
void ern_cl_fill_composite(struct ern_backend *table); /* composite, backdrop, picture, enlarge */
void ern_cl_fill_occupancy(struct ern_backend *table);
void ern_cl_fill_hashgrid(struct ern_backend *table);
void ern_cl_fill_mlp(struct ern_backend *table);
void ern_cl_fill_encoding(struct ern_backend *table); /* activations, SH, sines, region attention */
void ern_cl_fill_audio(struct ern_backend *table);
void ern_cl_fill_torso(struct ern_backend *table);
void ern_cl_fill_train(struct ern_backend *table); /* losses, optimizer */
void ern_cl_fill_steps(struct ern_backend *table); /* whole training steps, densities */
void ern_cl_fill_render(struct ern_backend *table);

struct ern_cl_portrait;
void ern_cl_portrait_free(struct ern_cl_stream *stream); /* accepts a stream without one */

#endif
