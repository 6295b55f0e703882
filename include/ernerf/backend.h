/* SPDX-License-Identifier: MIT
 * Where a portrait is computed: the CPU with one of its instruction sets, or an OpenCL device. */
#ifndef ERNERF_BACKEND_H
#define ERNERF_BACKEND_H

#include <stdbool.h>

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Read-only once made: any number of threads may make renderers and trainers on one, and describe it. A model belongs
 * to no backend. */
typedef struct ern_backend ern_backend;

enum { ERN_THREADS_MOST = 256 }; /* of a renderer, a trainer or a measurement */

/* Plain data, may grow. */
typedef struct ern_backend_config {
  uint32_t cookie, size; /* set by ern_backend_config_default() */
  const char *name;      /* "cpu", "opencl"; "auto" (default) or NULL: "cpu" */
  const char *isa;       /* instruction set of the CPU: "ref" (the reference, in float), "ref64" (the reference, in
                            double), "avx2", "avx512", "avx512bf16", "neon"; "auto" (default) or NULL: that of the
                            environment variable ERNERF_ISA, else the fastest that the machine has. One that the machine
                            lacks is ERN_E_UNSUPPORTED, also with "opencl", which does not use it otherwise */
  int device;            /* number of the OpenCL device, as ern_devices_list counts them; a number that no device has is
                            ERN_E_UNSUPPORTED */
  bool deterministic; /* of an OpenCL device: sums without atomics, so the same bytes on every run, which is slower on
                         some devices. On a CPU, "opencl" or not, results are the same on every run in any case */
  bool tune; /* of an OpenCL device: measure now which sizes of work-groups and tiles suit it, for up to two minutes,
                and keep the result for later runs in the user's cache folder. Without it a GPU is measured for up to 20
                seconds when it is first used */
} ern_backend_config;

/* The defaults. */
ERN_API void ern_backend_config_fill(ern_backend_config *config, size_t bytes);
static inline ern_backend_config ern_backend_config_default(void) {
  ern_backend_config config;
  ern_backend_config_fill(&config, sizeof config);
  return config;
}

/* On success the caller owns *backend. It serves any number of renderers and trainers of the context, and must outlive
 * them. ERN_E_UNSUPPORTED: the machine or the build lacks what the error text names. config NULL: the defaults. */
ERN_API ERN_NODISCARD ern_status ern_backend_create(ern_backend **backend, ern_context *context,
                                                    const ern_backend_config *config);
ERN_API void ern_backend_free(ern_backend **backend); /* accepts NULL and a pointer to NULL */

/* Plain data, may grow. */
typedef struct ern_backend_info {
  const char *name, *isa; /* live as long as the backend */
  int real_bytes;         /* 4, or 8 for ref64 */
  bool deterministic;     /* same inputs, same bytes, for any number of threads */
  int threads;            /* what 0 threads stand for here: the cores that this process may use, as its affinity mask
                             and the limits of its control groups (cgroups) have it; at most ERN_THREADS_MOST */
} ern_backend_info;

/* What the backend is. */
ERN_API void ern_backend_describe_sized(const ern_backend *backend, ern_backend_info *info, size_t bytes);
static inline void ern_backend_describe(const ern_backend *backend, ern_backend_info *info) {
  ern_backend_describe_sized(backend, info, sizeof *info);
}

/* A size of an OpenCL device's kernels: of a work-group, a tile, or how many there are. Plain data, may grow. */
typedef struct ern_tuning {
  const char *name; /* "mlp_fwd"; a literal */
  int standard;     /* the default, one for GPUs and one for CPUs; smaller where the device's limits require it */
  int best;         /* the fastest of the others that were tried; 0: it has not been measured */
  int used;         /* what kernels are built with: `best` where it was measured to be more than 5 % faster, else
                       `standard`; a size that may change results by rounding stays at `standard` where the backend
                       is `deterministic` */
  double standard_seconds, best_seconds; /* of a made-up call */
} ern_tuning;
/* Calls `say` for each size; for the CPU not at all. */
ERN_API void ern_backend_tuning(const ern_backend *backend, void (*say)(void *user, const ern_tuning *tuning),
                                void *user);

/* One line of `ernerf info devices`. Plain data, may grow. */
typedef struct ern_device_info {
  const char *kind;             /* "cpu" or "opencl" */
  int number;                   /* of the OpenCL device; 0 for the CPU */
  const char *name, *version;   /* as the system and the driver give them; version is "" for the CPU */
  const char *instruction_sets; /* of the CPU: "ref ref64 avx2 avx512"; "" otherwise */
  unsigned compute_units;       /* of the CPU: cores that this process may use; of an OpenCL device: its own */
  uint64_t memory_bytes;        /* of the CPU: memory that this process may take, limits of control groups included; of
                                   an OpenCL device: its global memory */
  /* of an OpenCL device; "", 0 and false for the CPU */
  const char *driver;                 /* its version */
  uint64_t buffer_bytes, local_bytes; /* one buffer at most; local memory of a work-group */
  bool half, subgroups;               /* half precision; groups that share registers */
  bool tuned;                         /* its sizes were measured (ern_backend_config's `tune`) */
  bool deterministic; /* the same bytes on every run; false: with ern_backend_config's `deterministic` alone */
  bool adds_floats;   /* adds to a float in memory by one instruction; false: by a loop of compare and swap */
  bool tensor_cores;  /* rendering uses them */
  bool kernels_kept;  /* the cache folder has kernels that an earlier frame, training or tuning built; never those of
                         PoCL, which keeps its own */
} ern_device_info;

/* Calls `say` for the CPU and each OpenCL device. A machine without OpenCL is no error. */
ERN_API ERN_NODISCARD ern_status ern_devices_list(ern_context *context,
                                                  void (*say)(void *user, const ern_device_info *device), void *user);

#ifdef __cplusplus
}
#endif
#endif
