/* SPDX-License-Identifier: MIT
 * Benchmarks: the machine's peak rates, and the share of them that the library reaches in each kernel, in a frame and
 * in a training step, on instruction sets of the CPU, on OpenCL devices, or on both. All figures of a call come from
 * one run: compared items are measured in turns.
 *
 * What is counted. FLOP: an addition or multiplication in the model's arithmetic counts one, a multiply-add two; a
 * division, square root, exponential or sine counts one; comparisons and index arithmetic count none. `flops_written`
 * follows the model's equations, `flops` the actual computation: the first is larger where a fused pass folds layers,
 * the second where the backward pass recomputes hidden values. Bytes: every input or output array, once; tables with
 * random access are counted by reads instead (32 bits each, in the double build 64). */
#ifndef ERNERF_LAB_BENCH_H
#define ERNERF_LAB_BENCH_H

#include <stdbool.h>

#include "ernerf/backend.h"
#include "ernerf/model.h"
#include "ernerf/render.h"

enum { ERN_BENCH_BACKENDS = 8, ERN_BENCH_STAGES = 16 };

typedef struct ern_bench_options {
  uint32_t cookie;
  int threads; /* for a frame, a step, and the peaks of all threads, 0..ERN_THREADS_MOST; 0: one for each core. Kernels
                  run on one thread, or on as many if a device is measured too */
  double seconds; /* approximate time of a call; what takes longer is still measured once. 0..86400; 5 */
  int frames;     /* most repeats of a frame, 1..1000; 16 */
  int rays;       /* of a training step, 1..1048576; 65536 */
  uint64_t seed;  /* of random rays and values */
  /* Called with the number of completed parts; a non-zero return value stops with ERN_E_CANCELLED. NULL: none. */
  int (*progress)(void *user, size_t done, size_t all);
  void *user;
} ern_bench_options;
ern_bench_options ern_bench_options_default(void);

/* Seconds of one call, on a device until its completion. Single-threaded items (peaks of one thread, kernels) are
 * measured in CPU time, which equals wall-clock time on an idle machine; all others in wall-clock time. */
typedef struct ern_bench_timing {
  double least, median;
  double cpu; /* the least CPU time of all threads together: meaningful also on a machine shared with others */
  int repeats;
} ern_bench_timing;

/* ---- peaks ------------------------------------------------------------------------------------------------------- */

/* The best rate of several repeats, per second: of one thread, and of all threads at once. For a device both are the
 * whole device's. */
typedef struct ern_bench_rate {
  double one, all;
} ern_bench_rate;

typedef struct ern_bench_peak {
  const char *backend;  /* "cpu" or "opencl"; lives as long as its backend, as `isa` does */
  const char *isa;      /* for a device its name */
  ern_bench_rate flops; /* multiply-adds in registers, FLOP. For ref and ref64: separate products and sums in scalar
                           code, as the reference is built */
  ern_bench_rate reads; /* of 32 bits at random places of a table of 64 KiB, the size of a level of the hash grid */
  /* For a device; 0 for the CPU, whose streams are in ern_bench_machine. */
  unsigned units;     /* compute units */
  size_t cache_bytes; /* of its memory; 0: not known */
  /* Bytes read and written by the fastest of a copy, an update in place and the driver's copy: on arrays of half the
   * cache (unknown: the same as stream_memory), and of four times the cache (64 to 512 MiB). */
  ern_bench_rate stream_cache, stream_memory;
} ern_bench_peak;

typedef struct ern_bench_machine {
  int threads;               /* of the `all` figures */
  size_t l2_bytes, l3_bytes; /* by the operating system; else guesses (1 MiB, 32 MiB) */
  /* Bytes read and written by the fastest of memcpy, a copy and an update in place, with the last instruction set: on
   * arrays of half of L2, half of L3, and four times L3 (64 to 512 MiB); the threads share the last two. 0 if no
   * backend is the CPU. */
  ern_bench_rate stream_l2, stream_l3, stream_memory;
  ern_bench_peak peak[ERN_BENCH_BACKENDS]; /* one for each backend, in the order of the call */
  size_t peaks;
  double unrest; /* largest median over least of the multiply-adds on all threads: well above 1 where other programs
                    take the processor's time, and all figures are then too low */
} ern_bench_machine;

/* `backends`: 1..ERN_BENCH_BACKENDS, all of one context. options NULL: the defaults. */
ERN_NODISCARD ern_status ern_bench_peaks(ern_backend *const *backends, size_t count, const ern_bench_options *options,
                                         ern_bench_machine *machine);

/* ---- the scene --------------------------------------------------------------------------------------------------- */

/* A model, a frame to draw and pixels to learn from. Read-only once made. */
typedef struct ern_bench_scene ern_bench_scene;

/* Creates a synthetic scene: a model with eye, codes and torso, 14 levels, whose density is a shell of the size of a
 * head and otherwise random, seen from the front. width, height: 1..8192; a portrait has 450 x 450. On success the
 * caller owns *scene. */
ERN_NODISCARD ern_status ern_bench_scene_make(ern_bench_scene **scene, ern_context *context, int width, int height,
                                              uint64_t seed);

/* Creates a scene from a model. The frame is an input of ern_renderer_frame, with a background. truth:
 * [height][width][3] of the picture to train on; face: the box of the landmarks, NULL: the whole picture. `model` and
 * what the frame points to must outlive the scene. */
ERN_NODISCARD ern_status ern_bench_scene_of(ern_bench_scene **scene, ern_context *context, const ern_model *model,
                                            const ern_frame_input *frame, const uint8_t *truth, const ern_box *face);
void ern_bench_scene_free(ern_bench_scene **scene); /* accepts NULL and a pointer to NULL */

typedef struct ern_bench_scene_info {
  bool made_up, has_torso;
  int width, height, levels;
  double occupied;     /* share of the cells of the scene */
  size_t parameters;   /* numbers of the model */
  size_t pixels;       /* of the frame */
  size_t hits;         /* rays with a sample */
  size_t marched;      /* samples in occupied cells */
  size_t lit;          /* of these, samples before the ray's transmittance is used up */
  double sample_flops; /* FLOP of one sample by the equations: encoder, attention, density and colour */
  double folded_flops; /* the same for a fused pass: values constant over a ray or frame are not counted, and the last
                          layer of the density and the first of the colour are folded into one */
} ern_bench_scene_info;
/* sample_flops for any head, the rows of the paper's ablation included, whose scenes are not benched. */
double ern_bench_sample_flops(const ern_model *model);

/* Counts by marching and shading the frame once, on `backend`. threads as in ern_bench_options. */
ERN_NODISCARD ern_status ern_bench_scene_describe(const ern_bench_scene *scene, ern_backend *backend, int threads,
                                                  ern_bench_scene_info *info);

/* ---- kernels ----------------------------------------------------------------------------------------------------- */

typedef struct ern_bench_kernel {
  const char *name;          /* "density_fwd"; static, as `item` */
  const char *item;          /* unit of work: "sample", "ray", "pixel", "cell", "value", "frame" */
  const char *backend, *isa; /* of its backend */
  int threads;               /* 1, or beside a device those of the options; of a device its compute units */
  double items;              /* number of items in one call; the next four are also for one call */
  double flops_written, flops;
  double bytes, reads;      /* 0: none are counted */
  ern_bench_timing seconds; /* of one call */
  double share; /* share of the peak that limits it (roofline): the largest of FLOP, bytes and reads, each divided by
                   the peak rate of as many threads or of the device, divided by the least time. NaN where the work
                   cannot be counted before the run */
  const char *bound; /* "flops", "l2", "l3", "cache" (device), "memory", "reads" or "": the limiting resource. Bytes are
                        compared with the stream rate of the smallest level that holds all arrays of the kernel */
} ern_bench_kernel;

/* Each kernel on each backend, with the sizes and the samples of the scene; calls `say` for each. A non-zero answer of
 * `say` stops with ERN_E_CANCELLED. `machine`: peaks of the same backends; NULL: every share is NaN. If all backends
 * are instruction sets of the CPU, each runs on one thread with data that fits its L2. If one backend is a device, all
 * run on all of their threads with the samples of options.rays rays. */
ERN_NODISCARD ern_status ern_bench_kernels(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                                           const ern_bench_machine *machine, const ern_bench_options *options,
                                           int (*say)(void *user, const ern_bench_kernel *kernel), void *user);

/* ---- a frame, a step --------------------------------------------------------------------------------------------- */

typedef struct ern_bench_stage {
  const char *name; /* static */
  double seconds;   /* mean of a call; sum over all threads / number of threads */
} ern_bench_stage;

/* The stages of a device are measured in extra calls after the timed ones. These wait for each slot, so the sum of the
 * stages may exceed the time of the whole pass, which does not wait. */
typedef struct ern_bench_pass {
  const char *backend, *isa; /* of its backend */
  int threads;               /* of a device its compute units */
  bool fused;                /* one fused pass, not stage by stage */
  ern_bench_timing seconds;  /* of a call */
  double rays;               /* of a call: pixels of a frame, rays of a step; the next ones too, 0: not counted */
  double marched, evaluated, colours; /* samples in occupied cells, with computed density, with computed colour */
  double flops_written, flops;
  double share;                            /* of the peak of all threads or of the device; NaN without peaks */
  ern_bench_stage stage[ERN_BENCH_STAGES]; /* parts of the whole; the remaining time is in none of them */
  int stages;
} ern_bench_pass;

/* results: [count]. A frame from speech and pose to 8-bit pixels, options.frames times at most. */
ERN_NODISCARD ern_status ern_bench_frame(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                                         const ern_bench_machine *machine, const ern_bench_options *options,
                                         ern_bench_pass *results);

/* A training step of the head, or of the torso (ERN_E_ARGUMENT where the scene has none): rays, forward, backward,
 * update, and its share of an occupancy refresh and of the smoothness term, both in stages of their own. The model does
 * not change: the learning rates are 0. CPU time is that of a plain step. */
ERN_NODISCARD ern_status ern_bench_step(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                                        const ern_bench_machine *machine, const ern_bench_options *options, bool torso,
                                        ern_bench_pass *results);

/* ---- hash collisions --------------------------------------------------------------------------------------------- */

typedef struct ern_bench_collision_count {
  size_t cells;      /* distinct cells that contain points */
  double collisions; /* look-ups of their corners whose entry was already taken by another vertex, times 1/8 (3D) or 1/4
                        (2D) */
} ern_bench_collision_count;

typedef struct ern_bench_collision_table {
  size_t points; /* samples of the frame in occupied cells, 16 a ray at most */
  double scale; /* factor that scales their coordinates about the centre, so that the longest side of their bounding box
                   equals the scene's: the supplement scales too, by an unstated factor */
  ern_bench_collision_count volume;   /* one 3D grid of 2^14 entries */
  ern_bench_collision_count plane[3]; /* of 2^14/3 entries each: frontal (xz), and the sides xy and yz */
} ern_bench_collision_table;

/* Hash collisions of one look-up step of the scene's frame at resolution 512, everything hashed: the table of the
 * paper's supplement ("The Number of Hash Collisions"; there 835186 against 138345 + 31041 + 26048). Points in one cell
 * have the same look-ups and count once. */
ERN_NODISCARD ern_status ern_bench_collisions(ern_backend *backend, const ern_bench_scene *scene,
                                              ern_bench_collision_table *table);

#endif
